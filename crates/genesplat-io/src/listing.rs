//! What the readers of scenes ([`crate::colmap`], `transforms`) return, before any photo is decoded, and what
//! they check.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::ffi::OsStr;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use genesplat_core::Camera;
use genesplat_core::camera::near_of;
use genesplat_core::constants::NEAR_DEPTH;
use glam::DVec3;

use crate::alike::difference;
use crate::colmap::ROUND;
use crate::digest::Digest;
use crate::error::SceneError;
use crate::offset::Offset;
use crate::photos::{Cut, Lens, part_names};
use crate::scene::{Cube, Doubt, Point, Sight, mask_beside};
use crate::similar::{PHOTO_ENDINGS, Similar, UNREAD, convert, entries, has_ending, photos_in};
use crate::{command_line, names, plural, shown};

pub(crate) struct Listing {
    pub(crate) photos: Vec<ListedPhoto>,
    /// None where the scene has none, or none are wanted.
    pub(crate) points: Vec<Point>,
    /// The scene has points, whether they are wanted or not.
    pub(crate) has_points: bool,
    /// Of the points that the scene itself has, once they are wanted.
    pub(crate) points_digest: Option<Digest>,
    /// Where random points lie, if this is known; else it follows from the cameras.
    pub(crate) cube: Option<Cube>,
    pub(crate) notices: Vec<String>,
    /// Why to train on it makes no sense.
    pub(crate) doubts: Vec<Doubt>,
    /// Where cameras and points lie.
    pub(crate) moved: Moved,
}

/// What is asked for beside photos.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted<'a> {
    pub(crate) points: bool,
    pub(crate) tracks: bool,
    pub(crate) masks: bool,
    pub(crate) depth: bool,
    /// A folder of photos in the place of where a `transforms.json` has them.
    pub(crate) images: Option<&'a Path>,
    /// Whether a `transforms.json` itself says which photos are for testing.
    pub(crate) splits: bool,
    pub(crate) frame: Frame,
}

/// Where a scene shall lie.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    /// What shall have been subtracted from the coordinates of its source; `None`: what is found.
    pub(crate) asked: Option<Offset>,
    /// What has been subtracted from those of its files already, as the scene itself says.
    pub(crate) already: Option<Offset>,
}

/// Where a scene lies.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Moved {
    /// What has been subtracted from the coordinates of its files.
    pub(crate) by: Offset,
    /// The same of its source.
    pub(crate) offset: Option<Offset>,
    /// Nobody has asked for it.
    pub(crate) is_found: bool,
}

/// A photo that exists and is not decoded yet.
pub(crate) struct ListedPhoto {
    /// As the list spells its path; [`Listing::name_views`] makes it unique within the scene and free of
    /// separators.
    pub(crate) name: String,
    pub(crate) path: PathBuf,
    /// The file that lists it, for errors; a scene may have several.
    pub(crate) list: Arc<Path>,
    /// At the size that the list states.
    pub(crate) camera: Camera,
    /// `None` for a pinhole.
    pub(crate) lens: Option<Lens>,
    /// What the scene itself says that the photo is for.
    pub(crate) purpose: Purpose,
    /// A picture that is black where the photo does not count.
    pub(crate) mask: Option<PathBuf>,
    /// How far away what it shows is.
    pub(crate) depth: Option<ListedDepth>,
    /// The points that it sees, in their order; none where that is not known or not asked for.
    pub(crate) seen: Vec<Sight>,
    /// When it was taken, where other lenses of a rig took photos, too: they are held out with it.
    pub(crate) moment: Option<u32>,
}

/// A depth map that is not decoded yet, and may not exist.
#[derive(Clone, Debug, PartialEq)]
pub struct ListedDepth {
    /// Its file.
    pub path: PathBuf,
    /// What its values are multiplied by, world units.
    pub unit: f64,
}

/// What a scene may say that a photo is for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// Nothing: where nothing is said of any photo, every eighth is held out; else it is trained on.
    #[default]
    Unsaid,
    /// Training, which sees no photo but these.
    Train,
    Test,
    /// Neither.
    Unused,
}

impl Listing {
    /// Gives all cameras one near plane: this, or what suits the size of the scene.
    ///
    /// Random points fill the space before the cameras, too. Where training starts from them the plane is as
    /// far away in any unit, so that a scene comes out the same in metres and in centimetres.
    pub(crate) fn set_near(&mut self, near: Option<f64>) {
        let centres: Vec<DVec3> = self.photos.iter().map(|photo| photo.camera.centre_in_world()).collect();
        let starts_from_random = !self.has_points && self.cube.is_none();
        let most = if starts_from_random { f64::INFINITY } else { NEAR_DEPTH };
        let near = near.unwrap_or_else(|| near_of(&centres, most));
        self.photos.iter_mut().for_each(|photo| photo.camera.near = near);
    }

    /// Random points, for a scene that has none.
    pub(crate) fn draw_points(&mut self, seed: u64) {
        let own = self.points.len();
        let cameras: Vec<Camera> = self.photos.iter().map(|photo| photo.camera).collect();
        let are_round = self.photos.iter().all(|photo| photo.lens.as_ref().is_some_and(Lens::is_round));
        let seen = || if are_round { Cube::around(&cameras) } else { Cube::seen_by(&cameras) };
        self.points = self.cube.unwrap_or_else(seen).points(seed);
        let count = self.points.len();
        let own = if own == 0 {
            "no points".to_owned()
        } else {
            format!("only {own} {}", plural(own, "point", "points"))
        };
        self.notices.push(format!("the scene has {own}, so training starts from {count} random ones"));
    }

    /// Fails where two entries have found the same file: the photo of one of them is not where its list says.
    /// Entries of one name are an error of [`Listing::name_views`].
    pub(crate) fn check_not_shared(&self) -> Result<(), SceneError> {
        let mut finders: HashMap<&Path, &ListedPhoto> = HashMap::new();
        for photo in &self.photos {
            let Some(first) = finders.insert(&photo.path, photo).filter(|first| first.name != photo.name)
            else {
                continue;
            };
            let problem = format!(
                "lists {} and {}, and {} is the only photo for both; put them where the list says",
                shown(&first.name),
                shown(&photo.name),
                shown(&photo.path)
            );
            return Err(SceneError::invalid(&photo.list, problem));
        }
        Ok(())
    }

    pub(crate) fn name_views(&mut self) -> Result<(), SceneError> {
        let Some(list) = self.photos.first().map(|photo| photo.list.clone()) else { return Ok(()) };
        let paths: Vec<&str> = self.photos.iter().map(|photo| photo.name.as_str()).collect();
        let names = view_names(&paths, &list)?;
        self.photos.iter_mut().zip(names).for_each(|(photo, name)| photo.name = name);
        self.check_parts(&list)
    }

    /// Fails where a photo is called as a part of another one would be.
    fn check_parts(&self, list: &Path) -> Result<(), SceneError> {
        let names: HashSet<&str> = self.photos.iter().map(|photo| &*photo.name).collect();
        for photo in self.photos.iter().filter(|photo| photo.cut().is_some()) {
            let mut parts = part_names().map(|part| part_name(&photo.name, part));
            if let Some(part) = parts.find(|part| names.contains(&**part)) {
                let problem = format!(
                    "lists {}, which is cut into parts, and {}, which one of them would be called; rename it",
                    shown(&photo.name),
                    shown(&part)
                );
                return Err(SceneError::invalid(list, problem));
            }
        }
        Ok(())
    }
}

impl ListedPhoto {
    /// What cuts it into pinhole views, where one does not show all of it.
    pub(crate) fn cut(&self) -> Option<Cut> {
        Cut::of(&self.camera, self.lens.as_ref()?)
    }
}

/// The name of the view that is this part of a photo: `1.jpg` has `1.front.jpg`.
pub(crate) fn part_name(photo: &str, part: &str) -> String {
    match photo.rsplit_once('.') {
        Some((stem, ending)) => format!("{stem}.{part}.{ending}"),
        None => format!("{photo}.{part}"),
    }
}

/// Gives `name` the separators of paths where it has those of Windows, and no file in `folder` is called so;
/// and the one form of names, where it has one.
pub(crate) fn separate(name: &mut String, folder: &Path) {
    if name.contains('\\') && !folder.join(&*name).is_file() {
        *name = name.replace('\\', "/");
    }
    if let Ok(below) = names::below(name) {
        *name = below;
    }
}

/// [`separate`]s `name`, as it came from another machine: what leads out of the folder becomes the file of
/// its last part in the first of `folders` that has one.
pub(crate) fn settle(name: &mut String, folders: &[&Path]) {
    folders.iter().take(1).for_each(|folder| separate(name, folder));
    let last = base_name(name).to_owned();
    let is_here = || folders.iter().any(|folder| folder.join(&last).is_file());
    if path_inside(name).is_none() && path_inside(&last).is_some() && is_here() {
        *name = last;
    }
}

/// The photo `name` as a path, if it stays inside its folder.
pub(crate) fn inside(name: &str, list: &Path) -> Result<PathBuf, SceneError> {
    path_inside(name).ok_or_else(|| {
        let problem = "which is not a path inside the scene's image folder; correct the name";
        SceneError::invalid(list, format!("lists the photo {name:?}, {problem}"))
    })
}

/// `name` as a path, if it stays inside its folder: a downloaded scene must not make us read other files.
pub(crate) fn path_inside(name: &str) -> Option<PathBuf> {
    names::below(name).ok().map(PathBuf::from)
}

pub(crate) fn no_photos(list: &Path) -> SceneError {
    SceneError::invalid(list, "lists no photos; the reconstruction failed, so run it again")
}

pub(crate) fn bad_pose(list: &Path, photo: &str, problem: &str) -> SceneError {
    let remedy = "remove the photo from the reconstruction or reconstruct again";
    SceneError::bad_record(list, format!("the pose of photo {} {problem}; {remedy}", shown(photo)))
}

/// Largest coordinate of a point or a camera that is believed, world units. Beyond it, a reconstruction has
/// gone wrong: squares of distances overflow f32 at 1e19, and at 1e9 a pixel is far below what f32 resolves.
pub(crate) const COORDINATE_MAX: f64 = 1e9;

/// What makes a position impossible, if anything does.
pub(crate) fn position_problem(position: [f64; 3]) -> Option<&'static str> {
    if !position.iter().all(|coordinate| coordinate.is_finite()) {
        Some("is not finite")
    } else if position.iter().any(|coordinate| coordinate.abs() > COORDINATE_MAX) {
        Some("lies beyond 1e9 world units")
    } else {
        None
    }
}

/// What makes a camera's intrinsics impossible, if anything does. All in pixels.
pub(crate) fn intrinsics_problem(
    size_px: [f64; 2],
    focal_px: [f64; 2],
    principal_px: [f64; 2],
) -> Option<&'static str> {
    /// Largest side of a photo that is believed: beyond it, the file is damaged.
    const SIDE_MAX_PX: f64 = (1 << 20) as f64;
    /// The same for focal lengths and, to either side, principal points.
    const LENGTH_MAX_PX: f64 = 1e9;
    /// The least focal length: with a shorter one, a photo shows more than half of the sky within f32's
    /// resolution.
    const FOCAL_MIN_PX: f64 = 1e-3;
    if !size_px.iter().all(|side| (1.0..=SIDE_MAX_PX).contains(side)) {
        Some("has an impossible image size")
    } else if !focal_px.iter().all(|focal| focal.is_finite() && *focal > 0.0) {
        Some("has a focal length that is not a positive number")
    } else if !principal_px.iter().all(|coordinate| coordinate.is_finite()) {
        Some("has a principal point that is not finite")
    } else if focal_px.iter().any(|focal| *focal < FOCAL_MIN_PX) {
        Some("has a focal length below 1e-3 pixels")
    } else if focal_px.iter().chain(&principal_px).any(|length| length.abs() > LENGTH_MAX_PX) {
        Some("has a focal length or a principal point beyond 1e9 pixels")
    } else {
        None
    }
}

/// An error where photos of this size cannot show all around: a whole sphere is twice as wide as high.
pub(crate) fn check_round(file: &Path, camera: &str, [width, height]: [f64; 2]) -> Result<(), SceneError> {
    if (0.5 * width - height).abs() <= (0.005 * height).max(1.0) {
        return Ok(());
    }
    let problem = format!(
        "camera {} is {ROUND}, and its photos of {width}x{height} pixels are not twice as wide as high; export them whole",
        shown(camera)
    );
    Err(SceneError::bad_record(file, problem))
}

/// What makes the coefficients of a lens impossible, if anything does.
pub(crate) fn coefficients_problem(coefficients: &[f64]) -> Option<&'static str> {
    if !coefficients.iter().all(|value| value.is_finite()) {
        Some("has distortion coefficients that are not finite")
    } else if coefficients.iter().any(|value| value.abs() > COORDINATE_MAX) {
        Some("has distortion coefficients beyond 1e9")
    } else {
        None
    }
}

/// Of all photos that `list` has, these do not exist: published scenes list photos that were removed as
/// blurred.
pub(crate) fn absent_notice(missing: &[PathBuf], all: usize, list: &Path) -> Option<String> {
    let (first, gone, list) = (shown(missing.first()?), missing.len(), shown(list));
    Some(format!("{gone} of the {all} photos that {list} lists do not exist and are left out, first {first}"))
}

/// Of all photos of a scene, these cannot be used, as their errors say, and are left out as absent ones are.
pub(crate) fn unusable_notice<E: Display>(unusable: &[E], all: usize) -> Option<String> {
    let (first, count) = (unusable.first()?, unusable.len());
    let are = plural(count, "cannot be used and is left out", "cannot be used and are left out");
    Some(format!("{count} of the {all} photos {are}, first: {first}"))
}

/// Of all photos that `list` has, these have poses that are not finite, or rotations of zeros: programs write
/// such numbers where they have found nothing. An error where no other is left.
pub(crate) fn lost_poses(lost: &[String], all: usize, list: &Path) -> Result<Option<String>, SceneError> {
    let Some(first) = lost.first() else { return Ok(None) };
    if lost.len() == all {
        return Err(bad_pose(list, first, "is not finite, or has a rotation of zeros"));
    }
    let have = plural(
        lost.len(),
        "has a pose that is not finite, or of zeros, and is left out",
        "have poses that are not finite, or of zeros, and are left out",
    );
    let (count, list, first) = (lost.len(), shown(list), shown(first));
    Ok(Some(format!("{count} of the {all} photos that {list} lists {have}, first {first}")))
}

/// Photos beside those of a list that are not in it: cameras were not found for them.
pub(crate) struct LeftOut {
    count: usize,
    /// Those in the list, too.
    all: usize,
    first: PathBuf,
}

impl LeftOut {
    /// Where they are at least a tenth of all, and not so many that to train makes no sense.
    pub(crate) fn notice(&self, list: &Path) -> Option<String> {
        let Self { count, all, first } = self;
        (10 * count >= *all && 2 * count <= *all).then(|| {
            format!(
                "{count} of the {all} photos have no camera in {} and are left out, first {}: photos that are blurred, or that show \
                 little of what others show, find none",
                shown(list),
                shown(first)
            )
        })
    }

    /// Where they are more than half of all.
    pub(crate) fn doubt(&self, list: &Path) -> Option<Doubt> {
        let Self { count, all, first } = self;
        (2 * count > *all).then(|| Doubt {
            problem: format!(
                "only {} of the {all} photos have a camera in {}; {} is the first of those without",
                all - count,
                shown(list),
                shown(first)
            ),
            remedy: "take photos in between and find cameras again, or go on with --anyway".into(),
        })
    }
}

/// What lies beside the photos that were `found`, and is not in their list, nor one of these `others`.
pub(crate) fn left_out<'a>(
    found: impl Iterator<Item = &'a Path> + Clone,
    others: &HashSet<&Path>,
) -> Option<LeftOut> {
    let folders: BTreeSet<&Path> = found.clone().filter_map(Path::parent).collect();
    let stems: HashSet<&OsStr> = found.clone().filter_map(Path::file_stem).collect();
    let there: Vec<PathBuf> = folders.into_iter().flat_map(photos_in).collect();
    let masks: HashSet<PathBuf> = found.clone().filter_map(mask_beside).collect();
    // A photo may lie beside what was made of it: `a.webp` beside `a.webp.png`.
    let is_used = |photo: &Path| {
        [photo.file_stem(), photo.file_name()].into_iter().flatten().any(|name| stems.contains(name))
    };
    let is_other = |photo: &PathBuf| masks.contains(photo) || others.contains(&**photo);
    let there: Vec<PathBuf> = there.into_iter().filter(|photo| !is_other(photo)).collect();
    let left_out: Vec<&PathBuf> = there.iter().filter(|photo| !is_used(photo)).collect();
    let first = left_out.iter().min()?.to_path_buf();
    Some(LeftOut { count: left_out.len(), all: there.len(), first })
}

/// Photos that were found under almost the names that `list` has.
pub(crate) fn similar_notice(similar: Similar, list: &Path) -> Option<String> {
    let (wanted, found, count) = similar.found()?;
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let (wanted, found, list) = (name(&wanted), name(&found), shown(list));
    let differs = difference(&found, &wanted);
    let photos = match differs.is_empty() {
        true => plural(count, "photo has another case or ending", "photos have other cases or endings"),
        false => {
            plural(count, "photo has a name in other characters", "photos have names in other characters")
        }
    };
    let (found, wanted) = (shown(&*found), shown(&*wanted));
    Some(format!("{count} {photos} than {list} says, first {found} for {wanted}{differs}"))
}

/// A folder that has the photos that another one lacks.
pub(crate) struct Elsewhere {
    pub(crate) path: PathBuf,
    /// What `--images` is to be.
    pub(crate) given: PathBuf,
}

/// The error where no photo exists that `list` has; `wanted` is the first, and may be `elsewhere`.
pub(crate) fn all_missing(
    wanted: &Path,
    count: usize,
    list: &Path,
    elsewhere: Option<&Elsewhere>,
) -> SceneError {
    let folder = wanted.parent().unwrap_or(Path::new(""));
    let first = |endings: &[&str]| entries(folder).filter(|entry| has_ending(entry, endings)).min();
    let name = |path: &Path| shown(path.file_name().unwrap_or_default()).to_string();
    let difference = |found: &Path| {
        let plain = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        difference(&plain(found), &plain(wanted))
    };
    let remedy = match (elsewhere, first(&PHOTO_ENDINGS), first(&UNREAD)) {
        (Some(elsewhere), ..) => {
            let Elsewhere { path, given } = elsewhere;
            format!(
                "; {} has photos of these names, so give {}",
                shown(path),
                command_line([Path::new("--images"), given])
            )
        }
        (_, Some(found), _) => {
            format!(
                ", which has names like {} where {} is wanted{}; put the photos there",
                name(&found),
                name(wanted),
                difference(&found)
            )
        }
        (_, _, Some(unread)) => {
            format!(", which has pictures like {} that are not read; {}", name(&unread), convert(&unread))
        }
        _ => "; put the photos there".into(),
    };
    SceneError::AllPhotosMissing { count, list: list.to_owned(), folder: folder.to_owned(), remedy }
}

pub(crate) fn base_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// A file name for each view: that of its photo. Where photos share one, the whole path joined by `_`, or by
/// as many `_` as tell all of them apart.
fn view_names(paths: &[&str], list: &Path) -> Result<Vec<String>, SceneError> {
    let whole: Vec<String> = paths.iter().map(|path| path.trim_start_matches("./").to_owned()).collect();
    if let Some(name) = repeated(&whole) {
        let problem = format!("lists the photo {} twice; remove one of its entries", shown(name));
        return Err(SceneError::invalid(list, problem));
    }
    let own: Vec<String> = paths.iter().map(|path| base_name(path).to_owned()).collect();
    let joined = (1..).map(|count| whole.iter().map(|path| path.replace('/', &"_".repeat(count))).collect());
    let mut candidates = std::iter::once(own).chain(joined);
    // Beyond the longest run of `_` in a path, different paths have different names.
    Ok(candidates
        .find(|names| repeated(names).is_none())
        .expect("different paths end up with different names"))
}

fn repeated(names: &[String]) -> Option<&String> {
    let mut seen = HashSet::new();
    names.iter().find(|name| !seen.insert(*name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_named_after_photos_and_never_share_a_name() {
        let names = |paths: &[&str]| view_names(paths, Path::new("list")).map_err(|error| error.to_string());
        assert_eq!(names(&["a/1.png", "a/2.png"]).unwrap(), ["1.png", "2.png"]);
        assert_eq!(names(&["./a/1.png", "b/1.png"]).unwrap(), ["a_1.png", "b_1.png"]);
        assert_eq!(names(&["a/1.png", "b/1.png", "a_1.png"]).unwrap(), ["a__1.png", "b__1.png", "a_1.png"]);
        assert!(names(&["a/1.png", "./a/1.png"]).unwrap_err().contains("a/1.png twice"));
    }
}
