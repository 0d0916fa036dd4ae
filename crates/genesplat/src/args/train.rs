//! `genesplat train`: how long, by which method, with which evolution.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use genesplat::train::{EvolutionMode, Variant};

use super::{LpipsArgs, MachineArgs, MethodArgs, SizeArgs, scale};

/// `genesplat train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Folder of the scene: a COLMAP model in sparse/0 (cameras, images, points3D as .bin or .txt) and its photos in images; or a
    /// transforms.json of nerfstudio or instant-ngp, or Blender's transforms_train.json and transforms_test.json, and the photos
    /// that they name
    pub dataset: PathBuf,
    /// Folder for the results; made if it is missing. It will hold point_cloud.ply, metrics.json, config.toml, log.jsonl
    /// and test/*.png; an earlier run's results there are moved to DIR/previous, and removed once this run has come to its end
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub size: SizeArgs,
    #[command(flatten)]
    pub machine: MachineArgs,
    #[command(flatten)]
    pub schedule: ScheduleArgs,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub evolution: EvolutionArgs,
    #[command(flatten)]
    pub lpips: LpipsArgs,
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
    /// Method: the original, or one of three improvements on it [default: 3dgs]
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
    /// Stop adding Gaussians at this many [default: no limit, or with --evolve renew as many as the photos can determine; 1000000
    /// with mcmc, which grows towards it by 5 % a time]. Bounds memory (about 1.5 KB a Gaussian) and time
    #[arg(long, value_name = "N", value_parser = positive)]
    pub max_gaussians: Option<usize>,
    /// Iterations between two checkpoints [default: 1000]; 0 for none but that of Ctrl-C and SIGTERM
    #[arg(long, value_name = "N")]
    pub checkpoint_every: Option<u32>,
}

/// Which evolution, and how much of it.
#[derive(Clone, Debug, Default, Args)]
pub struct EvolutionArgs {
    /// Evolution beside gradient descent [default: off]. paper, control: after each opacity reset; mosaic: at the end; recombine,
    /// renew: in the second half of the run
    #[arg(long, value_enum, value_name = "MODE")]
    pub evolve: Option<Evolve>,
    /// Generations of each evolution stage of paper and mosaic, at least 1 [default: 100, mosaic: 20]. Time grows in proportion
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub generations: Option<u32>,
    /// Individuals a generation, 1 to 10000 [default: 100, mosaic: 12]. Time grows in proportion
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
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
    /// 3DGS-MCMC (Kheradmand et al. 2024): Gaussians wander, dead ones move to where they are needed, up to --max-gaussians;
    /// give it several thousand iterations
    Mcmc,
}

impl From<VariantName> for Variant {
    fn from(name: VariantName) -> Self {
        match name {
            VariantName::ThreeDgs => Self::ThreeDgs,
            VariantName::PixelGs => Self::PixelGs,
            VariantName::MipSplatting => Self::MipSplatting,
            VariantName::Mcmc => Self::Mcmc,
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
    /// Ours: every twentieth of the second half of the run, a child bred from its last states takes over if photos held back
    /// from that search agree
    Recombine,
    /// Ours, and worth most: limits the number of Gaussians to what the photos can determine; after growth ends, replaces the least
    /// useful by copies where the error is largest; then also does recombine
    Renew,
    /// Ours, without gradients: each Gaussian takes the mutation that made the picture better where it is seen, if photos held back
    /// agree. Worth most on a splat that gradients have not finished
    Mosaic,
}

impl From<Evolve> for EvolutionMode {
    fn from(mode: Evolve) -> Self {
        match mode {
            Evolve::Off => Self::Off,
            Evolve::Paper => Self::Paper,
            Evolve::Control => Self::Control,
            Evolve::Recombine => Self::Recombine,
            Evolve::Renew => Self::Renew,
            Evolve::Mosaic => Self::Mosaic,
        }
    }
}

/// Those of them that a finished splat allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Search {
    /// Ours: each Gaussian takes the mutation that made the picture better where it is seen, if photos held back agree
    Mosaic,
    /// The genetic algorithm of "An Evolutionary Boost to Gaussian Splatting Optimization"
    Paper,
    /// For comparison: gradient steps for evolution.control_seconds of the configuration file
    Control,
}

impl From<Search> for Evolve {
    fn from(search: Search) -> Self {
        match search {
            Search::Mosaic => Self::Mosaic,
            Search::Paper => Self::Paper,
            Search::Control => Self::Control,
        }
    }
}

fn positive(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|&count: &usize| count > 0)
        .ok_or_else(|| "a whole number from 1 is needed".into())
}
