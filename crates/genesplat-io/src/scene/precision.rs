//! Scenes far from their origin are moved ([`crate::offset`]); what is still far is told, or refused.

use genesplat_core::Camera;
use glam::DVec3;

use crate::error::SceneError;
use crate::listing::{Frame, ListedPhoto, Listing, Moved};
use crate::offset::{self, FAR, Offset, reach, relative_step};

/// What to do about it.
pub(crate) const CENTRE: &str = "centre the reconstruction: move cameras and points by the same vector, for instance by \
                                 `colmap model_transformer`";

/// A scene is refused whose steps are larger than this part of the cameras' radius. Where the radius spans a
/// thousand pixels of a photo, they are a pixel.
const REFUSED: f64 = 1e-3;

/// Moves the cameras of `photos` to where they are asked for, or, where nobody asks and they are far from the
/// origin, near it.
pub(crate) fn move_cameras(photos: &mut [ListedPhoto], frame: Frame) -> Moved {
    let already = frame.already.unwrap_or_default();
    let found = match frame {
        // Whoever has moved it before meant it to lie there: other parts of it do, too.
        Frame { asked: Some(_), .. } | Frame { already: Some(_), .. } => None,
        _ => offset::of_cameras(&centres(photos)),
    };
    let offset = frame.asked.or(found).unwrap_or(already);
    let by: Offset = std::array::from_fn(|axis| offset[axis] - already[axis]);
    if by != [0.0; 3] {
        photos.iter_mut().for_each(|photo| move_camera(&mut photo.camera, by));
    }
    Moved { by, offset: Some(offset).filter(|offset| *offset != [0.0; 3]), is_found: found.is_some() }
}

/// `rotation (p - centre)` is `rotation p + translation`.
fn move_camera(camera: &mut Camera, by: Offset) {
    let centre = camera.centre_in_world() - DVec3::from(by);
    camera.camera_from_world_translation = -(camera.rotation() * centre);
}

fn centres(photos: &[ListedPhoto]) -> Vec<DVec3> {
    photos.iter().map(|photo| photo.camera.centre_in_world()).collect()
}

/// What the user should know of the offset, and of the cameras' distance from the origin where they are far
/// all the same; an error where it is far too large.
pub(super) fn check(listing: &Listing) -> Result<Option<String>, SceneError> {
    let (distance, radius) = reach(&centres(&listing.photos));
    let Some(step) = relative_step(distance, radius).filter(|&step| step > FAR) else {
        return Ok(listing.moved.offset.filter(|_| listing.moved.is_found).map(told));
    };
    match listing.photos.first() {
        Some(photo) if step > REFUSED => {
            Err(SceneError::FarFromOrigin { file: photo.list.to_path_buf(), distance, radius })
        }
        _ => Ok(Some(format!(
            "the scene is far from its origin, so that single precision is lost: its cameras are within {radius:.3} units \
             of their middle, and have coordinates up to {distance:.0}; {CENTRE}"
        ))),
    }
}

fn told(offset: Offset) -> String {
    format!(
        "the scene is far from its origin, where single precision has coarse steps, so its coordinates are taken less the \
         offset {}, which is kept beside what is written",
        offset::in_words(offset)
    )
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    #[test]
    fn a_moved_camera_sees_the_same() {
        let by = [431_250.0, 5_412_345.0, 300.0];
        let mut camera = Camera {
            camera_from_world_rotation: DQuat::from_xyzw(0.1, -0.5, 0.2, 0.8).normalize(),
            ..Camera::at_origin(10, 10, 10.0)
        };
        camera.camera_from_world_translation =
            -(camera.rotation() * DVec3::new(431_251.0, 5_412_347.0, 303.0));
        let point = DVec3::new(431_249.0, 5_412_344.5, 310.0);
        let before = camera.camera_from_world(point);
        move_camera(&mut camera, by);
        assert!(camera.camera_from_world(point - DVec3::from(by)).distance(before) < 1e-8);
        assert!(camera.centre_in_world().distance(DVec3::new(1.0, 2.0, 3.0)) < 1e-8);
    }
}
