//! A model's photos, joined with their cameras and found on the disk.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;
use glam::{DQuat, DVec3};

use super::frames::read_moments;
use super::tracks::{Seen, read_seen};
use super::{
    Finite, ImageRecord, Model, ModelFolder, has_points, part_models, points_file, read_photos, read_points,
};
use crate::error::SceneError;
use crate::listing::{
    Elsewhere, ListedPhoto, Listing, Purpose, Wanted, absent_notice, all_missing, base_name, inside,
    left_out, no_photos, settle, similar_notice,
};
use crate::photos::Lens;
use crate::scene::Sight;
use crate::scene::precision::move_cameras;
use crate::shown;
use crate::similar::{self, Similar, entries};

/// Where the photos of a model are.
pub(crate) struct PhotoFolder {
    pub(crate) path: PathBuf,
    /// Nobody has asked for it, so photos beside their list are meant where it has none.
    pub(crate) is_usual: bool,
}

impl PhotoFolder {
    /// Others that are meant where this one has none of the photos.
    fn beside<'a>(&'a self, list: &'a Path) -> impl Iterator<Item = &'a Path> {
        [list.parent(), self.path.parent()].into_iter().flatten().filter(|_| self.is_usual)
    }

    /// This one first.
    fn all<'a>(&'a self, list: &'a Path) -> Vec<&'a Path> {
        [&*self.path].into_iter().chain(self.beside(list)).collect()
    }

    /// This one, or that of the list, or that of the scene: the first that has a photo of `images`; and
    /// whether it is another.
    fn settled(&self, images: &[ImageRecord], list: &Path) -> (PathBuf, bool) {
        let own = similar::folder(&self.path);
        let has = |folder: &&Path, name: &str| folder.join(name).is_file();
        let has_any = |folder: &&Path| {
            let names = images.iter().map(|image| &*image.name);
            names
                .filter(|name| inside(name, list).is_ok())
                .any(|name| has(folder, name) || has(folder, base_name(name)))
        };
        let found = [&*own].into_iter().chain(self.beside(list)).find(has_any).map(Path::to_owned);
        found.filter(|found| *found != own).map_or((own, false), |found| (found, true))
    }
}

/// Lists the photos and, if they are wanted, the points and who sees them of the model in `folder`.
pub(crate) fn list(
    folder: &ModelFolder,
    given: &PhotoFolder,
    wanted: Wanted<'_>,
) -> Result<Listing, SceneError> {
    let mut model = read_photos(folder)?;
    let list = folder.form.file(&folder.path, "images");
    let folders = given.all(&list);
    model.images.iter_mut().for_each(|image| settle(&mut image.name, &folders));
    if model.images.is_empty() {
        return Err(no_photos(&list));
    }
    let mut notices = Vec::from_iter(other_models(&folder.path));
    let is_one_of_several = !notices.is_empty();
    notices.append(&mut model.notices);
    let (image_folder, is_beside) = given.settled(&model.images, &list);
    if is_beside {
        notices.push(format!("the photos are those in {}, beside their list", shown(&image_folder)));
    }
    let photos = find_photos(&model.images, &image_folder, &list, &mut notices)?;
    let left_out = left_out(photos.iter().map(|(_, path)| &**path), &HashSet::new());
    if !is_one_of_several {
        notices.extend(left_out.as_ref().and_then(|left_out| left_out.notice(&list)));
    }
    let doubts = Vec::from_iter(left_out.and_then(|left_out| left_out.doubt(&list)));
    let mut seen = if wanted.tracks { named(read_seen(folder)?, &folders) } else { BTreeMap::new() };
    let mut moments = named(read_moments(folder)?, &folders);
    let list: Arc<Path> = list.into();
    let listed = |(image, path): (&ImageRecord, PathBuf)| {
        let (name, list, (camera, lens)) = (image.name.clone(), list.clone(), camera(&model, image, &list)?);
        let seen = sights(&seen.remove(&name).unwrap_or_default(), &camera, lens.as_ref());
        let moment = moments.remove(&name);
        let (purpose, mask, depth) = (Purpose::Unsaid, None, None);
        Ok(ListedPhoto { name, path, list, camera, lens, purpose, mask, depth, seen, moment })
    };
    let mut photos = photos.into_iter().map(listed).collect::<Result<Vec<_>, SceneError>>()?;
    let moved = move_cameras(&mut photos, wanted.frame);
    let points = if wanted.points { read_points(folder, moved.by)? } else { Finite::none() };
    notices.extend(points.notice);
    let (points, points_digest) = (points.records, None);
    let has_points = if wanted.points { !points.is_empty() } else { has_points(&points_file(folder)) };
    Ok(Listing { photos, points, has_points, points_digest, cube: None, notices, doubts, moved })
}

/// What a photo by `camera` sees, without the lens.
fn sights(seen: &[Seen], camera: &Camera, lens: Option<&Lens>) -> Vec<Sight> {
    let ray = |[x, y]: [f32; 2]| {
        let at =
            |pixel: f32, axis: usize| (f64::from(pixel) - camera.principal_px[axis]) / camera.focal_px[axis];
        let shown = [at(x, 0), at(y, 1)];
        let straight = lens.map_or(Some(shown), |lens| lens.undistort(shown))?;
        Some(straight.map(|coordinate| coordinate as f32)).filter(|ray| ray.iter().all(|at| at.is_finite()))
    };
    seen.iter().map(|&(point, pixel)| Sight { point, ray: pixel.and_then(ray) }).collect()
}

/// What is known of photos, by their names as they are here.
fn named<T>(of_photos: BTreeMap<String, T>, folders: &[&Path]) -> BTreeMap<String, T> {
    let named = |(mut name, of_photo): (String, T)| {
        settle(&mut name, folders);
        (name, of_photo)
    };
    of_photos.into_iter().map(named).collect()
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
    let mut similar = Similar::default();
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
        return Err(all_missing(wanted, images.len(), list, beside(folder, &images[0].name).as_ref()));
    }
    notices.extend(similar_notice(similar, list));
    notices.extend(absent_notice(&missing, images.len(), list));
    Ok(found)
}

/// Another folder beside that of the photos, or beside that of their scene, where the photo `name` is.
fn beside(folder: &Path, name: &str) -> Option<Elsewhere> {
    let holds = |other: &PathBuf| {
        other != folder && [name, base_name(name)].iter().any(|name| other.join(name).is_file())
    };
    let in_place = |place: &Path| entries(place).filter(holds).min();
    let scene = folder.parent()?;
    let here =
        in_place(scene).map(|path| Elsewhere { given: path.file_name().unwrap_or_default().into(), path });
    here.or_else(|| in_place(scene.parent()?).map(|path| Elsewhere { given: path.clone(), path }))
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
