//! `genesplat bench`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::{JsonArgs, MachineArgs, SizeArgs, THREADS};

/// What can be measured.
#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    /// Time training steps stage by stage, at a fixed number of Gaussians, beside the best that blending could reach
    Step(BenchStepArgs),
    /// Time the scoring of a population just after an opacity reset, beside rendering each individual in full
    Evolution(BenchEvolutionArgs),
    /// Time training steps by stage and the scoring of a population on the graphics device, at several numbers of
    /// Gaussians
    Gpu(BenchGpuArgs),
}

/// Where the cameras, the photos and the Gaussians to measure with come from.
#[derive(Debug, Args)]
pub(crate) struct SourceArgs {
    /// Folder of a scene to take cameras, photos and points from [default: a synthetic cloud before one camera]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// A trained splat of that scene (a file), or the folder of a run, instead of Gaussians made from its points
    /// [default: none]
    #[arg(long, value_name = "SPLAT|RUN", requires = "data")]
    pub(crate) splat: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) size: SizeArgs,
}

/// A cloud to measure on.
#[derive(Debug, Args)]
pub(crate) struct WorkloadArgs {
    #[command(flatten)]
    pub(crate) source: SourceArgs,
    /// Number of Gaussians, at least 4 [default: as many as the scene has points; 55000 without --data, before a camera
    /// of 268x478]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(4..), conflicts_with = "splat")]
    pub(crate) gaussians: Option<u32>,
}

#[derive(Debug, Args)]
pub(crate) struct BenchStepArgs {
    #[command(flatten)]
    pub(crate) workload: WorkloadArgs,
    /// Steps to time; medians are reported
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) steps: u32,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
}

#[derive(Debug, Args)]
pub(crate) struct BenchEvolutionArgs {
    #[command(flatten)]
    pub(crate) workload: WorkloadArgs,
    /// Individuals to score: the paper's number
    #[arg(long, value_name = "P", default_value_t = 100, value_parser = clap::value_parser!(u32).range(2..))]
    pub(crate) population: u32,
    /// Views to score them on
    #[arg(long, value_name = "V", default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) views: u32,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
}

#[derive(Debug, Args)]
pub(crate) struct BenchGpuArgs {
    #[command(flatten)]
    pub(crate) source: SourceArgs,
    /// Numbers of Gaussians, separated by commas; those that the device has not enough memory for are left out
    #[arg(
        long,
        value_name = "N,..",
        value_delimiter = ',',
        default_value = "100000,1000000,3000000",
        value_parser = clap::value_parser!(u32).range(4..),
        conflicts_with = "splat"
    )]
    pub(crate) gaussians: Vec<u32>,
    /// Width of the synthetic photo, pixels
    #[arg(long, value_name = "PX", default_value_t = 1920, value_parser = side(), conflicts_with = "data")]
    pub(crate) width: u32,
    /// Its height
    #[arg(long, value_name = "PX", default_value_t = 1080, value_parser = side(), conflicts_with = "data")]
    pub(crate) height: u32,
    /// Steps to time
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) steps: u32,
    /// Individuals to score
    #[arg(long, value_name = "P", default_value_t = 100, value_parser = clap::value_parser!(u32).range(2..))]
    pub(crate) population: u32,
    /// Sort without subgroups, as on devices that have none, to see what they are worth on this one
    #[arg(long)]
    pub(crate) without_subgroups: bool,
    /// Processor threads to make the cloud with [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(THREADS))]
    pub(crate) threads: Option<u16>,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
}

/// What a side of a photo may be, px.
fn side() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=16384)
}
