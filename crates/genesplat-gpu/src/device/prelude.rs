//! What every shader begins with: the constants and structs of [`crate::layout`] and of [`genesplat_core`],
//! in WGSL.

use genesplat_core::constants::{
    ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON, ALPHA_MAX, ALPHA_MIN, ANTIALIAS_RATIO_MIN, DISCRIMINANT_MIN,
    LAMBDA_DSSIM, MIP_EPSILON, NOISE_OPACITY, NOISE_STEEPNESS, SSIM_C1, SSIM_C2, SSIM_RADIUS,
    TRANSMITTANCE_MIN, ssim_window,
};
use genesplat_core::edit::{
    LONG_AXIS_OFFSET, LONG_AXIS_OPACITY, LONG_AXIS_OPACITY_MIN, LONG_AXIS_SHRINK, LONG_AXIS_WIDTH,
    SPLIT_SHRINK,
};
use genesplat_core::rng::Stream;
use genesplat_core::spherical_harmonics::{C0, C1, C2, C3};

use crate::device::shaders::Abilities;
use crate::layout::*;

/// Constants and structs in WGSL, for the head of every shader.
pub(super) fn prelude(abilities: Abilities) -> String {
    let mut text = String::new();
    for (name, value) in float_constants() {
        // `{:e}` prints the shortest digits that read back as the same f32.
        text.push_str(&format!("const {name}: f32 = {value:e}f;\n"));
    }
    for (name, value) in integer_constants(abilities) {
        text.push_str(&format!("const {name}: u32 = {value}u;\n"));
    }
    text.push_str(&array_constant("SSIM_WINDOW", &ssim_window()));
    text.push_str(&array_constant("SH_C2", &C2));
    text.push_str(&array_constant("SH_C3", &C3));
    for text_of_struct in [ViewPass::WGSL, Optimiser::WGSL, Window::WGSL, Counters::WGSL, Edit::WGSL] {
        text.push_str(text_of_struct);
    }
    text
}

fn array_constant(name: &str, values: &[f64]) -> String {
    let list: Vec<String> = values.iter().map(|&value| format!("{:e}f", value as f32)).collect();
    format!("const {name} = array<f32, {}>({});\n", values.len(), list.join(", "))
}

fn float_constants() -> Vec<(&'static str, f32)> {
    macro_rules! named {
        ($($name:ident)*) => { [$((stringify!($name), $name)),*] };
    }
    let shared = named! {
        ALPHA_MIN ALPHA_MAX TRANSMITTANCE_MIN MIP_EPSILON ANTIALIAS_RATIO_MIN DISCRIMINANT_MIN
        LAMBDA_DSSIM SSIM_C1 SSIM_C2 ADAM_BETA1 ADAM_BETA2 ADAM_EPSILON NOISE_OPACITY NOISE_STEEPNESS
        SPLIT_SHRINK
        LONG_AXIS_OFFSET LONG_AXIS_SHRINK LONG_AXIS_WIDTH LONG_AXIS_OPACITY LONG_AXIS_OPACITY_MIN
    };
    let own = [
        // The exponent of two at which alpha is 1/255, negated.
        ("LOG2_255", 255f32.log2()),
        ("LOG2_E", std::f32::consts::LOG2_E),
        ("LN_2", std::f32::consts::LN_2),
        ("TAU", std::f32::consts::TAU),
        // As on the CPU: a list may have a splat too many, never one too few.
        ("SLACK_LOG2", 1e-3),
        ("SLACK_PX", 1e-2),
        // Noise fainter than this is left out, as on the CPU.
        ("FAINTNESS_MIN", 1e-12),
        ("SH_C0", C0 as f32),
        ("SH_C1", C1 as f32),
    ];
    shared.into_iter().chain(own).collect()
}

fn integer_constants(abilities: Abilities) -> Vec<(&'static str, u32)> {
    let own = [
        ("TILE_PIXELS", TILE * TILE),
        // Splats that rasterisation blends, and the backward pass reduces, at once.
        ("SPLATS_AT_ONCE", abilities.splats_at_once()),
        ("SSIM_RADIUS", SSIM_RADIUS as u32),
        ("STREAM_SPLIT_OFFSET", Stream::SplitOffset as u32),
        ("STREAM_SGLD_NOISE", Stream::SgldNoise as u32),
    ];
    [SHARED_CONSTANTS, &own].concat()
}
