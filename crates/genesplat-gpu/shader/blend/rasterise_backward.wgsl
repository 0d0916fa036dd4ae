// Stage `rasterise_backward`: from dL/dimage to one row of sums per intersection of a splat with a tile.
//
// Walks the lists front to back once more, as the forward pass does: with the final image known, the light behind a
// splat is what remains of it, so neither alphas nor transmittances are stored. Eight splats at a time:
// 1. each invocation is a pixel and leaves p = o G dL/dalpha and w = alpha T of each splat in workgroup memory;
// 2. each invocation is one of 32 parts of a splat and sums eight pixels of it;
// 3. each invocation is one column of a splat's row and sums its 32 parts.
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
// absolute values of dL/du and of dL/dv by pixel, and the number of pixels blended.
@group(0) @binding(7) var<storage, read_write> intersection_gradients: array<f32>;

const COLUMNS: u32 = 12u;
// Invocations that sum one splat in step 2.
const PARTS: u32 = TILE_PIXELS / SPLATS_AT_ONCE;
// Splats that are loaded at once.
const BATCH: u32 = 64u;

var<workgroup> range: vec2<u32>;
var<workgroup> batch: array<BatchSplat, BATCH>;
var<workgroup> batch_intersections: array<u32, BATCH>;
// p of each splat and pixel, then w; later the parts of the sums.
var<workgroup> partial_sums: array<f32, 2u * SPLATS_AT_ONCE * TILE_PIXELS>;
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
    finished: bool,
}

// Blends one splat once more; returns p and w.
fn replay(pixel: ptr<function, Pixel>, splat: BatchSplat) -> vec2<f32> {
    if (*pixel).finished {
        return vec2(0.0);
    }
    let exponent = exponent_at(splat.conic_log2, splat.log2_opacity, splat.mean_px - (*pixel).at);
    if exponent < -LOG2_255 {
        return vec2(0.0);
    }
    let unclamped = exp2(exponent);
    let alpha = min(unclamped, ALPHA_MAX);
    let weight = (*pixel).transmittance * alpha;
    let next = (*pixel).transmittance - weight;
    if next < TRANSMITTANCE_MIN {
        (*pixel).finished = true;
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

// Sums of eight pixels of one splat: pixels `part`, `part + 32`, ... of the tile, which lie in one column.
fn sum_part(splat: BatchSplat, slot: u32, part: u32) -> array<f32, COLUMNS> {
    let dx = f32(part % TILE) - splat.mean_px.x;
    let a = -LN_2 * splat.conic_log2;
    var moments = vec3(0.0);
    var rgb = vec3(0.0);
    var absolute = vec2(0.0);
    var pixels = 0.0;
    for (var i = 0u; i < TILE_PIXELS / PARTS; i++) {
        let pixel = part + i * PARTS;
        let p = partial_sums[slot * TILE_PIXELS + pixel];
        let w = partial_sums[(SPLATS_AT_ONCE + slot) * TILE_PIXELS + pixel];
        let dy = f32(pixel / TILE) - splat.mean_px.y;
        moments += p * vec3(1.0, dy, dy * dy);
        rgb += w * pixel_gradients[pixel];
        if view.signal >= SIGNAL_ABSOLUTE {
            absolute += abs(p * vec2(2.0 * a.x * dx + a.y * dy, a.y * dx + 2.0 * a.z * dy));
            pixels += f32(w > 0.0);
        }
    }
    return array(
        moments.x, dx * moments.x, moments.y, dx * dx * moments.x, dx * moments.y, moments.z,
        rgb.x, rgb.y, rgb.z, absolute.x, absolute.y, pixels,
    );
}

// Sums the parts of one column. Each invocation begins at another part, so that no two ask the same memory bank; there
// are four sums, so that no addition waits for the one before it.
fn sum_column(lane: u32) -> f32 {
    let first = lane * PARTS;
    var sums = vec4(0.0);
    for (var i = 0u; i < PARTS; i += 4u) {
        let part = lane + i;
        sums += vec4(
            partial_sums[first + part % PARTS], partial_sums[first + (part + 1u) % PARTS], partial_sums[first + (part + 2u) % PARTS],
            partial_sums[first + (part + 3u) % PARTS]);
    }
    return (sums.x + sums.y) + (sums.z + sums.w);
}

@compute @workgroup_size(TILE, TILE)
fn main(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let origin = vec2(f32(tile.x * TILE), f32(tile.y * TILE));
    let place = tile.xy * TILE + local.xy;
    if lane == 0u {
        range = ranges[tile.y * view.tiles_x + tile.x];
        atomicStore(&finished_pixels, 0u);
    }
    let intersection_range = workgroupUniformLoad(&range);

    var pixel = Pixel(vec2<f32>(local.xy), vec3(0.0), 1.0, 0.0, true);
    if place.x < view.width && place.y < view.height {
        let pixels = view.width * view.height;
        let at = place.y * view.width + place.x;
        let colour = vec3(image[at], image[pixels + at], image[2u * pixels + at]);
        pixel.gradient = vec3(gradient[at], gradient[pixels + at], gradient[2u * pixels + at]);
        pixel.remaining = dot(colour, pixel.gradient);
        pixel.finished = false;
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
                batch[lane] = load_batch_splat(intersection_splats[intersection], origin);
            }
        }
        workgroupBarrier();
        let count = min(BATCH, intersection_range.y - first);
        for (var start = 0u; start < count; start += SPLATS_AT_ONCE) {
            // 1. Pixels.
            for (var slot = 0u; slot < SPLATS_AT_ONCE; slot++) {
                let p_w = replay(&pixel, batch[start + slot]);
                partial_sums[slot * TILE_PIXELS + lane] = p_w.x;
                partial_sums[(SPLATS_AT_ONCE + slot) * TILE_PIXELS + lane] = p_w.y;
            }
            workgroupBarrier();
            // 2. Parts of splats.
            let sums = sum_part(batch[start + lane / PARTS], lane / PARTS, lane % PARTS);
            workgroupBarrier();
            for (var column = 0u; column < COLUMNS; column++) {
                partial_sums[(lane / PARTS * COLUMNS + column) * PARTS + lane % PARTS] = sums[column];
            }
            workgroupBarrier();
            // 3. Columns of rows.
            if lane < SPLATS_AT_ONCE * COLUMNS && start + lane / COLUMNS < count {
                intersection_gradients[batch_intersections[start + lane / COLUMNS] * COLUMNS + lane % COLUMNS] = sum_column(lane);
            }
            workgroupBarrier();
        }
    }
    // Nothing behind the last pixel's end has a gradient.
    for (var at = first * COLUMNS + lane; at < intersection_range.y * COLUMNS; at += TILE_PIXELS) {
        intersection_gradients[intersections[at / COLUMNS] * COLUMNS + at % COLUMNS] = 0.0;
    }
}
