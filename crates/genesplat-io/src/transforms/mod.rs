//! Scenes described by `transforms.json`: nerfstudio's and instant-ngp's, and Blender's pair of files.
//!
//! Poses are `world_from_camera` in OpenGL's camera axes (y up, z backwards); two axes are turned and the whole is
//! inverted (`camera`). Distorted photos are undistorted when they are loaded. Scenes without points start from random
//! ones (`random_points`). Poses are used as they are: no re-centring, no scaling.

mod camera;
mod random_points;
mod schema;
mod splits;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;

pub(crate) use self::camera::KNOWN_MODELS;
use self::random_points::{COUNT, Cube};
use self::splits::Splits;
use crate::error::SceneError;
use crate::listing::{ListedPhoto, Listing, Purpose, inside, missing_photo, no_photos, path_inside};
use crate::ply;
use crate::scene::Point;

/// What the file name of a photo may end in beyond what a frame says.
const ENDS: [&str; 3] = ["", ".png", ".jpg"];

/// The scene of `folder/transforms_train.json` and, if it exists, `transforms_test.json`: Blender's.
///
/// `seed` is that of random points, where there are no others; `None` where no points are wanted.
pub(crate) fn list_blender(folder: &Path, seed: Option<u64>) -> Result<Listing, SceneError> {
    let list = folder.join("transforms_train.json");
    let test = folder.join("transforms_test.json");
    let mut found = read_photos(&list, Some(Purpose::Unsaid))?;
    if test.is_file() {
        found.append(read_photos(&test, Some(Purpose::Test))?);
    }
    if let Some(missing) = found.missing.first() {
        let (there, all) = (found.photos.len(), found.photos.len() + found.missing.len());
        return Err(missing_photo(&missing.list, missing.photo.clone(), there, all, folder));
    }
    let mut notices = Vec::from_iter(found.masks_notice());
    let points_file = found.points_file(&list)?;
    let points = points(&found, &points_file, seed, || Cube::BLENDER, &mut notices)?;
    Ok(Listing { photos: found.photos, points, points_file, notices })
}

/// The scene of `folder/transforms.json`. Photos that are listed but absent are left out with a notice: published
/// scenes list photos that were removed as blurred.
pub(crate) fn list_nerfstudio(folder: &Path, seed: Option<u64>) -> Result<Listing, SceneError> {
    let list = folder.join("transforms.json");
    let found = read_photos(&list, None)?;
    let mut notices = Vec::from_iter(found.masks_notice());
    if let Some(first) = found.missing.first() {
        let (gone, all) = (found.missing.len(), found.photos.len() + found.missing.len());
        if gone == all {
            return Err(missing_photo(&list, first.photo.clone(), 0, all, folder));
        }
        let first = first.photo.display();
        notices.push(format!(
            "{gone} of the {all} photos that {} lists do not exist and are left out, first {first}",
            list.display()
        ));
    }
    notices.extend(found.unused_notice(&list));
    let cameras: Vec<Camera> = found.photos.iter().map(|photo| photo.camera).collect();
    let points_file = found.points_file(&list)?;
    let points = points(&found, &points_file, seed, || Cube::seen_by(&cameras), &mut notices)?;
    Ok(Listing { photos: found.photos, points, points_file, notices })
}

/// The points that the file names, or random ones with a notice; none where none are wanted.
fn points(
    found: &Found,
    file: &Path,
    seed: Option<u64>,
    cube: impl FnOnce() -> Cube,
    notices: &mut Vec<String>,
) -> Result<Vec<Point>, SceneError> {
    let Some(seed) = seed else { return Ok(Vec::new()) };
    if found.points.is_some() {
        if !file.exists() {
            return Err(SceneError::PointsMissing(file.to_owned()));
        }
        return Ok(ply::read_points(file)?);
    }
    notices.push(format!("the scene has no points, so training starts from {COUNT} random ones"));
    Ok(cube().points(seed))
}

fn with_end(path: &Path, end: &str) -> PathBuf {
    let mut whole = path.to_owned().into_os_string();
    whole.push(end);
    whole.into()
}

/// A listed photo that does not exist.
struct Missing {
    photo: PathBuf,
    list: Arc<Path>,
}

/// What one or two files list.
#[derive(Default)]
struct Found {
    photos: Vec<ListedPhoto>,
    missing: Vec<Missing>,
    /// How many photos have a mask.
    masks: usize,
    points: Option<String>,
}

impl Found {
    fn append(&mut self, other: Self) {
        self.photos.extend(other.photos);
        self.missing.extend(other.missing);
        self.masks += other.masks;
    }

    /// Masks take effort to make, and have no effect here.
    fn masks_notice(&self) -> Option<String> {
        (self.masks > 0).then(|| {
            let all = self.photos.len() + self.missing.len();
            format!(
                "masks are not used, though {} of the {all} photos have one (mask_path): what they cover counts like \
                 the rest",
                self.masks
            )
        })
    }

    /// A photo may be missing from the lists by mistake.
    fn unused_notice(&self, list: &Path) -> Option<String> {
        let unused = self.photos.iter().filter(|photo| photo.purpose == Purpose::Unused).count();
        (unused > 0).then(|| {
            let (list, all) = (list.display(), self.photos.len() + self.missing.len());
            format!(
                "{unused} of the {all} photos that {list} lists are neither trained nor tested on, as its \
                 train_filenames, val_filenames and test_filenames have it"
            )
        })
    }

    /// The file of the points that `list` names, or else `list` itself.
    fn points_file(&self, list: &Path) -> Result<PathBuf, SceneError> {
        let Some(name) = &self.points else { return Ok(list.to_owned()) };
        let outside = || {
            let problem = format!(
                "has the ply_file_path {name:?}, which is not a path inside the scene's folder; correct it, or remove \
                 it to start from random points"
            );
            SceneError::invalid(list, problem)
        };
        Ok(list.parent().unwrap_or(Path::new("")).join(path_inside(name).ok_or_else(outside)?))
    }
}

/// What the file `list` lists. Each photo has this `purpose`; without one, what the file's own lists say.
fn read_photos(list: &Path, purpose: Option<Purpose>) -> Result<Found, SceneError> {
    let file = schema::read(list)?;
    if file.frames.is_empty() {
        return Err(no_photos(list));
    }
    let splits = if purpose.is_some() { None } else { Some(Splits::of(&file, list)?) };
    let folder = list.parent().unwrap_or(Path::new(""));
    let shared: Arc<Path> = list.into();
    let masks = file.frames.iter().filter(|entry| entry.mask_path.is_some()).count();
    let mut found = Found { points: file.ply_file_path.clone(), masks, ..Found::default() };
    for entry in &file.frames {
        let relative = inside(&entry.file_path, list)?;
        let Some((name, path)) = find_photo(folder, relative, &entry.file_path) else {
            found.missing.push(Missing { photo: folder.join(relative), list: shared.clone() });
            continue;
        };
        let intrinsics = entry.intrinsics.or(&file.intrinsics);
        let (camera, distortion) = camera::camera(list, entry, &intrinsics, &path)?;
        let listed = splits.as_ref().map(|splits| splits.purpose(&entry.file_path, list)).transpose()?;
        let purpose = purpose.or(listed).unwrap_or_default();
        found.photos.push(ListedPhoto { name, path, list: shared.clone(), camera, distortion, purpose });
    }
    Ok(found)
}

/// The photo as it is named, or with the extension that Blender's script leaves out.
fn find_photo(folder: &Path, relative: &Path, name: &str) -> Option<(String, PathBuf)> {
    let candidates = ENDS.map(|end| (format!("{name}{end}"), with_end(&folder.join(relative), end)));
    candidates.into_iter().find(|(_, path)| path.is_file())
}
