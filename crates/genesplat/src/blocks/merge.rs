//! From the splats of blocks to one.

use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat::core::{Gaussians, RenderSettings};
use genesplat::io::shown;
use glam::DVec3;

use super::grid::{Grid, RUNS};
use super::split::command;
use crate::run::CLOUD;
use crate::splat;

/// The Gaussians of every block's run that stand on its core, block after block, and how they are meant to be shown.
pub(crate) fn merge(folder: &Path) -> Result<(Gaussians, RenderSettings)> {
    let grid = Grid::read(folder)?;
    check_runs(&grid, folder)?;
    let mut whole: Option<(Gaussians, RenderSettings)> = None;
    for block in &grid.blocks {
        let run = folder.join(RUNS).join(&block.name);
        let splat = splat::open(&run)?;
        let stands = |row: &u32| grid.owns(block, DVec3::from(splat.cloud.positions[*row as usize].map(f64::from)));
        let rows: Vec<u32> = (0..splat.cloud.len() as u32).filter(stands).collect();
        let part = splat.cloud.gather(&rows);
        let Some((cloud, settings)) = &mut whole else {
            whole = Some((part, splat.settings));
            continue;
        };
        let fits = *settings == splat.settings && cloud.filter_3d.is_some() == part.filter_3d.is_some();
        ensure!(
            fits,
            "{} was trained with other settings than the blocks before it; train them all alike",
            shown(&run)
        );
        cloud.append(part);
    }
    Ok(whole.expect("a grid has at least one block"))
}

fn check_runs(grid: &Grid, folder: &Path) -> Result<()> {
    let is_missing = |name: &str| !folder.join(RUNS).join(name).join(CLOUD).exists();
    let missing: Vec<_> = grid.blocks.iter().filter(|block| is_missing(&block.name)).collect();
    let Some(first) = missing.first() else { return Ok(()) };
    let names = missing.iter().map(|block| block.name.as_str()).collect::<Vec<_>>().join(", ");
    bail!("no splat is there yet of block {names}; {} makes the first", command(first, folder))
}
