//! Where the gallery is photographed from.

use std::f64::consts::TAU;

use genesplat_core::Camera;
use glam::{DMat3, DQuat, DVec3};

/// What the cameras look at, near enough.
const TARGET: DVec3 = DVec3::new(0.1, 1.35, 1.22);
/// Horizontal field of view, degrees.
const FIELD_OF_VIEW: f64 = 62.0;
/// Excursion of test views to the sides, and their distance from the mean one, metres: they stay well inside
/// the hull of the training views.
const TEST_EXCURSION: (f64, f64) = (0.75, -0.1);

/// `views` cameras on a closed path around the exhibits: to and fro twice in azimuth while height and
/// distance vary.
///
/// Every eighth, from the first on, is what the usual split holds out; those keep closer to the middle.
pub(crate) fn path(views: u32, width: u32, height: u32) -> Vec<Camera> {
    (0..views).map(|view| camera(view, views, width, height)).collect()
}

fn camera(view: u32, views: u32, width: u32, height: u32) -> Camera {
    let phase = TAU * f64::from(view) / f64::from(views);
    let (excursion, reach) =
        if view.is_multiple_of(8) { TEST_EXCURSION } else { (1.0, 0.35 * (5.0 * phase).cos()) };
    let azimuth = excursion * 0.87 * (2.0 * phase).sin();
    let lift = excursion * (3.0 * phase + 0.4).sin();
    let distance = 3.0 + reach;
    let centre =
        TARGET + distance * DVec3::new(azimuth.sin(), -azimuth.cos(), 0.0) + DVec3::Z * (0.25 + 0.42 * lift);
    // Not all look at one point: that would leave the rims seen from one side only.
    let target = TARGET + DVec3::new(0.35 * (3.0 * phase).cos(), 0.0, 0.12 * (4.0 * phase).sin());
    look_at(centre, target, width, height)
}

/// A level camera at `centre` that looks at `target`.
fn look_at(centre: DVec3, target: DVec3, width: u32, height: u32) -> Camera {
    let forward = (target - centre).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let world_from_camera = DMat3::from_cols(right, forward.cross(right), forward);
    let rotation = DQuat::from_mat3(&world_from_camera.transpose());
    let focal = 0.5 * f64::from(width) / (0.5 * FIELD_OF_VIEW.to_radians()).tan();
    Camera {
        camera_from_world_rotation: rotation,
        camera_from_world_translation: -(rotation * centre),
        ..Camera::at_origin(width, height, focal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_level_look_at_the_exhibits_and_stay_in_the_room() {
        for camera in path(48, 320, 214) {
            let target = camera.camera_from_world(TARGET);
            assert!(target.z > 2.0 && target.x.abs() < 0.5 && target.y.abs() < 0.5, "{target}");
            let up = camera.rotation() * DVec3::Z;
            assert!(up.x.abs() < 1e-9 && up.y < -0.8, "{up}");
            let centre = camera.centre_in_world();
            assert!(centre.x.abs() < 2.9 && centre.y > -2.5 && (0.7..2.2).contains(&centre.z), "{centre}");
        }
    }
}
