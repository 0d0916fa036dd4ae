// Stage `rasterise_backward`: from dL/dimage to one row of sums per intersection of a splat with a tile.
//
// Walks the lists front to back once more, as the forward pass does: with the final image known, the light behind a
// splat is what remains of it, so neither alphas nor transmittances are stored. Eight splats at a time:
// 1. each invocation is a pixel and leaves p = o G dL/dalpha and w = alpha T of each splat in workgroup memory;
// 2. each invocation is one of 32 parts of a splat and sums eight pixels of it, one of each block;
// 3. each invocation is one column of a splat's row and sums its 32 parts.
// Blocks that the splat's ellipse misses are passed over in steps 1 and 2.
//
// So a splat's gradient is reduced once per tile, no two workgroups write the same row, and there are no atomics: the
// result is the same on every run.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> intersections: array<u32>;
@group(0) @binding(3) var<storage, read> intersection_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> image: array<f32>;
@group(0) @binding(6) var<storage, read> gradient: array<f32>;
// [I, 12]: sums of p times 1, dx, dy, dx^2, dx dy, dy^2, offsets (pixel - mean) in px; dL/drgb; then the sums of the
// absolute values of dL/du and of dL/dv by pixel, and the number of pixels blended that have a gradient.
@group(0) @binding(7) var<storage, read_write> intersection_gradients: array<f32>;

const COLUMNS: u32 = 12u;
// Invocations that sum one splat in step 2.
const PARTS: u32 = BLOCK_PIXELS;
// Splats that are loaded at once.
const BATCH: u32 = 64u;

var<workgroup> range: vec2<u32>;
var<workgroup> batch: array<BatchSplat, BATCH>;
var<workgroup> batch_intersections: array<u32, BATCH>;
// p of each splat and pixel, then w [slots, blocks, pixels]; later the parts of the sums [columns, slots, parts]: there
// are as many slots as blocks. In three dimensions, so that naga checks numbers that stay the same; constants cost
// nothing.
var<workgroup> partial_sums: array<array<array<f32, BLOCK_PIXELS>, BLOCKS>, 2u * SPLATS_AT_ONCE>;
var<workgroup> pixel_gradients: array<vec3<f32>, TILE_PIXELS>;
var<workgroup> finished_pixels: atomic<u32>;
var<workgroup> all_finished: u32;

// One pixel on its way through the list.
struct Pixel {
    at: vec2<f32>,
    gradient: vec3<f32>,
    transmittance: f32,
    // Light that the splats still to come and the background send along the gradient.
    remaining: f32,
    // Splats with a smaller exponent do not reach the pixel; where it is finished, that is all of them.
    exponent_min: f32,
}

// Above the logarithm of every opacity.
const FINISHED: f32 = 1.0;

// Blends one splat once more; returns p and w.
fn replay(pixel: ptr<function, Pixel>, splat: BatchSplat) -> vec2<f32> {
    let exponent = exponent_at(splat.conic_log2, splat.log2_opacity, splat.mean_px - (*pixel).at);
    if exponent < (*pixel).exponent_min {
        return vec2(0.0);
    }
    let unclamped = exp2(exponent);
    let alpha = min(unclamped, ALPHA_MAX);
    let weight = (*pixel).transmittance * alpha;
    let next = (*pixel).transmittance - weight;
    if next < TRANSMITTANCE_MIN {
        (*pixel).exponent_min = FINISHED;
        atomicAdd(&finished_pixels, 1u);
        return vec2(0.0);
    }
    // dL/dalpha: what the splat adds itself, less what it takes from everything behind it. The clamp at 0.99 is
    // ignored, as published (straight-through).
    let own = dot((*pixel).gradient, splat.rgb);
    let remaining = (*pixel).remaining - weight * own;
    let alpha_gradient = (*pixel).transmittance * own - remaining / (1.0 - alpha);
    (*pixel).remaining = remaining;
    (*pixel).transmittance = next;
    return vec2(unclamped * alpha_gradient, weight);
}

// Sums of up to eight pixels of one splat: invocation `part` of each block that the splat reaches.
fn sum_part(splat: BatchSplat, slot: u32, part: u32) -> array<f32, COLUMNS> {
    let from_mean = vec2<f32>(pixel_of(part)) - splat.mean_px;
    let a = -LN_2 * splat.conic_log2;
    var moments = vec3(0.0);
    var second_moments = vec3(0.0);
    var rgb = vec3(0.0);
    var absolute = vec2(0.0);
    var pixels = 0.0;
    for (var block = 0u; block < BLOCKS; block++) {
        if ((splat.blocks >> block) & 1u) != 0u {
            let pixel = block * BLOCK_PIXELS + part;
            let p = partial_sums[slot][block][part];
            let w = partial_sums[SPLATS_AT_ONCE + slot][block][part];
            let d = from_mean + vec2<f32>(pixel_of(block * BLOCK_PIXELS));
            let p_d = p * d;
            moments += vec3(p, p_d);
            second_moments += vec3(p_d.x * d.x, p_d.x * d.y, p_d.y * d.y);
            rgb += w * pixel_gradients[pixel];
            if view.signal >= SIGNAL_ABSOLUTE {
                absolute += abs(p * vec2(2.0 * a.x * d.x + a.y * d.y, a.y * d.x + 2.0 * a.z * d.y));
                // What a mask hides has no gradient.
                pixels += f32(w > 0.0 && any(pixel_gradients[pixel] != vec3(0.0)));
            }
        }
    }
    return array(
        moments.x, moments.y, moments.z, second_moments.x, second_moments.y, second_moments.z,
        rgb.x, rgb.y, rgb.z, absolute.x, absolute.y, pixels,
    );
}

// Sums the parts of one column. Each invocation begins at another part, so that no two ask the same memory bank; there
// are four sums, so that no addition waits for the one before it.
fn sum_column(slot: u32, column: u32, lane: u32) -> f32 {
    var sums = vec4(0.0);
    for (var i = 0u; i < PARTS; i += 4u) {
        sums += vec4(
            partial_sums[column][slot][(lane + i) % PARTS], partial_sums[column][slot][(lane + i + 1u) % PARTS],
            partial_sums[column][slot][(lane + i + 2u) % PARTS], partial_sums[column][slot][(lane + i + 3u) % PARTS]);
    }
    return (sums.x + sums.y) + (sums.z + sums.w);
}

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = pixel_of(lane);
    let place = tile.xy * TILE + local;
    if lane == 0u {
        range = ranges[tile.y * view.tiles_x + tile.x];
        atomicStore(&finished_pixels, 0u);
    }
    let intersection_range = workgroupUniformLoad(&range);

    var pixel = Pixel(vec2<f32>(local), vec3(0.0), 1.0, 0.0, FINISHED);
    if place.x < view.width && place.y < view.height {
        let pixels = view.width * view.height;
        let at = place.y * view.width + place.x;
        let colour = vec3(image[at], image[pixels + at], image[2u * pixels + at]);
        pixel.gradient = vec3(gradient[at], gradient[pixels + at], gradient[2u * pixels + at]);
        pixel.remaining = dot(colour, pixel.gradient);
        pixel.exponent_min = -LOG2_255;
    } else {
        atomicAdd(&finished_pixels, 1u);
    }
    pixel_gradients[lane] = pixel.gradient;

    var first = intersection_range.x;
    for (; first < intersection_range.y; first += BATCH) {
        workgroupBarrier();
        if lane == 0u {
            all_finished = u32(atomicLoad(&finished_pixels) == TILE_PIXELS);
        }
        if workgroupUniformLoad(&all_finished) == 1u {
            break;
        }
        if lane < BATCH {
            batch[lane] = absent_splat();
            if first + lane < intersection_range.y {
                let intersection = intersections[first + lane];
                batch_intersections[lane] = intersection;
                batch[lane] = load_batch_splat(intersection_splats[intersection], tile.xy);
            }
        }
        workgroupBarrier();
        let count = min(BATCH, intersection_range.y - first);
        for (var start = 0u; start < count; start += SPLATS_AT_ONCE) {
            // 1. Pixels.
            for (var slot = 0u; slot < SPLATS_AT_ONCE; slot++) {
                if reaches_block(start + slot, lane) {
                    let p_w = replay(&pixel, batch[start + slot]);
                    partial_sums[slot][lane / BLOCK_PIXELS][lane % BLOCK_PIXELS] = p_w.x;
                    partial_sums[SPLATS_AT_ONCE + slot][lane / BLOCK_PIXELS][lane % BLOCK_PIXELS] = p_w.y;
                }
            }
            workgroupBarrier();
            // 2. Parts of splats.
            let sums = sum_part(batch[start + lane / PARTS], lane / PARTS, lane % PARTS);
            workgroupBarrier();
            for (var column = 0u; column < COLUMNS; column++) {
                partial_sums[column][lane / PARTS][lane % PARTS] = sums[column];
            }
            workgroupBarrier();
            // 3. Columns of rows.
            if lane < SPLATS_AT_ONCE * COLUMNS && start + lane / COLUMNS < count {
                let row = batch_intersections[start + lane / COLUMNS];
                let sum = sum_column(lane / COLUMNS, lane % COLUMNS, lane);
                intersection_gradients[row * COLUMNS + lane % COLUMNS] = sum;
            }
            workgroupBarrier();
        }
    }
    // Nothing behind the last pixel's end has a gradient.
    for (var at = first * COLUMNS + lane; at < intersection_range.y * COLUMNS; at += TILE_PIXELS) {
        intersection_gradients[intersections[at / COLUMNS] * COLUMNS + at % COLUMNS] = 0.0;
    }
}
