//! From a scene to the scenes of its blocks.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, ensure};
use genesplat::core::Camera;
use genesplat::io::colmap::write_model;
use genesplat::io::{Point, SceneList, ScenePhoto, model_of, shown};
use glam::DVec3;

use super::grid::{Block, Grid, RUNS, SCENES};
use super::ground::Ground;
use crate::files::{unwritable, write_text};
use crate::terminal::numbers::thousands;
use crate::terminal::output;

/// The list of held-out photos, in the folder of a block's scene.
const TEST_LIST: &str = "test.txt";
/// A photo is of a block if this fraction of the points that it shows stands on the block or near it.
const SHARE: f64 = 0.1;

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
    let grid = Grid::cut(scene, Ground::below(&cameras, &positions), &positions, count);
    let shown_points: Vec<Vec<usize>> = cameras.iter().map(|camera| shown_by(camera, &positions)).collect();
    let contents = grid.blocks.iter().map(|block| {
        let is_near = grid.near(block, &positions, margin);
        let content = content(list, &shown_points, &is_near);
        check(block, &content).map(|()| content)
    });
    let contents: Vec<Content<'_>> = contents.collect::<Result<_>>()?;
    for (block, content) in grid.blocks.iter().zip(&contents) {
        write(&out.join(SCENES).join(&block.name), content)?;
        tell(block, content, out)?;
    }
    // Last: a folder with this file is whole.
    grid.write(out)
}

/// Points in front of the camera and within its picture; what hides what is not known.
fn shown_by(camera: &Camera, positions: &[DVec3]) -> Vec<usize> {
    let (rotation, size) = (camera.rotation(), [camera.width, camera.height].map(f64::from));
    let is_shown = |&index: &usize| {
        let point = rotation * positions[index] + camera.camera_from_world_translation;
        let pixel = camera.pixel_from_camera(point);
        point.z > 0.0 && (0..2).all(|axis| (0.0..size[axis]).contains(&pixel[axis]))
    };
    (0..positions.len()).filter(is_shown).collect()
}

/// Photos that show enough of what is near, and all that they show.
fn content<'a>(list: &'a SceneList, shown_points: &[Vec<usize>], is_near: &[bool]) -> Content<'a> {
    let mut is_wanted = vec![false; list.points.len()];
    let mut photos = Vec::new();
    for (photo, points) in list.photos.iter().zip(shown_points) {
        let near = points.iter().filter(|&&point| is_near[point]).count();
        if near > 0 && near as f64 >= SHARE * points.len() as f64 {
            photos.push(photo);
            points.iter().for_each(|&point| is_wanted[point] = true);
        }
    }
    let points =
        list.points.iter().zip(is_wanted).filter_map(|(point, is_wanted)| is_wanted.then_some(*point)).collect();
    Content { photos, points }
}

fn check(block: &Block, content: &Content<'_>) -> Result<()> {
    ensure!(
        content.photos.iter().any(|photo| !photo.is_test),
        "no training photo shows enough of block {}; cut the scene into fewer blocks",
        block.name
    );
    Ok(())
}

fn write(folder: &Path, content: &Content<'_>) -> Result<()> {
    let images = folder.join("images");
    fs::create_dir_all(&images).map_err(|error| unwritable(&images, &error))?;
    for photo in &content.photos {
        place(&photo.path, &images.join(&photo.name))?;
    }
    let tests = content.photos.iter().filter(|photo| photo.is_test);
    write_text(&folder.join(TEST_LIST), &tests.map(|photo| format!("{}\n", photo.name)).collect::<String>())?;
    let model = folder.join("sparse/0");
    write_model(&model, &model_of(&content.photos, content.points.clone())).map_err(|error| unwritable(&model, &error))
}

/// A second name for the same file, or a copy where the file system has no such thing.
fn place(photo: &Path, name: &Path) -> Result<()> {
    let photo: PathBuf = photo.canonicalize().unwrap_or_else(|_| photo.to_owned());
    let placed = fs::hard_link(&photo, name).or_else(|_| fs::copy(&photo, name).map(|_| ()));
    placed.map_err(|error| anyhow!("cannot copy {} to {}: {error}", shown(&photo), shown(name)))
}

fn tell(block: &Block, content: &Content<'_>, out: &Path) -> Result<()> {
    let [photos, points] = [content.photos.len(), content.points.len()].map(thousands);
    output::print(&format!("block {}: {photos} photos, {points} points", block.name))?;
    output::print(&format!("  {}", command(block, out)))
}

/// How a block is trained.
pub(super) fn command(block: &Block, out: &Path) -> String {
    let scene = out.join(SCENES).join(&block.name);
    let [list, run] = [scene.join(TEST_LIST), out.join(RUNS).join(&block.name)];
    format!("genesplat train {} --test-list {} --out {}", shown(scene), shown(list), shown(run))
}
