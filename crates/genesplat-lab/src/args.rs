//! What can be asked for.
#![allow(missing_docs, reason = "clap would show the documentation of flattened arguments as help")]

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use genesplat::flags::{JsonArgs, LpipsArgs, MachineArgs, SizeArgs, VolumeArgs, scale};
use genesplat::run::settings::THREADS;
use genesplat::train::MethodName;

const EXIT_STATUS: &str = "Exit status: 0 done, 1 failed (one sentence on stderr says why), 2 wrong usage, 130 stopped by Ctrl-C or \
                           SIGTERM with what there was saved (experiment)";

/// The laboratory of genesplat: experiments, benchmarks, tables of its documents.
#[derive(Debug, Parser)]
#[command(name = "genesplat-lab", version, max_term_width = 120, after_help = EXIT_STATUS)]
pub(crate) struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
    #[command(flatten)]
    pub(crate) volume: VolumeArgs,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Repeat a comparison over scenes, methods and seeds, and make its tables; can be interrupted and goes
    /// on
    Experiment(ExperimentArgs),
    /// Measure how long a method takes to the PSNR with which another one ends
    Quality(QualityArgs),
    /// Measure how fast this machine trains
    Bench {
        /// What to measure
        #[command(subcommand)]
        what: Bench,
    },
    /// Write the tables of the documents from the figures in lab/results, and docs/settings.md from the
    /// comments of the settings
    Tables(TablesArgs),
}

#[derive(Debug, Args)]
pub(crate) struct ExperimentArgs {
    /// What to compare: smoke (minutes, no data needed), paper-table-2-3, study-evolution, study-paper,
    /// study-mcmc, study-improved, ablation-paper, ablation-genesplat, or a TOML file of one's own
    #[arg(value_name = "NAME|FILE.toml")]
    pub(crate) what: String,
    /// Folder for the runs, the tables and report.html; made if it is missing. The same command goes on with
    /// what is unfinished in it
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Folder that holds the folders of the scenes [default: none; the bundled gallery needs none]
    #[arg(long, value_name = "FOLDER")]
    pub(crate) data: Option<PathBuf>,
    /// Print the runs with their numbers, a line each, and run nothing
    #[arg(long, conflicts_with = "cell")]
    pub(crate) list: bool,
    /// Make run N of --list only, and no tables: for job arrays, any number at once in one folder. The same
    /// command without it makes the tables
    #[arg(long, value_name = "N")]
    pub(crate) cell: Option<usize>,
    /// Training steps of every run [default: as the experiment says]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) iterations: Option<u32>,
    /// Multiply every setting that counts steps by F, 0.001 to 1000 [default: as the experiment says]
    #[arg(long, value_name = "F", value_parser = scale)]
    pub(crate) steps_scale: Option<f64>,
    #[command(flatten)]
    pub(crate) size: SizeArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
}

#[derive(Debug, Args)]
pub(crate) struct QualityArgs {
    /// Folder of the scene, which holds photos out
    pub(crate) scene: PathBuf,
    /// Folder for the runs; made if it is missing. The same command goes on with what is unfinished in it
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Test PSNR to reach, dB [default: that with which the reference ends]
    #[arg(long, value_name = "DB", value_parser = psnr)]
    pub(crate) target: Option<f64>,
    /// Method of the reference
    #[arg(long, value_name = "METHOD", default_value = "3dgs", value_parser = method, conflicts_with = "target")]
    pub(crate) reference: MethodName,
    /// Its training steps
    #[arg(long, value_name = "N", default_value_t = 7000, value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "target")]
    pub(crate) reference_iterations: u32,
    /// Method that is to reach it
    #[arg(long, value_name = "METHOD", default_value = "genesplat", value_parser = method)]
    pub(crate) method: MethodName,
    /// Training steps of its first run; each further one has half as many again
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) shortest: u32,
    /// Training steps of its last run
    #[arg(long, value_name = "N", default_value_t = 30_000, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) longest: u32,
    /// Seed of all runs
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Train at most this many Gaussians, in all runs [default: as each method says]
    #[arg(long, value_name = "N")]
    pub(crate) max_gaussians: Option<usize>,
    #[command(flatten)]
    pub(crate) size: SizeArgs,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
}

fn psnr(text: &str) -> Result<f64, String> {
    let valid = |psnr: &f64| (1.0..=100.0).contains(psnr);
    text.parse().ok().filter(valid).ok_or_else(|| "a number between 1 and 100 is needed".into())
}

fn method(text: &str) -> Result<MethodName, String> {
    MethodName::from_name(text).ok_or_else(|| {
        let names = MethodName::ALL.map(MethodName::name).join(", ");
        format!("there is no such method; the methods are {names}")
    })
}

#[derive(Debug, Args)]
pub(crate) struct TablesArgs {
    /// Change nothing; fail where a document disagrees
    #[arg(long)]
    pub(crate) check: bool,
    /// First put the finished runs of an experiment's folder into a CSV file: the one of the experiment's own
    /// name in lab/results, else ablations.csv where that name begins with ablation, else real-size.csv
    #[arg(long, num_args = 4, value_names = ["DIR", "EXPERIMENT", "COMMIT", "MACHINE"], conflicts_with = "check")]
    pub(crate) add: Vec<String>,
    /// The same without their seconds, since the machine had other work
    #[arg(long, num_args = 4, value_names = ["DIR", "EXPERIMENT", "COMMIT", "MACHINE"], conflicts_with_all = ["check", "add"])]
    pub(crate) add_busy: Vec<String>,
}

/// What can be measured.
#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    /// Time training steps stage by stage, at a fixed number of Gaussians, beside the best that blending
    /// could reach
    Step(BenchStepArgs),
    /// Time the scoring of a population just after an opacity reset, beside rendering each individual in full
    Genetic(BenchGeneticArgs),
    /// Time training steps by stage and the scoring of a population on the graphics device, at several
    /// numbers of Gaussians
    Gpu(BenchGpuArgs),
}

/// Where the cameras, the photos and the Gaussians to measure with come from.
#[derive(Debug, Args)]
pub(crate) struct SourceArgs {
    /// Folder of a scene to take cameras, photos and points from [default: a synthetic cloud before one
    /// camera]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// A trained splat of that scene (a file), or the folder of a run, instead of Gaussians made from its
    /// points [default: none]
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
    /// Number of Gaussians, at least 4 [default: as many as the scene has points; 55000 without --data,
    /// before a camera of 268x478]
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
pub(crate) struct BenchGeneticArgs {
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
    /// Numbers of Gaussians, separated by commas; those that the device has not enough memory for are left
    /// out
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
    /// Steps of a whole run on the scene of --data, or on the bundled one, which is trained and scored as by
    /// `genesplat train`; 0 leaves it out
    #[arg(long, value_name = "N", default_value_t = 7_000)]
    pub(crate) iterations: u32,
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

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_definition_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn help_names_every_preset() {
        let mut command = Arguments::command();
        let help = command.find_subcommand_mut("experiment").unwrap().render_long_help().to_string();
        for (name, _) in crate::experiment::preset::PRESETS {
            assert!(help.contains(name), "{name}: {help}");
        }
    }
}
