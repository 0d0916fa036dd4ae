//! Scenes described by `transforms.json`: nerfstudio's and instant-ngp's, and Blender's pair of files.
//!
//! Poses are `world_from_camera` in OpenGL's camera axes (y up, z backwards); two axes are turned and the whole is
//! inverted. Lenses that bend are undone when the photos are loaded ([`crate::lens`]). Scenes without points start
//! from random ones ([`crate::start_points`]). Poses are used as they are: no re-centring, no scaling.

mod lists;
mod schema;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;
use glam::{DMat3, DQuat, DVec3};

use self::lists::Lists;
use self::schema::{Entry, Lens};
use crate::error::SceneError;
use crate::lens::Distortion;
use crate::listing::{Frame, Listing, Purpose, inside, missing_photo, path_inside, view_names};
use crate::scene::Point;
use crate::start_points::{COUNT, Cube};
use crate::{photos, ply};

/// What the name of a photo may have in addition to what a frame says.
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
    Ok(Listing { frames: found.into_frames(&list)?, points, points_file, notices })
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
    Ok(Listing { frames: found.into_frames(&list)?, points, points_file, notices })
}

/// The points that the file names, or random ones with a notice; none where none are wanted.
fn points(
    found: &Photos,
    file: &Path,
    seed: Option<u64>,
    cube: impl FnOnce() -> Cube,
    notices: &mut Vec<String>,
) -> Result<Vec<Point>, SceneError> {
    let Some(seed) = seed else { return Ok(Vec::new()) };
    if found.points.is_some() {
        if !file.exists() {
            return Err(SceneError::PointsMissing { points: file.to_owned() });
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

/// A photo that exists.
struct Found {
    path: String,
    photo: PathBuf,
    list: Arc<Path>,
    camera: Camera,
    distortion: Option<Distortion>,
    purpose: Purpose,
}

/// A photo that does not.
struct Missing {
    photo: PathBuf,
    list: Arc<Path>,
}

/// What a file lists.
#[derive(Default)]
struct Photos {
    photos: Vec<Found>,
    missing: Vec<Missing>,
    /// How many photos have a mask.
    masks: usize,
    points: Option<String>,
}

impl Photos {
    fn append(&mut self, other: Self) {
        self.photos.extend(other.photos);
        self.missing.extend(other.missing);
        self.masks += other.masks;
    }

    /// Who has made masks should know that they do nothing here.
    fn masks_notice(&self) -> Option<String> {
        (self.masks > 0).then(|| {
            let all = self.photos.len() + self.missing.len();
            format!(
                "masks are not used, though {} of the {all} photos have one (mask_path): what they cover counts like the rest",
                self.masks
            )
        })
    }

    /// That a photo is in no list may be a slip of the pen.
    fn unused_notice(&self, list: &Path) -> Option<String> {
        let unused = self.photos.iter().filter(|photo| photo.purpose == Purpose::Unused).count();
        (unused > 0).then(|| {
            let (list, all) = (list.display(), self.photos.len() + self.missing.len());
            format!(
                "{unused} of the {all} photos that {list} lists are neither trained nor tested on, as its train_filenames, \
                 val_filenames and test_filenames have it"
            )
        })
    }

    /// The file of the points that `list` names, or else `list` itself.
    fn points_file(&self, list: &Path) -> Result<PathBuf, SceneError> {
        let Some(name) = &self.points else { return Ok(list.to_owned()) };
        let outside = || SceneError::PointsOutside { file: list.to_owned(), name: name.clone() };
        Ok(list.parent().unwrap_or(Path::new("")).join(path_inside(name).ok_or_else(outside)?))
    }

    fn into_frames(self, list: &Path) -> Result<Vec<Frame>, SceneError> {
        let paths: Vec<&str> = self.photos.iter().map(|photo| photo.path.as_str()).collect();
        let names = view_names(&paths, list)?;
        let frame = |(name, found): (String, Found)| Frame {
            name,
            photo: found.photo,
            list: found.list,
            camera: found.camera,
            distortion: found.distortion,
            purpose: found.purpose,
        };
        Ok(names.into_iter().zip(self.photos).map(frame).collect())
    }
}

/// What `list` lists; all of it has one purpose, or that which the file's own lists say.
fn read_photos(list: &Path, purpose: Option<Purpose>) -> Result<Photos, SceneError> {
    let file = schema::read(list)?;
    if file.frames.is_empty() {
        return Err(SceneError::NoPhotos { file: list.to_owned() });
    }
    let lists = if purpose.is_some() { None } else { Some(Lists::of(&file, list)?) };
    let folder = list.parent().unwrap_or(Path::new(""));
    let shared: Arc<Path> = list.into();
    let masks = file.frames.iter().filter(|entry| entry.mask_path.is_some()).count();
    let mut found = Photos { points: file.ply_file_path.clone(), masks, ..Photos::default() };
    for entry in &file.frames {
        let relative = inside(&entry.file_path, list)?;
        let Some((path, photo)) = find_photo(folder, relative, &entry.file_path) else {
            found.missing.push(Missing { photo: folder.join(relative), list: shared.clone() });
            continue;
        };
        let (camera, distortion) = camera(list, entry, &entry.lens.or(&file.lens), &photo)?;
        let listed = lists.as_ref().map(|lists| lists.purpose(&entry.file_path, list)).transpose()?;
        let purpose = purpose.or(listed).unwrap_or_default();
        found.photos.push(Found { path, photo, list: shared.clone(), camera, distortion, purpose });
    }
    Ok(found)
}

/// The photo as it is named, or with the extension that Blender's script leaves out.
fn find_photo(folder: &Path, relative: &Path, name: &str) -> Option<(String, PathBuf)> {
    let candidates = ENDS.map(|end| (format!("{name}{end}"), with_end(&folder.join(relative), end)));
    candidates.into_iter().find(|(_, path)| path.is_file())
}

fn camera(
    list: &Path,
    entry: &Entry,
    lens: &Lens,
    photo: &Path,
) -> Result<(Camera, Option<Distortion>), SceneError> {
    let (rotation, translation) = pose(list, entry)?;
    check_model(list, lens)?;
    let bad =
        |problem| SceneError::BadCamera { file: list.to_owned(), camera: entry.file_path.clone(), problem };
    let [width, height] = match (lens.w, lens.h) {
        (Some(w), Some(h)) => [w, h],
        _ => photos::photo_size(photo).map(|(w, h)| [w, h].map(f64::from))?,
    };
    if ![width, height].iter().all(|side| (1.0..=f64::from(1 << 20)).contains(side)) {
        return Err(bad("has an impossible image size"));
    }
    let from_angle = |angle: Option<f64>, side: f64| angle.map(|angle| 0.5 * side / (0.5 * angle).tan());
    let fx = lens.fl_x.or(from_angle(lens.camera_angle_x, width));
    let fx = fx.ok_or_else(|| bad("has neither fl_x nor camera_angle_x"))?;
    let fy = lens.fl_y.or(from_angle(lens.camera_angle_y, height)).unwrap_or(fx);
    if ![fx, fy].iter().all(|focal| focal.is_finite() && *focal > 0.0) {
        return Err(bad("has a focal length that is not a positive number"));
    }
    let camera = Camera {
        width: width as u32,
        height: height as u32,
        focal_px: [fx, fy],
        principal_px: [lens.cx.unwrap_or(0.5 * width), lens.cy.unwrap_or(0.5 * height)],
        camera_from_world_rotation: rotation,
        camera_from_world_translation: translation,
    };
    Ok((camera, distortion(lens)))
}

/// COLMAP's names of the models whose coefficients mean what [`crate::lens`] takes them for.
///
/// FULL_OPENCV is none of them: it divides by a second polynomial, whose first coefficient it calls k4.
pub(crate) const KNOWN_MODELS: [&str; 5] = ["PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL"];

fn check_model(list: &Path, lens: &Lens) -> Result<(), SceneError> {
    let model = match (&lens.camera_model, lens.is_fisheye) {
        (_, Some(true)) => "OPENCV_FISHEYE",
        (Some(model), _) => model,
        (None, _) => return Ok(()),
    };
    if KNOWN_MODELS.contains(&model) {
        return Ok(());
    }
    Err(SceneError::UnknownLens { file: list.to_owned(), model: model.to_owned() })
}

fn distortion(lens: &Lens) -> Option<Distortion> {
    let value = |coefficient: Option<f64>| coefficient.unwrap_or(0.0);
    let distortion = Distortion {
        radial: [value(lens.k1), value(lens.k2), value(lens.k3), value(lens.k4)],
        tangential: [value(lens.p1), value(lens.p2)],
    };
    (!distortion.is_none()).then_some(distortion)
}

/// `camera_from_world` of an entry.
fn pose(list: &Path, entry: &Entry) -> Result<(DQuat, DVec3), SceneError> {
    let bad = |problem| SceneError::BadPose { file: list.to_owned(), name: entry.file_path.clone(), problem };
    let [x, y, z, ..] = entry.transform_matrix.as_slice() else {
        return Err(bad("has fewer than three rows"));
    };
    let row = |row: &[f64; 4]| DVec3::new(row[0], row[1], row[2]);
    let world_from_gl = DMat3::from_cols(row(x), row(y), row(z)).transpose();
    let centre = DVec3::new(x[3], y[3], z[3]);
    if !(world_from_gl.is_finite() && centre.is_finite()) {
        return Err(bad("is not finite"));
    }
    // Writers print few digits, so a per cent is allowed; a mirror image or a scale is not.
    let deviation = world_from_gl * world_from_gl.transpose() - DMat3::IDENTITY;
    if deviation.to_cols_array().iter().any(|v| v.abs() > 0.01) || world_from_gl.determinant() < 0.0 {
        return Err(bad("is not a rotation"));
    }
    // OpenGL's camera looks along −z with y up; ours along z with y down.
    let world_from_camera =
        DMat3::from_cols(world_from_gl.x_axis, -world_from_gl.y_axis, -world_from_gl.z_axis);
    let rotation = DQuat::from_mat3(&world_from_camera.transpose()).normalize();
    Ok((rotation, -(rotation * centre)))
}
