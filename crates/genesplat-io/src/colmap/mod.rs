//! COLMAP reconstructions: `sparse/0/{cameras,images,points3D}.{bin,txt}` beside a folder of photos.
//!
//! Both forms are read into one [`Model`] (`binary`, `text`), checked there record by record, and joined here to
//! photos with cameras. Only pinhole cameras are taken: a rasteriser of splats projects along straight lines, so a
//! distorted reconstruction must be undistorted first (COLMAP's `image_undistorter`).
//!
//! Frames: `camera_from_world` is stored as COLMAP stores it, x right, y down, z forward.
//! Source of the layouts: COLMAP's "Output Format" documentation.

mod binary;
mod check;
mod text;
mod write;

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;
use glam::{DQuat, DVec3};

pub use write::write_model;

use crate::error::SceneError;
use crate::listing::{Frame, Listing, Purpose, base_name, inside, missing_photo, view_names};
use crate::scene::Point;

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
    /// By COLMAP's camera id.
    pub cameras: BTreeMap<u32, Intrinsics>,
    /// In file order.
    pub images: Vec<ImageRecord>,
    /// In file order.
    pub points: Vec<Point>,
}

/// A pinhole camera without its pose.
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

/// The folder of a model and the form found there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFolder {
    /// Holds `cameras`, `images` and `points3D`.
    pub path: PathBuf,
    /// Binary wherever both exist.
    pub form: Form,
}

/// The model of a scene folder: in `sparse/0`, `sparse`, or the folder itself.
pub fn find_model(scene: &Path) -> Option<ModelFolder> {
    let folders = ["sparse/0", "sparse", ""].map(|sub| scene.join(sub));
    let forms = [Form::Binary, Form::Text];
    folders.iter().flat_map(|path| forms.map(|form| (path, form))).find_map(|(path, form)| {
        form.file(path, "cameras").is_file().then(|| ModelFolder { path: path.clone(), form })
    })
}

/// Reads the three files of a model. Every record is checked; nothing is believed beyond the bytes that back it.
pub fn read_model(folder: &ModelFolder) -> Result<Model, SceneError> {
    let points = read_points(folder)?;
    Ok(Model { points, ..read_photos(folder)? })
}

/// The model without its points.
fn read_photos(folder: &ModelFolder) -> Result<Model, SceneError> {
    let [cameras, images] = ["cameras", "images"].map(|stem| folder.form.file(&folder.path, stem));
    let (camera_bytes, image_bytes) = (read(&cameras)?, read(&images)?);
    let (cameras, images) = match folder.form {
        Form::Binary => (binary::cameras(&cameras, &camera_bytes)?, binary::images(&images, &image_bytes)?),
        Form::Text => (text::cameras(&cameras, &camera_bytes)?, text::images(&images, &image_bytes)?),
    };
    Ok(Model { cameras, images, points: Vec::new() })
}

fn read_points(folder: &ModelFolder) -> Result<Vec<Point>, SceneError> {
    let file = folder.form.file(&folder.path, "points3D");
    let bytes = read(&file)?;
    match folder.form {
        Form::Binary => binary::points(&file, &bytes),
        Form::Text => text::points(&file, &bytes),
    }
}

fn read(file: &Path) -> Result<Vec<u8>, SceneError> {
    std::fs::read(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })
}

/// Photos with cameras, and points if they are wanted, of the model in `folder`, whose photos are in `image_folder`.
pub(crate) fn list(
    folder: &ModelFolder,
    image_folder: &Path,
    with_points: bool,
) -> Result<Listing, SceneError> {
    let model = if with_points { read_model(folder)? } else { read_photos(folder)? };
    let list = folder.form.file(&folder.path, "images");
    if model.images.is_empty() {
        return Err(SceneError::NoPhotos { file: list });
    }
    let photos = find_photos(&model.images, image_folder, &list)?;
    let paths: Vec<&str> = model.images.iter().map(|image| image.name.as_str()).collect();
    let names = view_names(&paths, &list)?;
    let shared: Arc<Path> = list.as_path().into();
    let frames = (model.images.iter().zip(photos).zip(names))
        .map(|((image, photo), name)| {
            let (list, camera) = (shared.clone(), camera(&model, image, &list)?);
            Ok(Frame { name, photo, list, camera, distortion: None, purpose: Purpose::Unsaid })
        })
        .collect::<Result<_, SceneError>>()?;
    let points_file = folder.form.file(&folder.path, "points3D");
    Ok(Listing { frames, points: model.points, points_file, notices: other_models(&folder.path) })
}

fn camera(model: &Model, image: &ImageRecord, list: &Path) -> Result<Camera, SceneError> {
    let intrinsics = model.cameras.get(&image.camera).ok_or_else(|| SceneError::NoSuchCamera {
        file: list.to_owned(),
        name: image.name.clone(),
        camera: image.camera,
    })?;
    let [w, x, y, z] = image.rotation;
    Ok(Camera {
        width: intrinsics.width,
        height: intrinsics.height,
        focal_px: intrinsics.focal_px,
        principal_px: intrinsics.principal_px,
        camera_from_world_rotation: DQuat::from_xyzw(x, y, z, w).normalize(),
        camera_from_world_translation: DVec3::from(image.translation),
    })
}

/// Path of every photo: by the record's whole name, or else by its last part, as the reference trainer looks.
fn find_photos(images: &[ImageRecord], folder: &Path, list: &Path) -> Result<Vec<PathBuf>, SceneError> {
    let mut found = Vec::with_capacity(images.len());
    let mut missing = None;
    for image in images {
        let whole = folder.join(inside(&image.name, list)?);
        let flat = folder.join(base_name(&image.name));
        if whole.is_file() {
            found.push(whole);
        } else if flat.is_file() {
            found.push(flat);
        } else {
            missing = missing.or(Some(whole));
        }
    }
    if let Some(photo) = missing {
        return Err(missing_photo(list, photo, found.len(), images.len(), folder));
    }
    match shared(&found).map(|pair| pair.map(|at| images[at].name.clone())) {
        // Two records of one name are found out with the names of the views.
        Some([first, second]) if first != second => {
            Err(SceneError::OneForTwo { file: list.to_owned(), first, second, folder: folder.to_owned() })
        }
        _ => Ok(found),
    }
}

/// The first two records that found one photo: that of one of them is not where the list says.
fn shared(found: &[PathBuf]) -> Option<[usize; 2]> {
    let mut finders = HashMap::new();
    found.iter().enumerate().find_map(|(at, photo)| finders.insert(photo, at).map(|first| [first, at]))
}

/// A notice where COLMAP split the photos into several models, of which only the first is used.
fn other_models(folder: &Path) -> Vec<String> {
    let second = folder.with_file_name("1");
    if folder.ends_with("sparse/0") && second.is_dir() {
        return vec![format!(
            "COLMAP split the photos into several models; only {} is used, and photos of the others are left out",
            folder.display()
        )];
    }
    Vec::new()
}
