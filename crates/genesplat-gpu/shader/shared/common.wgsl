// What every stage uses. Grids wider than GRID_WIDTH workgroups wrap into the second dimension.

fn group_of(id: vec3<u32>) -> u32 {
    return id.x + id.y * GRID_WIDTH;
}

fn is_finite(x: f32) -> bool {
    // By bits: a compiler may assume that there is no NaN.
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

// By bits, too: what comparisons, minima and maxima make of a NaN is the driver's choice, so none of them can
// find one.
fn has_nan(v: vec4<f32>) -> bool {
    return any((bitcast<vec4<u32>>(v) & vec4(0x7fffffffu)) > vec4(0x7f800000u));
}

// e^x, with the exponent limited as on the CPU. Any power may come out of a NaN.
fn exp_limited(x: f32) -> f32 {
    return exp2(clamp(x * LOG2_E, -126.0, 126.0));
}

fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp_limited(-x));
}

// A sum that exceeds 32 bits is the largest number.
fn saturating_add(a: u32, b: u32) -> u32 {
    return a + min(b, ~a);
}

// High bits of a tile count: the row's 3-sigma square meets a tile (what density averages count); the row has
// a splat.
const SEEN_BIT: u32 = 0x80000000u;
const SPLAT_BIT: u32 = 0x40000000u;
const COUNT_BITS: u32 = 0x3fffffffu;
