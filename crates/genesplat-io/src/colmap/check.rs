//! The rules that a record must meet in either form; both readers call these, so that both refuse the same files.

use std::collections::BTreeMap;
use std::path::Path;

use super::{ImageRecord, Intrinsics};
use crate::error::SceneError;
use crate::listing::{bad_pose, intrinsics_problem, position_problem};
use crate::photos::Lens;
use crate::scene::Point;

/// The cameras of a file by their IDs, of which each may occur once.
pub(super) fn by_id(
    file: &Path,
    cameras: impl Iterator<Item = Result<(u32, Intrinsics), SceneError>>,
) -> Result<BTreeMap<u32, Intrinsics>, SceneError> {
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
) -> Result<Intrinsics, SceneError> {
    if let Some(problem) = intrinsics_problem(size.map(|side| side as f64), [fx, fy], [cx, cy]) {
        return Err(bad_camera(file, camera, problem));
    }
    let [width, height] = size.map(|side| side as u32);
    Ok(Intrinsics { width, height, focal_px: [fx, fy], principal_px: [cx, cy], lens })
}

/// A pose that is a rotation and a finite translation.
pub(super) fn pose(file: &Path, image: ImageRecord) -> Result<ImageRecord, SceneError> {
    let norm = image.rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
    let problem = if !image.rotation.iter().all(|v| v.is_finite()) {
        Some("is not finite")
    } else if norm < 1e-9 || !norm.is_finite() {
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

/// The point at 1-based `place` of the file.
pub(super) fn point(file: &Path, place: usize, position: [f64; 3], rgb: [u8; 3]) -> Result<Point, SceneError> {
    if let Some(problem) = position_problem(position) {
        let problem = format!("point {place} has a position that {problem}; remove it or reconstruct again");
        return Err(SceneError::bad_record(file, problem));
    }
    Ok(Point { position: position.map(|v| v as f32), rgb })
}

pub(super) fn bad_camera(file: &Path, camera: u32, problem: &'static str) -> SceneError {
    SceneError::BadCamera { file: file.to_owned(), camera: camera.to_string(), problem }
}
