//! COLMAP reconstructions: `sparse/0/{cameras,images,points3D}.{bin,txt}` beside a folder of photos; points
//! may be in `points3D.ply`, too.
//!
//! A rasteriser of splats projects along straight lines, so photos of every other camera than a pinhole are
//! undistorted when they are loaded, as COLMAP's `image_undistorter` does it.
//!
//! Frames: `camera_from_world` is stored as COLMAP stores it, x right, y down, z forward.
//! Source of the layouts: COLMAP's "Output Format" documentation.

mod binary;
mod check;
mod cursor;
mod frames;
mod listing;
mod models;
mod text;
mod tracks;
mod write;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

pub(crate) use check::{Finite, Judged, points as finite_points};
pub(crate) use frames::parse_frames;
pub(crate) use listing::{PhotoFolder, list};
pub(crate) use models::{ROUND, round};
pub(crate) use tracks::parse_tracks;
pub use write::write_model;

use glam::{DQuat, DVec3};

use crate::error::SceneError;
use crate::offset::{self, Offset};
use crate::photos::Lens;
use crate::scene::Point;
use crate::similar::entries;
use crate::{input, ply};

/// The two forms in which COLMAP writes a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// `.bin`, little-endian.
    Binary,
    /// `.txt`.
    Text,
}

impl Form {
    fn file(self, folder: &Path, stem: &str) -> PathBuf {
        folder.join(format!("{stem}.{}", if self == Self::Binary { "bin" } else { "txt" }))
    }
}

/// A reconstruction, as far as training needs it: 2D features and tracks are passed over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Those that took photos, by COLMAP's camera id.
    pub cameras: BTreeMap<u32, Intrinsics>,
    /// In file order.
    pub images: Vec<ImageRecord>,
    /// In file order.
    pub points: Vec<Point>,
    /// What the user should know: one sentence each.
    pub notices: Vec<String>,
}

/// A camera without its pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Image width, px.
    pub width: u32,
    /// Image height, px.
    pub height: u32,
    /// `[fx, fy]`, px.
    pub focal_px: [f64; 2],
    /// `[cx, cy]`, px from the top-left corner.
    pub principal_px: [f64; 2],
    /// What bends its photos; `None` for a pinhole.
    pub lens: Option<Lens>,
}

/// A photo and its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageRecord {
    /// Path relative to the image folder.
    pub name: String,
    /// Which of the model's cameras took it.
    pub camera: u32,
    /// `camera_from_world` as a quaternion `(w, x, y, z)`, of any length but zero.
    pub rotation: [f64; 4],
    /// `camera_from_world`, world units.
    pub translation: [f64; 3],
}

impl ImageRecord {
    pub(crate) fn camera_from_world(&self) -> DQuat {
        let [w, x, y, z] = self.rotation;
        DQuat::from_xyzw(x, y, z, w).normalize()
    }

    /// Where the camera stands, world units.
    pub(crate) fn centre(&self) -> DVec3 {
        self.camera_from_world().inverse() * -DVec3::from(self.translation)
    }
}

/// The folder of a model and the form found there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFolder {
    /// Holds `cameras`, `images` and `points3D`.
    pub path: PathBuf,
    /// Binary wherever both exist.
    pub form: Form,
}

/// The model of a scene folder: in `sparse/0`, `sparse`, or the folder itself. Of several in `sparse`, the
/// one with the most photos.
pub fn find_model(scene: &Path) -> Option<ModelFolder> {
    find_model_in(scene, ["sparse", ""])
}

/// The model of a scene in whose folder COLMAP has one of its own, as nerfstudio leaves it.
pub(crate) fn find_nested_model(scene: &Path) -> Option<ModelFolder> {
    find_model_in(scene, ["colmap/sparse", "colmap"])
}

/// The model in a folder that is none of a scene: in its `sparse`, in it itself, or in its numbered parts.
pub(crate) fn find_any_model(folder: &Path) -> Option<ModelFolder> {
    find_model(folder).or_else(|| find_model_in(folder, ["", ""]))
}

fn find_model_in(scene: &Path, [sparse, whole]: [&str; 2]) -> Option<ModelFolder> {
    let below = |folder: &str| if folder.is_empty() { scene.to_owned() } else { scene.join(folder) };
    let [sparse, whole] = [sparse, whole].map(below);
    let mut parts = part_models(&sparse);
    if parts.len() > 1 {
        // Of equal ones, the first.
        parts.sort_by_cached_key(|part| Reverse(image_count(part)));
    }
    parts.into_iter().next().or_else(|| model_in(&sparse)).or_else(|| model_in(&whole))
}

/// The models that COLMAP calls 0, 1, ..., in this order.
fn part_models(sparse: &Path) -> Vec<ModelFolder> {
    let number = |path: &PathBuf| path.file_name().and_then(|name| name.to_str()?.parse::<u32>().ok());
    let mut folders: Vec<(u32, PathBuf)> =
        entries(sparse).filter_map(|path| Some((number(&path)?, path))).collect();
    folders.sort();
    folders.iter().filter_map(|(_, folder)| model_in(folder)).collect()
}

/// The model whose files are in `folder` itself.
pub(crate) fn model_in(folder: &Path) -> Option<ModelFolder> {
    let is_whole =
        |form: &Form| form.file(folder, "cameras").is_file() && form.file(folder, "images").exists();
    let form = [Form::Binary, Form::Text].into_iter().find(is_whole)?;
    Some(ModelFolder { path: folder.to_owned(), form })
}

/// How many photos a model claims to have; 0 where that cannot be told.
fn image_count(model: &ModelFolder) -> u64 {
    let file = model.form.file(&model.path, "images");
    match model.form {
        Form::Binary => {
            let mut count = [0; 8];
            let read = input::open(&file).and_then(|mut file| file.read_exact(&mut count));
            read.map_or(0, |()| u64::from_le_bytes(count))
        }
        // Two lines each.
        Form::Text => input::read(&file).map_or(0, |bytes| {
            bytes.split(|byte| *byte == b'\n').filter(|line| !line.starts_with(b"#")).count() as u64 / 2
        }),
    }
}

/// Reads the three files of a model. Every record is checked, and no count is believed beyond the bytes that
/// back it.
pub fn read_model(folder: &ModelFolder) -> Result<Model, SceneError> {
    read_model_less(folder, |_| Offset::default()).map(|(model, _)| model)
}

/// The same with points less an offset that brings them near the origin, and that offset.
pub(crate) fn read_model_near(folder: &ModelFolder) -> Result<(Model, Offset), SceneError> {
    read_model_less(folder, |model| {
        let centres: Vec<DVec3> = model.images.iter().map(ImageRecord::centre).collect();
        offset::of_cameras(&centres).unwrap_or_default()
    })
}

fn read_model_less(
    folder: &ModelFolder,
    offset: impl FnOnce(&Model) -> Offset,
) -> Result<(Model, Offset), SceneError> {
    let mut model = read_photos(folder)?;
    let offset = offset(&model);
    let Finite { records, notice } = read_points(folder, offset)?;
    model.points = records;
    model.notices.extend(notice);
    Ok((model, offset))
}

fn read_photos(folder: &ModelFolder) -> Result<Model, SceneError> {
    let [cameras, images] = ["cameras", "images"].map(|stem| folder.form.file(&folder.path, stem));
    let (camera_bytes, image_bytes) = (read(&cameras)?, read(&images)?);
    let judged = parse_cameras(folder.form, &cameras, &camera_bytes)?;
    let Finite { records: images, notice } = parse_images(folder.form, &images, &image_bytes)?;
    let used: BTreeSet<u32> = images.iter().map(|image| image.camera).collect();
    let used = judged.into_iter().filter(|(id, _)| used.contains(id));
    let cameras = used.map(|(id, judged)| Ok((id, judged?))).collect::<Result<_, SceneError>>()?;
    Ok(Model { cameras, images, points: Vec::new(), notices: Vec::from_iter(notice) })
}

/// The points less `offset`.
fn read_points(folder: &ModelFolder, offset: Offset) -> Result<Finite<Point>, SceneError> {
    let file = points_file(folder);
    let ending = file.extension().and_then(|ending| ending.to_str());
    match ending {
        // Whoever knows the cameras from elsewhere may have none.
        _ if !file.exists() => Ok(Finite::none()),
        Some("ply") => ply::read_points(&file, offset),
        Some("bin") => parse_points(Form::Binary, &file, &read(&file)?, offset),
        _ => parse_points(Form::Text, &file, &read(&file)?, offset),
    }
}

/// Where the points are: in the cameras' form, in the other, or in the PLY that the reference trainer makes
/// of either.
fn points_file(folder: &ModelFolder) -> PathBuf {
    let own = folder.form.file(&folder.path, "points3D");
    let other = ["bin", "txt", "ply"].map(|ending| folder.path.join("points3D").with_extension(ending));
    [own.clone()].into_iter().chain(other).find(|file| file.exists()).unwrap_or(own)
}

/// Whether the file lists any point, as far as that is known without reading it whole.
fn has_points(file: &Path) -> bool {
    let Ok(opened) = input::open(file) else { return false };
    let mut opened = BufReader::new(opened);
    match file.extension().and_then(|ending| ending.to_str()) {
        Some("ply") => true,
        Some("bin") => {
            let mut count = [0; 8];
            opened.read_exact(&mut count).is_ok() && u64::from_le_bytes(count) > 0
        }
        _ => opened.split(b'\n').map_while(Result::ok).any(|line| !line.is_empty() && line[0] != b'#'),
    }
}

/// The cameras in the `bytes` of `file`, by their ids.
pub(crate) fn parse_cameras(
    form: Form,
    file: &Path,
    bytes: &[u8],
) -> Result<BTreeMap<u32, Judged>, SceneError> {
    match form {
        Form::Binary => binary::cameras(file, bytes),
        Form::Text => text::cameras(file, &input::as_utf8(bytes)),
    }
}

/// The photos in the `bytes` of `file`.
pub(crate) fn parse_images(form: Form, file: &Path, bytes: &[u8]) -> Result<Finite<ImageRecord>, SceneError> {
    match form {
        Form::Binary => binary::images(file, bytes),
        Form::Text => text::images(file, &input::as_utf8(bytes)),
    }
}

/// The points in the `bytes` of `file`, less `offset`.
pub(crate) fn parse_points(
    form: Form,
    file: &Path,
    bytes: &[u8],
    offset: Offset,
) -> Result<Finite<Point>, SceneError> {
    match form {
        Form::Binary => binary::points(file, bytes, offset),
        Form::Text => text::points(file, &input::as_utf8(bytes), offset),
    }
}

fn read(file: &Path) -> Result<Vec<u8>, SceneError> {
    input::read(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })
}
