//! `genesplat poses`.

use std::path::PathBuf;

use clap::Args;
use genesplat::flags::MORE;
use genesplat::run::settings::THREADS;

#[derive(Debug, Args)]
pub(crate) struct PosesArgs {
    /// Folder or zip of photos (JPEG, PNG, WebP, in folders HEIC), or a video: of something that stands
    /// still, from many places, in small steps
    #[arg(value_name = "PHOTOS|VIDEO")]
    pub(crate) photos: PathBuf,
    /// Folder for the scene; made if it is missing. It will hold the photos in images, their cameras in
    /// sparse/0, and in poses what a search that was stopped goes on from
    #[arg(long, value_name = "SCENE")]
    pub(crate) out: PathBuf,
    /// Photos to take from a video, the sharpest of each interval [default: 120]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(3..=10_000))]
    pub(crate) frames: Option<u32>,
    /// Compare each photo with each other, however many there are, which may find the last cameras and takes
    /// much longer; a search that compared fewer goes on from there [default: where there are at most 150]
    #[arg(long, help_heading = MORE)]
    pub(crate) all_pairs: bool,
    /// Processor threads to use, 1 to 1024 [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(THREADS), help_heading = MORE)]
    pub(crate) threads: Option<u16>,
}
