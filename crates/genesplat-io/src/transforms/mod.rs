//! Scenes described by `transforms.json`: nerfstudio's and instant-ngp's, and Blender's pair of files.
//!
//! Poses are `world_from_camera` in OpenGL's camera axes (y up, z backwards). They are used as they are: no
//! re-centring, no scaling.

mod camera;
mod nested;
mod number;
mod reading;
mod schema;
mod splits;

use std::path::{Path, PathBuf};

use genesplat_core::Camera;

pub(crate) use self::camera::KNOWN_MODELS;
use self::reading::Reading;
use self::splits::Splits;
use crate::colmap::Finite;
use crate::error::SceneError;
use crate::listing::{
    ListedPhoto, Listing, Purpose, Wanted, all_missing, base_name, inside, left_out, no_photos, path_inside,
    separate,
};
use crate::offset::Offset;
use crate::scene::precision::move_cameras;
use crate::scene::{Cube, Point};
use crate::{ply, shown, similar};

/// Point clouds that may lie beside the list: nerfstudio's, those of converters, the reference trainer's.
const BESIDE: [&str; 4] = ["sparse_pc.ply", "pointcloud.ply", "points3D.ply", "points3d.ply"];

/// What the file name of a photo may end in beyond what a frame says.
const ENDS: [&str; 3] = ["", ".png", ".jpg"];

/// The scene of `folder/transforms_train.json` and, if it exists, `transforms_test.json`: Blender's.
pub(crate) fn list_blender(folder: &Path, wanted: Wanted<'_>) -> Result<Listing, SceneError> {
    let list = folder.join("transforms_train.json");
    let test = folder.join("transforms_test.json");
    let mut found = read_photos(&list, Some(Purpose::Unsaid), wanted)?;
    if test.is_file() {
        // It may be empty: some programs ask for the file.
        found.add(read_photos(&test, Some(Purpose::Test), wanted)?);
    }
    let listing = found.into_listing(wanted)?;
    let cube = (listing.moved.by == [0.0; 3]).then_some(Cube::BLENDER);
    Ok(Listing { cube, ..listing })
}

/// The scene of `folder/transforms.json`.
pub(crate) fn list_nerfstudio(folder: &Path, wanted: Wanted<'_>) -> Result<Listing, SceneError> {
    let list = folder.join("transforms.json");
    let mut listing = read_photos(&list, None, wanted)?.into_listing(wanted)?;
    let others = listing.photos.iter().flat_map(|photo| {
        photo.mask.as_deref().into_iter().chain(photo.depth.as_ref().map(|depth| &*depth.path))
    });
    if let Some(left_out) = left_out(listing.photos.iter().map(|photo| &*photo.path), &others.collect()) {
        listing.notices.extend(left_out.notice(&list));
        listing.doubts.extend(left_out.doubt(&list));
    }
    Ok(listing)
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
    fn into_listing(mut self, wanted: Wanted<'_>) -> Result<Listing, SceneError> {
        if let (true, Some(wanted)) = (self.photos.is_empty(), self.missing.first()) {
            return Err(all_missing(wanted, self.missing.len(), &self.list, None));
        }
        let moved = move_cameras(&mut self.photos, wanted.frame);
        let OfPoints { points, has_points } = self.points_of(wanted.points, moved.by)?;
        Ok(Listing {
            photos: self.photos,
            points,
            has_points,
            points_digest: None,
            cube: None,
            notices: self.notices,
            doubts: Vec::new(),
            moved,
        })
    }

    /// The points that the file names, or those of a file that lies where others put it, less `offset`.
    fn points_of(&mut self, with_points: bool, offset: Offset) -> Result<OfPoints, SceneError> {
        let folder = self.list.parent().unwrap_or(Path::new("")).to_owned();
        let points_file = match &self.points {
            Some(name) => {
                let inside = path_inside(name).ok_or_else(|| points_outside(&self.list, name))?;
                similar::file(&folder.join(inside))
            }
            None => self.list.clone(),
        };
        let mut points = Vec::new();
        // A file that nobody reads yet is taken for one with points.
        let mut has_points = self.points.is_some() && points_file.exists();
        if with_points && has_points {
            points = self.read_points(&points_file, offset)?;
            has_points = !points.is_empty();
        } else if with_points && self.points.is_some() {
            self.notices.push(format!("the point cloud {} does not exist", shown(&points_file)));
        }
        if !has_points {
            let nested = nested::points(&folder, &self.photos).unwrap_or_default();
            has_points = !nested.is_empty();
            points = if with_points { nested } else { Vec::new() };
        }
        let beside = BESIDE.map(|name| folder.join(name)).into_iter().find(|file| file.is_file());
        if let Some(file) = beside.filter(|_| !has_points) {
            has_points = true;
            if with_points {
                points = self.read_points(&file, offset)?;
                has_points = !points.is_empty();
                self.notices.push(format!(
                    "training starts from the points of {}, which the scene does not name",
                    shown(&file)
                ));
            }
        }
        Ok(OfPoints { points, has_points })
    }

    fn read_points(&mut self, file: &Path, offset: Offset) -> Result<Vec<Point>, SceneError> {
        let Finite { records, notice } = ply::read_points(file, offset)?;
        self.notices.extend(notice);
        Ok(records)
    }
}

/// What training starts from.
struct OfPoints {
    /// None where none are wanted.
    points: Vec<Point>,
    has_points: bool,
}

fn points_outside(list: &Path, name: &str) -> SceneError {
    let problem =
        "which is not a path inside the scene's folder; correct it, or remove it to start from random points";
    SceneError::invalid(list, format!("has the ply_file_path {name:?}, {problem}"))
}

/// World units of what depth maps hold where a file does not say (nerfstudio): they are millimetres, in
/// metres.
const DEPTH_UNIT: f64 = 1e-3;

/// What the file `list` lists. Each photo has this `purpose`; without one, what the file's own lists say.
fn read_photos(list: &Path, purpose: Option<Purpose>, wanted: Wanted<'_>) -> Result<Found, SceneError> {
    let mut file = schema::read(list)?;
    if file.frames.is_empty() && purpose != Some(Purpose::Test) {
        return Err(no_photos(list));
    }
    let is_turned = camera::turn_columns(&mut file.frames);
    let folder = list.parent().unwrap_or(Path::new(""));
    file.names_mut().for_each(|(usual, name)| settle(name, folder, usual));
    let has_splits = purpose.is_none() && wanted.splits;
    let splits = has_splits.then(|| Splits::of(&file, list)).transpose()?;
    let scale = camera::common_scale(file.frames.iter());
    let depth_unit = file.depth_unit_scale_factor.unwrap_or(DEPTH_UNIT);
    let mut reading = Reading::of(list, folder, wanted, scale, depth_unit);
    for entry in &file.frames {
        let listed = splits.as_ref().map(|splits| splits.purpose(&entry.file_path, list)).transpose()?;
        let purpose = purpose.or(listed).unwrap_or_default();
        reading.add(entry, &entry.intrinsics.or(&file.intrinsics), purpose)?;
    }
    let mut found = reading.finish(file.ply_file_path.filter(|name| !name.is_empty()))?;
    if is_turned {
        let list = shown(list);
        found.notices.push(format!("all poses of {list} are written column by column, and are read so"));
    }
    Ok(found)
}

/// The cameras that the `text` of `list` describes, all of whose rules they have met; photos are looked at
/// only where it does not say their size.
pub(crate) fn parse_cameras(list: &Path, text: &[u8]) -> Result<Vec<Camera>, SceneError> {
    let file = schema::parse(list, text)?;
    let (splits, scale) = (Splits::of(&file, list)?, camera::common_scale(file.frames.iter()));
    let entries = file.frames.iter().map(|entry| {
        let photo = inside(&entry.file_path, list)?;
        splits.purpose(&entry.file_path, list)?;
        Ok(camera::camera(list, entry, &entry.intrinsics.or(&file.intrinsics), &photo, scale)?.0)
    });
    entries.collect()
}

/// The name of a file that has come from another machine, as it is here: an absolute path, or one out of the
/// folder, becomes that of the file of this name in `usual`, if it is there.
fn settle(name: &mut String, folder: &Path, usual: &str) {
    separate(name, folder);
    let is_of_windows = name.as_bytes().get(1) == Some(&b':');
    let here = format!("{usual}/{}", base_name(name));
    let here = here.trim_start_matches('/');
    if (is_of_windows || path_inside(name).is_none()) && folder.join(here).is_file() {
        *name = here.to_owned();
    }
}
