//! Scenes: which form a folder has, which photos are held out, and the photos themselves.
//!
//! Each reader ([`crate::colmap`], `transforms`) turns its files into a [`Listing`]: photos by path, with cameras, and
//! points. What follows is the same for all: split, then decode, check, straighten and resize in parallel.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::{Camera, Photo, View};
use rayon::prelude::*;

use crate::error::SceneError;
use crate::listing::{Frame, Listing, Purpose};
pub use crate::photos::PhotoSize;
use crate::{colmap, lens, photos, transforms};

/// A point of a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// World units.
    pub position: [f32; 3],
    /// 8-bit colour.
    pub rgb: [u8; 3],
}

/// Photos with cameras, split for training and testing, and the points to start from.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the folder.
    pub name: String,
    /// Views to train on, sorted by name.
    pub train: Vec<View>,
    /// Views that training must never see, sorted by name.
    pub test: Vec<View>,
    /// Points in the order of their file.
    pub points: Vec<Point>,
    /// Files of the photos, which nobody may write over; none for a scene that never was on a disk.
    pub photos: Vec<PathBuf>,
    /// What the user should know: one sentence each.
    pub notices: Vec<String>,
}

/// Which photos are held out for testing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum HoldOut {
    /// Sorted by name, every eighth, from the first on: the field's convention. A scene that names its own test
    /// photos (Blender, nerfstudio file lists) keeps those instead.
    #[default]
    EveryEighth,
    /// None: everything is trained on, but for what a scene's lists leave out.
    None,
}

impl HoldOut {
    /// Training and test views of a scene that names no test photos, each sorted by name.
    pub fn split(self, views: Vec<View>) -> (Vec<View>, Vec<View>) {
        every_eighth(views, |view| &view.name, self)
    }
}

/// How a scene is loaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadOptions {
    /// Size of the photos.
    pub size: PhotoSize,
    /// Both sides of that size are divided by this and rounded as [`PhotoSize::Downscale`] does, in one reduction with it:
    /// how a splat looks at a fraction of the size that it was trained at. 1 leaves the size alone.
    pub divisor: u32,
    /// Which photos are held out.
    pub hold_out: HoldOut,
    /// Colour behind transparent photos.
    pub background: [u8; 3],
    /// Folder of a COLMAP scene's photos, relative to the scene: some data sets ship `images_2`, `images_4`, ...
    pub image_folder: PathBuf,
    /// Whether points are loaded, or drawn where there are none: to look at a finished cloud takes none.
    pub with_points: bool,
    /// Seed of the random points that a scene without points starts from.
    pub seed: u64,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            size: PhotoSize::default(),
            divisor: 1,
            hold_out: HoldOut::default(),
            background: [0; 3],
            image_folder: "images".into(),
            with_points: true,
            seed: 0,
        }
    }
}

impl LoadOptions {
    /// The loaded size of a photo of `width` x `height` px.
    fn size_of(&self, width: u32, height: u32) -> (u32, u32) {
        let (width, height) = self.size.of(width, height);
        PhotoSize::Downscale(self.divisor).of(width, height)
    }
}

/// Hears how far loading is; called from many threads.
pub trait LoadProgress: Sync {
    /// Decoding of `photos` photos begins.
    fn start(&self, photos: usize);
    /// One more is ready.
    fn photo_done(&self);
}

/// Nobody listens.
impl LoadProgress for () {
    fn start(&self, _photos: usize) {}
    fn photo_done(&self) {}
}

/// Least side of a loaded photo, px: SSIM's window alone has 11.
pub const LEAST_SIDE_PX: u32 = 16;

/// Fewest points that training starts from: initial scales are distances to the three nearest others.
const LEAST_POINTS: usize = 4;

/// Loads the scene in the folder `path`: a COLMAP model with its photos, a Blender pair of `transforms_*.json`, or the
/// `transforms.json` of nerfstudio and instant-ngp; the first of these that is there.
///
/// Photos are decoded in parallel on rayon's current pool. The result does not depend on the number of threads.
pub fn load_scene(
    path: &Path,
    options: &LoadOptions,
    progress: &dyn LoadProgress,
) -> Result<Scene, SceneError> {
    let listing = list(path, options)?;
    let photos = listing.frames.iter().map(|frame| frame.photo.clone()).collect();
    let (train, test) = split(listing.frames, options.hold_out);
    if train.is_empty() {
        let (photos, held_out) = (test.len(), test.len());
        return Err(SceneError::NotEnoughPhotos { path: path.to_owned(), photos, held_out });
    }
    progress.start(train.len() + test.len());
    let load = |frames: &[Frame]| -> Result<Vec<View>, SceneError> {
        frames.par_iter().map(|frame| load_view(frame, options, progress)).collect()
    };
    Ok(Scene {
        name: scene_name(path),
        train: load(&train)?,
        test: load(&test)?,
        points: listing.points,
        photos,
        notices: listing.notices,
    })
}

/// The points of [`load_scene`] without the photos: for a scene that comes with none, they depend on the seed.
pub fn load_points(path: &Path, options: &LoadOptions) -> Result<Vec<Point>, SceneError> {
    Ok(list(path, options)?.points)
}

fn list(path: &Path, options: &LoadOptions) -> Result<Listing, SceneError> {
    if !path.exists() {
        return Err(SceneError::Missing { path: path.to_owned() });
    }
    match list_known(path, options) {
        Err(error @ (SceneError::Unrecognised { .. } | SceneError::AllPhotosMissing { .. })) => {
            Err(whole_scene(path)
                .map_or(error, |scene| SceneError::PartOfScene { path: path.to_owned(), scene }))
        }
        known => enough_points(known?, options),
    }
}

/// Now, since training would find it out only after the photos are decoded and the folder for its results is cleared.
fn enough_points(listing: Listing, options: &LoadOptions) -> Result<Listing, SceneError> {
    let points = listing.points.len();
    if options.with_points && points < LEAST_POINTS {
        return Err(SceneError::TooFewPoints { file: listing.points_file, points, least: LEAST_POINTS });
    }
    Ok(listing)
}

fn list_known(path: &Path, options: &LoadOptions) -> Result<Listing, SceneError> {
    let seed = options.with_points.then_some(options.seed);
    if let Some(model) = colmap::find_model(path) {
        return colmap::list(&model, &path.join(&options.image_folder), options.with_points);
    }
    if path.join("transforms_train.json").is_file() {
        return transforms::list_blender(path, seed);
    }
    if path.join("transforms.json").is_file() {
        return transforms::list_nerfstudio(path, seed);
    }
    Err(SceneError::Unrecognised { path: path.to_owned() })
}

/// The scene that `path` is a part of, as `sparse/0`, `sparse` and `images` are.
fn whole_scene(path: &Path) -> Option<PathBuf> {
    let path = path.canonicalize().ok()?;
    let is_scene = |folder: &&Path| folder.join("sparse").is_dir() && folder.join("images").is_dir();
    path.ancestors().skip(1).take(2).find(is_scene).map(Path::to_owned)
}

/// Training and test frames, each sorted by name.
fn split(frames: Vec<Frame>, hold_out: HoldOut) -> (Vec<Frame>, Vec<Frame>) {
    let used: Vec<Frame> = frames.into_iter().filter(|frame| frame.purpose != Purpose::Unused).collect();
    if used.iter().all(|frame| frame.purpose == Purpose::Unsaid) {
        return every_eighth(used, |frame| &frame.name, hold_out);
    }
    // The scene itself says which photos are for testing.
    let (used, _) = every_eighth(used, |frame| &frame.name, HoldOut::None);
    used.into_iter().partition(|frame| hold_out == HoldOut::None || frame.purpose != Purpose::Test)
}

/// The reference's split: sorted by the file name up to its first dot (the whole name breaks ties), every eighth for
/// testing, from the first on.
fn every_eighth<T>(mut items: Vec<T>, name: impl Fn(&T) -> &str, hold_out: HoldOut) -> (Vec<T>, Vec<T>) {
    items.sort_by(|a, b| {
        let (a, b) = (name(a), name(b));
        stem(a).cmp(stem(b)).then_with(|| a.cmp(b))
    });
    let numbered = items.into_iter().enumerate();
    let (train, test): (Vec<_>, Vec<_>) =
        numbered.partition(|(index, _)| hold_out == HoldOut::None || index % 8 != 0);
    let items = |part: Vec<(usize, T)>| part.into_iter().map(|(_, item)| item).collect();
    (items(train), items(test))
}

fn stem(name: &str) -> &str {
    name.split('.').next().unwrap_or(name)
}

fn scene_name(path: &Path) -> String {
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    whole.file_name().map_or_else(|| "scene".into(), |name| name.to_string_lossy().into_owned())
}

fn load_view(frame: &Frame, options: &LoadOptions, progress: &dyn LoadProgress) -> Result<View, SceneError> {
    let photo = photos::read_photo_on(&frame.photo, options.background)?;
    let camera = camera_of_photo(frame, photo.width, photo.height)?;
    let (width, height) = options.size_of(photo.width, photo.height);
    if width.min(height) < LEAST_SIDE_PX {
        return Err(SceneError::PhotoTooSmall {
            photo: frame.photo.clone(),
            width,
            height,
            least: LEAST_SIDE_PX,
        });
    }
    let (photo, camera) = straighten(frame, photo, camera)?;
    let photo = Arc::new(photos::resize(&photo, width, height));
    progress.photo_done();
    Ok(View { name: frame.name.clone(), camera: camera.resized(width, height), photo })
}

/// The photo as a pinhole would have taken it, and that pinhole.
fn straighten(frame: &Frame, photo: Photo, camera: Camera) -> Result<(Photo, Camera), SceneError> {
    let Some(distortion) = &frame.distortion else { return Ok((photo, camera)) };
    lens::straighten(&photo, &camera, distortion).ok_or_else(|| SceneError::BadCamera {
        file: frame.list.to_path_buf(),
        camera: frame.name.clone(),
        problem: "has distortion coefficients that cannot be undone",
    })
}

/// The listed camera at the photo's own size.
///
/// Published scenes calibrate on larger photos than they ship (Tanks and Temples: twice), rounded to whole pixels; so
/// a camera of the same shape is scaled, and a camera of another shape is a mistake.
fn camera_of_photo(frame: &Frame, width: u32, height: u32) -> Result<Camera, SceneError> {
    let camera = &frame.camera;
    let scale = f64::from(width) / f64::from(camera.width);
    let expected_height = f64::from(camera.height) * scale;
    // Either side may have been rounded by a pixel before and after the reduction; 0.5 % covers large photos.
    let tolerance = (0.005 * f64::from(height)).max(2.0);
    if (expected_height - f64::from(height)).abs() > tolerance {
        return Err(SceneError::SizeMismatch {
            photo: frame.photo.clone(),
            photo_size: [width, height],
            list: frame.list.to_path_buf(),
            camera_size: [camera.width, camera.height],
        });
    }
    Ok(camera.resized(width, height))
}
