//! Every constant and every struct that Rust and WGSL share.
//!
//! Structs are declared once, by `device_struct!`, which makes both the Rust type and its WGSL text; constants are
//! written into WGSL by `device::prelude`. A test reads the WGSL back with naga and compares offsets.

use bytemuck::{Pod, Zeroable};

/// Side of a tile, px.
pub(crate) const TILE: u32 = 16;
/// Invocations of every one-dimensional workgroup.
pub(crate) const GROUP: u32 = 256;
/// Workgroups in the first dimension of a grid; what is more goes to the second (65,535 is WebGPU's limit for each). So
/// few in unit tests that grids of theirs have a second dimension, too.
pub(crate) const GRID_WIDTH: u32 = if cfg!(test) { 3 } else { 32_768 };
/// Elements that one workgroup of a prefix sum handles.
pub(crate) const SCAN_BLOCK: u32 = 8 * GROUP;
/// Keys that one workgroup of a radix sort handles.
pub(crate) const SORT_BLOCK: u32 = 16 * GROUP;
/// Values of a digit of the radix sort; one invocation serves each.
pub(crate) const DIGITS: u32 = 256;
/// Splats that the backward pass reduces at once.
pub(crate) const SPLATS_AT_ONCE: u32 = 8;
/// Floats of a splat.
pub(crate) const SPLAT_FLOATS: u32 = 12;
/// Floats of the gradient of an intersection: sums over the pixels of one tile.
pub(crate) const INTERSECTION_GRADIENT_FLOATS: u32 = 12;
/// Floats of a Gaussian's geometry: position, opacity logit; log-scales, 3D filter; rotation.
pub(crate) const GEOMETRY_FLOATS: u32 = 12;
/// Floats of a Gaussian's colour.
pub(crate) const SH_FLOATS: u32 = 48;
/// Floats of the gradients of one Gaussian: geometry; colour; density signal.
pub(crate) const GRADIENT_FLOATS: u32 = 16;
/// Floats of the density statistics of one Gaussian: gradient, weight, absolute gradient, nothing.
pub(crate) const DENSITY_FLOATS: u32 = 4;
/// Floats of the gene statistics of one Gaussian: seven sums, then the number of views.
pub(crate) const GENE_FLOATS: u32 = 8;
/// Floats of the contribution of one Gaussian: weight, error.
pub(crate) const CONTRIBUTION_FLOATS: u32 = 2;

/// Individuals that a workgroup of stage `score` renders: as many pixels as an invocation has registers for.
pub(crate) const SLOTS: u32 = 16;
/// Words with a bit for each individual of a pool.
pub(crate) const HOLDER_WORDS: u32 = 4;
/// Where the genes of an allele are, if it is what its row has itself.
pub(crate) const OWN_GENES: u32 = u32::MAX;

/// Declares a `#[repr(C)]` struct and its WGSL twin.
macro_rules! device_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:tt,)* }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub(crate) struct $name { $($(#[$field_doc])* pub(crate) $field: device_struct!(@rust $kind),)* }

        impl $name {
            /// The same struct in WGSL.
            pub(crate) const WGSL: &'static str = concat!(
                "struct ", stringify!($name), " {\n",
                $("    ", stringify!($field), ": ", device_struct!(@wgsl $kind), ",\n",)*
                "}\n"
            );

            /// Names and offsets of its fields, bytes.
            #[cfg(test)]
            pub(crate) fn fields() -> Vec<(&'static str, usize)> {
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
    ViewPass {
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
        /// Intersections that fit the buffers.
        intersection_capacity: u32,
        /// Pictures that are made at once, one for each individual of a pool.
        layers: u32,
        /// Nothing.
        pad_0: u32,
        /// Nothing.
        pad_1: u32,
    }
}

device_struct! {
    /// One optimiser step: Adam's bias-corrected factors `lr / (1 − β1ᵗ)` and `1 / sqrt(1 − β2ᵗ)`, and MCMC's
    /// additions.
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
        /// 1 adds 3DGS-MCMC's regularisers and noise.
        is_mcmc: u32,
        /// Factor of the positional noise.
        noise_scale: f32,
        /// Weight of the mean opacity in the loss.
        opacity_weight: f32,
        /// Weight of the mean scale in the loss.
        scale_weight: f32,
        /// Counter of the noise stream.
        counter: u32,
        /// Key of the random streams, low half.
        key_low: u32,
        /// Key of the random streams, high half.
        key_high: u32,
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
        /// Intersections in all tile lists; 0 where they do not fit.
        intersections: u32,
        /// Intersections that the lists would have.
        wanted: u32,
        /// One of the `HALT_` bits is set: from here on, steps change nothing until the host clears it.
        halted: u32,
        /// Steps that were completed since the host last cleared this.
        completed: u32,
        /// `0.8 · L1 + 0.2 · (1 − SSIM)` of the last completed step.
        loss: f32,
        /// Splats of the last completed step.
        step_visible: u32,
        /// Intersections of the last completed step.
        step_intersections: u32,
    }
}

device_struct! {
    /// Parameters of the verbs that change rows.
    Edit {
        /// Counter of the random stream that split children are drawn from.
        iteration: u32,
        /// Key of the random streams, low half.
        key_low: u32,
        /// Key of the random streams, high half.
        key_high: u32,
        /// The ceiling of opacities, or the fraction of a state in a mean.
        amount: f32,
    }
}

/// The intersections do not fit the buffers.
pub(crate) const HALT_OVERFLOW: u32 = 1;
/// The loss is not finite.
pub(crate) const HALT_NON_FINITE: u32 = 2;

/// 3DGS.
pub(crate) const FILTER_CLASSIC: u32 = 0;
/// 3DGS's antialiasing.
pub(crate) const FILTER_ANTIALIASED: u32 = 1;
/// Mip-Splatting.
pub(crate) const FILTER_MIP: u32 = 2;

/// No density signal.
pub(crate) const SIGNAL_NONE: u32 = 0;
/// Norm of the signed gradient.
pub(crate) const SIGNAL_SIGNED: u32 = 1;
/// Norm of the absolute gradients.
pub(crate) const SIGNAL_ABSOLUTE: u32 = 2;
/// Both.
pub(crate) const SIGNAL_BOTH: u32 = 3;
/// Pixel-GS.
pub(crate) const SIGNAL_PIXELS: u32 = 4;

/// Slots of the lengths that only the device knows: rows of the cloud, ...
pub(crate) const LENGTH_ROWS: u32 = 0;
/// ... splats of the view, ...
pub(crate) const LENGTH_VISIBLE: u32 = 1;
/// ... intersections of all tile lists.
pub(crate) const LENGTH_INTERSECTIONS: u32 = 2;
/// Slots.
pub(crate) const LENGTHS: u32 = 3;

/// Grids that only the device knows: an invocation a splat, ...
pub(crate) const GRID_VISIBLE: u32 = 0;
/// ... a prefix sum over the splats, ...
pub(crate) const GRID_VISIBLE_SCAN: u32 = 1;
/// ... a pass of the depth sort, ...
pub(crate) const GRID_DEPTH_SORT: u32 = 2;
/// ... an invocation an intersection, ...
pub(crate) const GRID_INTERSECTIONS: u32 = 3;
/// ... a pass of the tile sort.
pub(crate) const GRID_TILE_SORT: u32 = 4;
/// Grids.
pub(crate) const GRIDS: u32 = 5;

/// Codes of [`genesplat_core::Origin`].
pub(crate) const ORIGIN_KEPT: u32 = 0;
/// See [`ORIGIN_KEPT`].
pub(crate) const ORIGIN_CLONE: u32 = 1;
/// First child; the second is one more.
pub(crate) const ORIGIN_SPLIT: u32 = 2;
/// Relocated, fresh moments.
pub(crate) const ORIGIN_RELOCATED: u32 = 4;
/// Relocated, moments kept.
pub(crate) const ORIGIN_RELOCATED_KEPT: u32 = 5;
/// First twin; the second is one more.
pub(crate) const ORIGIN_TWIN: u32 = 6;
