//! What can be asked for. Help texts are written for someone who has never trained a splat.
#![allow(missing_docs, reason = "clap would show the documentation of flattened arguments as help")]

use std::ops::RangeTo;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use genesplat::flags::{JsonArgs, LpipsArgs, MORE, MachineArgs, VolumeArgs, choice};
use genesplat::run::device::DeviceChoice;
use genesplat::run::metrics::Split;
use genesplat::train::{Background, MethodName};

use choice::{FIXED_BACKGROUNDS, METHODS, SPLITS};

mod blocks;
mod choice;
mod clean;
mod convert;
mod page;
mod photos;
mod placement;
mod poses;
#[cfg(test)]
mod tests;
mod train;

pub(crate) use blocks::{MergeArgs, SplitArgs};
pub(crate) use clean::CleanArgs;
pub(crate) use convert::ConvertArgs;
pub(crate) use page::{ExportArgs, PathChoice, TrainPageArgs, ViewArgs};
pub(crate) use photos::{HoldOutArgs, PhotosArgs};
pub(crate) use poses::PosesArgs;
pub(crate) use train::{OldArgs, SCENE, STEPS, SearchArgs, TrainArgs};

const EXIT_STATUS: &str = "Exit status: 0 done, 1 failed (one sentence on stderr says why), 2 wrong usage, 130 stopped by Ctrl-C or \
                           SIGTERM with what there was saved";

/// Reconstruct a scene from photos as 3D Gaussians, and evolve them.
///
/// New here? `genesplat demo` builds a small scene, trains it by the published method and by ours, and shows
/// the difference.
#[derive(Debug, Parser)]
#[command(name = "genesplat", version, max_term_width = 120, after_help = EXIT_STATUS)]
pub(crate) struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
    #[command(flatten)]
    pub(crate) volume: VolumeArgs,
}

/// Commands of earlier versions, and where each is now.
const MOVED: [(&str, &str); 5] = [
    (
        "experiment",
        "genesplat experiment is genesplat-lab experiment now: cargo run --release -p genesplat-lab -- experiment",
    ),
    ("bench", "genesplat bench is genesplat-lab bench now: cargo run --release -p genesplat-lab -- bench"),
    ("compare", "genesplat compare is genesplat evaluate now: genesplat evaluate A.png B.png"),
    ("lpips", "genesplat lpips install is a flag of evaluate now: genesplat evaluate --install-lpips FILE.."),
    ("completions", "genesplat completions is a flag of man now: genesplat man --completions SHELL"),
];

/// Where a command of earlier versions is now.
pub(crate) fn moved(name: &str) -> Option<&'static str> {
    MOVED.iter().find(|(old, _)| *old == name).map(|(_, place)| *place)
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Start here: build a small scene, train it by the published method and by ours, show the difference (a
    /// few minutes)
    Demo(DemoArgs),
    /// Train a scene: photos with known cameras in, a splat and its figures out
    Train(TrainArgs),
    /// Find the cameras of a folder of photos, or of a video, so that it can be trained; can be interrupted
    /// and goes on
    Poses(PosesArgs),
    /// Look at a scene, a splat or a run: what is in it, what looks wrong, what training will take here
    Inspect(InspectArgs),
    /// Measure how well a splat reproduces photos, or how alike two pictures are: PSNR, SSIM and LPIPS
    Evaluate(EvaluateArgs),
    /// Render a splat from the viewpoints of photos, as PNG
    Render(RenderArgs),
    /// Look at a splat in the browser: a page on this machine that this machine renders
    View(ViewArgs),
    /// Write a splat as a page to send: one file that any browser shows in 3D, without a server and without a
    /// network
    Export(ExportArgs),
    /// Write a splat as another format: .ply, compressed .ply, .splat, .spz, .sog or .glb
    Convert(ConvertArgs),
    /// Cut a scene that one memory does not hold into blocks, which are trained one by one
    Split(SplitArgs),
    /// Put the splats of blocks together
    Merge(MergeArgs),
    /// Make a finished splat of any trainer better: gradient steps, whose last states are averaged, or the
    /// genetic search
    Refine(RefineArgs),
    /// Remove what no photo supports: Gaussians that none or one shows, right in front of cameras, or away
    /// from everything
    Clean(CleanArgs),
    /// List what this machine can train on, or test a graphics device against the CPU
    Devices(DevicesArgs),
    /// Print the manual page: genesplat man | man -l -
    Man(ManArgs),
}

#[derive(Debug, Args)]
pub(crate) struct InspectArgs {
    /// Folder of a scene or of a run, or a splat (.ply, compressed .ply, .splat, .spz, .sog or .glb)
    #[arg(value_name = "SCENE|SPLAT|RUN")]
    pub(crate) what: PathBuf,
    /// Say what happens when in a training by this method
    #[arg(long, value_name = "METHOD", value_parser = choice(METHODS), ignore_case = true)]
    pub(crate) method: Option<MethodName>,
    /// Of so many steps [default: 30000]
    #[arg(long, value_name = "N", requires = "method", value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    pub(crate) iterations: Option<u32>,
    /// Folder of a scene: also say how well the splat, or that of the run, shows some of its photos, and
    /// whether it is one of this scene at all
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
}

#[derive(Debug, Args)]
pub(crate) struct DevicesArgs {
    /// Compare every stage of training with the CPU's, on a bundled scene: seconds on a card
    #[arg(long)]
    pub(crate) test: bool,
    /// Which device to test: gpu, or gpu:N of the list
    #[arg(long, value_name = "DEVICE", requires = "test", default_value = "gpu", value_parser = graphics)]
    pub(crate) device: DeviceChoice,
}

/// A device that can be compared with the CPU.
fn graphics(text: &str) -> Result<DeviceChoice, String> {
    let choice: DeviceChoice = text.parse()?;
    let is_graphics = choice.is_graphics().then_some(choice);
    is_graphics.ok_or_else(|| "gpu or gpu:N is needed: it is compared with the CPU".into())
}

#[derive(Debug, Args)]
pub(crate) struct ManArgs {
    /// Page of this command [default: of them all]
    #[arg(value_name = "COMMAND", conflicts_with = "completions")]
    pub(crate) command: Option<String>,
    /// Print a script that completes commands and flags in a shell instead
    #[arg(long, value_name = "SHELL")]
    pub(crate) completions: Option<Shell>,
}

#[derive(Debug, Args)]
pub(crate) struct DemoArgs {
    /// Folder for the scene, both runs and the picture that compares them; made if it is missing. What an
    /// earlier demo left there is replaced
    #[arg(long, value_name = "DIR", default_value = "runs/demo")]
    pub(crate) out: PathBuf,
    /// Method of the second run; the first is 3dgs
    #[arg(long, value_name = "METHOD", value_parser = choice(METHODS), ignore_case = true)]
    #[arg(default_value = "genesplat")]
    pub(crate) method: MethodName,
    /// Search after each opacity reset in the second run, as published
    #[arg(long)]
    pub(crate) genetic: bool,
    /// Seed of the scene and of both runs. Same seed, same bytes, with one build on
    /// CPUs of one kind
    #[arg(long, value_name = "S", default_value_t = 0, value_parser = clap::value_parser!(u64).range(SEEDS))]
    pub(crate) seed: u64,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
    #[command(flatten)]
    pub(crate) old: OldArgs,
}

/// What says nothing of two pictures.
const OF_SPLATS: [&str; 12] = [
    "data",
    "split",
    "max_side",
    "downscale",
    "images",
    "test_every",
    "test_list",
    "train_on_all",
    "mask",
    "near",
    "background",
    "device",
];

#[derive(Debug, Args)]
pub(crate) struct EvaluateArgs {
    /// A splat (.ply, compressed .ply, .splat, .spz, .sog or .glb), or the folder of a run, whose photos are
    /// loaded as it was trained on them unless a flag says otherwise; --downscale divides the size that they
    /// had there. Or a picture, a PNG or JPEG
    #[arg(id = "splat", value_name = "SPLAT|RUN|A.png", required_unless_present = "install_lpips")]
    pub(crate) path: Option<PathBuf>,
    /// Another picture of the same size: measure how alike both are
    #[arg(value_name = "B.png", conflicts_with_all = OF_SPLATS)]
    pub(crate) other: Option<PathBuf>,
    /// Folder of the scene with the photos to compare with [default: that of the RUN; a SPLAT needs it]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// Which photos: those that training never saw (every 8th, unless it was told otherwise), or those that
    /// it saw
    #[arg(long, value_name = "SPLIT", value_parser = choice(SPLITS), ignore_case = true, default_value = "test")]
    pub(crate) split: Split,
    #[command(flatten)]
    pub(crate) json: JsonArgs,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    #[command(flatten)]
    pub(crate) on: ShownOnArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
    /// Check files of weights first, and put them where LPIPS is looked for: torchvision's VGG16 or AlexNet
    /// (.pth) and the heads of the Python package lpips (weights/v0.1/*.pth), or safetensors with both
    #[arg(long, value_name = "FILE", num_args = 1.., help_heading = MORE)]
    pub(crate) install_lpips: Vec<PathBuf>,
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
    /// Render what a moving camera sees: orbit (around the scene, once), spiral (small circles in front of
    /// it), interpolate (from camera to camera), or a file that the page of `genesplat view` has saved
    #[arg(long, value_name = "orbit|spiral|interpolate|FILE.json", value_parser = PathChoice::parse)]
    pub(crate) path: Option<PathChoice>,
    /// Frames of the path, 2 to 10000 [default: 120]
    #[arg(long, value_name = "N", conflicts_with_all = ["image", "split"], value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub(crate) frames: Option<u32>,
    /// At the exposure and white balance of each photo, with its darker corners, as a run with --corrections
    /// found them [default: the mean of all]
    #[arg(long, conflicts_with = "path")]
    pub(crate) as_photo: bool,
    /// With --image the picture to write, a .png or a .jpg; with --split the folder for
    /// PNGs; with --path that, or a .mp4 or .gif, which ffmpeg makes if it is installed
    #[arg(long, value_name = "FILE|DIR")]
    pub(crate) out: PathBuf,
    #[command(flatten)]
    pub(crate) splat: SplatArgs,
}

#[derive(Debug, Args)]
pub(crate) struct RefineArgs {
    /// The splat to start from: a .ply in the layout of the 3DGS authors, as nearly every trainer writes it,
    /// another format that `genesplat convert` reads, or the folder of a run, whose photos are loaded as it
    /// was trained on them unless a flag says otherwise; --downscale divides the size that they had there
    #[arg(value_name = "SPLAT|RUN")]
    pub(crate) splat: PathBuf,
    /// Folder of the scene that it shows [default: that of the RUN; a SPLAT needs it]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// The splat to write, in the format that its name ends in. Ctrl-C ends the refinement, and what it has
    /// reached so far is written
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Gradient steps, one photo each [default: 2000]; none with --genetic, which only searches
    #[arg(long, value_name = "N", aliases = STEPS, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) iterations: Option<u32>,
    #[command(flatten)]
    pub(crate) search: SearchArgs,
    /// Refine although there is no hope of a good splat: it shows less of the photos than one colour each
    /// would, as one of another scene does; fewer than 10 photos, cameras for less than half of them, masks
    /// that fit no photo
    #[arg(long, help_heading = MORE)]
    pub(crate) anyway: bool,
    /// Seed of all random numbers [default: 0]. Same seed, same bytes, with one build on
    /// CPUs of one kind
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(SEEDS))]
    pub(crate) seed: Option<u64>,
    /// TOML file with settings, as for train [default: none]. The dataset, device and threads that it names
    /// do not count
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    #[command(flatten)]
    pub(crate) on: ShownOnArgs,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
    #[command(flatten)]
    pub(crate) old: OldArgs,
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

/// Seeds that can be asked for: those that TOML can hold.
const SEEDS: RangeTo<u64> = ..1 << 63;
/// A finished splat, the photos that it is shown beside, and where that is computed.
#[derive(Debug, Args)]
pub(crate) struct SplatArgs {
    /// A splat (.ply, compressed .ply, .splat, .spz, .sog or .glb), or the folder of a run, whose photos are
    /// loaded as it was trained on them unless a flag says otherwise; --downscale divides the size that they
    /// had there
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
    /// Colour behind the splat, and behind photos that are transparent [default: that of the RUN; for a file,
    /// which does not say, black]
    #[arg(long, value_name = "COLOUR", value_parser = choice(FIXED_BACKGROUNDS), ignore_case = true)]
    pub(crate) background: Option<Background>,
}

fn fraction<T: FromStr + PartialOrd + From<bool>>(text: &str) -> Result<T, String> {
    let is_valid = |value: &T| (T::from(false)..=T::from(true)).contains(value);
    text.parse().ok().filter(is_valid).ok_or_else(|| "a number from 0 to 1 is needed".into())
}
