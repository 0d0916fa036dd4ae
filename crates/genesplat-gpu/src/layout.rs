//! The one home of every constant and every struct that Rust and WGSL share.
//!
//! Structs are declared once, by `device_struct!`, which makes both the Rust type and its WGSL text; constants are
//! written into WGSL by [`prelude`]. A test reads the WGSL back with naga and compares offsets.

use bytemuck::{Pod, Zeroable};
use genesplat_core::constants::{
    ADAM_BETA1, ADAM_BETA2, ADAM_EPSILON, ALPHA_MAX, ALPHA_MIN, ANTIALIAS_RATIO_MIN, DISCRIMINANT_MIN,
    LAMBDA_DSSIM, MIP_EPSILON, NEAR_DEPTH, NOISE_OPACITY, NOISE_STEEPNESS, SSIM_C1, SSIM_C2, SSIM_RADIUS,
    TRANSMITTANCE_MIN, ssim_window,
};
use genesplat_core::edit::{SPLIT_SHRINK, TWIN_OFFSET, TWIN_OPACITY_MAX};
use genesplat_core::rng::Stream;
use genesplat_core::spherical_harmonics::{C0, C1, C2, C3};

/// Side of a tile, px.
pub const TILE: u32 = 16;
/// Invocations of every one-dimensional workgroup.
pub const GROUP: u32 = 256;
/// Workgroups in the first dimension of a grid; what is more goes to the second (65,535 is WebGPU's limit for each). So few in
/// unit tests that grids of theirs have a second dimension, too.
pub const GRID_WIDTH: u32 = if cfg!(test) { 3 } else { 32_768 };
/// Elements that one workgroup of a prefix sum handles.
pub const SCAN_BLOCK: u32 = 8 * GROUP;
/// Keys that one workgroup of a radix sort handles.
pub const SORT_BLOCK: u32 = 16 * GROUP;
/// Values of a digit of the radix sort; one invocation serves each.
pub const DIGITS: u32 = 256;
/// Splats that the backward pass reduces at once.
pub const SHARES: u32 = 8;
/// Floats of a splat.
pub const SPLAT_FLOATS: u32 = 12;
/// Floats of a gradient row: the sums over the pixels of one tile.
pub const ROW_FLOATS: u32 = 12;
/// Floats of a Gaussian's geometry: position, opacity logit; log-scales, 3D filter; rotation.
pub const GEOMETRY_FLOATS: u32 = 12;
/// Floats of a Gaussian's colour.
pub const SH_FLOATS: u32 = 48;
/// Floats of the gradients of one Gaussian: geometry; colour; density signal.
pub const GRADIENT_FLOATS: u32 = 16;
/// Floats of the density statistics of one Gaussian: gradient, weight, absolute gradient, nothing.
pub const DENSITY_FLOATS: u32 = 4;
/// Floats of the gene statistics of one Gaussian: seven sums, then the number of views.
pub const GENE_FLOATS: u32 = 8;
/// Floats of the merit of one Gaussian: weight, error.
pub const MERIT_FLOATS: u32 = 2;
/// Mutants that one backward pass credits: one a channel.
pub const MUTANTS_AT_ONCE: u32 = 3;
/// Floats of the credit of one Gaussian: of three mutants, then the number of views.
pub const CREDIT_FLOATS: u32 = 4;

/// Individuals of which a workgroup of stage `score` makes the pictures: as many lights as an invocation has registers for.
pub const SEATS: u32 = 16;
/// Words with a bit for each individual of a pool.
pub const HOLDER_WORDS: u32 = 4;
/// Where the genes of an allele are, if it is what its row has itself.
pub const OWN_GENES: u32 = u32::MAX;

/// Declares a `#[repr(C)]` struct and its WGSL twin.
macro_rules! device_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:tt,)* }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub struct $name { $($(#[$field_doc])* pub $field: device_struct!(@rust $kind),)* }

        impl $name {
            /// The same struct in WGSL.
            pub const WGSL: &'static str = concat!(
                "struct ", stringify!($name), " {\n",
                $("    ", stringify!($field), ": ", device_struct!(@wgsl $kind), ",\n",)*
                "}\n"
            );

            /// Names and offsets of its fields, bytes.
            #[cfg(test)]
            pub fn fields() -> Vec<(&'static str, usize)> {
                vec![$((stringify!($field), std::mem::offset_of!($name, $field)),)*]
            }
        }
    };
    (@rust vec4) => { [f32; 4] };
    (@rust f32) => { f32 };
    (@rust u32) => { u32 };
    (@wgsl vec4) => { "vec4<f32>" };
    (@wgsl f32) => { "f32" };
    (@wgsl u32) => { "u32" };
}

device_struct! {
    /// What a render depends on besides the cloud. Vectors come first and the size is a multiple of 16 bytes, so that
    /// WGSL's and Rust's layouts agree.
    Frame {
        /// First row of `camera_from_world`: rotation, translation.
        camera_x: vec4,
        /// Second row.
        camera_y: vec4,
        /// Third row.
        camera_z: vec4,
        /// Camera centre, world.
        centre: vec4,
        /// Colour behind all splats.
        background: vec4,
        /// px
        focal_x: f32,
        /// px
        focal_y: f32,
        /// Pixel coordinate that the optical axis hits.
        axis_x: f32,
        /// See `axis_x`.
        axis_y: f32,
        /// Largest `|x/z|` that the Jacobian sees.
        limit_x: f32,
        /// Largest `|y/z|`.
        limit_y: f32,
        /// Variance added to the diagonal of the projected covariance, px².
        dilation: f32,
        /// Pixel-GS's depth threshold, world units.
        depth_threshold: f32,
        /// px
        width: u32,
        /// px
        height: u32,
        /// Tiles across.
        tiles_x: u32,
        /// Tiles down.
        tiles_y: u32,
        /// Rows of the cloud.
        rows: u32,
        /// Active degree of the spherical harmonics.
        sh_degree: u32,
        /// One of the `FILTER_` constants.
        filter_kind: u32,
        /// One of the `SIGNAL_` constants.
        signal: u32,
        /// Entries that fit the buffers.
        entry_capacity: u32,
        /// Pictures that are made at once, one for each individual of a pool.
        layers: u32,
        /// Nothing.
        pad_0: u32,
        /// Nothing.
        pad_1: u32,
    }
}

device_struct! {
    /// One optimiser step: Adam's bias-corrected factors `lr / (1 − β1ᵗ)` and `1 / sqrt(1 − β2ᵗ)`, and MCMC's additions.
    Optimiser {
        /// Positions.
        position: f32,
        /// Log-scales.
        scale: f32,
        /// Quaternions.
        rotation: f32,
        /// Opacity logits.
        opacity: f32,
        /// Base colour.
        sh_dc: f32,
        /// View-dependent colour.
        sh_rest: f32,
        /// Second factor of all groups but opacity.
        root: f32,
        /// Second factor of opacity.
        opacity_root: f32,
        /// 0 leaves opacities and their moments alone.
        step_opacity: u32,
        /// MCMC: 1 adds regularisers and noise.
        explore: u32,
        /// Factor of the positional noise.
        noise: f32,
        /// Weight of the mean opacity in the loss.
        opacity_weight: f32,
        /// Weight of the mean scale in the loss.
        scale_weight: f32,
        /// Counter of the noise stream.
        counter: u32,
        /// Seed, low half.
        seed_low: u32,
        /// Seed, high half.
        seed_high: u32,
    }
}

device_struct! {
    /// Rows `first .. first + count`: what one binding of a column that is too large for a single one shows.
    Window {
        /// First row.
        first: u32,
        /// Number of rows.
        count: u32,
        /// Another row, where a stage needs two windows.
        source_first: u32,
        /// Its count; or a stage's own parameter.
        source_count: u32,
    }
}

device_struct! {
    /// What the device counts and reports. Zeroed by the host, written by the stages.
    Counters {
        /// Splats of the view.
        visible: u32,
        /// Entries of all tile lists; 0 where they do not fit.
        entries: u32,
        /// Entries that the lists would have.
        wanted: u32,
        /// One of the `HALT_` bits is set: from here on, steps change nothing until the host clears it.
        halted: u32,
        /// Steps that were completed since the host last cleared this.
        completed: u32,
        /// `0.8 · L1 + 0.2 · (1 − SSIM)` of the last completed step.
        loss: f32,
        /// Splats of the last completed step.
        step_visible: u32,
        /// Tile entries of the last completed step.
        step_entries: u32,
    }
}

device_struct! {
    /// Parameters of the verbs that change rows.
    Edit {
        /// Counter of the random stream that split children are drawn from.
        iteration: u32,
        /// Seed, low half.
        seed_low: u32,
        /// Seed, high half.
        seed_high: u32,
        /// The ceiling of opacities, or the share of a state in a mean.
        amount: f32,
    }
}

/// The entries do not fit the buffers.
pub const HALT_OVERFLOW: u32 = 1;
/// The loss is not finite.
pub const HALT_NON_FINITE: u32 = 2;

/// 3DGS.
pub const FILTER_CLASSIC: u32 = 0;
/// 3DGS's antialiasing.
pub const FILTER_ANTIALIASED: u32 = 1;
/// Mip-Splatting.
pub const FILTER_MIP: u32 = 2;

/// No density signal.
pub const SIGNAL_NONE: u32 = 0;
/// Norm of the signed gradient.
pub const SIGNAL_SIGNED: u32 = 1;
/// Norm of the absolute gradients.
pub const SIGNAL_ABSOLUTE: u32 = 2;
/// Both.
pub const SIGNAL_BOTH: u32 = 3;
/// Pixel-GS.
pub const SIGNAL_PIXELS: u32 = 4;

/// Slots of the lengths that only the device knows: rows of the cloud, ...
pub const LENGTH_ROWS: u32 = 0;
/// ... splats of the view, ...
pub const LENGTH_VISIBLE: u32 = 1;
/// ... entries of all tile lists.
pub const LENGTH_ENTRIES: u32 = 2;
/// Slots.
pub const LENGTHS: u32 = 3;

/// Grids that only the device knows: an invocation a splat, ...
pub const GRID_VISIBLE: u32 = 0;
/// ... a prefix sum over the splats, ...
pub const GRID_VISIBLE_SCAN: u32 = 1;
/// ... a pass of the depth sort, ...
pub const GRID_DEPTH_SORT: u32 = 2;
/// ... an invocation an entry, ...
pub const GRID_ENTRIES: u32 = 3;
/// ... a pass of the tile sort.
pub const GRID_TILE_SORT: u32 = 4;
/// Grids.
pub const GRIDS: u32 = 5;

/// Codes of [`genesplat_core::Origin`].
pub const ORIGIN_KEPT: u32 = 0;
/// See [`ORIGIN_KEPT`].
pub const ORIGIN_CLONE: u32 = 1;
/// First child; the second is one more.
pub const ORIGIN_SPLIT: u32 = 2;
/// Relocated, fresh moments.
pub const ORIGIN_RELOCATED: u32 = 4;
/// Relocated, moments kept.
pub const ORIGIN_RELOCATED_KEPT: u32 = 5;
/// First twin; the second is one more.
pub const ORIGIN_TWIN: u32 = 6;

/// Constants and structs in WGSL, for the head of every shader.
pub fn prelude() -> String {
    let mut text = String::new();
    for (name, value) in float_constants() {
        // `{:e}` prints the shortest digits that read back as the same f32.
        text.push_str(&format!("const {name}: f32 = {value:e}f;\n"));
    }
    for (name, value) in integer_constants() {
        text.push_str(&format!("const {name}: u32 = {value}u;\n"));
    }
    text.push_str(&array_constant("SSIM_WINDOW", &ssim_window()));
    text.push_str(&array_constant("SH_C2", &C2));
    text.push_str(&array_constant("SH_C3", &C3));
    for text_of_struct in [Frame::WGSL, Optimiser::WGSL, Window::WGSL, Counters::WGSL, Edit::WGSL] {
        text.push_str(text_of_struct);
    }
    text
}

fn array_constant(name: &str, values: &[f64]) -> String {
    let list: Vec<String> = values.iter().map(|&value| format!("{:e}f", value as f32)).collect();
    format!("const {name} = array<f32, {}>({});\n", values.len(), list.join(", "))
}

fn float_constants() -> Vec<(&'static str, f32)> {
    vec![
        ("NEAR_DEPTH", NEAR_DEPTH),
        ("ALPHA_MIN", ALPHA_MIN),
        ("ALPHA_MAX", ALPHA_MAX),
        // The exponent of two at which alpha is 1/255, negated.
        ("LOG2_255", 255f32.log2()),
        ("LOG2_E", std::f32::consts::LOG2_E),
        ("LN_2", std::f32::consts::LN_2),
        ("TAU", std::f32::consts::TAU),
        ("TRANSMITTANCE_MIN", TRANSMITTANCE_MIN),
        // Lists may hold a splat in vain, never miss one: every ellipse is widened by this much, in powers of two of
        // alpha, and its intervals by this many pixels (as on the CPU).
        ("SLACK_LOG2", 1e-3),
        ("SLACK_PX", 1e-2),
        ("MIP_EPSILON", MIP_EPSILON),
        ("ANTIALIAS_RATIO_MIN", ANTIALIAS_RATIO_MIN),
        ("DISCRIMINANT_MIN", DISCRIMINANT_MIN),
        ("LAMBDA_DSSIM", LAMBDA_DSSIM),
        ("SSIM_C1", SSIM_C1),
        ("SSIM_C2", SSIM_C2),
        ("ADAM_BETA1", ADAM_BETA1),
        ("ADAM_BETA2", ADAM_BETA2),
        ("ADAM_EPSILON", ADAM_EPSILON),
        ("NOISE_OPACITY", NOISE_OPACITY),
        ("NOISE_STEEPNESS", NOISE_STEEPNESS),
        // Noise fainter than this is left out, as on the CPU.
        ("FAINTNESS_MIN", 1e-12),
        ("SPLIT_SHRINK", SPLIT_SHRINK),
        ("TWIN_OFFSET", TWIN_OFFSET),
        ("TWIN_OPACITY_MAX", TWIN_OPACITY_MAX),
        ("FRAC_1_SQRT_2", std::f32::consts::FRAC_1_SQRT_2),
        ("SH_C0", C0 as f32),
        ("SH_C1", C1 as f32),
    ]
}

fn integer_constants() -> Vec<(&'static str, u32)> {
    vec![
        ("MUTANTS_AT_ONCE", MUTANTS_AT_ONCE),
        ("SEATS", SEATS),
        ("HOLDER_WORDS", HOLDER_WORDS),
        ("OWN_GENES", OWN_GENES),
        ("TILE", TILE),
        ("TILE_PIXELS", TILE * TILE),
        ("GROUP", GROUP),
        ("GRID_WIDTH", GRID_WIDTH),
        ("SCAN_BLOCK", SCAN_BLOCK),
        ("SORT_BLOCK", SORT_BLOCK),
        ("DIGITS", DIGITS),
        ("SHARES", SHARES),
        ("SSIM_RADIUS", SSIM_RADIUS as u32),
        ("HALT_OVERFLOW", HALT_OVERFLOW),
        ("HALT_NON_FINITE", HALT_NON_FINITE),
        ("FILTER_CLASSIC", FILTER_CLASSIC),
        ("FILTER_ANTIALIASED", FILTER_ANTIALIASED),
        ("FILTER_MIP", FILTER_MIP),
        ("SIGNAL_NONE", SIGNAL_NONE),
        ("SIGNAL_SIGNED", SIGNAL_SIGNED),
        ("SIGNAL_ABSOLUTE", SIGNAL_ABSOLUTE),
        ("SIGNAL_BOTH", SIGNAL_BOTH),
        ("SIGNAL_PIXELS", SIGNAL_PIXELS),
        ("ORIGIN_KEPT", ORIGIN_KEPT),
        ("ORIGIN_CLONE", ORIGIN_CLONE),
        ("ORIGIN_SPLIT", ORIGIN_SPLIT),
        ("ORIGIN_RELOCATED", ORIGIN_RELOCATED),
        ("ORIGIN_RELOCATED_KEPT", ORIGIN_RELOCATED_KEPT),
        ("ORIGIN_TWIN", ORIGIN_TWIN),
        ("LENGTH_ROWS", LENGTH_ROWS),
        ("LENGTH_VISIBLE", LENGTH_VISIBLE),
        ("LENGTH_ENTRIES", LENGTH_ENTRIES),
        ("GRID_VISIBLE", GRID_VISIBLE),
        ("GRID_VISIBLE_SCAN", GRID_VISIBLE_SCAN),
        ("GRID_DEPTH_SORT", GRID_DEPTH_SORT),
        ("GRID_ENTRIES", GRID_ENTRIES),
        ("GRID_TILE_SORT", GRID_TILE_SORT),
        ("STREAM_SPLIT_OFFSET", Stream::SplitOffset as u32),
        ("STREAM_EXPLORATION_NOISE", Stream::SgldNoise as u32),
    ]
}
