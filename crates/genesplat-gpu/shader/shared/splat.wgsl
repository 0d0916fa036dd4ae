// A splat: three vectors, 48 bytes.

// Stands for no splat where a row is expected.
const NO_SPLAT: u32 = 0xffffffffu;

struct Splat {
    mean_px: vec2<f32>,
    log2_opacity: f32,
    // Half extent of the ellipse alpha >= 1/255, px.
    half_extent_px: vec2<f32>,
    // [-A/2, -B, -C/2] * log2(e) of the inverse covariance: the exponent comes out in powers of two.
    conic_log2: vec3<f32>,
    rgb: vec3<f32>,
    // Bit c is set where channel c was clamped at 0.
    clamped: u32,
}

fn first_vector(splat: Splat) -> vec4<f32> {
    return vec4(splat.mean_px, splat.log2_opacity, splat.half_extent_px.x);
}

fn second_vector(splat: Splat) -> vec4<f32> {
    return vec4(splat.conic_log2, splat.half_extent_px.y);
}

fn third_vector(splat: Splat) -> vec4<f32> {
    return vec4(splat.rgb, bitcast<f32>(splat.clamped | 0x3f800000u));
}

// Clamps a colour at 0.
fn set_colour(splat: ptr<function, Splat>, colour: vec3<f32>) {
    let below = colour < vec3(0.0);
    (*splat).rgb = max(colour, vec3(0.0));
    (*splat).clamped = u32(below.x) | u32(below.y) << 1u | u32(below.z) << 2u;
}

fn splat_from(a: vec4<f32>, b: vec4<f32>, c: vec4<f32>) -> Splat {
    // The bits of 1.0 keep the flags from looking like a denormal, which some devices flush to zero.
    return Splat(a.xy, a.z, vec2(a.w, b.w), b.xyz, c.xyz, bitcast<u32>(c.w) & 7u);
}

// log2(o G) at an offset from the mean. No Gaussian exceeds its opacity, but far from the mean of a needle
// large terms cancel, and rounding may leave anything.
fn exponent_at(conic_log2: vec3<f32>, log2_opacity: f32, d: vec2<f32>) -> f32 {
    let power = (conic_log2.x * d.x + conic_log2.y * d.y) * d.x + conic_log2.z * d.y * d.y;
    return min(power + log2_opacity, log2_opacity);
}
