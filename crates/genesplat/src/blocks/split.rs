//! From a scene to the scenes of its blocks.

use std::path::Path;

use anyhow::{Result, anyhow, ensure};
use genesplat::core::Camera;
use genesplat::io::blocks::{Block, Grid, Members};
use genesplat::io::colmap::write_model;
use genesplat::io::{Point, SceneList, ScenePhoto, model_of, plural, shown};
use genesplat::run::files::{link_or_copy, unwritable, write_text};
use genesplat::run::numbers::thousands;
use genesplat::run::output;
use glam::DVec3;

use super::folder::{Cut, TEST_LIST, command, scene_of};

/// What is in one block.
struct Content<'a> {
    photos: Vec<&'a ScenePhoto>,
    points: Vec<Point>,
}

/// Cuts `list`, the scene at `scene`, into `columns` x `rows` blocks, and writes them below `out`. A block is also given what stands
/// within `margin` of its sides beyond its core.
pub(crate) fn split(scene: &Path, list: &SceneList, count: [usize; 2], margin: f64, out: &Path) -> Result<()> {
    let positions: Vec<DVec3> = list.points.iter().map(|point| DVec3::from(point.position.map(f64::from))).collect();
    let cameras: Vec<Camera> = list.photos.iter().map(|photo| photo.camera).collect();
    let grid = Grid::cut(&cameras, &positions, count);
    let members = Members::of(&grid, &cameras, &positions, margin);
    for (number, block) in grid.blocks().iter().enumerate() {
        check(block, members.photos(number).iter().map(|&photo| &list.photos[photo]))?;
    }
    for (number, block) in grid.blocks().iter().enumerate() {
        let photos = members.photos(number).iter().map(|&photo| &list.photos[photo]).collect();
        let points = members.points(number).map(|point| list.points[point]).collect();
        let content = Content { photos, points };
        write(&scene_of(block, out), &content)?;
        tell(block, &content, out)?;
    }
    // Last: a folder with this file is whole.
    Cut { scene: shown(scene), grid }.write(out)
}

fn check<'a>(block: &Block, mut photos: impl Iterator<Item = &'a ScenePhoto>) -> Result<()> {
    ensure!(
        photos.any(|photo| !photo.is_test),
        "no training photo shows enough of block {}; cut the scene into fewer blocks",
        block.name
    );
    Ok(())
}

fn write(folder: &Path, content: &Content<'_>) -> Result<()> {
    for photo in &content.photos {
        place(&photo.path, &folder.join("images").join(&photo.name))?;
        if let Some(mask) = &photo.mask {
            place(mask, &folder.join("masks").join(format!("{}.png", photo.name)))?;
        }
    }
    let tests = content.photos.iter().filter(|photo| photo.is_test);
    let tests: String = tests.map(|photo| format!("{}\n", photo.name)).collect();
    if !tests.is_empty() {
        write_text(&folder.join(TEST_LIST), &tests)?;
    }
    let model = folder.join("sparse/0");
    write_model(&model, &model_of(&content.photos, content.points.clone())).map_err(|error| unwritable(&model, &error))
}

fn place(file: &Path, to: &Path) -> Result<()> {
    link_or_copy(file, to).map_err(|error| anyhow!("cannot copy {} to {}: {error}", shown(file), shown(to)))
}

fn tell(block: &Block, content: &Content<'_>, out: &Path) -> Result<()> {
    let [photos, points] = [(content.photos.len(), ["photo", "photos"]), (content.points.len(), ["point", "points"])]
        .map(|(count, [one, many])| format!("{} {}", thousands(count), plural(count, one, many)));
    output::print(&format!("block {}: {photos}, {points}", block.name))?;
    output::print(&format!("  {}", command(block, out)))
}
