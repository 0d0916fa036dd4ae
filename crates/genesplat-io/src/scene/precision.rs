//! Scenes far from their origin, as reconstructions in geographic coordinates are: single precision, in which
//! splats are trained and stored, has steps there that are not small beside the scene.

use genesplat_core::camera::mean_and_radius;
use glam::DVec3;

use crate::error::SceneError;
use crate::listing::Listing;

/// What to do about it.
pub(crate) const CENTRE: &str = "centre the reconstruction: move cameras and points by the same vector, for instance by \
                                 `colmap model_transformer`";

/// Steps of single precision where the cameras are, as a part of the cameras' radius: beyond the first the
/// user is told, and beyond the second the scene is refused. Where the radius spans a thousand pixels of a
/// photo, they are a hundredth of a pixel and a pixel.
const TOLD: f64 = 1e-5;
const REFUSED: f64 = 1e-3;

/// Of the largest coordinate, so much is rounding even in double precision: cameras no farther apart are in
/// one place.
const ONE_PLACE: f64 = 1e-12;

/// What the user should know of the cameras' distance from the origin, if anything; an error where it is far
/// too large.
pub(super) fn check(listing: &Listing) -> Result<Option<String>, SceneError> {
    let centres: Vec<DVec3> = listing.photos.iter().map(|photo| photo.camera.centre_in_world()).collect();
    let (distance, radius) = reach(&centres);
    let Some(step) = relative_step(distance, radius).filter(|&step| step > TOLD) else { return Ok(None) };
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

/// The largest coordinate, and the largest distance from the mean.
fn reach(centres: &[DVec3]) -> (f64, f64) {
    let distance = centres.iter().map(|centre| centre.abs().max_element()).fold(0.0, f64::max);
    (distance, mean_and_radius(centres).1)
}

/// The step of single precision at a coordinate, as a part of `radius`; `None` where cameras in one place say
/// nothing of the scene's size.
fn relative_step(distance: f64, radius: f64) -> Option<f64> {
    (radius > ONE_PLACE * distance).then(|| distance * f64::from(f32::EPSILON) / radius)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_measured_by_the_cameras_radius() {
        let ring = |middle: DVec3| [DVec3::X, DVec3::NEG_X, DVec3::Y].map(|arm| middle + 3.0 * arm);
        assert_eq!(reach(&[DVec3::new(-7.0, 2.0, 3.0)]), (7.0, 0.0));
        assert_eq!(reach(&[]), (0.0, 0.0));
        let step = |middle| {
            let (distance, radius) = reach(&ring(middle));
            relative_step(distance, radius).unwrap()
        };
        assert!(step(DVec3::ZERO) < 1e-6);
        assert!((TOLD..REFUSED).contains(&step(DVec3::new(0.0, 1000.0, 0.0))));
        assert!(step(DVec3::new(5e5, 5.4e6, 300.0)) > 0.1);
    }

    #[test]
    fn cameras_in_one_place_say_nothing() {
        assert_eq!(relative_step(0.0, 0.0), None);
        assert_eq!(relative_step(5.4e6, 0.0), None);
        assert_eq!(relative_step(5.4e6, 1e-9), None, "rounding");
    }
}
