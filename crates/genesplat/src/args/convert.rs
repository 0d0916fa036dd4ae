//! `genesplat convert`.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use genesplat::flags::{MachineArgs, choice};
use genesplat::io::format::SpzVersion;

use super::choice::SPZ_VERSIONS;
use super::placement::PlacementArgs;
use super::{PhotosArgs, ShownOnArgs, fraction};

/// What says nothing where no photos are loaded.
const OF_PHOTOS: [&str; 8] =
    ["max_side", "downscale", "test_every", "test_list", "train_on_all", "mask", "near", "background"];

#[derive(Debug, Args)]
#[command(group(ArgGroup::new("of photos").args(OF_PHOTOS).multiple(true).requires("data")))]
pub(crate) struct ConvertArgs {
    /// The splat to read (.ply, compressed .ply, .splat, .spz, .sog or .glb), or the folder of a run, whose
    /// photos are loaded as it was trained on them unless a flag says otherwise; --downscale divides the size
    /// that they had there
    #[arg(value_name = "SPLAT|RUN")]
    pub(crate) splat: PathBuf,
    /// The splat to write, in the format that its name ends in: .ply, .compressed.ply, .splat, .spz, .sog or
    /// .glb
    #[arg(value_name = "OUT")]
    pub(crate) out: PathBuf,
    /// Keep only Gaussians whose centres are in this box, in the units and axes of the splat [default: all]
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = box_of, allow_hyphen_values = true)]
    pub(crate) crop: Option<Box3>,
    /// Drop Gaussians whose opacity, 0 to 1, is lower than this [default: none]
    #[arg(long, value_name = "OPACITY", value_parser = fraction::<f32>)]
    pub(crate) prune: Option<f32>,
    /// Highest degree of the spherical harmonics to write, 0 to 3: a lower one loses highlights [default: all
    /// there is]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=3))]
    pub(crate) sh_degree: Option<u8>,
    #[command(flatten)]
    pub(crate) placement: PlacementArgs,
    /// Give back the coordinates of the survey, in double precision: what was subtracted from them, since
    /// they are far from their origin, is added again. For .ply, which alone has double precision
    #[arg(long, conflicts_with_all = ["up", "rotate", "scale", "translate"])]
    pub(crate) georeferenced: bool,
    /// Version of .spz to write [default: 4]
    #[arg(long, value_name = "N", value_parser = choice(SPZ_VERSIONS), ignore_case = true)]
    pub(crate) spz_version: Option<SpzVersion>,
    /// Folder of the scene that the splat shows: say what is lost, in dB, on all photos that training never
    /// saw [default: eight of them of the RUN, if its scene is still there; none for a SPLAT]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    #[command(flatten)]
    pub(crate) on: ShownOnArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
}

/// A box between two corners, world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Box3 {
    low: [f32; 3],
    high: [f32; 3],
}

impl Box3 {
    pub(crate) fn contains(&self, position: [f32; 3]) -> bool {
        (0..3).all(|axis| (self.low[axis]..=self.high[axis]).contains(&position[axis]))
    }
}

fn box_of(text: &str) -> Result<Box3, String> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    let corners = numbers.as_deref().and_then(|numbers| <[f32; 6]>::try_from(numbers).ok());
    let [x0, y0, z0, x1, y1, z1] = corners.ok_or("six numbers with commas between them are needed")?;
    let (low, high) = ([x0, y0, z0], [x1, y1, z1]);
    if (0..3).all(|axis| low[axis] < high[axis]) {
        Ok(Box3 { low, high })
    } else {
        Err("the first corner must be lower than the second on every axis".into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_has_two_corners_in_order() {
        let cube = box_of("-1, -1,-1,1,1,1").unwrap();
        assert!(cube.contains([0.0, 1.0, -1.0]) && !cube.contains([0.0, 1.1, 0.0]));
        for wrong in ["", "1,2,3", "0,0,0,1,1,x", "0,0,0,1,1,0", "0,0,0,1,1,NaN"] {
            assert!(box_of(wrong).is_err(), "{wrong}");
        }
    }
}
