//! Depth maps of the photos of a scene: found, taken to the photo's view, and to the scene's unit.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use genesplat_core::depth_map::is_known;
use genesplat_core::{DepthMap, View};
use glam::DVec3;

use super::depth_fit::{Fit, fit};
use super::frame::{Frame, is_same_shape};
use super::view::PhotoStorage;
use super::{Point, Sight};
use crate::digest::Digest;
use crate::error::SceneError;
use crate::listing::{ListedDepth, ListedPhoto, Listing};
use crate::photos::{Depths, PhotoError};
use crate::{input, plural, shown};

/// Points that a map is compared with, at most.
const POINTS_MAX: usize = 5000;

/// Where COLMAP's dense reconstruction has its maps: the one kind after the other.
pub(super) const DENSE: &str = "stereo/depth_maps";
const KINDS: [&str; 2] = ["geometric", "photometric"];

/// Gives each photo without a depth map that of COLMAP's dense reconstruction in `scene`, if it is there.
/// Photos have the names of their lists yet.
pub(super) fn find(listing: &mut Listing, scene: &Path) {
    let folder = scene.join(DENSE);
    if !folder.is_dir() {
        return;
    }
    let of_photo = |name: &str| {
        let mut maps = KINDS.iter().map(|kind| folder.join(format!("{name}.{kind}.bin")));
        maps.find(|map| map.is_file()).map(|path| ListedDepth { path, unit: 1.0 })
    };
    for photo in &mut listing.photos {
        photo.depth = photo.depth.take().or_else(|| of_photo(&photo.name));
    }
}

/// Where COLMAP's dense reconstruction would have the map of the photo of this name.
pub fn dense_name(photo: &str) -> PathBuf {
    Path::new(DENSE).join(format!("{photo}.{}.bin", KINDS[0]))
}

impl ListedDepth {
    /// Its file is of COLMAP's dense reconstruction, in the scene's unit.
    pub fn is_dense(&self) -> bool {
        self.unit == 1.0 && self.path.extension().is_some_and(|extension| extension == "bin")
    }

    /// The file of COLMAP's dense reconstruction that says the same. Fails where the map cannot be read.
    pub fn to_dense(&self) -> Result<Vec<u8>, SceneError> {
        let unread = |error| SceneError::invalid(&self.path, format!("cannot be read: {error}"));
        let mut depths = Depths::of(&self.path, input::read(&self.path).map_err(unread)?)?;
        depths.values.iter_mut().for_each(|depth| *depth *= self.unit as f32);
        Ok(depths.to_dense())
    }
}

/// What tells the unit of a map: the scene's own points, and which of them each photo sees.
pub(super) struct Judge<'a> {
    pub(super) points: &'a [Point],
    pub(super) seen: &'a BTreeMap<String, Vec<Sight>>,
}

impl Judge<'_> {
    /// The points that the photo of this name sees; all points where that is not known.
    fn points_of(&self, photo: &str) -> Box<dyn Iterator<Item = &Point> + '_> {
        match self.seen.get(photo) {
            Some(seen) => Box::new(seen.iter().filter_map(|sight| self.points.get(sight.point as usize))),
            None => Box::new(self.points.iter()),
        }
    }

    /// Inverse depths of a map at the pixels of `view`, and of the points there.
    fn pairs(&self, photo: &str, view: &View, depths: &[f32]) -> Vec<[f64; 2]> {
        let camera = &view.camera;
        let pair = |point: &Point| {
            let in_camera = camera.camera_from_world(DVec3::from_array(point.position.map(f64::from)));
            let at = camera.pixel_from_camera(in_camera).map(|at| at.round());
            let is_inside = in_camera.z > camera.near
                && (0.0..f64::from(camera.width)).contains(&at[0])
                && (0.0..f64::from(camera.height)).contains(&at[1]);
            let depth = is_inside.then(|| depths[at[1] as usize * camera.width as usize + at[0] as usize])?;
            is_known(depth).then(|| [1.0 / f64::from(depth), 1.0 / in_camera.z])
        };
        let pairs: Vec<[f64; 2]> = self.points_of(photo).filter_map(pair).collect();
        // Thinned now: most points of a large scene lie in other photos.
        let every = pairs.len().div_ceil(POINTS_MAX).max(1);
        pairs.into_iter().step_by(every).collect()
    }
}

/// What became of a photo's depth map.
pub(super) enum Outcome {
    /// It had none.
    Absent,
    Used(Fit),
    /// It cannot be read, or is of another shape, or knows nothing.
    Bad {
        path: PathBuf,
        reason: String,
    },
    /// Of a photo that is cut into several views.
    Cut,
}

/// The map of a photo for its only view, and its file's digest.
pub(super) fn load(
    listed: &ListedPhoto,
    frame: &Frame,
    view: Option<&mut View>,
    judge: &Judge,
    storage: &PhotoStorage,
) -> Result<(Outcome, Option<Digest>), SceneError> {
    let Some(ListedDepth { path, unit }) = &listed.depth else { return Ok((Outcome::Absent, None)) };
    let bad = |reason: String| Outcome::Bad { path: path.clone(), reason };
    let bytes = match input::read(path) {
        Ok(bytes) => bytes,
        Err(error) => return Ok((bad(error.to_string()), None)),
    };
    let digest = Digest::of(&bytes);
    let raw = match Depths::of(path, bytes) {
        Ok(raw) => raw,
        Err(PhotoError::Decode { reason, .. }) => return Ok((bad(reason), Some(digest))),
        Err(error) => return Ok((bad(error.to_string()), Some(digest))),
    };
    let (size, camera) = (raw.size, [listed.camera.width, listed.camera.height]);
    if !is_same_shape(camera, size) {
        let problem = format!("it is {}x{}, and its camera {}x{}", size[0], size[1], camera[0], camera[1]);
        return Ok((bad(problem), Some(digest)));
    }
    let (Some(mut depths), Some(view)) = (frame.depths(&raw), view) else {
        return Ok((Outcome::Cut, Some(digest)));
    };
    depths.iter_mut().for_each(|depth| *depth *= *unit as f32);
    let found = fit(&judge.pairs(&listed.name, view, &depths), judge.seen.contains_key(&listed.name));
    match found {
        Fit::Other => return Ok((Outcome::Used(found), Some(digest))),
        Fit::Line { scale, shift } => {
            // What is infinitely far is not known, and stays so.
            for depth in depths.iter_mut().filter(|depth| is_known(**depth)) {
                *depth = (1.0 / (scale / f64::from(*depth) + shift)) as f32;
            }
        }
        Fit::Same | Fit::Unknown => {}
    }
    if let Some(mask) = &view.mask {
        depths
            .iter_mut()
            .zip(&mask.counts)
            .filter(|(_, counts)| !**counts)
            .for_each(|(depth, _)| *depth = 0.0);
    }
    let Some((codes, nearest)) = DepthMap::encode(&depths, view.camera.width, view.camera.height) else {
        return Ok((bad("it knows no depth".into()), Some(digest)));
    };
    view.depth = Some(DepthMap { codes: storage.keep(codes)?, nearest });
    Ok((Outcome::Used(found), Some(digest)))
}

/// Whether maps that no point has judged are of no use: most of the others had another unit.
pub(super) fn are_strange<'a>(outcomes: impl Iterator<Item = &'a Outcome>) -> bool {
    let (mut judged, mut moved) = (0, 0);
    for outcome in outcomes {
        if let Outcome::Used(fit @ (Fit::Same | Fit::Line { .. })) = outcome {
            judged += 1;
            moved += usize::from(*fit != Fit::Same);
        }
    }
    2 * moved > judged
}

/// What the user should know of them.
pub(super) fn notices(photos: &[&Outcome], drops_unknown: bool) -> Vec<String> {
    let count = |is: &dyn Fn(&Outcome) -> bool| photos.iter().filter(|outcome| is(outcome)).count();
    let used = count(&|outcome| match outcome {
        Outcome::Used(Fit::Unknown) => !drops_unknown,
        Outcome::Used(Fit::Same | Fit::Line { .. }) => true,
        _ => false,
    });
    let mut notices = Vec::new();
    if used > 0 {
        let have = plural(used, "photo has", "photos have");
        notices.push(format!(
            "{used} of {} {have} a depth map, which trains shapes (--depth off)",
            photos.len()
        ));
    }
    let moved = count(&|outcome| matches!(outcome, Outcome::Used(Fit::Line { .. })));
    if moved > 0 {
        let maps = plural(moved, "depth map is", "depth maps are");
        notices.push(format!("{moved} {maps} brought to the scene's unit by its points"));
    }
    let others = count(&|outcome| matches!(outcome, Outcome::Used(Fit::Other)));
    if others > 0 {
        let maps = plural(others, "depth map is", "depth maps are");
        notices.push(format!("{others} {maps} left out: the scene's points are elsewhere"));
    }
    let unknown = count(&|outcome| matches!(outcome, Outcome::Used(Fit::Unknown)));
    if drops_unknown && unknown > 0 {
        let maps = plural(unknown, "depth map is", "depth maps are");
        notices.push(format!("{unknown} {maps} left out: too few points tell their unit"));
    }
    if !drops_unknown && unknown > 0 {
        let maps = plural(unknown, "depth map is", "depth maps are");
        notices.push(format!(
            "{unknown} {maps} taken as told: too few points say whether the unit is the scene's"
        ));
    }
    let cut = count(&|outcome| matches!(outcome, Outcome::Cut));
    if cut > 0 {
        let maps = plural(cut, "depth map is", "depth maps are");
        notices.push(format!("{cut} {maps} left out: the photo is cut into several views"));
    }
    let bad = || {
        photos.iter().filter_map(|outcome| match outcome {
            Outcome::Bad { path, reason } => Some((path, reason)),
            _ => None,
        })
    };
    if let Some((path, reason)) = bad().next() {
        let count = bad().count();
        let maps = plural(count, "depth map cannot", "depth maps cannot");
        notices.push(format!("{count} {maps} be used, first {}: {reason}", shown(path)));
    }
    notices
}
