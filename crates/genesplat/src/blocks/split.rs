//! From a scene to the scenes of its blocks.

use std::io::{ErrorKind, Write as _};
use std::path::Path;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::core::Camera;
use genesplat::io::blocks::{Block, Grid, Members};
use genesplat::io::colmap::write_model;
use genesplat::io::{
    ListedDepth, Offset, Point, SceneError, SceneList, ScenePhoto, dense_name, model_of, offset, own, plural,
    shown,
};
use genesplat::run::files::{make_own_folder, unwritable, write_own, write_own_text};
use genesplat::run::numbers::thousands;
use genesplat::run::output;
use glam::DVec3;

use super::claim::Claim;
use super::folder::{Cut, SCENES, TEST_LIST, command};

/// What is in one block.
struct Content<'a> {
    photos: Vec<&'a ScenePhoto>,
    points: Vec<Point>,
    /// What was subtracted from the coordinates of the whole scene.
    offset: Option<Offset>,
}

/// Cuts `list`, the scene at `scene`, into `columns` x `rows` blocks, and writes them below `out`. A block is
/// also given what stands within `margin` of its sides beyond its core. Where a process was killed that did
/// the same, this one goes on.
pub(crate) fn split(
    scene: &Path,
    list: &SceneList,
    count: [usize; 2],
    margin: f64,
    out: &Path,
) -> Result<()> {
    let positions: Vec<DVec3> =
        list.points.iter().map(|point| DVec3::from(point.position.map(f64::from))).collect();
    let cameras: Vec<Camera> = list.photos.iter().map(|photo| photo.camera).collect();
    let grid = Grid::cut(&cameras, &positions, count);
    // A photo of all around is of each block that one of its views shows.
    let (pinholes, photos): (Vec<Camera>, Vec<&ScenePhoto>) = list
        .photos
        .iter()
        .flat_map(|photo| photo.pinholes().into_iter().map(move |camera| (camera, photo)))
        .unzip();
    let members = Members::of(&grid, &pinholes, &positions, margin);
    let photos_of = |number: usize| {
        let mut shown: Vec<&ScenePhoto> = members.photos(number).iter().map(|&view| photos[view]).collect();
        shown.dedup_by_key(|photo| &photo.name);
        shown
    };
    for (number, block) in grid.blocks().iter().enumerate() {
        check(block, photos_of(number).into_iter())?;
    }
    let claim = Claim::take(out, list, count, margin)?;
    for (number, block) in grid.blocks().iter().enumerate() {
        let photos = photos_of(number);
        let points = members.points(number).map(|point| list.points[point]).collect();
        let content = Content { photos, points, offset: list.offset };
        write(&make_own_folder(out, Path::new(SCENES).join(&block.name))?, &content)?;
        tell(block, &content, out)?;
    }
    // Last: a folder with this file is whole.
    Cut { scene: shown(scene), grid, offset: list.offset }.write(out)?;
    claim.finish()
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
    let mut unread = Vec::new();
    for photo in &content.photos {
        place(&photo.path, folder, &Path::new("images").join(&photo.name))?;
        if let Some(mask) = &photo.mask {
            place(mask, folder, &Path::new("masks").join(format!("{}.png", photo.name)))?;
        }
        if let Some(depth) = &photo.depth {
            unread.extend(place_depth(depth, folder, &photo.name)?);
        }
    }
    if let [error, ..] = &unread[..] {
        let maps = format!("{} {}", unread.len(), plural(unread.len(), "depth map", "depth maps"));
        output::tell(&format!("notice: {} goes without {maps}: {error}", shown(folder)));
    }
    let tests: Vec<&str> =
        content.photos.iter().filter(|photo| photo.is_test).map(|photo| &*photo.name).collect();
    if let Some(name) = tests.iter().find(|name| name.contains(['\n', '\r'])) {
        bail!(
            "{} has a line break in its name, and lists of test photos have a line each; rename it",
            shown(name)
        );
    }
    if !tests.is_empty() {
        write_own_text(folder, TEST_LIST, &(tests.join("\n") + "\n"))?;
    }
    // Where there is none, too: all blocks lie in one frame.
    write_own_text(folder, offset::OF_SCENE, &offset::to_json(content.offset.unwrap_or_default()))?;
    let model = make_own_folder(folder, "sparse/0")?;
    write_model(&model, &model_of(&content.photos, content.points.clone()))
        .map_err(|error| unwritable(&model, &error))
}

/// Puts a photo's depth map into the scene of a block, where COLMAP has it. One that cannot be read is left
/// out, as by training; says why.
fn place_depth(depth: &ListedDepth, folder: &Path, photo: &str) -> Result<Option<SceneError>> {
    let name = dense_name(photo);
    if depth.is_dense() && depth.path.is_file() {
        return place(&depth.path, folder, &name).map(|()| None);
    }
    match depth.to_dense() {
        Ok(bytes) => write_own(folder, &name, |out| out.write_all(&bytes)).map(|()| None),
        Err(error) => Ok(Some(error)),
    }
}

/// Puts a photo or a mask into the scene of a block, unless it is there since the last time.
fn place(file: &Path, folder: &Path, name: &Path) -> Result<()> {
    let to = folder.join(name);
    match own::link_or_copy(file, folder, name) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            ensure!(
                own::is_same(file, &to).is_ok_and(|is_same| is_same),
                "{} is there already, and is not {}; remove it",
                shown(&to),
                shown(file)
            );
            Ok(())
        }
        done => done.map_err(|error| anyhow!("cannot copy {} to {}: {error}", shown(file), shown(&to))),
    }
}

fn tell(block: &Block, content: &Content<'_>, out: &Path) -> Result<()> {
    let [photos, points] =
        [(content.photos.len(), ["photo", "photos"]), (content.points.len(), ["point", "points"])]
            .map(|(count, [one, many])| format!("{} {}", thousands(count), plural(count, one, many)));
    output::print(&format!("block {}: {photos}, {points}", block.name))?;
    output::print(&format!("  {}", command(block, out)))
}
