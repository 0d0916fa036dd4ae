// Stage `rasterise`: blends the splats of each tile front to back, one pixel an invocation. A splat is passed
// over where its ellipse misses the block of pixels that runs in lockstep: the list has it if it reaches any
// block.
//
// A pixel is finished when a splat would leave less than 1e-4 of its light: that splat is not blended into
// it, nor is any other.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
// Numbers of the intersections, tile after tile.
@group(0) @binding(2) var<storage, read> intersections: array<u32>;
@group(0) @binding(3) var<storage, read> intersection_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<vec4<f32>>;
// [3, H, W], then what of the light behind all splats reaches each pixel, if it is asked for.
override TRANSMITTANCE: bool = false;
@group(0) @binding(5) var<storage, read_write> image: array<f32>;
// Of those that this dispatch has.
@group(0) @binding(6) var<uniform> first_tile_row: u32;

var<workgroup> range: vec2<u32>;
// In groups that are blended at once: naga checks the number of the group, and constants cost nothing.
var<workgroup> batch: array<array<BatchSplat, SPLATS_AT_ONCE>, TILE_PIXELS / SPLATS_AT_ONCE>;
var<workgroup> finished_pixels: atomic<u32>;
var<workgroup> all_finished: u32;

// One pixel, blended so far.
struct Blended {
    // px from the tile's corner
    at: vec2<f32>,
    colour: vec3<f32>,
    transmittance: f32,
    // Splats with a smaller exponent do not reach the pixel; where it is finished, that is all of them.
    exponent_min: f32,
}

// Above the logarithm of every opacity.
const FINISHED: f32 = 1.0;

// Blends a splat of the batch into a pixel, unless that would leave less than 1e-4 of the light: then the
// pixel is finished.
fn blend(blended: ptr<function, Blended>, splat: BatchSplat) {
    let exponent = exponent_at(splat.conic_log2, splat.log2_opacity, splat.mean_px - (*blended).at);
    if exponent < (*blended).exponent_min {
        return;
    }
    let weight = (*blended).transmittance * min(exp2(exponent), ALPHA_MAX);
    let next = (*blended).transmittance - weight;
    if next < TRANSMITTANCE_MIN {
        (*blended).exponent_min = FINISHED;
        atomicAdd(&finished_pixels, 1u);
        return;
    }
    (*blended).colour += weight * splat.rgb;
    (*blended).transmittance = next;
}

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = group + vec3(0u, first_tile_row, 0u);
    let local = pixel_of(lane);
    let pixel = tile.xy * TILE + local;
    let inside = pixel.x < view.width && pixel.y < view.height;
    if lane == 0u {
        range = ranges[tile.y * view.tiles_x + tile.x];
        atomicStore(&finished_pixels, 0u);
    }
    let intersection_range = workgroupUniformLoad(&range);

    var blended = Blended(vec2<f32>(local), vec3(0.0), 1.0, select(FINISHED, -LOG2_255, inside));
    if !inside {
        atomicAdd(&finished_pixels, 1u);
    }
    let own_block = 1u << (lane / BLOCK_PIXELS);
    for (var first = intersection_range.x; first < intersection_range.y; first += TILE_PIXELS) {
        // 1. Is any pixel unfinished? The barriers in this also end the batch before.
        workgroupBarrier();
        if lane == 0u {
            all_finished = u32(atomicLoad(&finished_pixels) == TILE_PIXELS);
        }
        if workgroupUniformLoad(&all_finished) == 1u {
            break;
        }
        // 2. Load the next splats, one an invocation.
        var splat = absent_splat();
        if first + lane < intersection_range.y {
            splat = load_batch_splat(intersection_splats[intersections[first + lane]], tile.xy);
        }
        batch[lane / SPLATS_AT_ONCE][lane % SPLATS_AT_ONCE] = splat;
        workgroupBarrier();
        // 3. Blend, several at once: that spares tests of the loop.
        let count = min(TILE_PIXELS, intersection_range.y - first);
        for (var group = 0u; SPLATS_AT_ONCE * group < count && blended.exponent_min < FINISHED; group++) {
            for (var slot = 0u; slot < SPLATS_AT_ONCE; slot++) {
                if (batch[group][slot].blocks & own_block) != 0u {
                    blend(&blended, batch[group][slot]);
                }
            }
        }
    }
    if inside {
        let value = blended.colour + blended.transmittance * view.background.xyz;
        let pixels = view.width * view.height;
        let out = pixel.y * view.width + pixel.x;
        image[out] = value.x;
        image[pixels + out] = value.y;
        image[2u * pixels + out] = value.z;
        if TRANSMITTANCE {
            image[3u * pixels + out] = blended.transmittance;
        }
    }
}
