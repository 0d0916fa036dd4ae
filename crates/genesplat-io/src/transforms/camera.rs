//! Cameras of a `transforms.json`: intrinsics, distortion, and poses turned from OpenGL's camera axes to
//! ours.

use std::path::Path;

use genesplat_core::Camera;
use genesplat_core::constants::NEAR_DEPTH;
use glam::{DMat3, DQuat, DVec3};

use super::schema::{OptionalIntrinsics, PhotoEntry};
use crate::colmap::{ROUND, round};
use crate::error::SceneError;
use crate::listing::{bad_pose, check_round, coefficients_problem, intrinsics_problem, position_problem};
use crate::photos::{self, Lens, Polynomial, Projection};
use crate::shown;

/// Most that the columns of a pose may differ from a rotation's: writers print few digits.
const DEVIATION_MAX: f64 = 0.01;

/// Whether a pose has numbers alone, and is not 0: programs write such where they have found nothing.
pub(super) fn is_known(entry: &PhotoEntry) -> bool {
    let is_zero = entry.transform_matrix.iter().take(3).all(|row| row[..3] == [0.0; 3]);
    !is_zero && entry.transform_matrix.iter().flatten().all(|value| value.is_finite())
}

/// Turns poses that are written column by column, as their translations in the last row tell: all of them, or
/// none. Whether they were.
pub(super) fn turn_columns(entries: &mut [PhotoEntry]) -> bool {
    let fits = |entry: &PhotoEntry| {
        let last_column = entry.transform_matrix.iter().map(|row| row[3]);
        last_column.eq([0.0, 0.0, 0.0, 1.0])
    };
    let is_moved = |entry: &PhotoEntry| entry.transform_matrix[3][..3] != [0.0; 3];
    let is_turned = entries.iter().all(fits) && entries.iter().any(is_moved);
    for entry in entries.iter_mut().filter(|_| is_turned) {
        let columns = entry.transform_matrix.clone();
        let row = |row: usize| std::array::from_fn(|column: usize| columns[column][row]);
        entry.transform_matrix = (0..4).map(row).collect();
    }
    is_turned
}

/// By how much all poses are scaled, beside their rotation; 1 where they are not, or each by its own.
pub(super) fn common_scale<'a>(entries: impl Iterator<Item = &'a PhotoEntry>) -> f64 {
    let scale = |entry: &PhotoEntry| Some(columns(entry)?.determinant().cbrt());
    let mut scales = entries.filter(|entry| is_known(entry)).filter_map(scale);
    let Some(first) = scales.next().filter(|first| *first > 0.0 && first.is_finite()) else { return 1.0 };
    let is_like = |scale: f64| ((scale / first).powi(2) - 1.0).abs() <= DEVIATION_MAX;
    let is_none = (first.powi(2) - 1.0).abs() <= DEVIATION_MAX;
    if !is_none && scales.all(is_like) { first } else { 1.0 }
}

/// The upper left of a pose: the axes of the camera in the world.
fn columns(entry: &PhotoEntry) -> Option<DMat3> {
    let [x, y, z, ..] = entry.transform_matrix.as_slice() else { return None };
    let row = |row: &[f64; 4]| DVec3::new(row[0], row[1], row[2]);
    Some(DMat3::from_cols(row(x), row(y), row(z)).transpose())
}

/// The camera of `entry`, and its lens; `photo` is asked for its size where the file does not say it. The
/// pose is divided by [`common_scale`].
pub(super) fn camera(
    list: &Path,
    entry: &PhotoEntry,
    intrinsics: &OptionalIntrinsics,
    photo: &Path,
    scale: f64,
) -> Result<(Camera, Option<Lens>), SceneError> {
    let (rotation, translation) = pose(list, entry, scale)?;
    let lens = lens(list, intrinsics)?;
    let bad = |problem: &str| SceneError::BadCamera {
        file: list.to_owned(),
        camera: entry.file_path.clone(),
        problem: problem.to_owned(),
    };
    let [width, height] = match (intrinsics.w, intrinsics.h) {
        (Some(w), Some(h)) => [w, h],
        _ => photos::photo_size(photo).map(|(w, h)| [w, h].map(f64::from))?,
    };
    let is_round = lens.as_ref().is_some_and(Lens::is_round);
    if is_round {
        check_round(list, &entry.file_path, [width, height])?;
    }
    let [fx, fy, cx, cy] = match is_round {
        true => round(width, height),
        false => pinhole(intrinsics, [width, height])
            .ok_or_else(|| bad("has none of fl_x, fl_y, camera_angle_x and camera_angle_y"))?,
    };
    let coefficients =
        [intrinsics.k1, intrinsics.k2, intrinsics.k3, intrinsics.k4, intrinsics.p1, intrinsics.p2];
    let coefficients = coefficients.map(|coefficient| coefficient.unwrap_or(0.0));
    let problem = intrinsics_problem([width, height], [fx, fy], [cx, cy]);
    if let Some(problem) = problem.or_else(|| coefficients_problem(&coefficients)) {
        return Err(bad(problem));
    }
    let camera = Camera {
        width: width as u32,
        height: height as u32,
        focal_px: [fx, fy],
        principal_px: [cx, cy],
        camera_from_world_rotation: rotation,
        camera_from_world_translation: translation,
        near: NEAR_DEPTH,
    };
    Ok((camera, lens))
}

/// `[fx, fy, cx, cy]` of photos of this size; pixels are square where one focal length is all that is said.
fn pinhole(intrinsics: &OptionalIntrinsics, [width, height]: [f64; 2]) -> Option<[f64; 4]> {
    let from_angle = |angle: Option<f64>, side: f64| angle.map(|angle| 0.5 * side / (0.5 * angle).tan());
    let fx = intrinsics.fl_x.or(from_angle(intrinsics.camera_angle_x, width));
    let fy = intrinsics.fl_y.or(from_angle(intrinsics.camera_angle_y, height));
    let [cx, cy] = [intrinsics.cx.unwrap_or(0.5 * width), intrinsics.cy.unwrap_or(0.5 * height)];
    Some([fx.or(fy)?, fy.or(fx)?, cx, cy])
}

/// COLMAP's names of the models whose coefficients a `transforms.json` can hold.
///
/// FULL_OPENCV is none of them: it divides by a second polynomial, whose first coefficient it calls k4, and
/// which nerfstudio's k4 is not.
pub(crate) const KNOWN_MODELS: [&str; 9] = [
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "OPENCV",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV_FISHEYE",
    "RADIAL_FISHEYE",
    "SIMPLE_RADIAL_FISHEYE",
    ROUND,
];

fn lens(list: &Path, intrinsics: &OptionalIntrinsics) -> Result<Option<Lens>, SceneError> {
    let said = intrinsics.camera_model.as_deref().unwrap_or("OPENCV");
    let model = match (said.to_ascii_uppercase().as_str(), intrinsics.is_fisheye) {
        (_, Some(true)) => "OPENCV_FISHEYE".to_owned(),
        ("PERSPECTIVE", _) => "OPENCV".to_owned(),
        (model, _) => model.to_owned(),
    };
    if !KNOWN_MODELS.contains(&model.as_str()) {
        return Err(SceneError::UnknownLens { file: list.to_owned(), model: said.to_owned() });
    }
    if model == ROUND {
        return Ok(Some(Lens { projection: Projection::Equirectangular, ..Lens::default() }));
    }
    let value = |coefficient: Option<f64>| coefficient.unwrap_or(0.0);
    let [k1, k2, k3, k4] = [intrinsics.k1, intrinsics.k2, intrinsics.k3, intrinsics.k4].map(value);
    let is_fisheye = model.ends_with("FISHEYE");
    let lens = Lens {
        projection: if is_fisheye { Projection::Fisheye } else { Projection::Perspective },
        polynomial: Polynomial {
            radial: [k1, k2, k3, k4, 0.0, 0.0],
            tangential: [intrinsics.p1, intrinsics.p2].map(|p| if is_fisheye { 0.0 } else { value(p) }),
            ..Polynomial::default()
        },
    };
    Ok((!lens.is_pinhole()).then_some(lens))
}

fn pose(list: &Path, entry: &PhotoEntry, scale: f64) -> Result<(DQuat, DVec3), SceneError> {
    let bad = |problem| bad_pose(list, &entry.file_path, problem);
    let world_from_gl = columns(entry).ok_or_else(|| bad("has fewer than three rows"))? * scale.recip();
    let centre = DVec3::from_array([0, 1, 2].map(|row| entry.transform_matrix[row][3]));
    if !world_from_gl.is_finite() {
        return Err(bad("is not finite"));
    }
    if entry.transform_matrix.get(3).is_some_and(|last| last[..3] != [0.0; 3]) {
        return Err(bad("has a last row that is not 0 0 0 1"));
    }
    if let Some(problem) = position_problem(centre.into()) {
        return Err(bad(problem));
    }
    // A mirror image is no rotation, nor is a scale of one pose alone.
    let deviation = world_from_gl * world_from_gl.transpose() - DMat3::IDENTITY;
    if deviation.to_cols_array().iter().any(|v| v.abs() > DEVIATION_MAX) {
        return Err(bad("is not a rotation"));
    }
    if world_from_gl.determinant() < 0.0 {
        let problem = format!(
            "the pose of photo {} is a mirror image, as in left-handed axes; export the cameras in right-handed ones (OpenGL's)",
            shown(&entry.file_path)
        );
        return Err(SceneError::bad_record(list, problem));
    }
    // OpenGL's camera looks along −z with y up; ours along z with y down.
    let world_from_camera =
        DMat3::from_cols(world_from_gl.x_axis, -world_from_gl.y_axis, -world_from_gl.z_axis);
    let rotation = DQuat::from_mat3(&world_from_camera.transpose()).normalize();
    Ok((rotation, -(rotation * centre)))
}
