//! A model's photos, joined with their cameras and found on the disk.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;
use glam::{DQuat, DVec3};

use super::tracks::read_seen;
use super::{ImageRecord, Model, ModelFolder, has_points, part_models, points_file, read_model, read_photos};
use crate::error::SceneError;
use crate::listing::{
    ListedPhoto, Listing, Purpose, absent_notice, all_missing, base_name, inside, left_out_notice, no_photos,
    separate, similar_notice,
};
use crate::photos::Lens;
use crate::scene::LoadOptions;
use crate::shown;
use crate::similar::{self, Similar, entries};

/// Lists the photos and, if they are wanted, the points and who sees them of the model in `folder`; photos are in
/// `image_folder`.
pub(crate) fn list(
    folder: &ModelFolder,
    image_folder: &Path,
    options: &LoadOptions,
) -> Result<Listing, SceneError> {
    let with_points = options.with_points;
    let mut model = if with_points { read_model(folder)? } else { read_photos(folder)? };
    model.images.iter_mut().for_each(|image| separate(&mut image.name, image_folder));
    let list = folder.form.file(&folder.path, "images");
    if model.images.is_empty() {
        return Err(no_photos(&list));
    }
    let mut notices = Vec::from_iter(other_models(&folder.path));
    let is_one_of_several = !notices.is_empty();
    notices.append(&mut model.notices);
    let photos = find_photos(&model.images, image_folder, &list, &mut notices)?;
    if !is_one_of_several {
        notices.extend(left_out_notice(photos.iter().map(|(_, path)| &**path), &list));
    }
    let seen = if with_points && options.with_tracks { read_seen(folder)? } else { BTreeMap::new() };
    let mut seen: BTreeMap<String, Vec<u32>> = seen
        .into_iter()
        .map(|(mut name, points)| {
            separate(&mut name, image_folder);
            (name, points)
        })
        .collect();
    let list: Arc<Path> = list.into();
    let listed = |(image, path): (&ImageRecord, PathBuf)| {
        let (name, list, (camera, lens)) = (image.name.clone(), list.clone(), camera(&model, image, &list)?);
        let seen = seen.remove(&name).unwrap_or_default();
        Ok(ListedPhoto { name, path, list, camera, lens, purpose: Purpose::Unsaid, mask: None, seen })
    };
    let photos = photos.into_iter().map(listed).collect::<Result<_, SceneError>>()?;
    let points_file = points_file(folder);
    let has_points = if with_points { !model.points.is_empty() } else { has_points(&points_file) };
    let (points, points_digest) = (model.points, None);
    Ok(Listing { photos, points, has_points, points_digest, points_file, cube: None, notices })
}

fn camera(model: &Model, image: &ImageRecord, list: &Path) -> Result<(Camera, Option<Lens>), SceneError> {
    let intrinsics = model.cameras.get(&image.camera).ok_or_else(|| {
        let (name, camera) = (shown(&image.name), image.camera);
        let problem = format!(
            "photo {name} refers to camera {camera}, which the model does not have; export the model again"
        );
        SceneError::bad_record(list, problem)
    })?;
    let [w, x, y, z] = image.rotation;
    let camera = Camera {
        focal_px: intrinsics.focal_px,
        principal_px: intrinsics.principal_px,
        camera_from_world_rotation: DQuat::from_xyzw(x, y, z, w).normalize(),
        camera_from_world_translation: DVec3::from(image.translation),
        ..Camera::at_origin(intrinsics.width, intrinsics.height, intrinsics.focal_px[0])
    };
    Ok((camera, intrinsics.lens))
}

/// The photos that exist: by the record's whole name, or else by its last part, as the reference trainer
/// looks; or by almost these.
fn find_photos<'a>(
    images: &'a [ImageRecord],
    folder: &Path,
    list: &Path,
    notices: &mut Vec<String>,
) -> Result<Vec<(&'a ImageRecord, PathBuf)>, SceneError> {
    let (folder, mut similar) = (similar::folder(folder), Similar::default());
    let (mut found, mut missing) = (Vec::with_capacity(images.len()), Vec::new());
    for image in images {
        let whole = folder.join(inside(&image.name, list)?);
        let flat = folder.join(base_name(&image.name));
        let there = [&whole, &flat].into_iter().find(|path| path.is_file()).cloned();
        match there.or_else(|| similar.find(&whole)).or_else(|| similar.find(&flat)) {
            Some(path) => found.push((image, path)),
            None => missing.push(whole),
        }
    }
    if let (true, Some(wanted)) = (found.is_empty(), missing.first()) {
        return Err(all_missing(wanted, images.len(), list, beside(&folder, &images[0].name).as_deref()));
    }
    notices.extend(similar_notice(similar, list));
    notices.extend(absent_notice(&missing, images.len(), list));
    Ok(found)
}

/// Another folder beside that of the photos, where the photo `name` is.
fn beside(folder: &Path, name: &str) -> Option<PathBuf> {
    let holds = |other: &PathBuf| other != folder && other.join(name).is_file();
    entries(folder.parent()?).filter(holds).min()
}

/// A notice where COLMAP split the photos into several models, of which one is used.
fn other_models(folder: &Path) -> Option<String> {
    let models = part_models(folder.parent().filter(|parent| parent.ends_with("sparse"))?);
    let is_one_of_several = models.len() > 1 && models.iter().any(|model| model.path == folder);
    is_one_of_several.then(|| {
        format!(
            "COLMAP split the photos into {} models; {} is used, the largest unless another one is given, and photos of the others \
             are left out",
            models.len(),
            shown(folder)
        )
    })
}
