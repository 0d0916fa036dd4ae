// A splat as the pixels of one tile read it from workgroup memory.

struct TileSplat {
    // Mean, px from the tile's corner.
    mean: vec2<f32>,
    log2_opacity: f32,
    conic_log2: vec3<f32>,
    rgb: vec3<f32>,
}

// One that reaches nothing.
fn absent_splat() -> TileSplat {
    return TileSplat(vec2(0.0), -1e3, vec3(0.0), vec3(0.0));
}

fn load_tile_splat(row: u32, origin: vec2<f32>) -> TileSplat {
    if row == NO_SPLAT {
        return absent_splat();
    }
    let a = splats[3u * row];
    return TileSplat(a.xy - origin, a.z, splats[3u * row + 1u].xyz, splats[3u * row + 2u].xyz);
}

// What one pixel has seen of a list, front to back.
struct Sight {
    // px from the tile's corner
    at: vec2<f32>,
    colour: vec3<f32>,
    transmittance: f32,
    finished: bool,
}

// Blends a splat of the batch into a pixel, unless that would leave less than 1e-4 of the light: then the pixel is finished.
// Needs `batch` and `finished_pixels`.
fn blend(sight: ptr<function, Sight>, index: u32) {
    let d = batch[index].mean - (*sight).at;
    let exponent = exponent_at(batch[index].conic_log2, batch[index].log2_opacity, d);
    if exponent < -LOG2_255 {
        return;
    }
    let weight = (*sight).transmittance * min(exp2(exponent), ALPHA_MAX);
    let next = (*sight).transmittance - weight;
    if next < TRANSMITTANCE_MIN {
        (*sight).finished = true;
        atomicAdd(&finished_pixels, 1u);
        return;
    }
    (*sight).colour += weight * batch[index].rgb;
    (*sight).transmittance = next;
}
