//! What can be asked for. Help texts are written for someone who has never trained a splat.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use genesplat::io::PhotoSize;
use genesplat::train::{EvolutionMode, Variant};

use crate::device::Device;

/// Reconstruct a scene from photos as 3D Gaussians, and evolve them.
///
/// New here? `genesplat demo` builds a small scene, trains it without and with evolution, and shows the difference.
#[derive(Debug, Parser)]
#[command(name = "genesplat", version, max_term_width = 120, infer_long_args = false)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Train a scene: photos with known cameras in, a splat and its figures out
    Train(TrainArgs),
}

/// How large photos are loaded.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct SizeArgs {
    /// Longest side of the photos in pixels; larger ones are reduced [default: only widths above 1600 are reduced, to 1600].
    /// Smaller trains faster and shows less detail
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..), conflicts_with = "downscale")]
    pub max_side: Option<u32>,
    /// Divide both sides of the photos by K (the field's benchmarks use 1, 2, 4 and 8)
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub downscale: Option<u32>,
}

impl SizeArgs {
    /// The size that was asked for, if any was.
    pub fn size(self) -> Option<PhotoSize> {
        self.max_side.map(PhotoSize::MaxSide).or(self.downscale.map(PhotoSize::Downscale))
    }
}

/// Which machine power to use.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct MachineArgs {
    /// Where to compute; results do not depend on the number of threads, but may on the kind of device [default: auto]
    #[arg(long, value_enum, value_name = "DEVICE")]
    pub device: Option<Device>,
    /// Processor threads to use, at least 1 [default: all cores]
    #[arg(long, value_name = "N", value_parser = positive)]
    pub threads: Option<usize>,
}

/// `genesplat train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Folder of the scene: a COLMAP model in sparse/0 (cameras, images, points3D as .bin or .txt) and its photos in images
    pub dataset: PathBuf,
    /// Folder for the results; made if it is missing. It will hold point_cloud.ply, metrics.json, config.toml, log.jsonl
    /// and test/*.png
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would show it as help")]
    pub size: SizeArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would show it as help")]
    pub machine: MachineArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would show it as help")]
    pub schedule: ScheduleArgs,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would show it as help")]
    pub evolution: EvolutionArgs,
    /// TOML file with settings (the config.toml of any run is one); flags given here win over it [default: none]
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Go on with the interrupted run in DIR, from its checkpoint; the result is the same as without the interruption
    #[arg(long)]
    pub resume: bool,
}

/// How long, and what kind of training.
#[derive(Clone, Debug, Default, Args)]
pub struct ScheduleArgs {
    /// Method: the original, or one of two improvements on it [default: 3dgs]
    #[arg(long, value_enum, value_name = "METHOD")]
    pub variant: Option<VariantName>,
    /// Training steps, one photo each [default: 30000]. More is better and slower; alone it cuts the schedule short,
    /// so 7000 is a good quick run
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
    /// Multiply every setting that counts steps by F, 0.001 to 1000 [default: 1]. 0.1 gives a run of the same shape in a
    /// tenth of the steps
    #[arg(long, value_name = "F", value_parser = scale)]
    pub steps_scale: Option<f64>,
    /// Seed of all random numbers [default: 0]. Same seed, same bytes
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(..1 << 63))]
    pub seed: Option<u64>,
    /// Stop adding Gaussians at this many [default: no limit]. Bounds memory (about 1.5 KB a Gaussian) and time
    #[arg(long, value_name = "N", value_parser = positive)]
    pub max_gaussians: Option<usize>,
    /// Iterations between two checkpoints [default: 1000]; 0 for none but that of Ctrl-C
    #[arg(long, value_name = "N")]
    pub checkpoint_every: Option<u32>,
}

/// The genetic algorithm.
#[derive(Clone, Debug, Default, Args)]
pub struct EvolutionArgs {
    /// What runs after each opacity reset (every 3000 steps by default) [default: off]
    #[arg(long, value_enum, value_name = "MODE")]
    pub evolve: Option<Evolve>,
    /// Generations of each evolution stage [default: 100]. Time grows in proportion
    #[arg(long, value_name = "N")]
    pub generations: Option<u32>,
    /// Individuals a generation, at least 1 [default: 100]. Time grows in proportion
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub population: Option<u32>,
}

/// Methods, as `--variant` names them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum VariantName {
    /// 3D Gaussian Splatting (Kerbl et al. 2023)
    #[value(name = "3dgs")]
    ThreeDgs,
    /// Pixel-GS (Zhang et al. 2024): adds Gaussians where many pixels need them
    PixelGs,
    /// Mip-Splatting (Yu et al. 2024): stays sharp when seen from nearer or farther than the photos
    MipSplatting,
}

impl From<VariantName> for Variant {
    fn from(name: VariantName) -> Self {
        match name {
            VariantName::ThreeDgs => Self::ThreeDgs,
            VariantName::PixelGs => Self::PixelGs,
            VariantName::MipSplatting => Self::MipSplatting,
        }
    }
}

/// Modes of evolution, as `--evolve` names them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Evolve {
    /// Gradient descent only
    Off,
    /// The genetic algorithm of "An Evolutionary Boost to Gaussian Splatting Optimization"
    Paper,
    /// For comparison: the same time (evolution.control_seconds of the configuration file) spent on more gradient steps
    Control,
}

impl From<Evolve> for EvolutionMode {
    fn from(mode: Evolve) -> Self {
        match mode {
            Evolve::Off => Self::Off,
            Evolve::Paper => Self::Paper,
            Evolve::Control => Self::Control,
        }
    }
}

fn positive(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|&count: &usize| count > 0)
        .ok_or_else(|| "a whole number from 1 is needed".into())
}

fn scale(text: &str) -> Result<f64, String> {
    let valid = |scale: &f64| (1e-3..=1e3).contains(scale);
    text.parse().ok().filter(valid).ok_or_else(|| "a number between 0.001 and 1000 is needed".into())
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        Arguments::command().debug_assert();
    }
}
