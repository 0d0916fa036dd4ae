// Stage `score`, step 2: the pictures that sixteen individuals make of one tile, one pixel an invocation.
//
// The list of a tile has the row versions of the whole pool. Of the next 256 those that any of the sixteen
// holds are loaded; the alpha of each is evaluated once, and blended for those that hold it.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> intersections: array<u32>;
@group(0) @binding(3) var<storage, read> intersection_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<vec4<f32>>;
// A bit an individual [K, HOLDER_WORDS].
@group(0) @binding(5) var<storage, read> holders: array<u32>;
// [layers, 3, H, W]
@group(0) @binding(6) var<storage, read_write> images: array<f32>;
// Of those that this dispatch has.
@group(0) @binding(7) var<uniform> first_tile_row: u32;

// A bit for each individual that the workgroup renders.
const ALL_SLOTS: u32 = (1u << SLOTS) - 1u;
// Words with a bit for each intersection that is looked at.
const WANTED_WORDS: u32 = TILE_PIXELS / 32u;
// Parts of a power of two in which dimming is counted, and what rounding may add to it.
const DIMMING_STEPS: f32 = 256.0;
const DIMMING_SLACK: f32 = 1.001;

var<workgroup> range: vec2<u32>;
var<workgroup> batch: array<BatchSplat, TILE_PIXELS>;
// The individuals that hold each splat: a bit a slot.
var<workgroup> batch_holders: array<u32, TILE_PIXELS>;
var<workgroup> wanted: array<atomic<u32>, WANTED_WORDS>;
// The most that the batch can dim a pixel, in parts of a power of two.
var<workgroup> batch_dimming: atomic<u32>;
var<workgroup> finished_pixels: atomic<u32>;
var<workgroup> all_finished: u32;

// Transmittance of a slot without an individual; that of a finished pixel is -0.01 or above.
const EMPTY_SLOT: f32 = -1.0;

// One pixel of four individuals, blended so far. A transmittance is negative where the pixel is finished.
struct Accumulated {
    transmittance: vec4<f32>,
    red: vec4<f32>,
    green: vec4<f32>,
    blue: vec4<f32>,
}

// Before the first splat; finished from the start where there is no individual, or no pixel.
fn initial(first_slot: u32, slots: u32) -> Accumulated {
    let is_taken = first_slot + vec4(0u, 1u, 2u, 3u) < vec4(slots);
    return Accumulated(select(vec4(EMPTY_SLOT), vec4(1.0), is_taken), vec4(0.0), vec4(0.0), vec4(0.0));
}

// The smallest transmittance of the slots that are taken.
fn smallest(transmittance: vec4<f32>) -> f32 {
    let v = select(transmittance, vec4(1.0), transmittance == vec4(EMPTY_SLOT));
    return min(min(v.x, v.y), min(v.z, v.w));
}

fn largest(v: vec4<f32>) -> f32 {
    return max(max(v.x, v.y), max(v.z, v.w));
}

// Blends a splat into the pixel of those of four individuals that hold it. Where pixels may finish, as in
// `rasterise`: what would leave less than 1e-4 of the light finishes the pixel, and is not blended.
fn blend(accumulated: ptr<function, Accumulated>, held: u32, alpha: f32, rgb: vec3<f32>, may_finish: bool) {
    let alphas = select(vec4(0.0), vec4(alpha), (vec4(held) & vec4(1u, 2u, 4u, 8u)) != vec4(0u));
    let before = (*accumulated).transmittance;
    var weight = before * alphas;
    var after = before - weight;
    if may_finish {
        let goes_on = after >= vec4(TRANSMITTANCE_MIN);
        weight = select(vec4(0.0), weight, goes_on);
        after = select(-abs(before), after, goes_on);
    }
    (*accumulated).transmittance = after;
    (*accumulated).red += weight * rgb.x;
    (*accumulated).green += weight * rgb.y;
    (*accumulated).blue += weight * rgb.z;
}

// Splat of an intersection of the list, and those of this workgroup's individuals that hold it.
fn held_splat(intersection: u32, first_individual: u32) -> vec2<u32> {
    let splat = intersection_splats[intersections[intersection]];
    if splat == NO_SPLAT {
        return vec2(splat, 0u);
    }
    let word = holders[HOLDER_WORDS * splat + first_individual / 32u];
    return vec2(splat, (word >> (first_individual % 32u)) & ALL_SLOTS);
}

// The most that a splat dims a pixel, rounded up.
fn dimming_of(log2_opacity: f32) -> u32 {
    return u32(-log2(1.0 - min(exp2(log2_opacity), ALPHA_MAX)) * DIMMING_STEPS) + 1u;
}

// Blends a batch of `count` splats into a pixel of sixteen individuals; true where it is finished for all of
// them.
fn blend_batch(
    a: ptr<function, Accumulated>,
    b: ptr<function, Accumulated>,
    c: ptr<function, Accumulated>,
    d: ptr<function, Accumulated>,
    lane: u32,
    count: u32,
) -> bool {
    let pixel = vec2<f32>(pixel_of(lane));
    // The test for it is left out where the batch cannot dim the pixel that far.
    let least = min(min(smallest((*a).transmittance), smallest((*b).transmittance)),
        min(smallest((*c).transmittance), smallest((*d).transmittance)));
    let left = least * exp2(-f32(atomicLoad(&batch_dimming)) / DIMMING_STEPS);
    let may_finish = left < TRANSMITTANCE_MIN * DIMMING_SLACK;
    for (var i = 0u; i < count; i++) {
        if !reaches_block(batch[i].blocks, lane) {
            continue;
        }
        let exponent = exponent_at(batch[i].conic_log2, batch[i].log2_opacity, batch[i].mean_px - pixel);
        if exponent < -LOG2_255 {
            continue;
        }
        let alpha = min(exp2(exponent), ALPHA_MAX);
        let held = batch_holders[i];
        let rgb = batch[i].rgb;
        if (held & 0xfu) != 0u {
            blend(a, held, alpha, rgb, may_finish);
        }
        if (held & 0xf0u) != 0u {
            blend(b, held >> 4u, alpha, rgb, may_finish);
        }
        if (held & 0xf00u) != 0u {
            blend(c, held >> 8u, alpha, rgb, may_finish);
        }
        if (held & 0xf000u) != 0u {
            blend(d, held >> 12u, alpha, rgb, may_finish);
        }
    }
    let most = max(max(largest((*a).transmittance), largest((*b).transmittance)),
        max(largest((*c).transmittance), largest((*d).transmittance)));
    return most < 0.0;
}

fn write_pixel(layer: u32, place: u32, colour: vec3<f32>, transmittance: f32) {
    if layer >= view.layers {
        return;
    }
    let value = colour + abs(transmittance) * view.background.xyz;
    let pixels = view.width * view.height;
    images[3u * layer * pixels + place] = value.x;
    images[(3u * layer + 1u) * pixels + place] = value.y;
    images[(3u * layer + 2u) * pixels + place] = value.z;
}

fn write_pixels(first_layer: u32, place: u32, accumulated: Accumulated) {
    let t = accumulated.transmittance;
    write_pixel(first_layer, place, vec3(accumulated.red.x, accumulated.green.x, accumulated.blue.x), t.x);
    write_pixel(first_layer + 1u, place, vec3(accumulated.red.y, accumulated.green.y, accumulated.blue.y), t.y);
    write_pixel(first_layer + 2u, place, vec3(accumulated.red.z, accumulated.green.z, accumulated.blue.z), t.z);
    write_pixel(first_layer + 3u, place, vec3(accumulated.red.w, accumulated.green.w, accumulated.blue.w), t.w);
}

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = group + vec3(0u, first_tile_row, 0u);
    let first_individual = SLOTS * tile.z;
    let local = pixel_of(lane);
    let pixel = tile.xy * TILE + local;
    let inside = pixel.x < view.width && pixel.y < view.height;
    if lane == 0u {
        range = ranges[tile.y * view.tiles_x + tile.x];
        atomicStore(&finished_pixels, 0u);
    }
    let intersection_range = workgroupUniformLoad(&range);

    let slots = select(0u, view.layers - first_individual, inside);
    var a = initial(0u, slots);
    var b = initial(4u, slots);
    var c = initial(8u, slots);
    var d = initial(12u, slots);
    var finished = !inside;
    if finished {
        atomicAdd(&finished_pixels, 1u);
    }
    for (var first = intersection_range.x; first < intersection_range.y; first += TILE_PIXELS) {
        // 1. Is any pixel unfinished? The barriers in this also end the batch before.
        workgroupBarrier();
        if lane == 0u {
            all_finished = u32(atomicLoad(&finished_pixels) == TILE_PIXELS);
            atomicStore(&batch_dimming, 0u);
        }
        if lane < WANTED_WORDS {
            atomicStore(&wanted[lane], 0u);
        }
        if workgroupUniformLoad(&all_finished) == 1u {
            break;
        }
        // 2. Which of the next splats are held by an individual of this workgroup?
        var splat = vec2(NO_SPLAT, 0u);
        if first + lane < intersection_range.y {
            splat = held_splat(first + lane, first_individual);
        }
        if splat.y != 0u {
            atomicOr(&wanted[lane / 32u], 1u << (lane % 32u));
        }
        workgroupBarrier();
        // 3. Load those, without gaps.
        var place = 0u;
        var count = 0u;
        for (var word = 0u; word < WANTED_WORDS; word++) {
            let bits = atomicLoad(&wanted[word]);
            count += countOneBits(bits);
            if word < lane / 32u {
                place += countOneBits(bits);
            } else if word == lane / 32u {
                place += countOneBits(bits & ((1u << (lane % 32u)) - 1u));
            }
        }
        if splat.y != 0u {
            batch[place] = load_batch_splat(splat.x, tile.xy);
            batch_holders[place] = splat.y;
            atomicAdd(&batch_dimming, dimming_of(batch[place].log2_opacity));
        }
        workgroupBarrier();
        // 4. Blend them.
        if !finished && blend_batch(&a, &b, &c, &d, lane, count) {
            finished = true;
            atomicAdd(&finished_pixels, 1u);
        }
    }
    if inside {
        let at = pixel.y * view.width + pixel.x;
        write_pixels(first_individual, at, a);
        write_pixels(first_individual + 4u, at, b);
        write_pixels(first_individual + 8u, at, c);
        write_pixels(first_individual + 12u, at, d);
    }
}
