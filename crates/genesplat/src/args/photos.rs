//! Which photos of a scene are used, for what, and how large.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, ensure};
use clap::Args;
use genesplat::flags::{MORE, SizeArgs, choice};
use genesplat::io::{HoldOut, MaskUse, input, shown};
use genesplat::run::settings::{PhotosAsked, TEST_EVERY, is_near};

use super::choice::MASKS;

#[derive(Clone, Debug, Default, PartialEq, Args)]
pub(crate) struct PhotosArgs {
    #[command(flatten)]
    pub(crate) size: SizeArgs,
    /// Folder of a COLMAP scene's photos, below the scene's or anywhere, such as images_4 [default: images]
    #[arg(long, value_name = "FOLDER", help_heading = MORE)]
    pub(crate) images: Option<PathBuf>,
    #[command(flatten)]
    hold_out: HoldOutArgs,
    /// What masks (masks/NAME.jpg.png, masks/NAME.png and the like beside the photos, black where they hide)
    /// and transparency mean [default: usual]
    #[arg(long, value_name = "USE", value_parser = choice(MASKS), ignore_case = true, help_heading = MORE)]
    mask: Option<MaskUse>,
    /// Draw nothing nearer to a camera than this, in the scene's units [default: 0.2, or a tenth of the way
    /// from the middle of the cameras to the farthest of them, if that is less or the scene has no points]
    #[arg(long, value_name = "DEPTH", value_parser = above_zero, help_heading = MORE)]
    near: Option<f64>,
}

/// Which photos are held out for testing.
#[derive(Clone, Debug, Default, PartialEq, Args)]
#[group(multiple = false)]
#[command(next_help_heading = MORE)]
pub(crate) struct HoldOutArgs {
    /// Hold out every N-th photo by name for testing, at least 2 [default: the test photos that the scene
    /// names, else every 8th]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(TEST_EVERY))]
    test_every: Option<u32>,
    /// Hold out the photos that FILE names, one a line: file names, with or without their endings; a folder
    /// before the name tells photos of one name apart
    #[arg(long, value_name = "FILE")]
    test_list: Option<PathBuf>,
    /// Hold out no photo: all of them train, and no figures tell how good the splat is on others
    #[arg(long)]
    train_on_all: bool,
}

impl PhotosArgs {
    /// The file with the names of the photos to hold out.
    pub(crate) fn test_list(&self) -> Option<&Path> {
        self.hold_out.test_list.as_deref()
    }

    /// What is asked for, the list of photos read.
    pub(crate) fn asked(&self) -> Result<PhotosAsked> {
        Ok(PhotosAsked {
            images: self.images.clone(),
            hold_out: self.hold_out.asked()?,
            mask: self.mask,
            near: self.near,
            ..self.size.asked()
        })
    }
}

impl HoldOutArgs {
    pub(crate) fn asked(&self) -> Result<Option<HoldOut>> {
        let every = self.test_every.and_then(NonZeroU32::new).map(HoldOut::Every);
        let listed = self.test_list.as_deref().map(read_list).transpose()?;
        Ok(every.or(listed).or(self.train_on_all.then_some(HoldOut::None)))
    }
}

fn above_zero(text: &str) -> Result<f64, String> {
    let depth = text.parse().ok().filter(|depth| is_near(*depth));
    depth.ok_or_else(|| "a number above 0, and at most 1e9, is needed".into())
}

fn read_list(file: &Path) -> Result<HoldOut> {
    let text =
        input::read_text(file).map_err(|error| anyhow!("cannot read the list {}: {error}", shown(file)))?;
    let names: Vec<String> =
        text.lines().map(str::trim).filter(|line| !line.is_empty()).map(str::to_owned).collect();
    ensure!(
        !names.is_empty(),
        "the list {} names no photo; write a file name a line, or give --train-on-all to hold none out",
        shown(file)
    );
    Ok(HoldOut::Photos(names))
}
