//! A model's photos, joined with their cameras and found on the disk.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;
use genesplat_core::constants::NEAR_DEPTH;
use glam::{DQuat, DVec3};

use super::{ImageRecord, Model, ModelFolder, read_model, read_photos};
use crate::error::SceneError;
use crate::listing::{ListedPhoto, Listing, Purpose, base_name, inside, no_photos};
use crate::photos::Lens;
use crate::shown;

/// Lists the photos and, if they are wanted, the points of the model in `folder`; photos are in `image_folder`.
pub(crate) fn list(folder: &ModelFolder, image_folder: &Path, with_points: bool) -> Result<Listing, SceneError> {
    let model = if with_points { read_model(folder)? } else { read_photos(folder)? };
    let list = folder.form.file(&folder.path, "images");
    if model.images.is_empty() {
        return Err(no_photos(&list));
    }
    let photos = find_photos(&model.images, image_folder, &list)?;
    let list: Arc<Path> = list.into();
    let listed = |(image, path): (&ImageRecord, PathBuf)| {
        let (name, list, (camera, lens)) = (image.name.clone(), list.clone(), camera(&model, image, &list)?);
        Ok(ListedPhoto { name, path, list, camera, lens, purpose: Purpose::Unsaid, mask: None })
    };
    let photos = model.images.iter().zip(photos).map(listed).collect::<Result<_, SceneError>>()?;
    let points_file = folder.form.file(&folder.path, "points3D");
    Ok(Listing { photos, points: model.points, points_file, notices: other_models(&folder.path) })
}

fn camera(model: &Model, image: &ImageRecord, list: &Path) -> Result<(Camera, Option<Lens>), SceneError> {
    let intrinsics = model.cameras.get(&image.camera).ok_or_else(|| {
        let (name, camera) = (shown(&image.name), image.camera);
        let problem =
            format!("photo {name} refers to camera {camera}, which the model does not have; export the model again");
        SceneError::bad_record(list, problem)
    })?;
    let [w, x, y, z] = image.rotation;
    let camera = Camera {
        width: intrinsics.width,
        height: intrinsics.height,
        focal_px: intrinsics.focal_px,
        principal_px: intrinsics.principal_px,
        camera_from_world_rotation: DQuat::from_xyzw(x, y, z, w).normalize(),
        camera_from_world_translation: DVec3::from(image.translation),
        near: NEAR_DEPTH,
    };
    Ok((camera, intrinsics.lens))
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
        let (list, folder, count) = (list.to_owned(), folder.to_owned(), images.len());
        return Err(match found.is_empty() {
            true => SceneError::AllPhotosMissing { count, list, folder },
            false => SceneError::PhotoMissing { photo, list },
        });
    }
    match shared(&found).map(|pair| pair.map(|at| images[at].name.clone())) {
        // Two records of one name are an error of `Listing::name_views`.
        Some([first, second]) if first != second => {
            let problem = format!(
                "lists {} and {}, and {} has one photo of that name for both; put them where the list says",
                shown(&first),
                shown(&second),
                shown(folder)
            );
            Err(SceneError::invalid(list, problem))
        }
        _ => Ok(found),
    }
}

/// The first two records that found the same file: the photo of one of them is not where the list says.
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
            shown(folder)
        )];
    }
    Vec::new()
}
