//! Every constant and every struct that Rust and WGSL share.
//!
//! Declared once; `device::prelude` writes them into WGSL. A test reads that back with naga and compares
//! offsets.

use bytemuck::{Pod, Zeroable};

/// Declares constants, and the table of them that is written into WGSL.
macro_rules! shared_constants {
    ($($name:ident = $value:expr,)*) => {
        $(pub(crate) const $name: u32 = $value;)*

        pub(crate) const SHARED_CONSTANTS: &[(&str, u32)] = &[$((stringify!($name), $name),)*];
    };
}

shared_constants! {
    // Side of a tile, px.
    TILE = 16,
    // Invocations of every one-dimensional workgroup.
    GROUP = 256,
    // Workgroups in the first dimension of a grid, few in tests; what is more goes to the second.
    GRID_WIDTH = if cfg!(test) { 3 } else { 32_768 },
    // Entries of a tile's list that a workgroup sorts at once: 8 KiB of its memory.
    LIST_BLOCK = 1024,
    // Sorted runs of a longer list that are merged at once.
    RUNS = 32,
    // Tiles of a splat that one invocation lists, and whose gradients it sums, few in tests; those of wider
    // splats, a workgroup.
    SERIAL_TILES = if cfg!(test) { 4 } else { 32 },
    // Steps that colours may have to make up for, few in tests.
    LATE_STEPS_MAX = if cfg!(test) { 5 } else { 64 },
    // Individuals that a workgroup of stage `score` renders: as many pixels as an invocation has registers
    // for.
    SLOTS = 16,
    // Words with a bit for each individual of a pool.
    HOLDER_WORDS = 4,
    // Where the genes of a row version are, if they are the row's own.
    OWN_GENES = u32::MAX,

    // Why the device changes nothing more: intersections that do not fit their buffers, a loss that is not
    // finite, a list that is longer than its merges reach.
    HALT_OVERFLOW = 1,
    HALT_NON_FINITE = 2,
    HALT_LONG_LIST = 4,
    // Screen filters.
    FILTER_CLASSIC = 0,
    FILTER_ANTIALIASED = 1,
    FILTER_MIP = 2,
    // Density signals.
    SIGNAL_NONE = 0,
    SIGNAL_SIGNED = 1,
    SIGNAL_ABSOLUTE = 2,
    SIGNAL_PIXELS = 3,
    // Slots of what is counted for the tile lists, and their number: splats, intersections, and whether these
    // exceed 32 bits. The length of each tile's list comes behind them.
    TALLY_VISIBLE = 0,
    TALLY_INTERSECTIONS = 1,
    TALLY_CARRY = 2,
    TALLIES = 3,
    // Slots of the grids that only the device knows, and their number.
    GRID_INTERSECTIONS = 0,
    GRID_LISTS = 1,
    GRID_BLOCKS = 2,
    GRIDS = 3,
    // Codes of `genesplat_core::Origin`; the second child of a split of either kind is one more.
    ORIGIN_KEPT = 0,
    ORIGIN_CLONE = 1,
    ORIGIN_SPLIT = 2,
    ORIGIN_RELOCATED = 4,
    ORIGIN_RELOCATED_KEPT = 5,
    ORIGIN_LONG_AXIS = 6,
}

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
/// Floats of the density statistics of one Gaussian: gradient, weight.
pub(crate) const DENSITY_FLOATS: u32 = 2;
/// Floats of the gene statistics of one Gaussian: seven sums, then the number of views.
pub(crate) const GENE_FLOATS: u32 = 8;

/// Declares a `#[repr(C)]` struct and its WGSL twin.
macro_rules! device_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $kind:tt,)* }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub(crate) struct $name { $($(#[$field_doc])* pub(crate) $field: device_struct!(@rust $kind),)* }

        impl $name {
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
    /// What a render depends on besides the cloud. Vectors come first, so that WGSL's and Rust's layouts
    /// agree.
    ViewPass {
        /// Rows of `camera_from_world`: rotation, translation.
        camera_x: vec4,
        camera_y: vec4,
        camera_z: vec4,
        /// Camera centre, world; the depth that is 1 of a picture of inverse depth, world units, or 0.
        centre: vec4,
        /// Colour behind all splats; the weight of a loss of inverse depth.
        background: vec4,
        /// Focal lengths, px.
        focal_x: f32,
        focal_y: f32,
        /// Pixel coordinate that the optical axis hits.
        axis_x: f32,
        axis_y: f32,
        /// Largest `|x/z|` and `|y/z|` that the Jacobian sees.
        limit_x: f32,
        limit_y: f32,
        /// Variance added to the diagonal of the projected covariance, px².
        dilation: f32,
        /// Pixel-GS's depth threshold, world units.
        depth_threshold: f32,
        /// Size, px, and in tiles.
        width: u32,
        height: u32,
        tiles_x: u32,
        tiles_y: u32,
        /// Rows of the cloud.
        rows: u32,
        /// Active degree of the spherical harmonics.
        sh_degree: u32,
        /// One of the `FILTER_` and one of the `SIGNAL_` constants.
        filter_kind: u32,
        signal: u32,
        /// Intersections that fit the buffers.
        intersection_capacity: u32,
        /// Pictures that are made at once, one for each individual of a pool.
        layers: u32,
        /// 1 where some pixels of the photo do not count.
        is_masked: u32,
        /// Near plane, world units.
        near: f32,
    }
}

device_struct! {
    /// One optimiser step: Adam's factors `lr / (1 − β1ᵗ)` and `1 / sqrt(1 − β2ᵗ)`, and MCMC's additions.
    Optimiser {
        position: f32,
        /// How far a step moves a Gaussian at most, in its standard deviations; 0 for no limit.
        position_reach: f32,
        scale: f32,
        rotation: f32,
        opacity: f32,
        sh_dc: f32,
        sh_rest: f32,
        /// Second factor of all groups but opacity.
        root: f32,
        /// That of opacity; 0 leaves opacities and their moments alone.
        opacity_root: f32,
        /// 1 adds 3DGS-MCMC's regularisers and noise.
        is_mcmc: u32,
        /// Factor of the positional noise.
        noise_scale: f32,
        /// Weights of the mean opacity and of the mean scale in the loss.
        opacity_weight: f32,
        scale_weight: f32,
        /// Counter and key of the noise stream.
        counter: u32,
        key_low: u32,
        key_high: u32,
    }
}

device_struct! {
    /// Rows `first .. first + count`: what one binding of a column that is too large for a single one shows.
    Window {
        first: u32,
        count: u32,
        /// A second window, or a stage's own parameters.
        source_first: u32,
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
        /// Loss, splats and intersections of the last completed step.
        loss: f32,
        step_visible: u32,
        step_intersections: u32,
    }
}

device_struct! {
    /// Parameters of the verbs that change rows.
    Edit {
        /// Counter and key of the random stream that split children are drawn from.
        iteration: u32,
        key_low: u32,
        key_high: u32,
        /// The ceiling of opacities, or the fraction of a state in a mean.
        amount: f32,
    }
}
