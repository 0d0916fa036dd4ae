//! The rules that a record must meet in either form; both readers call these, so that both refuse the same
//! files.
//!
//! What is not finite is left out and counted: programs write such numbers where they have found nothing.

use std::collections::BTreeMap;
use std::path::Path;

use super::{ImageRecord, Intrinsics};
use crate::error::SceneError;
use crate::listing::{bad_pose, check_round, intrinsics_problem, lost_poses, position_problem};
use crate::offset::{Offset, less};
use crate::photos::Lens;
use crate::scene::Point;
use crate::{plural, shown};

/// The records of a file that are finite.
pub(crate) struct Finite<T> {
    /// In file order.
    pub(crate) records: Vec<T>,
    /// What the user should know of the others, if there are any.
    pub(crate) notice: Option<String>,
}

impl<T> Finite<T> {
    /// Of a file that is not there, or not wanted.
    pub(crate) fn none() -> Self {
        Self { records: Vec::new(), notice: None }
    }
}

/// A camera's intrinsics, or why they cannot be: an error of the photos that have them.
pub(crate) type Judged = Result<Intrinsics, SceneError>;

/// The cameras of a file by their IDs, of which each may occur once.
pub(super) fn by_id(
    file: &Path,
    cameras: impl Iterator<Item = Result<(u32, Judged), SceneError>>,
) -> Result<BTreeMap<u32, Judged>, SceneError> {
    let mut by_id = BTreeMap::new();
    for read in cameras {
        let (camera, intrinsics) = read?;
        if by_id.insert(camera, intrinsics).is_some() {
            let problem = format!("has two cameras with the ID {camera}; export the model again");
            return Err(SceneError::invalid(file, problem));
        }
    }
    Ok(by_id)
}

pub(super) fn intrinsics(
    file: &Path,
    camera: u32,
    size: [u64; 2],
    ([fx, fy, cx, cy], lens): ([f64; 4], Option<Lens>),
) -> Judged {
    if let Some(problem) = intrinsics_problem(size.map(|side| side as f64), [fx, fy], [cx, cy]) {
        return Err(bad_camera(file, camera, problem));
    }
    if lens.as_ref().is_some_and(Lens::is_round) {
        // The size that the model states, too.
        check_round(file, &camera.to_string(), [2.0 * cx, 2.0 * cy])?;
        check_round(file, &camera.to_string(), size.map(|side| side as f64))?;
    }
    let [width, height] = size.map(|side| side as u32);
    Ok(Intrinsics { width, height, focal_px: [fx, fy], principal_px: [cx, cy], lens })
}

/// The photos of a file, each with a pose that is a rotation and a finite translation.
pub(super) fn images(
    file: &Path,
    all: impl Iterator<Item = Result<ImageRecord, SceneError>>,
) -> Result<Finite<ImageRecord>, SceneError> {
    let (mut records, mut lost) = (Vec::new(), Vec::new());
    for image in all {
        let image = image?;
        let is_finite = image.rotation.iter().chain(&image.translation).all(|value| value.is_finite());
        match is_finite && image.rotation != [0.0; 4] {
            true => records.push(pose(file, image)?),
            false => lost.push(image.name),
        }
    }
    let notice = lost_poses(&lost, lost.len() + records.len(), file)?;
    Ok(Finite { records, notice })
}

fn pose(file: &Path, image: ImageRecord) -> Result<ImageRecord, SceneError> {
    let norm = image.rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
    let problem = if norm < 1e-9 || !norm.is_finite() {
        Some("has a rotation that is zero or overflows")
    } else {
        // As far from the origin as the camera.
        position_problem(image.translation)
    };
    match problem {
        Some(problem) => Err(bad_pose(file, &image.name, problem)),
        None => Ok(image),
    }
}

/// The points of a file that can be: position in world units, less `offset`, and colour.
pub(crate) fn points(
    file: &Path,
    offset: Offset,
    all: impl Iterator<Item = Result<([f64; 3], [u8; 3]), SceneError>>,
) -> Result<Finite<Point>, SceneError> {
    let (mut records, mut lost) = (Vec::new(), 0);
    for point in all {
        let (position, rgb) = point?;
        match position_problem(position) {
            None => records.push(Point { position: less(position, offset), rgb }),
            Some(_) => lost += 1,
        }
    }
    let all = lost + records.len();
    let notice = (lost > 0).then(|| {
        let are = plural(lost, "is", "are");
        format!("{lost} of the {all} points of {} {are} not finite, or beyond 1e9 world units, and {are} left out", shown(file))
    });
    Ok(Finite { records, notice })
}

pub(super) fn bad_camera(file: &Path, camera: u32, problem: impl Into<String>) -> SceneError {
    SceneError::BadCamera { file: file.to_owned(), camera: camera.to_string(), problem: problem.into() }
}
