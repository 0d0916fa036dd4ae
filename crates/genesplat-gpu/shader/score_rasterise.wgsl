// Stage `score`, step 2: the pictures that sixteen individuals make of one tile, one pixel an invocation.
//
// The list of a tile has the alleles of the whole pool. Of the next 256 those that any of the sixteen holds are loaded; the
// alpha of each is evaluated once, and blended into the light of those who hold it.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> entries: array<u32>;
@group(0) @binding(3) var<storage, read> entry_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<vec4<f32>>;
// A bit an individual [K, HOLDER_WORDS].
@group(0) @binding(5) var<storage, read> holders: array<u32>;
// [layers, 3, H, W]
@group(0) @binding(6) var<storage, read_write> images: array<f32>;

// Bits of the individuals that have a seat.
const ALL_SEATS: u32 = (1u << SEATS) - 1u;
// Words with a bit for each entry that is looked at.
const WANTED_WORDS: u32 = TILE_PIXELS / 32u;
// Parts of a power of two in which dimming is counted, and what rounding may add to it.
const DIMMING_STEPS: f32 = 256.0;
const DIMMING_SLACK: f32 = 1.001;

var<workgroup> range: vec2<u32>;
var<workgroup> batch: array<TileSplat, TILE_PIXELS>;
// Bits of the seats.
var<workgroup> batch_holders: array<u32, TILE_PIXELS>;
var<workgroup> wanted: array<atomic<u32>, WANTED_WORDS>;
// The most that the batch can dim a pixel, in parts of a power of two.
var<workgroup> batch_dimming: atomic<u32>;
var<workgroup> finished_pixels: atomic<u32>;
var<workgroup> all_finished: u32;

// Transmittance of a seat that nobody has; a pixel is finished with a hundredth of its light or less.
const NOBODY: f32 = -1.0;

// The light of four individuals in a pixel. A transmittance is negative where the pixel is finished.
struct Lights {
    transmittance: vec4<f32>,
    red: vec4<f32>,
    green: vec4<f32>,
    blue: vec4<f32>,
}

// Before the first splat; finished from the start where there is nobody, or no pixel.
fn untouched(first_seat: u32, seats: u32) -> Lights {
    let is_taken = first_seat + vec4(0u, 1u, 2u, 3u) < vec4(seats);
    return Lights(select(vec4(NOBODY), vec4(1.0), is_taken), vec4(0.0), vec4(0.0), vec4(0.0));
}

// The smallest transmittance of those who are there.
fn smallest(transmittance: vec4<f32>) -> f32 {
    let v = select(transmittance, vec4(1.0), transmittance == vec4(NOBODY));
    return min(min(v.x, v.y), min(v.z, v.w));
}

fn largest(v: vec4<f32>) -> f32 {
    return max(max(v.x, v.y), max(v.z, v.w));
}

// Blends a splat into the light of those of four who hold it. With care, as `rasterise` does it: what would leave less than
// 1e-4 of the light finishes the pixel, and is not blended.
fn blend(lights: ptr<function, Lights>, held: u32, alpha: f32, rgb: vec3<f32>, with_care: bool) {
    let alphas = select(vec4(0.0), vec4(alpha), (vec4(held) & vec4(1u, 2u, 4u, 8u)) != vec4(0u));
    let before = (*lights).transmittance;
    var weight = before * alphas;
    var after = before - weight;
    if with_care {
        let goes_on = after >= vec4(TRANSMITTANCE_MIN);
        weight = select(vec4(0.0), weight, goes_on);
        after = select(-abs(before), after, goes_on);
    }
    (*lights).transmittance = after;
    (*lights).red += weight * rgb.x;
    (*lights).green += weight * rgb.y;
    (*lights).blue += weight * rgb.z;
}

// Splat of an entry of the list, and those in the seats who hold it, if anybody does.
fn held_splat(entry: u32, first_individual: u32) -> vec2<u32> {
    let splat = entry_splats[entries[entry]];
    if splat == NO_SPLAT {
        return vec2(splat, 0u);
    }
    let word = holders[HOLDER_WORDS * splat + first_individual / 32u];
    return vec2(splat, (word >> (first_individual % 32u)) & ALL_SEATS);
}

// The most that a splat dims a pixel, rounded up.
fn dimming_of(log2_opacity: f32) -> u32 {
    return u32(-log2(1.0 - min(exp2(log2_opacity), ALPHA_MAX)) * DIMMING_STEPS) + 1u;
}

// Blends a batch of `count` splats into a pixel of sixteen individuals; true where it is finished for all of them.
fn blend_batch(
    a: ptr<function, Lights>,
    b: ptr<function, Lights>,
    c: ptr<function, Lights>,
    d: ptr<function, Lights>,
    pixel: vec2<f32>,
    count: u32,
) -> bool {
    // With care only where the pixel may be finished.
    let least = min(min(smallest((*a).transmittance), smallest((*b).transmittance)),
        min(smallest((*c).transmittance), smallest((*d).transmittance)));
    let left = least * exp2(-f32(atomicLoad(&batch_dimming)) / DIMMING_STEPS);
    let with_care = left < TRANSMITTANCE_MIN * DIMMING_SLACK;
    for (var i = 0u; i < count; i++) {
        let exponent = exponent_at(batch[i].conic_log2, batch[i].log2_opacity, batch[i].mean - pixel);
        if exponent < -LOG2_255 {
            continue;
        }
        let alpha = min(exp2(exponent), ALPHA_MAX);
        let held = batch_holders[i];
        let rgb = batch[i].rgb;
        if (held & 0xfu) != 0u {
            blend(a, held, alpha, rgb, with_care);
        }
        if (held & 0xf0u) != 0u {
            blend(b, held >> 4u, alpha, rgb, with_care);
        }
        if (held & 0xf00u) != 0u {
            blend(c, held >> 8u, alpha, rgb, with_care);
        }
        if (held & 0xf000u) != 0u {
            blend(d, held >> 12u, alpha, rgb, with_care);
        }
    }
    let most = max(max(largest((*a).transmittance), largest((*b).transmittance)),
        max(largest((*c).transmittance), largest((*d).transmittance)));
    return most < 0.0;
}

fn write_pixel(layer: u32, place: u32, colour: vec3<f32>, transmittance: f32) {
    if layer >= frame.layers {
        return;
    }
    let value = colour + abs(transmittance) * frame.background.xyz;
    let pixels = frame.width * frame.height;
    images[3u * layer * pixels + place] = value.x;
    images[(3u * layer + 1u) * pixels + place] = value.y;
    images[(3u * layer + 2u) * pixels + place] = value.z;
}

fn write_lights(first_layer: u32, place: u32, lights: Lights) {
    let t = lights.transmittance;
    write_pixel(first_layer, place, vec3(lights.red.x, lights.green.x, lights.blue.x), t.x);
    write_pixel(first_layer + 1u, place, vec3(lights.red.y, lights.green.y, lights.blue.y), t.y);
    write_pixel(first_layer + 2u, place, vec3(lights.red.z, lights.green.z, lights.blue.z), t.z);
    write_pixel(first_layer + 3u, place, vec3(lights.red.w, lights.green.w, lights.blue.w), t.w);
}

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first_individual = SEATS * tile.z;
    let origin = vec2(f32(tile.x * TILE), f32(tile.y * TILE));
    let local = pixel_of(lane);
    let pixel = tile.xy * TILE + local;
    let inside = pixel.x < frame.width && pixel.y < frame.height;
    if lane == 0u {
        range = ranges[tile.y * frame.tiles_x + tile.x];
        atomicStore(&finished_pixels, 0u);
    }
    let entry_range = workgroupUniformLoad(&range);

    let seats = select(0u, frame.layers - first_individual, inside);
    var a = untouched(0u, seats);
    var b = untouched(4u, seats);
    var c = untouched(8u, seats);
    var d = untouched(12u, seats);
    var finished = !inside;
    if finished {
        atomicAdd(&finished_pixels, 1u);
    }
    for (var first = entry_range.x; first < entry_range.y; first += TILE_PIXELS) {
        // 1. Has anyone still something to do? The barriers in this also end the batch before.
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
        // 2. Which of the next splats does anybody here hold?
        var splat = vec2(NO_SPLAT, 0u);
        if first + lane < entry_range.y {
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
            batch[place] = load_tile_splat(splat.x, origin);
            batch_holders[place] = splat.y;
            atomicAdd(&batch_dimming, dimming_of(batch[place].log2_opacity));
        }
        workgroupBarrier();
        // 4. Blend them.
        if !finished && blend_batch(&a, &b, &c, &d, vec2<f32>(local), count) {
            finished = true;
            atomicAdd(&finished_pixels, 1u);
        }
    }
    if inside {
        let at = pixel.y * frame.width + pixel.x;
        write_lights(first_individual, at, a);
        write_lights(first_individual + 4u, at, b);
        write_lights(first_individual + 8u, at, c);
        write_lights(first_individual + 12u, at, d);
    }
}
