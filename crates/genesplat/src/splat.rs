//! Finished splats, from a file or from the folder of a run.

use std::path::Path;

use anyhow::Result;
use genesplat::core::{Gaussians, RenderSettings, ScreenFilter};
use genesplat::io::PhotoSize;
use genesplat::io::ply::{check_finite, read_ply, read_ply_header};

use crate::run_folder::RunFolder;
use crate::settings::ConfigFile;

/// A cloud and how it is meant to be shown.
pub struct Splat {
    /// The Gaussians; all values are finite.
    pub cloud: Gaussians,
    /// How to render it.
    pub settings: RenderSettings,
    /// The size of photos that it was trained on, where that is known.
    pub size: PhotoSize,
}

/// Reads a PLY, or the splat of a run.
pub fn open(path: &Path) -> Result<Splat> {
    if path.is_dir() { open_run(path) } else { open_ply(path) }
}

fn open_run(folder: &Path) -> Result<Splat> {
    let config = ConfigFile::of_run(folder)?;
    let size = config.size();
    let settings = config.train.resolve()?.render_settings();
    Ok(Splat { cloud: read_cloud(&RunFolder::cloud_in(folder))?, settings, size })
}

fn open_ply(path: &Path) -> Result<Splat> {
    let header = read_ply_header(path)?;
    let cloud = read_cloud(path)?;
    let declared = header.render_mode.map(ScreenFilter::from).unwrap_or_default();
    let filter = if header.has_filter_3d { ScreenFilter::Mip } else { declared };
    let settings = RenderSettings { sh_degree: header.sh_degree, filter, ..RenderSettings::default() };
    Ok(Splat { cloud, settings, size: PhotoSize::default() })
}

fn read_cloud(path: &Path) -> Result<Gaussians> {
    let cloud = read_ply(path)?;
    check_finite(path, &cloud)?;
    Ok(cloud)
}
