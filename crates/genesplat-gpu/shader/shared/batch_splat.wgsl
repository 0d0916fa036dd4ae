// What kernels that walk the list of a tile have in common: a splat of the batch in workgroup memory, and, going
// forward, which pixel an invocation has.

struct BatchSplat {
    // Mean, px from the tile's corner.
    mean_px: vec2<f32>,
    log2_opacity: f32,
    conic_log2: vec3<f32>,
    rgb: vec3<f32>,
}

// One that reaches nothing.
fn absent_splat() -> BatchSplat {
    return BatchSplat(vec2(0.0), -1e3, vec3(0.0), vec3(0.0));
}

fn load_batch_splat(row: u32, origin: vec2<f32>) -> BatchSplat {
    if row == NO_SPLAT {
        return absent_splat();
    }
    let a = splats[3u * row];
    return BatchSplat(a.xy - origin, a.z, splats[3u * row + 1u].xyz, splats[3u * row + 2u].xyz);
}

// The pixel of an invocation: 32 in a row have a block of 8x4, and 64 one of 8x8. What runs in lockstep passes over a
// splat only together, and a compact block is missed by more splats than two rows of pixels are.
fn pixel_of(lane: u32) -> vec2<u32> {
    return vec2((lane & 7u) | ((lane >> 3u) & 8u), ((lane >> 3u) & 7u) | ((lane >> 4u) & 8u));
}
