//! Flags that the programs of this workspace share, and what they come to as settings of a run.
#![allow(missing_docs, reason = "clap would show the documentation of flattened arguments as help")]

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use genesplat_io::PhotoSize;
use genesplat_run::device::DeviceChoice;
use genesplat_run::files::write_json;
use genesplat_run::lpips;
use genesplat_run::settings::{DOWNSCALE, MAX_SIDE, Machine, PhotosAsked, THREADS};
use serde::Serialize;

/// Heading of the flags that few users need.
pub const MORE: &str = "More options";

/// A value, its names (the first is shown, the others are understood, too), and its help.
pub type Choice<T> = (T, &'static [&'static str], &'static str);

/// Parses a flag that takes one of these values.
pub fn choice<T>(choices: &'static [Choice<T>]) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
{
    let shown = choices
        .iter()
        .map(|(_, names, help)| PossibleValue::new(names[0]).aliases(names[1..].iter().copied()).help(*help));
    PossibleValuesParser::new(shown).map(|name| {
        let is_it = |known: &&str| known.eq_ignore_ascii_case(&name);
        let found = choices.iter().find(|(_, names, _)| names.iter().any(is_it));
        found.expect("clap has checked the name").0
    })
}

/// How much is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Volume {
    /// Errors and the final result.
    Quiet,
    /// What a user should see.
    Normal,
    /// What helps to find a fault, too.
    Verbose,
}

/// How much is said on stderr.
#[derive(Clone, Copy, Debug, Default, Args)]
#[command(next_help_heading = "Messages")]
pub struct VolumeArgs {
    /// Show errors and the final result only
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Show what helps to find a fault, too: the choice of the device, and messages of graphics drivers
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    verbose: bool,
}

impl VolumeArgs {
    pub fn volume(self) -> Volume {
        match (self.quiet, self.verbose) {
            (true, _) => Volume::Quiet,
            (_, true) => Volume::Verbose,
            _ => Volume::Normal,
        }
    }
}

/// The learned measure LPIPS.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = MORE)]
pub struct LpipsArgs {
    /// Weights of LPIPS: a file, or a folder of files [default: what the environment variable GENESPLAT_LPIPS
    /// names, else those that `genesplat evaluate --install-lpips` has put in place]
    #[arg(long, value_name = "FILE|FOLDER")]
    pub lpips_weights: Option<PathBuf>,
    /// Leave LPIPS out, though its weights are there: it takes about 2.5 seconds of a core for a photo of
    /// 512x512
    #[arg(long)]
    pub no_lpips: bool,
}

impl LpipsArgs {
    pub fn asked(&self) -> lpips::Asked {
        lpips::Asked { weights: self.lpips_weights.clone(), is_left_out: self.no_lpips }
    }
}

/// Figures for other programs.
#[derive(Clone, Debug, Default, Args)]
pub struct JsonArgs {
    /// Also write the figures to this file [default: none]
    #[arg(long = "json", value_name = "FILE")]
    pub path: Option<PathBuf>,
}

impl JsonArgs {
    /// Writes `figures` where that was asked for.
    pub fn write(&self, figures: &impl Serialize) -> Result<()> {
        self.path.as_ref().map_or(Ok(()), |path| write_json(path, figures))
    }
}

/// How large photos are loaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Args)]
pub struct SizeArgs {
    /// Longest side of the photos in pixels; larger ones are reduced [default: only widths above 1600 are
    /// reduced, to 1600]. Smaller trains faster and shows less detail
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(MAX_SIDE), conflicts_with = "downscale")]
    pub max_side: Option<u32>,
    /// Divide both sides of the photos by K (the field's benchmarks use 1, 2, 4 and 8)
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(DOWNSCALE), help_heading = MORE)]
    pub downscale: Option<u32>,
}

impl SizeArgs {
    /// The size that was asked for, if any was.
    pub fn size(self) -> Option<PhotoSize> {
        self.max_side.map(PhotoSize::MaxSide).or(self.downscale.map(PhotoSize::Downscale))
    }

    /// The same of photos of which nothing else is asked.
    pub fn asked(self) -> PhotosAsked {
        PhotosAsked { max_side: self.max_side, downscale: self.downscale, ..PhotosAsked::default() }
    }
}

/// Which machine power to use.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct MachineArgs {
    /// Where to compute: auto (the graphics card if this machine has one that can be used, else the
    /// processor), cpu (all its cores), gpu (the best device with a Vulkan, Metal or DX12 driver, even one in
    /// software), or gpu:N (the one that `genesplat devices` gives this number). Results do not depend on the
    /// number of threads, but may on the kind of device [default: auto]
    #[arg(long, value_name = "DEVICE")]
    device: Option<DeviceChoice>,
    /// What other trainers call `--device gpu`.
    #[arg(long, hide = true, conflicts_with = "device")]
    gpu: bool,
    /// Processor threads to use, 1 to 1024 [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(THREADS), help_heading = MORE)]
    pub threads: Option<u16>,
}

impl MachineArgs {
    /// Where to compute, if anything is asked for.
    pub fn device(self) -> Option<DeviceChoice> {
        self.device.or(self.gpu.then_some(DeviceChoice::Gpu))
    }
}

impl From<MachineArgs> for Machine {
    fn from(asked: MachineArgs) -> Self {
        Self { device: asked.device(), threads: asked.threads }
    }
}

/// A factor of the schedule's length.
pub fn scale(text: &str) -> Result<f64, String> {
    let valid = |scale: &f64| (1e-3..=1e3).contains(scale);
    text.parse().ok().filter(valid).ok_or_else(|| "a number between 0.001 and 1000 is needed".into())
}
