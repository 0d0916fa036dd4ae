//! What can be asked for. Help texts are written for someone who has never trained a splat.
#![allow(missing_docs, reason = "clap would show the documentation of flattened arguments as help")]

use std::ops::{RangeInclusive, RangeTo};
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use genesplat::io::PhotoSize;
use genesplat::train::{Background, EvolutionMode};
use serde::Serialize;

use crate::device::DeviceChoice;
use crate::files::write_json;
use crate::terminal::output::Volume;
use choice::{EVOLUTION, FIXED_BACKGROUNDS, REFINEMENT, choice};

mod bench;
mod blocks;
mod choice;
mod convert;
mod page;
mod photos;
mod poses;
#[cfg(test)]
mod tests;
mod train;

pub(crate) use bench::{Bench, BenchEvolutionArgs, BenchGpuArgs, BenchStepArgs, SourceArgs, WorkloadArgs};
pub(crate) use blocks::{MergeArgs, SplitArgs};
pub(crate) use convert::ConvertArgs;
pub(crate) use page::{ExportArgs, PathChoice, TrainPageArgs, ViewArgs};
pub(crate) use photos::{HoldOutArgs, PhotosArgs, is_near};
pub(crate) use poses::PosesArgs;
pub(crate) use train::{SCENE, SearchArgs, TrainArgs};

/// Heading of the flags that few users need.
const MORE: &str = "More options";

const EXIT_STATUS: &str = "Exit status: 0 done, 1 failed (one sentence on stderr says why), 2 wrong usage, 130 stopped by Ctrl-C or \
                           SIGTERM with what there was saved (train, poses, refine, render, demo, experiment)";

/// Reconstruct a scene from photos as 3D Gaussians, and evolve them.
///
/// New here? `genesplat demo` builds a small scene, trains it without and with evolution, and shows the difference.
#[derive(Debug, Parser)]
#[command(name = "genesplat", version, max_term_width = 120, after_help = EXIT_STATUS)]
pub(crate) struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
    #[command(flatten)]
    pub(crate) volume: VolumeArgs,
}

/// How much is said on stderr.
#[derive(Clone, Copy, Debug, Default, Args)]
#[command(next_help_heading = "Messages")]
pub(crate) struct VolumeArgs {
    /// Show errors and the final result only
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Show what helps to find a fault, too: the choice of the device, and messages of graphics drivers
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    verbose: bool,
}

impl VolumeArgs {
    pub(crate) fn volume(self) -> Volume {
        match (self.quiet, self.verbose) {
            (true, _) => Volume::Quiet,
            (_, true) => Volume::Verbose,
            _ => Volume::Normal,
        }
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Start here: build a small scene, train it without and with evolution, show the difference (a few minutes)
    Demo(DemoArgs),
    /// Train a scene: photos with known cameras in, a splat and its figures out
    Train(TrainArgs),
    /// Find the cameras of a folder of photos, or of a video, so that it can be trained; can be interrupted and goes on
    Poses(PosesArgs),
    /// Look at a scene, a splat or a run: what is in it, what looks wrong, what training will take here
    Inspect(InspectArgs),
    /// Measure how well a splat reproduces photos: PSNR, SSIM and LPIPS
    Evaluate(EvaluateArgs),
    /// Render a splat from the viewpoints of photos, as PNG
    Render(RenderArgs),
    /// Look at a splat in the browser: a page on this machine that this machine renders
    View(ViewArgs),
    /// Write a splat as a page to send: one file that any browser shows in 3D, without a server and without a network
    Export(ExportArgs),
    /// Write a splat as another format: .ply, compressed .ply, .splat, .spz, .sog or .glb
    Convert(ConvertArgs),
    /// Cut a scene that one memory does not hold into blocks, which are trained one by one
    Split(SplitArgs),
    /// Put the splats of blocks together
    Merge(MergeArgs),
    /// Make a finished splat of any trainer better: gradient steps and renewals
    Refine(RefineArgs),
    /// Measure how alike two pictures are: PSNR, SSIM and LPIPS
    Compare(CompareArgs),
    /// Set up LPIPS, a measure that needs the weights of a network
    Lpips {
        /// What to do
        #[command(subcommand)]
        what: LpipsCommand,
    },
    /// Repeat a comparison over scenes, methods and seeds, and make its tables; can be interrupted and goes on
    Experiment(ExperimentArgs),
    /// Measure how fast this machine trains
    Bench {
        /// What to measure
        #[command(subcommand)]
        what: Bench,
    },
    /// List what this machine can train on
    Devices,
    /// Print a script that completes commands and flags in a shell
    Completions {
        /// Which shell
        #[arg(value_name = "SHELL")]
        shell: Shell,
    },
    /// Print the manual page: genesplat man | man -l -
    Man {
        /// Page of this command [default: of them all]
        #[arg(value_name = "COMMAND")]
        command: Option<String>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct InspectArgs {
    /// Folder of a scene or of a run, or a splat (.ply, compressed .ply, .splat, .spz, .sog or .glb)
    #[arg(value_name = "SCENE|SPLAT|RUN")]
    pub(crate) what: PathBuf,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
}

/// What can be done about LPIPS.
#[derive(Debug, Subcommand)]
pub(crate) enum LpipsCommand {
    /// Check files of weights and put them where LPIPS is looked for
    Install(LpipsInstallArgs),
}

#[derive(Debug, Args)]
pub(crate) struct LpipsInstallArgs {
    /// torchvision's VGG16 or AlexNet (.pth) and the heads of the Python package lpips (weights/v0.1/*.pth), or
    /// safetensors with both
    #[arg(value_name = "FILE", required = true)]
    pub(crate) files: Vec<PathBuf>,
}

/// The learned measure LPIPS.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = MORE)]
pub(crate) struct LpipsArgs {
    /// Weights of LPIPS: a file, or a folder of files [default: what the environment variable GENESPLAT_LPIPS names,
    /// else those that `genesplat lpips install` has put in place]
    #[arg(long, value_name = "FILE|FOLDER")]
    pub(crate) lpips_weights: Option<PathBuf>,
    /// Leave LPIPS out, though its weights are there: it takes about 2.5 seconds of a core for a photo of 512x512
    #[arg(long)]
    pub(crate) no_lpips: bool,
}

/// Figures for other programs.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct JsonArgs {
    /// Also write the figures to this file [default: none]
    #[arg(long = "json", value_name = "FILE")]
    pub(crate) path: Option<PathBuf>,
}

impl JsonArgs {
    /// Writes `figures` where that was asked for.
    pub(crate) fn write(&self, figures: &impl Serialize) -> Result<()> {
        self.path.as_ref().map_or(Ok(()), |path| write_json(path, figures))
    }
}

#[derive(Debug, Args)]
pub(crate) struct DemoArgs {
    /// Folder for the scene, both runs and the picture that compares them; made if it is missing. What an earlier demo
    /// left there is replaced
    #[arg(long, value_name = "DIR", default_value = "runs/demo")]
    pub(crate) out: PathBuf,
    /// What the second run evolves with
    #[arg(long, value_name = "MODE", value_parser = choice(EVOLUTION), default_value = "renew")]
    pub(crate) evolve: EvolutionMode,
    /// Seed of the scene and of both runs. Same seed, same bytes, with one build on
    /// CPUs of one kind
    #[arg(long, value_name = "S", default_value_t = 0, value_parser = clap::value_parser!(u64).range(SEEDS))]
    pub(crate) seed: u64,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
}

#[derive(Debug, Args)]
pub(crate) struct EvaluateArgs {
    /// Folder of the scene with the photos to compare with [default: that of the RUN; a SPLAT needs it]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// Which photos: those that training never saw (every 8th, unless it was told otherwise), or those that it saw
    #[arg(long, value_enum, value_name = "SPLIT", default_value_t = Split::Test)]
    pub(crate) split: Split,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
    #[command(flatten)]
    pub(crate) splat: SplatArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
}

#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("which").required(true).args(["image", "split", "path"])))]
pub(crate) struct RenderArgs {
    /// Folder of the scene with the cameras to render from [default: that of the RUN; a SPLAT needs it]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// Render the viewpoint of one photo, by its file name
    #[arg(long, value_name = "NAME")]
    pub(crate) image: Option<String>,
    /// Render the viewpoints of many photos
    #[arg(long, value_enum, value_name = "SPLIT")]
    pub(crate) split: Option<RenderSplit>,
    /// Render what a moving camera sees: orbit (around the scene, once), spiral (small circles in front of it),
    /// interpolate (from camera to camera), or a file that the page of `genesplat view` has saved
    #[arg(long, value_name = "orbit|spiral|interpolate|FILE.json", value_parser = PathChoice::parse)]
    pub(crate) path: Option<PathChoice>,
    /// Frames of the path, 2 to 10000 [default: 120]
    #[arg(long, value_name = "N", conflicts_with_all = ["image", "split"], value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub(crate) frames: Option<u32>,
    /// With --image the picture to write, a .png or a .jpg; with --split the folder for
    /// PNGs; with --path that, or a .mp4 or .gif, which ffmpeg makes if it is installed
    #[arg(long, value_name = "FILE|DIR")]
    pub(crate) out: PathBuf,
    #[command(flatten)]
    pub(crate) splat: SplatArgs,
}

#[derive(Debug, Args)]
pub(crate) struct RefineArgs {
    /// The splat to start from: a .ply in the layout of the 3DGS authors, as nearly every trainer writes it, another
    /// format that `genesplat convert` reads, or the folder of a run, whose photos are loaded as it was trained on them
    /// unless a flag says otherwise; --downscale divides the size that they had there
    #[arg(value_name = "SPLAT|RUN")]
    pub(crate) splat: PathBuf,
    /// Folder of the scene that it shows [default: that of the RUN; a SPLAT needs it]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// The splat to write, in the format that its name ends in. Ctrl-C ends the refinement, and what it has reached so
    /// far is written
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Gradient steps, one photo each [default: 2000]; none with --evolve paper
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) iterations: Option<u32>,
    /// What is done to it [default: renew]
    #[arg(long, value_name = "MODE", value_parser = choice(REFINEMENT))]
    pub(crate) evolve: Option<EvolutionMode>,
    #[command(flatten)]
    pub(crate) search: SearchArgs,
    /// Seed of all random numbers [default: 0]. Same seed, same bytes, with one build on
    /// CPUs of one kind
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(SEEDS))]
    pub(crate) seed: Option<u64>,
    /// TOML file with settings, as for train [default: none]. The dataset, device and threads that it names do not
    /// count
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    #[command(flatten)]
    pub(crate) on: ShownOnArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
}

#[derive(Debug, Args)]
pub(crate) struct CompareArgs {
    /// A PNG or JPEG
    #[arg(value_name = "A.png")]
    pub(crate) first: PathBuf,
    /// Another one of the same size
    #[arg(value_name = "B.png")]
    pub(crate) second: PathBuf,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
}

#[derive(Debug, Args)]
pub(crate) struct ExperimentArgs {
    /// What to compare: smoke (minutes, no data needed), paper-table-2-3, study-evolution, study-paper, study-mcmc,
    /// study-improved, ablation-paper, ablation-renew, or a TOML file of one's own
    #[arg(value_name = "NAME|FILE.toml")]
    pub(crate) what: String,
    /// Folder for the runs, the tables and report.html; made if it is missing. The same command goes on with what is
    /// unfinished in it
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Folder that holds the folders of the scenes [default: none; the bundled gallery needs none]
    #[arg(long, value_name = "FOLDER")]
    pub(crate) data: Option<PathBuf>,
    /// Print the runs with their numbers, a line each, and run nothing
    #[arg(long, conflicts_with = "cell")]
    pub(crate) list: bool,
    /// Make run N of --list only, and no tables: for job arrays, any number at once in one folder. The same command
    /// without it makes the tables
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

/// One part of a scene's photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Split {
    /// Photos that training never saw
    Test,
    /// Photos that it saw
    Train,
}

impl Split {
    /// Test first: that is what counts.
    pub(crate) const ALL: [Self; 2] = [Self::Test, Self::Train];

    /// As flags and files call it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Test => "test",
            Self::Train => "train",
        }
    }
}

/// Which viewpoints to render.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum RenderSplit {
    /// Photos that training never saw
    Test,
    /// Photos that it saw
    Train,
    /// Both
    All,
}

/// Longest sides that can be asked for, px.
pub(crate) const MAX_SIDE: RangeInclusive<i64> = 16..=u32::MAX as i64;
/// Divisors of both sides that can be asked for.
pub(crate) const DOWNSCALE: RangeInclusive<i64> = 1..=64;
/// Intervals of test photos that can be asked for: of every photo, none would be left to train on.
pub(crate) const TEST_EVERY: RangeInclusive<i64> = 2..=u32::MAX as i64;
/// Seeds that can be asked for: those that TOML can hold.
const SEEDS: RangeTo<u64> = ..1 << 63;
/// Numbers of threads that can be asked for.
pub(crate) const THREADS: RangeInclusive<i64> = 1..=1024;

/// How large photos are loaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Args)]
pub(crate) struct SizeArgs {
    /// Longest side of the photos in pixels; larger ones are reduced [default: only widths above 1600 are reduced, to
    /// 1600]. Smaller trains faster and shows less detail
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(MAX_SIDE), conflicts_with = "downscale")]
    pub(crate) max_side: Option<u32>,
    /// Divide both sides of the photos by K (the field's benchmarks use 1, 2, 4 and 8)
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(DOWNSCALE), help_heading = MORE)]
    pub(crate) downscale: Option<u32>,
}

impl SizeArgs {
    /// The size that was asked for, if any was.
    pub(crate) fn size(self) -> Option<PhotoSize> {
        self.max_side.map(PhotoSize::MaxSide).or(self.downscale.map(PhotoSize::Downscale))
    }
}

/// A finished splat, the photos that it is shown beside, and where that is computed.
#[derive(Debug, Args)]
pub(crate) struct SplatArgs {
    /// A splat (.ply, compressed .ply, .splat, .spz, .sog or .glb), or the folder of a run, whose photos are loaded as it
    /// was trained on them unless a flag says otherwise; --downscale divides the size that they had there
    #[arg(id = "splat", value_name = "SPLAT|RUN")]
    pub(crate) path: PathBuf,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    #[command(flatten)]
    pub(crate) on: ShownOnArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
}

/// What a finished splat is shown on.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct ShownOnArgs {
    /// Colour behind the splat, and behind photos that are transparent [default: that of the RUN; for a file, which does
    /// not say, black]
    #[arg(long, value_name = "COLOUR", value_parser = choice(FIXED_BACKGROUNDS))]
    pub(crate) background: Option<Background>,
}

/// Which machine power to use.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct MachineArgs {
    /// Where to compute; results do not depend on the number of threads, but may on the kind of device [default: auto]
    #[arg(long, value_enum, value_name = "DEVICE")]
    pub(crate) device: Option<DeviceChoice>,
    /// Processor threads to use, 1 to 1024 [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(THREADS), help_heading = MORE)]
    pub(crate) threads: Option<u16>,
}

fn fraction<T: FromStr + PartialOrd + From<bool>>(text: &str) -> Result<T, String> {
    let is_valid = |value: &T| (T::from(false)..=T::from(true)).contains(value);
    text.parse().ok().filter(is_valid).ok_or_else(|| "a number from 0 to 1 is needed".into())
}

fn scale(text: &str) -> Result<f64, String> {
    let valid = |scale: &f64| (1e-3..=1e3).contains(scale);
    text.parse().ok().filter(valid).ok_or_else(|| "a number between 0.001 and 1000 is needed".into())
}
