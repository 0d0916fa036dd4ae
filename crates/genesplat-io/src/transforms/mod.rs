//! Scenes described by `transforms.json`: nerfstudio's and instant-ngp's, and Blender's pair of files.
//!
//! Poses are `world_from_camera` in OpenGL's camera axes (y up, z backwards). They are used as they are: no re-centring,
//! no scaling.

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
use crate::listing::{ListedPhoto, Listing, Purpose, inside, no_photos, path_inside};
use crate::{ply, shown};

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
        let tested = read_photos(&test, Some(Purpose::Test))?;
        found.photos.extend(tested.photos);
        found.missing.extend(tested.missing);
    }
    match found.missing.first() {
        Some((photo, list)) if !found.photos.is_empty() => {
            Err(SceneError::PhotoMissing { photo: photo.clone(), list: list.to_path_buf() })
        }
        _ => found.into_listing(&list, seed, |_| Cube::BLENDER),
    }
}

/// The scene of `folder/transforms.json`. Photos that are listed but absent are left out with a notice: published
/// scenes list photos that were removed as blurred.
pub(crate) fn list_nerfstudio(folder: &Path, seed: Option<u64>) -> Result<Listing, SceneError> {
    let list = folder.join("transforms.json");
    read_photos(&list, None)?.into_listing(&list, seed, |photos| {
        let cameras: Vec<Camera> = photos.iter().map(|photo| photo.camera).collect();
        Cube::seen_by(&cameras)
    })
}

fn with_end(path: &Path, end: &str) -> PathBuf {
    let mut whole = path.to_owned().into_os_string();
    whole.push(end);
    whole.into()
}

/// What one or two files list.
#[derive(Default)]
struct Found {
    photos: Vec<ListedPhoto>,
    /// Photos that do not exist, each with the file that lists it.
    missing: Vec<(PathBuf, Arc<Path>)>,
    points: Option<String>,
}

impl Found {
    /// With the points that the file names, or random ones with a notice; none where none are wanted.
    fn into_listing(
        self,
        list: &Path,
        seed: Option<u64>,
        cube: impl FnOnce(&[ListedPhoto]) -> Cube,
    ) -> Result<Listing, SceneError> {
        let folder = list.parent().unwrap_or(Path::new(""));
        if self.photos.is_empty() {
            let (count, list, folder) = (self.missing.len(), list.to_owned(), folder.to_owned());
            return Err(SceneError::AllPhotosMissing { count, list, folder });
        }
        let mut notices = self.notices(list);
        let points_file = match &self.points {
            Some(name) => folder.join(path_inside(name).ok_or_else(|| points_outside(list, name))?),
            None => list.to_owned(),
        };
        let points = match (seed, &self.points) {
            (None, _) => Vec::new(),
            (_, Some(_)) if !points_file.exists() => return Err(SceneError::PointsMissing(points_file)),
            (_, Some(_)) => ply::read_points(&points_file)?,
            (Some(seed), None) => {
                notices.push(format!("the scene has no points, so training starts from {COUNT} random ones"));
                cube(&self.photos).points(seed)
            }
        };
        Ok(Listing { photos: self.photos, points, points_file, notices })
    }

    /// A photo may be missing, or be in no list, by mistake.
    fn notices(&self, list: &Path) -> Vec<String> {
        let (list, all) = (shown(list), self.photos.len() + self.missing.len());
        let mut notices = Vec::new();
        if let Some((first, _)) = self.missing.first() {
            let (gone, first) = (self.missing.len(), shown(first));
            notices.push(format!(
                "{gone} of the {all} photos that {list} lists do not exist and are left out, first {first}"
            ));
        }
        let unused = self.photos.iter().filter(|photo| photo.purpose == Purpose::Unused).count();
        if unused > 0 {
            notices.push(format!(
                "{unused} of the {all} photos that {list} lists are neither trained nor tested on, as its \
                 train_filenames, val_filenames and test_filenames have it"
            ));
        }
        notices
    }
}

fn points_outside(list: &Path, name: &str) -> SceneError {
    let problem = "which is not a path inside the scene's folder; correct it, or remove it to start from random points";
    SceneError::invalid(list, format!("has the ply_file_path {name:?}, {problem}"))
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
    let mut found = Found { points: file.ply_file_path.clone(), ..Found::default() };
    for entry in &file.frames {
        let relative = inside(&entry.file_path, list)?;
        let Some((name, path)) = find_photo(folder, relative, &entry.file_path) else {
            found.missing.push((folder.join(relative), shared.clone()));
            continue;
        };
        let intrinsics = entry.intrinsics.or(&file.intrinsics);
        let (camera, lens) = camera::camera(list, entry, &intrinsics, &path)?;
        let listed = splits.as_ref().map(|splits| splits.purpose(&entry.file_path, list)).transpose()?;
        let purpose = purpose.or(listed).unwrap_or_default();
        let mask = entry.mask_path.as_deref().map(|name| find_mask(folder, name, list)).transpose()?;
        found.photos.push(ListedPhoto { name, path, list: shared.clone(), camera, lens, purpose, mask });
    }
    Ok(found)
}

/// The cameras that the `text` of `list` describes, all of whose rules they have met; photos are looked at only where
/// it does not say their size.
pub(crate) fn parse_cameras(list: &Path, text: &[u8]) -> Result<Vec<Camera>, SceneError> {
    let file = schema::parse(list, text)?;
    let splits = Splits::of(&file, list)?;
    let entries = file.frames.iter().map(|entry| {
        let photo = inside(&entry.file_path, list)?;
        splits.purpose(&entry.file_path, list)?;
        Ok(camera::camera(list, entry, &entry.intrinsics.or(&file.intrinsics), photo)?.0)
    });
    entries.collect()
}

/// The mask that a photo's entry names.
fn find_mask(folder: &Path, name: &str, list: &Path) -> Result<PathBuf, SceneError> {
    let path = path_inside(name).map(|relative| folder.join(relative)).filter(|path| path.is_file());
    path.ok_or_else(|| {
        let problem = "which is no file in the scene's folder; put it there, or remove the mask_path";
        SceneError::invalid(list, format!("names the mask {name:?}, {problem}"))
    })
}

/// The photo as it is named, or with the extension that Blender's script leaves out.
fn find_photo(folder: &Path, relative: &Path, name: &str) -> Option<(String, PathBuf)> {
    let candidates = ENDS.map(|end| (format!("{name}{end}"), with_end(&folder.join(relative), end)));
    candidates.into_iter().find(|(_, path)| path.is_file())
}
