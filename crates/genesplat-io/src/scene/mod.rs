//! Scenes: what a reader lists is split ([`split`]), and its photos are loaded in parallel ([`view`]).

mod bare;
pub mod blocks;
mod depth_fit;
mod depths;
mod digests;
mod doubt;
mod frame;
mod listed;
mod masks;
mod odd_lenses;
mod place;
pub(crate) mod precision;
mod random_points;
mod replaced;
mod sources;
mod split;
mod stray;
mod view;

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use genesplat_core::View;
use rayon::prelude::*;

pub use depths::dense_name;
pub use digests::{PhotoDigests, SceneDigests};
pub use doubt::Doubt;
pub use listed::{SceneList, ScenePhoto, list_scene, model_of};
pub use masks::{MaskUse, Masks, mask_beside};
pub(crate) use random_points::Cube;
pub use replaced::replace_photos;
pub use split::HoldOut;
pub use view::SIDE_MIN_PX;

use crate::digest::Digest;
use crate::error::SceneError;
use crate::listing::{ListedPhoto, unusable_notice};
use crate::offset::Offset;
use crate::photos::PhotoSize;
use crate::{input, plural, shown};
use depth_fit::Fit;
use depths::{Judge, Outcome};
use frame::Pinholes;
use sources::list;
use view::{Loaded, Opened, PhotoStorage};

/// A point of a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// World units.
    pub position: [f32; 3],
    /// 8-bit colour.
    pub rgb: [u8; 3],
}

/// A point that a photo sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Its place in [`Scene::points`].
    pub point: u32,
    /// Where the photo shows it: `x / z` and `y / z` along the axes of its camera, whatever its lens; `None`
    /// where that is not known.
    pub ray: Option<[f32; 2]>,
}

/// Photos with cameras, split for training and testing, and the points to start from.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the folder.
    pub name: String,
    /// Views to train on, sorted by the names of their photos.
    pub train: Vec<View>,
    /// Views that training must never see, sorted likewise.
    pub test: Vec<View>,
    /// Points in the order of their file.
    pub points: Vec<Point>,
    /// The points that each photo sees, by its name, in their order. Empty where that is not known (COLMAP's
    /// tracks say it) or not asked for.
    pub seen: BTreeMap<String, Vec<Sight>>,
    /// The photo that a view is a part of, by the view's name: photos that show more than a pinhole can are
    /// cut into several views. Other views have the names of their photos.
    pub whole: BTreeMap<String, String>,
    /// Files of the photos, which must not be written over; empty for a scene that is not from a disk.
    pub photos: Vec<PathBuf>,
    /// What tells whether the scene is still what it was.
    pub digests: SceneDigests,
    /// What the user should know: one sentence each.
    pub notices: Vec<String>,
    /// Why to train on it makes no sense.
    pub doubts: Vec<Doubt>,
}

/// How a scene is loaded.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadOptions {
    /// Size of the photos.
    pub size: PhotoSize,
    /// Both sides of that size are divided by this and rounded as [`PhotoSize::Downscale`] does, in one
    /// reduction with it: a splat can be compared at a fraction of the size that it was trained at. 1 leaves
    /// the size alone.
    pub divisor: u32,
    /// Which photos are held out.
    pub hold_out: HoldOut,
    /// Colour behind transparent photos.
    pub background: [u8; 3],
    /// What masks and transparency mean.
    pub mask: MaskUse,
    /// Near plane of all cameras, world units; `None` for the usual one, or a nearer one in a scene that is
    /// small.
    pub near: Option<f64>,
    /// Folder of a COLMAP scene's photos, absolute or relative to the scene: some data sets ship `images_2`,
    /// `images_4`, ...
    pub image_folder: PathBuf,
    /// Whether points are loaded, or drawn where there are none: to look at a finished cloud takes none.
    pub with_points: bool,
    /// Only so many photos, at even distances: held-out ones, or training photos where none are held out.
    /// `None`: all of them.
    pub sample: Option<NonZeroUsize>,
    /// What shall have been subtracted from all coordinates, world units; `None`: nothing, or, where the
    /// scene is far from its origin, what brings it there.
    pub offset: Option<Offset>,
    /// Whether [`Scene::seen`] is loaded, too, with the points.
    pub with_tracks: bool,
    /// Whether [`View::depth`] is loaded, where photos have depth maps.
    pub with_depth: bool,
    /// Seed of the random points that a scene without points starts from.
    pub seed: u64,
    /// When and where photos are kept in a file; `None`: in memory, however many they are.
    pub spill: Option<Spill>,
}

/// Photos are kept in a file, and read from it whenever they are looked at, if there are more than memory
/// should hold.
#[derive(Clone, Debug, PartialEq)]
pub struct Spill {
    /// Folder of the file, which has no name and is gone after the last photo.
    pub folder: PathBuf,
    /// Bytes of pixels that stay in memory.
    pub memory_bytes: u64,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            size: PhotoSize::default(),
            divisor: 1,
            hold_out: HoldOut::default(),
            background: [0; 3],
            mask: MaskUse::default(),
            near: None,
            image_folder: "images".into(),
            with_points: true,
            sample: None,
            offset: None,
            with_tracks: false,
            with_depth: false,
            seed: 0,
            spill: None,
        }
    }
}

impl LoadOptions {
    /// The folder of photos, where it is not the usual one.
    fn asked_images(&self) -> Option<&Path> {
        (self.image_folder != Self::default().image_folder).then_some(&*self.image_folder)
    }

    /// The loaded size of a photo of `width` x `height` px.
    fn size_of(&self, width: u32, height: u32) -> (u32, u32) {
        let (width, height) = self.size.of(width, height);
        PhotoSize::Downscale(self.divisor).of(width, height)
    }
}

/// Is told how far loading is; called from many threads.
pub trait LoadProgress: Sync {
    /// Decoding of `photos` photos begins.
    fn start(&self, photos: usize);
    /// One more is ready.
    fn photo_done(&self);
}

impl LoadProgress for () {
    fn start(&self, _photos: usize) {}
    fn photo_done(&self) {}
}

/// Loads the scene in the folder `path`: a COLMAP model with its photos, a Blender pair of
/// `transforms_*.json`, or the `transforms.json` of nerfstudio and instant-ngp; the first of these that is
/// there.
///
/// Photos are decoded in parallel on rayon's current pool. The result does not depend on the number of
/// threads.
pub fn load_scene(
    path: &Path,
    options: &LoadOptions,
    progress: &dyn LoadProgress,
) -> Result<Scene, SceneError> {
    let listing = list(path, options)?;
    let files = |photo: &ListedPhoto| {
        let depth = photo.depth.as_ref().map(|depth| depth.path.clone());
        std::iter::once(photo.path.clone()).chain(photo.mask.clone()).chain(depth)
    };
    let photos = listing.photos.iter().flat_map(files).collect();
    let (mut train, mut test) = split::split(listing.photos, &options.hold_out, path)?;
    if train.is_empty() {
        let problem = format!(
            "has not enough photos: {0}, of which {0} would be held out for testing and none is left to train on; \
             add photos",
            test.len()
        );
        return Err(SceneError::invalid(path, problem));
    }
    if let Some(most) = options.sample {
        (train, test) = split::sample(train, test, most);
    }
    let seen = seen([&mut train, &mut test]);
    progress.start(train.len() + test.len());
    let mut notices = listing.notices;
    let own_points = if listing.has_points { &listing.points[..] } else { &[] };
    let judge = Judge { points: own_points, seen: &seen };
    let (loaded, digests) = load_photos([&train, &test], options, &judge, progress, &mut notices)?;
    let whole = whole(&loaded);
    let [train, test] =
        loaded.map(|photos| photos.into_iter().flat_map(|photo| photo.views).collect::<Vec<_>>());
    if train.is_empty() && options.sample.is_none() {
        return Err(SceneError::invalid(
            path,
            "has masks that hide all of its training photos; masks are black where a \
            photo does not count",
        ));
    }
    let digests = SceneDigests::of(digests, listing.points_digest).moved(listing.moved.offset);
    let (name, points, doubts) = (scene_name(path), listing.points, listing.doubts);
    Ok(Scene { name, train, test, points, seen, whole, photos, digests, notices, doubts })
}

impl Scene {
    /// Whether the scene has no points of its own, and those that it starts from are random.
    pub fn starts_from_random(&self) -> bool {
        self.digests.points == Some(digests::of_points(&[]))
    }

    /// As if no photo had a depth map.
    pub fn forget_depth(&mut self) {
        self.train.iter_mut().chain(&mut self.test).for_each(|view| view.depth = None);
        self.digests.photos.iter_mut().for_each(|photo| photo.depth = None);
    }

    /// The name of the photo that the view of this name shows, or a part of.
    pub fn photo_of<'a>(&'a self, view: &'a str) -> &'a str {
        self.whole.get(view).map_or(view, |photo| photo)
    }
}

/// The photos that views are parts of, by the names of both.
fn whole(photos: &OfParts<Loaded>) -> BTreeMap<String, String> {
    let parts = |photo: &Loaded| {
        let parts = photo.views.iter().filter(|view| view.name != photo.name);
        parts.map(|view| (view.name.clone(), photo.name.clone())).collect::<Vec<_>>()
    };
    photos.iter().flatten().flat_map(parts).collect()
}

/// The points that each of these photos sees, taken out of them.
fn seen(photos: [&mut [ListedPhoto]; 2]) -> BTreeMap<String, Vec<Sight>> {
    let of_photo = |photo: &mut ListedPhoto| (photo.name.clone(), std::mem::take(&mut photo.seen));
    let all = photos.into_iter().flatten().map(of_photo);
    all.filter(|(_, points)| !points.is_empty()).collect()
}

/// Something of each training photo, and of each test photo.
type OfParts<T> = [Vec<T>; 2];

/// Training and test photos with their views; what is hidden entirely is left out. And the digests of all of
/// them.
fn load_photos(
    photos: [&[ListedPhoto]; 2],
    options: &LoadOptions,
    judge: &Judge,
    progress: &dyn LoadProgress,
    notices: &mut Vec<String>,
) -> Result<(OfParts<Loaded>, OfParts<PhotoDigests>), SceneError> {
    let (pinholes, storage) =
        (Pinholes::default(), PhotoStorage::new(photos.iter().copied().flatten(), options)?);
    let load = |photos: &[ListedPhoto]| -> Result<Vec<Opened>, SceneError> {
        photos
            .par_iter()
            .map(|photo| view::load(photo, options, &pinholes, &storage, judge, progress))
            .collect()
    };
    let (mut loaded, digests) = usable([load(photos[0])?, load(photos[1])?], notices)?;
    notices.extend(cut_notice(&loaded));
    let all = || loaded.iter().flatten();
    let count = |holds: fn(&Loaded) -> bool| all().filter(|loaded| holds(loaded)).count();
    let found = masks::Found {
        photos: all().count(),
        masked: count(|loaded| loaded.is_masked),
        transparent: count(|loaded| loaded.is_transparent),
    };
    notices.extend(options.mask.notices(found));
    notices.extend(settle_depths(&mut loaded));
    loaded.iter_mut().flatten().for_each(|photo| photo.views.retain(|view| view.counted_pixels() > 0));
    let all = || loaded.iter().flatten();
    if let Some(hidden) = all().find(|photo| photo.views.is_empty()) {
        let count = all().filter(|photo| photo.views.is_empty()).count();
        let photos = plural(count, "photo is", "photos are");
        notices.push(format!("{count} {photos} hidden entirely and left out, first {}", shown(&hidden.name)));
    }
    Ok((loaded, digests))
}

/// Leaves out the depth maps whose unit nobody knows where most of the others had another; what to say of all.
fn settle_depths(photos: &mut OfParts<Loaded>) -> Vec<String> {
    let drops_unknown = depths::are_strange(photos.iter().flatten().map(|photo| &photo.depth));
    let is_unknown = |photo: &&mut Loaded| matches!(photo.depth, Outcome::Used(Fit::Unknown));
    for photo in photos.iter_mut().flatten().filter(|photo| drops_unknown && is_unknown(photo)) {
        photo.views.iter_mut().for_each(|view| view.depth = None);
    }
    let outcomes: Vec<&Outcome> = photos.iter().flatten().map(|photo| &photo.depth).collect();
    depths::notices(&outcomes, drops_unknown)
}

/// How many photos show more than a pinhole can, if any do.
fn cut_notice(photos: &OfParts<Loaded>) -> Option<String> {
    let is_cut = |photo: &&Loaded| photo.views.first().is_some_and(|view| view.name != photo.name);
    let cut: Vec<&Loaded> = photos.iter().flatten().filter(is_cut).collect();
    let views: usize = cut.iter().map(|photo| photo.views.len()).sum();
    let photos = plural(cut.len(), "photo shows", "photos show");
    (views > 0)
        .then(|| format!("{} {photos} more than a pinhole can, and are cut into {views} views", cut.len()))
}

/// The photos that can be used, and the digests of all. An error where none is left to train on, or half of
/// all are too small, or not the photos of their cameras.
fn usable(
    opened: OfParts<Opened>,
    notices: &mut Vec<String>,
) -> Result<(OfParts<Loaded>, OfParts<PhotoDigests>), SceneError> {
    let all = opened.iter().map(Vec::len).sum();
    let digests = opened.each_ref().map(|part| part.iter().map(|photo| photo.digests.clone()).collect());
    let mut unusable = Vec::new();
    let loaded = opened.map(|part| -> Vec<Loaded> {
        part.into_iter().filter_map(|photo| photo.loaded.map_err(|error| unusable.push(error)).ok()).collect()
    });
    let is_other = |error: &SceneError| matches!(error, SceneError::BadPhoto { .. });
    let are_others = 2 * unusable.iter().filter(|error| is_other(error)).count() >= all;
    let counts = |error: &SceneError| loaded[0].is_empty() || (are_others && is_other(error));
    if let Some(why) = unusable.iter().position(counts) {
        return Err(unusable.swap_remove(why));
    }
    notices.extend(unusable_notice(&unusable, all));
    Ok((loaded, digests))
}

/// The digests of [`load_scene`] alone: files are read, and not decoded.
pub fn scene_digests(path: &Path, options: &LoadOptions) -> Result<SceneDigests, SceneError> {
    let listing = list(path, options)?;
    let (train, test) = split::split(listing.photos, &options.hold_out, path)?;
    let of = |photos: &[ListedPhoto]| photos.par_iter().map(digests_of).collect::<Result<Vec<_>, _>>();
    Ok(SceneDigests::of([of(&train)?, of(&test)?], listing.points_digest).moved(listing.moved.offset))
}

fn digests_of(listed: &ListedPhoto) -> Result<PhotoDigests, SceneError> {
    let digest = |file: &Path| {
        let bytes = input::read(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })?;
        Ok::<_, SceneError>(Digest::of(&bytes))
    };
    let mask = listed.mask.as_deref().map(digest).transpose()?;
    // A depth map that is not there, or damaged, is left out.
    let depth = listed.depth.as_ref().and_then(|depth| digest(&depth.path).ok());
    Ok(PhotoDigests::of(listed, digest(&listed.path)?, mask, depth))
}

/// The points of [`load_scene`] without the photos: for a scene that comes with none, they depend on the
/// seed.
pub fn load_points(path: &Path, options: &LoadOptions) -> Result<Vec<Point>, SceneError> {
    Ok(list(path, options)?.points)
}

fn scene_name(path: &Path) -> String {
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    whole.file_name().map_or_else(|| "scene".into(), |name| name.to_string_lossy().into_owned())
}
