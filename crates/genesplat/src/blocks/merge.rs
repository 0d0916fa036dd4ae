//! From the splats of blocks to one.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use genesplat::core::{Gaussians, RenderSettings, ScreenFilter, Similarity};
use genesplat::io::blocks::{Block, Grid};
use genesplat::io::{Offset, shown};
use genesplat::run::inputs::{Inputs, check_shared};
use genesplat::run::session::has_checkpoint;
use genesplat::run::splat;
use genesplat::run::{CLOUD, METRICS};
use glam::DVec3;

use super::folder::{Cut, command, run_of};

/// What the blocks come to.
pub(crate) struct Merged {
    /// The Gaussians of every block's run that stand on its core, block after block.
    pub(crate) cloud: Gaussians,
    /// How they are meant to be shown.
    pub(crate) settings: RenderSettings,
    /// What was subtracted from the coordinates of the scene before it was cut.
    pub(crate) offset: Option<Offset>,
}

/// The splats of all blocks in `folder` as one.
pub(crate) fn merge(folder: &Path) -> Result<Merged> {
    let Cut { grid, offset, .. } = Cut::read(folder)?;
    check_runs(&grid, folder)?;
    check_inputs(&grid, folder)?;
    let whole_offset = DVec3::from(offset.unwrap_or_default());
    let mut whole: Option<(Gaussians, RenderSettings)> = None;
    for block in grid.blocks() {
        let run = run_of(block, folder);
        let mut splat = splat::open(&run)?;
        // A block that does not say where the others lie may have been moved once more.
        let translation = DVec3::from(splat.offset.unwrap_or_default()) - whole_offset;
        Similarity { translation, ..Similarity::default() }.apply(&mut splat.cloud);
        let stands =
            |row: &u32| grid.owns(block, DVec3::from(splat.cloud.positions[*row as usize].map(f64::from)));
        let rows: Vec<u32> = (0..splat.cloud.len() as u32).filter(stands).collect();
        let part = (splat.cloud.gather(&rows), splat.settings);
        let Some(whole) = &mut whole else {
            whole = Some(part);
            continue;
        };
        if let Some([before, here]) = difference(whole, &part) {
            bail!(
                "{} was trained with {here}, and the blocks before it with {before}; train them all alike",
                shown(&run)
            );
        }
        whole.0.append(part.0);
    }
    let (cloud, settings) = whole.expect("a cut has at least one block");
    Ok(Merged { cloud, settings, offset })
}

/// The first setting in which both differ, as each has it.
fn difference(a: &(Gaussians, RenderSettings), b: &(Gaussians, RenderSettings)) -> Option<[String; 2]> {
    let [a, b] = [a, b].map(|(cloud, settings)| named(settings, cloud.filter_3d.is_some()));
    a.into_iter().zip(b).find(|(a, b)| a != b).map(|(a, b)| [a, b])
}

fn named(settings: &RenderSettings, has_filter_3d: bool) -> [String; 4] {
    let RenderSettings { sh_degree, background, filter, .. } = settings;
    let background = match background.map(|value| (255.0 * value).round() as u8) {
        [0, 0, 0] => "black".to_owned(),
        [255, 255, 255] => "white".to_owned(),
        rgb => format!("{rgb:?}"),
    };
    let filter = match filter {
        ScreenFilter::Classic => "antialiasing off",
        ScreenFilter::Antialiased => "antialiasing on",
        ScreenFilter::Mip => "method mip-splatting",
    };
    let filter_3d = if has_filter_3d { "a 3D filter" } else { "no 3D filter" };
    [
        format!("background {background}"),
        filter.to_owned(),
        format!("sh_degree {sh_degree}"),
        filter_3d.to_owned(),
    ]
}

/// Fails where a photo that two blocks share was not the same, or stood elsewhere, when their runs began.
fn check_inputs(grid: &Grid, folder: &Path) -> Result<()> {
    let mut before: Vec<(PathBuf, Inputs)> = Vec::new();
    for block in grid.blocks() {
        let run = run_of(block, folder);
        let Some(inputs) = Inputs::read(&run)? else { continue };
        before.iter().try_for_each(|(other, of_other)| check_shared([other, &run], [of_other, &inputs]))?;
        before.push((run, inputs));
    }
    Ok(())
}

fn check_runs(grid: &Grid, folder: &Path) -> Result<()> {
    let (mut missing, mut stopped, mut failed) = (Vec::new(), Vec::new(), Vec::new());
    for block in grid.blocks() {
        let run = run_of(block, folder);
        match (has_checkpoint(&run), run.join(CLOUD).exists(), run.join(METRICS).exists()) {
            (true, ..) => stopped.push(block),
            (false, false, _) => missing.push(block),
            // What it had come to was saved, and its checkpoint could not be.
            (false, true, false) => failed.push(block),
            (false, true, true) => {}
        }
    }
    let names =
        |blocks: &[&Block]| blocks.iter().map(|block| block.name.as_str()).collect::<Vec<_>>().join(", ");
    if let Some(first) = missing.first() {
        bail!(
            "no splat is there yet of block {}; {} makes the first",
            names(&missing),
            command(first, folder)
        );
    }
    if let Some(first) = failed.first() {
        let (names, command) = (names(&failed), command(first, folder));
        bail!("the run of block {names} failed before its end; {command} trains the first anew");
    }
    if let Some(first) = stopped.first() {
        let (names, command) = (names(&stopped), command(first, folder));
        bail!(
            "the run of block {names} was stopped before its end; {command} --resume goes on with the first"
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_is_named_with_both_values() {
        let usual = (Gaussians::zeros(1), RenderSettings::default());
        assert_eq!(difference(&usual, &usual), None);
        let with = |settings: RenderSettings| (Gaussians::zeros(1), settings);
        let filtered = Gaussians { filter_3d: Some(vec![1.0]), ..Gaussians::zeros(1) };
        let cases = [
            (
                with(RenderSettings { background: [1.0; 3], ..usual.1 }),
                ["background black", "background white"],
            ),
            (
                with(RenderSettings { filter: ScreenFilter::Antialiased, ..usual.1 }),
                ["antialiasing off", "antialiasing on"],
            ),
            (
                with(RenderSettings { filter: ScreenFilter::Mip, ..usual.1 }),
                ["antialiasing off", "method mip-splatting"],
            ),
            (with(RenderSettings { sh_degree: 1, ..usual.1 }), ["sh_degree 3", "sh_degree 1"]),
            ((filtered, usual.1), ["no 3D filter", "a 3D filter"]),
        ];
        for (other, expected) in cases {
            assert_eq!(difference(&usual, &other).unwrap(), expected);
        }
    }
}
