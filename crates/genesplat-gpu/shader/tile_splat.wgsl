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
