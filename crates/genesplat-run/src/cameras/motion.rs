//! How the camera of a photo is moved.

use genesplat_core::Camera;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// A turn of a camera about its centre, and a shift of that.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Rotation vector along the axes of the world, rad.
    pub turn: [f64; 3],
    /// World units.
    pub shift: [f64; 3],
}

impl Motion {
    /// Of three numbers each: turn, and shift.
    pub(super) fn of([tx, ty, tz, sx, sy, sz]: [f64; 6]) -> Self {
        Self { turn: [tx, ty, tz], shift: [sx, sy, sz] }
    }

    /// The camera, moved.
    pub fn of_camera(&self, camera: &Camera) -> Camera {
        let turn = DQuat::from_scaled_axis(self.turn.into());
        let rotation = (camera.camera_from_world_rotation.normalize() * turn.inverse()).normalize();
        let centre = camera.centre_in_world() + DVec3::from(self.shift);
        let translation = -(rotation * centre);
        Camera { camera_from_world_rotation: rotation, camera_from_world_translation: translation, ..*camera }
    }

    /// This one, and then another.
    pub(super) fn then(&self, next: &Self) -> Self {
        let [turn, next_turn] = [self, next].map(|motion| DQuat::from_scaled_axis(motion.turn.into()));
        let shift = DVec3::from(self.shift) + DVec3::from(next.shift);
        Self { turn: (next_turn * turn).to_scaled_axis().into(), shift: shift.into() }
    }

    /// How far it turns, rad.
    pub fn angle(&self) -> f64 {
        DVec3::from(self.turn).length()
    }

    /// How far it shifts, world units.
    pub fn distance(&self) -> f64 {
        DVec3::from(self.shift).length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.9),
            camera_from_world_translation: DVec3::new(1.0, -2.0, 3.0),
            ..Camera::at_origin(40, 30, 50.0)
        }
    }

    #[test]
    fn a_turn_is_about_the_centre_and_a_shift_keeps_where_it_looks() {
        let camera = camera();
        let turned = Motion::of([0.1, -0.2, 0.3, 0.0, 0.0, 0.0]).of_camera(&camera);
        assert!(turned.centre_in_world().distance(camera.centre_in_world()) < 1e-12);
        let expected = DQuat::from_scaled_axis(DVec3::new(0.1, -0.2, 0.3)) * camera.axis_in_world();
        assert!(turned.axis_in_world().distance(expected) < 1e-12);
        let shifted = Motion::of([0.0, 0.0, 0.0, 1.0, 2.0, -3.0]).of_camera(&camera);
        assert!(shifted.axis_in_world().distance(camera.axis_in_world()) < 1e-12);
        let expected = camera.centre_in_world() + DVec3::new(1.0, 2.0, -3.0);
        assert!(shifted.centre_in_world().distance(expected) < 1e-12);
    }

    #[test]
    fn one_motion_after_the_other_is_their_sum() {
        let (first, second) =
            (Motion::of([0.1, 0.2, -0.3, 1.0, 0.0, 2.0]), Motion::of([-0.2, 0.1, 0.05, 0.0, 3.0, -1.0]));
        let (camera, both) = (camera(), first.then(&second));
        let [once, twice] = [both.of_camera(&camera), second.of_camera(&first.of_camera(&camera))];
        assert!(once.axis_in_world().distance(twice.axis_in_world()) < 1e-12);
        assert!(once.centre_in_world().distance(twice.centre_in_world()) < 1e-12);
        let same = Motion::default().then(&first);
        assert!((same.angle() - first.angle()).abs() < 1e-12 && same.shift == first.shift);
    }
}
