//! The table of shaders: which texts make each of them.
//!
//! A shader is the prelude, the parts that it shares with others, and its own file, whose entry point is
//! `main`. Everything is compiled in, and validated by a test that needs no device.

use crate::device::adapter::WORKGROUP_BYTES;
use crate::device::prelude::prelude;
use crate::device::unroll::unrolled;

#[derive(Debug)]
pub(crate) struct Shader {
    /// Path of its file in `shader/`, without the extension.
    pub(crate) name: &'static str,
    parts: &'static [&'static str],
}

impl Shader {
    /// What is compiled for a device: the whole text, with constant loops written out.
    pub(super) fn source(&self, abilities: Abilities) -> String {
        unrolled(&self.text(abilities))
    }

    pub(super) fn text(&self, abilities: Abilities) -> String {
        let mut text = prelude(abilities);
        text.extend(self.parts.iter().copied());
        text
    }
}

/// What a device can do, as far as shaders differ by it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Abilities {
    /// Memory that a workgroup shares, bytes.
    pub(crate) workgroup_bytes: u32,
}

impl Abilities {
    /// Splats that a workgroup has room to reduce at once.
    pub(super) fn splats_at_once(self) -> u32 {
        if self.workgroup_bytes < WORKGROUP_BYTES { 4 } else { 8 }
    }
}

macro_rules! shaders {
    ($($name:ident = $file:literal + [$($part:ident),*];)*) => {
        $(pub(crate) static $name: Shader = Shader {
            name: $file,
            parts: &[parts::COMMON, $(parts::$part,)* include_str!(concat!("../../shader/", $file, ".wgsl"))],
        };)*

        static ALL: &[&Shader] = &[$(&$name),*];
    };
}

/// What shaders share.
mod parts {
    macro_rules! parts {
        ($($name:ident = $file:literal;)*) => {
            $(pub(super) const $name: &str = include_str!(concat!("../../shader/", $file));)*
        };
    }
    parts! {
        COMMON = "shared/common.wgsl";
        SPLAT = "shared/splat.wgsl";
        GEOMETRY = "shared/geometry.wgsl";
        COLOUR = "shared/colour.wgsl";
        SH_ROW = "shared/sh_row.wgsl";
        BATCH_SPLAT = "shared/batch_splat.wgsl";
        ROTATION = "shared/rotation.wgsl";
        TILE_SUMS = "shared/tile_sums.wgsl";
        SPLAT_SUMS = "shared/splat_sums.wgsl";
        PHOTO = "shared/photo.wgsl";
        RANDOM = "shared/random.wgsl";
        OVERLAP = "bin/overlap.wgsl";
        WRITE_SPLAT = "bin/write_splat.wgsl";
        GROUP_SCAN = "bin/group_scan.wgsl";
        LIST_ORDER = "bin/list_order.wgsl";
        SSIM = "loss/ssim.wgsl";
        HALO = "loss/halo.wgsl";
        ADAM_STEP = "optimise/adam_step.wgsl";
        COLOUR_STEPS = "optimise/colour_steps.wgsl";
        MAKE_UP = "optimise/make_up.wgsl";
    }
}

shaders! {
    // From a cloud to splats.
    PROJECT = "bin/project" + [SPLAT, ROTATION, GEOMETRY, OVERLAP, WRITE_SPLAT];
    SPLAT_COLOUR = "bin/colour" + [SPLAT, COLOUR, SH_ROW, ADAM_STEP, COLOUR_STEPS, MAKE_UP];
    // From splats to a list for each tile, nearest first.
    EMIT = "bin/emit" + [SPLAT, OVERLAP, GROUP_SCAN];
    PLAN_LISTS = "bin/plan_lists" + [GROUP_SCAN];
    FILL_LISTS = "bin/fill_lists" + [SPLAT];
    SORT_LISTS = "bin/sort_lists" + [LIST_ORDER];
    MERGE_LISTS = "bin/merge_lists" + [LIST_ORDER];
    // From splats to a loss, and back to gradients of intersections.
    RASTERISE = "blend/rasterise" + [SPLAT, OVERLAP, BATCH_SPLAT];
    RASTERISE_BACKWARD = "blend/rasterise_backward" + [SPLAT, OVERLAP, BATCH_SPLAT];
    LOSS = "loss/loss" + [SSIM, HALO, PHOTO];
    LOSS_SUM = "loss/loss_sum" + [TILE_SUMS];
    LOSS_GRADIENT = "loss/loss_gradient" + [HALO, PHOTO];
    DEPTH_LOSS = "loss/depth_loss" + [];
    // From gradients of intersections to stepped parameters.
    PROJECT_BACKWARD = "optimise/project_backward" + [SPLAT, ROTATION, GEOMETRY, COLOUR, SH_ROW, SPLAT_SUMS];
    STATISTICS = "optimise/statistics" + [];
    GENE_STATISTICS = "optimise/gene_statistics" + [];
    ADAM_COLOUR = "optimise/adam_colour" + [ADAM_STEP, COLOUR_STEPS, COLOUR];
    NOTE_STEP = "optimise/note_step" + [COLOUR_STEPS];
    MAKE_UP_COLOUR = "optimise/make_up_colour" + [ADAM_STEP, COLOUR_STEPS, MAKE_UP];
    ADAM_GEOMETRY = "optimise/adam_geometry" + [ADAM_STEP, ROTATION];
    // The same where an optimiser step has the gradients of several views.
    KEEP_COLOUR = "optimise/keep_colour" + [COLOUR];
    KEEP_GEOMETRY = "optimise/keep_geometry" + [];
    ADAM_PENDING_COLOUR = "optimise/adam_pending_colour" + [ADAM_STEP, COLOUR_STEPS];
    NOISE = "optimise/noise" + [ROTATION, RANDOM];
    // Edits of rows.
    GATHER = "rows/gather" + [];
    EDIT_GEOMETRY = "rows/edit_geometry" + [ROTATION, RANDOM];
    RESET_OPACITY = "rows/reset_opacity" + [];
    SET_GENES = "rows/set_genes" + [];
    SET_FILTER = "rows/set_filter" + [];
    // The mean of states.
    AVERAGE = "rows/average" + [];
    COPY_FILTER = "rows/copy_filter" + [];
    // Losses of many individuals at once.
    PROJECT_ROW_VERSIONS = "score/project_row_versions" + [SPLAT, ROTATION, GEOMETRY, OVERLAP, COLOUR, SH_ROW, WRITE_SPLAT];
    RASTERISE_INDIVIDUALS = "score/rasterise_individuals" + [SPLAT, OVERLAP, BATCH_SPLAT];
    VIEW_LOSSES = "score/view_losses" + [TILE_SUMS];
    // What the device's memory can do.
    COPY = "shared/copy" + [];
    // How much of each pixel every Gaussian is.
    WEIGHT_SUM = "blend/weight_sum" + [SPLAT_SUMS];
    // Splats that the host has projected, and what it goes on from after the backward blending.
    COUNT_TILES = "bin/count_tiles" + [SPLAT, OVERLAP];
    SPLAT_SUMS = "blend/splat_sums" + [SPLAT_SUMS];
}

/// Name and WGSL of every kernel, as devices with 24 KiB a workgroup compile it: what tools count.
pub fn kernel_sources() -> impl Iterator<Item = (&'static str, String)> {
    let abilities = Abilities { workgroup_bytes: WORKGROUP_BYTES };
    ALL.iter().map(move |shader| (shader.name, shader.source(abilities)))
}

/// Name and text of every kernel, with its loops.
#[cfg(test)]
pub(crate) fn kernel_texts(abilities: Abilities) -> impl Iterator<Item = (&'static str, String)> {
    ALL.iter().map(move |shader| (shader.name, shader.text(abilities)))
}

#[cfg(test)]
mod tests {
    use naga::AddressSpace;
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    use super::*;
    use crate::device::adapter::{STORAGE_BUFFERS, WORKGROUP_BYTES_MIN};
    use crate::layout::{Counters, Edit, Optimiser, ViewPass, Window};

    const PLAIN: Abilities = Abilities { workgroup_bytes: WORKGROUP_BYTES_MIN };

    /// All of them, for devices with so much memory.
    fn all(workgroup_bytes: u32) -> impl Iterator<Item = (&'static Shader, String)> {
        ALL.iter().map(move |&shader| (shader, shader.source(Abilities { workgroup_bytes })))
    }

    fn parse(shader: &Shader, source: &str) -> naga::Module {
        naga::front::wgsl::parse_str(source)
            .unwrap_or_else(|error| panic!("{}: {}", shader.name, error.emit_to_string(source)))
    }

    /// Without any device: what no driver is needed for must not wait for one.
    #[test]
    fn every_shader_is_valid() {
        assert!(ALL.len() > 20, "the table lists all shaders");
        for (shader, source) in [WORKGROUP_BYTES_MIN, WORKGROUP_BYTES].into_iter().flat_map(all) {
            let module = parse(shader, &source);
            let validated = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
            if let Err(error) = validated {
                panic!("{}: {}", shader.name, error.emit_to_string(&source));
            }
        }
    }

    #[test]
    fn no_shader_needs_more_than_devices_are_asked_for() {
        for most in [WORKGROUP_BYTES_MIN, WORKGROUP_BYTES] {
            let (mut buffers, mut bytes) = (0, 0);
            for module in all(most).map(|(shader, source)| parse(shader, &source)) {
                let of = |wanted: fn(AddressSpace) -> bool| {
                    module
                        .global_variables
                        .iter()
                        .map(|(_, variable)| variable)
                        .filter(move |v| wanted(v.space))
                };
                let size =
                    |variable: &naga::GlobalVariable| module.types[variable.ty].inner.size(module.to_ctx());
                buffers =
                    buffers.max(of(|space| matches!(space, AddressSpace::Storage { .. })).count() as u32);
                bytes = bytes.max(of(|space| space == AddressSpace::WorkGroup).map(size).sum::<u32>());
            }
            assert_eq!(buffers, STORAGE_BUFFERS);
            assert!(bytes <= most && bytes > most / 2, "{bytes} bytes");
        }
    }

    #[test]
    fn a_planted_error_is_found() {
        let source = PROJECT.source(PLAIN).replace("window.count", "window.length");
        assert!(naga::front::wgsl::parse_str(&source).is_err());
    }

    #[test]
    fn rust_and_wgsl_agree_on_every_offset() {
        let module = parse(&PROJECT, &PROJECT.source(PLAIN));
        let structs = [
            ("ViewPass", ViewPass::fields(), size_of::<ViewPass>()),
            ("Optimiser", Optimiser::fields(), size_of::<Optimiser>()),
            ("Window", Window::fields(), size_of::<Window>()),
            ("Counters", Counters::fields(), size_of::<Counters>()),
            ("Edit", Edit::fields(), size_of::<Edit>()),
        ];
        for (name, fields, size) in structs {
            let found = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).expect(name).1;
            let naga::TypeInner::Struct { members, span } = &found.inner else {
                panic!("{name} is a struct")
            };
            let wgsl: Vec<_> = members
                .iter()
                .map(|member| (member.name.as_deref().unwrap_or_default(), member.offset as usize))
                .collect();
            assert_eq!(wgsl, fields, "{name}");
            assert_eq!(*span as usize, size, "{name}: the sizes");
            assert_eq!(size % 16, 0, "{name}: uniforms are whole vectors");
        }
    }
}
