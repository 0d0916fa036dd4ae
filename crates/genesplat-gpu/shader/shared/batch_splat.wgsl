// What kernels that walk the list of a tile have in common: a splat of the batch in workgroup memory, and
// which pixel an invocation has. Needs `view` and `splats`.

struct BatchSplat {
    // Mean, px from the tile's corner.
    mean_px: vec2<f32>,
    log2_opacity: f32,
    // Bit b is set where the splat can reach pixels of invocations 32 b to 32 b + 31, which are a block of
    // 8x4.
    blocks: u32,
    conic_log2: vec3<f32>,
    rgb: vec3<f32>,
}

// Blocks of a tile, and the invocations of each.
const BLOCKS: u32 = 8u;
const BLOCK_PIXELS: u32 = TILE_PIXELS / BLOCKS;

// One that reaches nothing.
fn absent_splat() -> BatchSplat {
    return BatchSplat(vec2(0.0), 0.0, 0u, vec3(0.0), vec3(0.0));
}

fn load_batch_splat(row: u32, tile: vec2<u32>) -> BatchSplat {
    if row == NO_SPLAT {
        return absent_splat();
    }
    let splat = splat_from(splats[3u * row], splats[3u * row + 1u], splats[3u * row + 2u]);
    let blocks = blocks_of(spans_of(splat, tile.y), i32(tile.x));
    return BatchSplat(splat.mean_px - vec2<f32>(tile * TILE), splat.log2_opacity, blocks, splat.conic_log2, splat.rgb);
}

// The blocks that the spans of a tile row meet in one of its tiles: the band of four pixel rows that a block
// is in has two of them.
fn blocks_of(spans: Spans, tile_x: i32) -> u32 {
    let first = vec4(4 * tile_x);
    let left = max(spans.begin, first) < min(spans.end, first + 2);
    let right = max(spans.begin, first + 2) < min(spans.end, first + 4);
    let bits = select(vec4(0u), vec4(1u, 2u, 16u, 32u), left) | select(vec4(0u), vec4(4u, 8u, 64u, 128u), right);
    return bits.x | bits.y | bits.z | bits.w;
}

// Whether a splat that reaches these blocks reaches that of an invocation.
fn reaches_block(blocks: u32, lane: u32) -> bool {
    return ((blocks >> (lane / BLOCK_PIXELS)) & 1u) != 0u;
}

// The pixel of an invocation: 32 in a row have a block of 8x4, and 64 one of 8x8. What runs in lockstep
// passes over a splat only together, and a compact block is missed by more splats than two rows of pixels
// are.
fn pixel_of(lane: u32) -> vec2<u32> {
    return vec2((lane & 7u) | ((lane >> 3u) & 8u), ((lane >> 3u) & 7u) | ((lane >> 4u) & 8u));
}
