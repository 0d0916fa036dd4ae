//! The table of shaders: which texts make each of them.
//!
//! A shader is the prelude of [`crate::layout`], the parts that it shares with others, and its own file, whose entry point
//! is `main`. Two of the shared parts exist twice: for devices with subgroups, and for those without. Everything is compiled
//! in, and validated by a test that needs no device.

use crate::layout;

/// One shader.
#[derive(Debug)]
pub struct Shader {
    /// Name of the stage, or of its step.
    pub name: &'static str,
    /// Texts after the prelude.
    parts: &'static [Part],
}

impl Shader {
    /// The whole text.
    pub fn source(&self, subgroups: Subgroups) -> String {
        let mut source = layout::prelude();
        source.extend(self.parts.iter().map(|part| match (part, subgroups) {
            (Part::Only(text), _) => *text,
            (Part::Twice { without, .. }, Subgroups::Without) => without,
            (Part::Twice { with, .. }, Subgroups::With) => with,
        }));
        source
    }
}

/// Do kernels use subgroups? They do the same with and without.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subgroups {
    With,
    Without,
}

/// Text of a shader.
#[derive(Debug)]
enum Part {
    Only(&'static str),
    /// The same functions, in two ways.
    Twice {
        with: &'static str,
        without: &'static str,
    },
}

macro_rules! shaders {
    ($($(#[$doc:meta])* $name:ident = $file:literal + [$($part:ident),*];)*) => {
        $($(#[$doc])* pub static $name: Shader = Shader {
            name: $file,
            parts: &[parts::COMMON, $(parts::$part,)* Part::Only(include_str!(concat!("../shader/", $file, ".wgsl")))],
        };)*

        /// All of them.
        #[cfg(test)]
        pub static ALL: &[&Shader] = &[$(&$name),*];
    };
}

/// What shaders share.
mod parts {
    use super::Part;

    macro_rules! text {
        ($file:literal) => {
            include_str!(concat!("../shader/", $file))
        };
    }
    macro_rules! parts {
        ($($name:ident = $file:literal;)*) => {
            $(pub const $name: Part = Part::Only(text!($file));)*
        };
    }
    pub const GROUP_SCAN: Part = Part::Twice {
        with: concat!(text!("subgroup.wgsl"), text!("group_scan_subgroups.wgsl")),
        without: text!("group_scan.wgsl"),
    };
    pub const MARK: Part = Part::Twice { with: text!("mark_subgroups.wgsl"), without: text!("mark.wgsl") };
    parts! {
        COMMON = "common.wgsl";
        SUBGROUP = "subgroup.wgsl";
        SPLAT = "splat.wgsl";
        GEOMETRY = "geometry.wgsl";
        OVERLAP = "overlap.wgsl";
        COLOUR = "colour.wgsl";
        SH_ROW = "sh_row.wgsl";
        WRITE_SPLAT = "write_splat.wgsl";
        GRIDS = "grids.wgsl";
        TILE_SPLAT = "tile_splat.wgsl";
        ROTATION = "rotation.wgsl";
        SSIM = "ssim.wgsl";
        TILE_SUMS = "tile_sums.wgsl";
        PHOTO = "photo.wgsl";
        PIXEL_ERROR = "pixel_error.wgsl";
        ENTRY_SUMS = "entry_sums.wgsl";
        ADAM_STEP = "adam_step.wgsl";
        RANDOM = "random.wgsl";
    }
}

shaders! {
    /// Cloud to splats.
    PROJECT = "project" + [SPLAT, ROTATION, GEOMETRY, OVERLAP, COLOUR, SH_ROW, WRITE_SPLAT];
    /// Prefix sum: sums of blocks.
    SCAN_SUMS = "scan_sums" + [GROUP_SCAN];
    /// Prefix sum: over the blocks.
    SCAN_BLOCKS = "scan_blocks" + [GROUP_SCAN];
    /// Prefix sum: within the blocks.
    SCAN_APPLY = "scan_apply" + [GROUP_SCAN];
    /// What subgroups do here.
    PROBE_SUBGROUPS = "probe_subgroups" + [SUBGROUP];
    /// Splats without gaps.
    COMPACT = "compact" + [];
    /// Work that the splats are.
    PLAN_VISIBLE = "plan_visible" + [GRIDS];
    /// Work that the tile lists are.
    PLAN_ENTRIES = "plan_entries" + [GRIDS];
    /// Radix sort: digits by block.
    RADIX_COUNT = "radix_count" + [];
    /// Radix sort: where each block's digits begin.
    DIGIT_SCAN = "digit_scan" + [GROUP_SCAN];
    /// Radix sort: every key to its place.
    RADIX_SCATTER = "radix_scatter" + [GROUP_SCAN, MARK];
    /// Tile counts by depth.
    RANK_COUNTS = "rank_counts" + [];
    /// Entries of the tile lists.
    EMIT = "emit" + [SPLAT, OVERLAP];
    /// Where each tile's entries are.
    TILE_RANGES = "tile_ranges" + [];
    /// Splats to pixels.
    RASTERISE = "rasterise" + [SPLAT, TILE_SPLAT];
    /// Loss of each tile.
    LOSS = "loss" + [SSIM, PHOTO];
    /// Loss of the image.
    LOSS_SUM = "loss_sum" + [TILE_SUMS];
    /// Gradient of the image.
    LOSS_GRADIENT = "loss_gradient" + [SSIM, PHOTO];
    /// Gradient rows of the splats.
    RASTERISE_BACKWARD = "rasterise_backward" + [SPLAT, TILE_SPLAT];
    /// Gradients of the parameters.
    PROJECT_BACKWARD = "project_backward" + [SPLAT, ROTATION, GEOMETRY, COLOUR, SH_ROW];
    /// Sums for density control.
    STATISTICS = "statistics" + [];
    /// Sums for evolution.
    GENE_STATISTICS = "gene_statistics" + [];
    /// Optimiser, colours.
    ADAM_COLOUR = "adam_colour" + [ADAM_STEP, COLOUR];
    /// Optimiser, everything else.
    ADAM_GEOMETRY = "adam_geometry" + [ADAM_STEP];
    /// MCMC's noise.
    EXPLORE = "explore" + [ROTATION, RANDOM];
    /// Merits: what takes the place of the image's gradient.
    WEIGH_PIXELS = "weigh_pixels" + [PHOTO, PIXEL_ERROR];
    /// Merits: sums of each Gaussian.
    WEIGH_SUM = "weigh_sum" + [ENTRY_SUMS];
    /// Credit: errors of mutants, and what they are above those of the base.
    CREDIT_PIXELS = "credit_pixels" + [PHOTO, PIXEL_ERROR];
    /// Credit: sums of each Gaussian.
    CREDIT_SUM = "credit_sum" + [ENTRY_SUMS];
    /// Scoring: splats of the alleles.
    SCORE_PROJECT = "score_project" + [SPLAT, ROTATION, GEOMETRY, OVERLAP, COLOUR, SH_ROW, WRITE_SPLAT];
    /// Scoring: pictures of individuals.
    SCORE_RASTERISE = "score_rasterise" + [SPLAT, TILE_SPLAT];
    /// Scoring: losses of individuals.
    SCORE_SUM = "score_sum" + [TILE_SUMS];
    /// Row edits: copies.
    GATHER = "gather" + [];
    /// Row edits: clones, children, twins, relocations.
    EDIT_GEOMETRY = "edit_geometry" + [ROTATION, RANDOM];
    /// Opacity reset.
    RESET_OPACITY = "reset_opacity" + [];
    /// Genes of single rows.
    APPLY = "apply" + [];
    /// Mip-Splatting's 3D filter.
    SET_FILTER = "set_filter" + [];
    /// Mean of states.
    AVERAGE = "average" + [];
    /// A child of the cloud and its parents.
    BREED = "breed" + [];
}

#[cfg(test)]
mod tests {
    use naga::AddressSpace;
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    use super::*;
    use crate::adapter::{STORAGE_BUFFERS, WORKGROUP_BYTES};
    use crate::layout::{Counters, Edit, Frame, Optimiser, Window};

    /// All of them, in both ways, and what a device must be able to do for that.
    fn all() -> impl Iterator<Item = (&'static Shader, String, Capabilities)> {
        let ways = [(Subgroups::Without, Capabilities::empty()), (Subgroups::With, Capabilities::SUBGROUP)];
        ways.into_iter().flat_map(|(subgroups, capabilities)| {
            let runs =
                move |shader: &&&Shader| subgroups == Subgroups::With || shader.name != PROBE_SUBGROUPS.name;
            ALL.iter().filter(runs).map(move |&shader| (shader, shader.source(subgroups), capabilities))
        })
    }

    fn parse(shader: &Shader, source: &str) -> naga::Module {
        naga::front::wgsl::parse_str(source)
            .unwrap_or_else(|error| panic!("{}: {}", shader.name, error.emit_to_string(source)))
    }

    /// Without any device: what no driver is needed for must not wait for one.
    #[test]
    fn every_shader_is_valid() {
        assert!(ALL.len() > 20, "the table lists all shaders");
        for (shader, source, capabilities) in all() {
            let module = parse(shader, &source);
            let validated = Validator::new(ValidationFlags::all(), capabilities).validate(&module);
            if let Err(error) = validated {
                panic!("{}: {}", shader.name, error.emit_to_string(&source));
            }
        }
    }

    #[test]
    fn no_shader_needs_more_than_devices_are_asked_for() {
        let (mut buffers, mut bytes) = (0, 0);
        for module in all().map(|(shader, source, _)| parse(shader, &source)) {
            let of = |wanted: fn(AddressSpace) -> bool| {
                module.global_variables.iter().map(|(_, variable)| variable).filter(move |v| wanted(v.space))
            };
            let size =
                |variable: &naga::GlobalVariable| module.types[variable.ty].inner.size(module.to_ctx());
            buffers = buffers.max(of(|space| matches!(space, AddressSpace::Storage { .. })).count() as u32);
            bytes = bytes.max(of(|space| space == AddressSpace::WorkGroup).map(size).sum::<u32>());
        }
        assert_eq!(buffers, STORAGE_BUFFERS);
        assert!(bytes <= WORKGROUP_BYTES && bytes > WORKGROUP_BYTES / 2, "{bytes} bytes");
    }

    #[test]
    fn a_planted_error_is_found() {
        let source = PROJECT.source(Subgroups::Without).replace("window.count", "window.length");
        assert!(naga::front::wgsl::parse_str(&source).is_err());
    }

    #[test]
    fn every_file_is_in_the_table() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("shader");
        let text: String = all().map(|(_, source, _)| source).collect();
        for file in std::fs::read_dir(folder).expect("the shaders") {
            let path = file.expect("readable").path();
            let source = std::fs::read_to_string(&path).expect("UTF-8");
            assert!(text.contains(&source), "{} is in no shader", path.display());
        }
    }

    #[test]
    fn rust_and_wgsl_agree_on_every_offset() {
        let module = parse(&PROJECT, &PROJECT.source(Subgroups::Without));
        let structs = [
            ("Frame", Frame::fields(), size_of::<Frame>()),
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
