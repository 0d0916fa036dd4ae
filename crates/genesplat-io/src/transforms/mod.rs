//! Scenes described by `transforms.json`: nerfstudio's and instant-ngp's, and Blender's pair of files.
//!
//! Poses are `world_from_camera` in OpenGL's camera axes (y up, z backwards). They are used as they are: no
//! re-centring, no scaling.

mod camera;
mod nested;
mod schema;
mod splits;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;

pub(crate) use self::camera::KNOWN_MODELS;
use self::splits::Splits;
use crate::error::SceneError;
use crate::listing::{
    ListedPhoto, Listing, Purpose, absent_notice, all_missing, base_name, inside, no_photos, path_inside,
    separate, similar_notice,
};
use crate::scene::{Cube, Point};
use crate::similar::Similar;
use crate::{ply, shown};

/// Point clouds that may lie beside the list: nerfstudio's, those of converters, the reference trainer's.
const BESIDE: [&str; 4] = ["sparse_pc.ply", "pointcloud.ply", "points3D.ply", "points3d.ply"];

/// What the file name of a photo may end in beyond what a frame says.
const ENDS: [&str; 3] = ["", ".png", ".jpg"];

/// The scene of `folder/transforms_train.json` and, if it exists, `transforms_test.json`: Blender's.
pub(crate) fn list_blender(folder: &Path, with_points: bool) -> Result<Listing, SceneError> {
    let list = folder.join("transforms_train.json");
    let test = folder.join("transforms_test.json");
    let mut found = read_photos(&list, Some(Purpose::Unsaid))?;
    if test.is_file() {
        found.add(read_photos(&test, Some(Purpose::Test))?);
    }
    Ok(Listing { cube: Some(Cube::BLENDER), ..found.into_listing(with_points)? })
}

/// The scene of `folder/transforms.json`.
pub(crate) fn list_nerfstudio(folder: &Path, with_points: bool) -> Result<Listing, SceneError> {
    read_photos(&folder.join("transforms.json"), None)?.into_listing(with_points)
}

fn with_end(path: &Path, end: &str) -> PathBuf {
    let mut whole = path.to_owned().into_os_string();
    whole.push(end);
    whole.into()
}

/// What one or two files list.
struct Found {
    /// The first file.
    list: PathBuf,
    photos: Vec<ListedPhoto>,
    /// Where photos should be that are listed and do not exist.
    missing: Vec<PathBuf>,
    points: Option<String>,
    notices: Vec<String>,
}

impl Found {
    fn add(&mut self, other: Self) {
        self.photos.extend(other.photos);
        self.missing.extend(other.missing);
        self.notices.extend(other.notices);
    }

    /// With the points that the file names.
    fn into_listing(mut self, with_points: bool) -> Result<Listing, SceneError> {
        if let (true, Some(wanted)) = (self.photos.is_empty(), self.missing.first()) {
            return Err(all_missing(wanted, self.missing.len(), &self.list, None));
        }
        let OfPoints { points, has_points, points_file } = self.points_of(with_points)?;
        Ok(Listing {
            photos: self.photos,
            points,
            has_points,
            points_digest: None,
            points_file,
            cube: None,
            notices: self.notices,
        })
    }

    /// The points that the file names, or those of a file that lies where others put it.
    fn points_of(&mut self, with_points: bool) -> Result<OfPoints, SceneError> {
        let folder = self.list.parent().unwrap_or(Path::new(""));
        let mut points_file = match &self.points {
            Some(name) => folder.join(path_inside(name).ok_or_else(|| points_outside(&self.list, name))?),
            None => self.list.clone(),
        };
        let mut points = Vec::new();
        // A file that nobody reads yet is taken for one with points.
        let mut has_points = self.points.is_some() && points_file.exists();
        if with_points && has_points {
            points = ply::read_points(&points_file)?;
            has_points = !points.is_empty();
        } else if with_points && self.points.is_some() {
            self.notices.push(format!("the point cloud {} does not exist", shown(&points_file)));
        }
        if !has_points {
            let nested = nested::points(folder, &self.photos).unwrap_or_default();
            has_points = !nested.is_empty();
            points = if with_points { nested } else { Vec::new() };
        }
        let beside = BESIDE.map(|name| folder.join(name)).into_iter().find(|file| file.is_file());
        if let Some(file) = beside.filter(|_| !has_points) {
            has_points = true;
            if with_points {
                points = ply::read_points(&file)?;
                has_points = !points.is_empty();
                self.notices.push(format!(
                    "training starts from the points of {}, which the scene does not name",
                    shown(&file)
                ));
                points_file = file;
            }
        }
        Ok(OfPoints { points, has_points, points_file })
    }
}

/// What training starts from.
struct OfPoints {
    /// None where none are wanted.
    points: Vec<Point>,
    has_points: bool,
    /// The file that they are from, or that names none.
    points_file: PathBuf,
}

/// A photo may be missing, or be in no list, by mistake.
fn notices(photos: &[ListedPhoto], missing: &[PathBuf], similar: Similar, list: &Path) -> Vec<String> {
    let all = photos.len() + missing.len();
    let unused = photos.iter().filter(|photo| photo.purpose == Purpose::Unused).count();
    let unused = (unused > 0).then(|| {
        format!(
            "{unused} of the {all} photos that {} lists are neither trained nor tested on, as its train_filenames, \
             val_filenames and test_filenames have it",
            shown(list)
        )
    });
    [similar_notice(similar, list), absent_notice(missing, all, list), unused].into_iter().flatten().collect()
}

fn points_outside(list: &Path, name: &str) -> SceneError {
    let problem =
        "which is not a path inside the scene's folder; correct it, or remove it to start from random points";
    SceneError::invalid(list, format!("has the ply_file_path {name:?}, {problem}"))
}

/// What the file `list` lists. Each photo has this `purpose`; without one, what the file's own lists say.
fn read_photos(list: &Path, purpose: Option<Purpose>) -> Result<Found, SceneError> {
    let mut file = schema::read(list)?;
    if file.frames.is_empty() {
        return Err(no_photos(list));
    }
    let folder = list.parent().unwrap_or(Path::new(""));
    file.names_mut().for_each(|name| settle(name, folder));
    let splits = if purpose.is_some() { None } else { Some(Splits::of(&file, list)?) };
    let shared: Arc<Path> = list.into();
    let (mut photos, mut missing, mut similar) = (Vec::new(), Vec::new(), Similar::default());
    for entry in &file.frames {
        let relative = inside(&entry.file_path, list)?;
        let Some((name, path)) = find_photo(folder, &relative, &entry.file_path, &mut similar) else {
            missing.push(folder.join(relative));
            continue;
        };
        let intrinsics = entry.intrinsics.or(&file.intrinsics);
        let (camera, lens) = camera::camera(list, entry, &intrinsics, &path)?;
        let listed = splits.as_ref().map(|splits| splits.purpose(&entry.file_path, list)).transpose()?;
        let purpose = purpose.or(listed).unwrap_or_default();
        let mask = entry.mask_path.as_deref().map(|name| find_mask(folder, name, list)).transpose()?;
        photos.push(ListedPhoto {
            name,
            path,
            list: shared.clone(),
            camera,
            lens,
            purpose,
            mask,
            seen: Vec::new(),
        });
    }
    let notices = notices(&photos, &missing, similar, list);
    Ok(Found { list: list.to_owned(), photos, missing, points: file.ply_file_path.clone(), notices })
}

/// The cameras that the `text` of `list` describes, all of whose rules they have met; photos are looked at
/// only where it does not say their size.
pub(crate) fn parse_cameras(list: &Path, text: &[u8]) -> Result<Vec<Camera>, SceneError> {
    let file = schema::parse(list, text)?;
    let splits = Splits::of(&file, list)?;
    let entries = file.frames.iter().map(|entry| {
        let photo = inside(&entry.file_path, list)?;
        splits.purpose(&entry.file_path, list)?;
        Ok(camera::camera(list, entry, &entry.intrinsics.or(&file.intrinsics), &photo)?.0)
    });
    entries.collect()
}

/// The name of a photo that has come from another machine, as it is here: an absolute path, or one out of the
/// folder, becomes that of the photo of this name in `images`, if it is there.
fn settle(name: &mut String, folder: &Path) {
    separate(name, folder);
    let is_of_windows = name.as_bytes().get(1) == Some(&b':');
    let here = format!("images/{}", base_name(name));
    if (is_of_windows || path_inside(name).is_none()) && folder.join(&here).is_file() {
        *name = here;
    }
}

/// The mask that a photo's entry names.
fn find_mask(folder: &Path, name: &str, list: &Path) -> Result<PathBuf, SceneError> {
    let path = path_inside(name).map(|relative| folder.join(relative)).filter(|path| path.is_file());
    path.ok_or_else(|| {
        let problem = "which is no file in the scene's folder; put it there, or remove the mask_path";
        SceneError::invalid(list, format!("names the mask {name:?}, {problem}"))
    })
}

/// The photo as it is named, or with the extension that Blender's script leaves out; or almost so.
fn find_photo(
    folder: &Path,
    relative: &Path,
    name: &str,
    similar: &mut Similar,
) -> Option<(String, PathBuf)> {
    let whole = folder.join(relative);
    let candidates = ENDS.map(|end| (format!("{name}{end}"), with_end(&whole, end)));
    let exact = candidates.into_iter().find(|(_, path)| path.is_file());
    exact.or_else(|| similar.find(&whole).map(|path| (name.to_owned(), path)))
}
