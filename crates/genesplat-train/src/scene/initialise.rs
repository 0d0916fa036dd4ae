//! The cloud that training starts from, and the size of the scene.
//!
//! Every point of the sparse reconstruction becomes one isotropic Gaussian (3DGS, section 5.1 and its code):
//! scale = root of the mean *squared* distance to the three nearest other points, opacity 0.1, colour in the
//! base coefficient only.

use std::ops::Range;

use genesplat_core::camera::mean_and_radius;
use genesplat_core::gaussians::logit;
use genesplat_core::spherical_harmonics::{dc_from_rgb, sh_index};
use genesplat_core::{Camera, Gaussians, median, morton_order};
use glam::DVec3;

use super::nearest::mean_squared_distances;

/// Opacity of every initial Gaussian (3DGS).
const INITIAL_OPACITY: f32 = 0.1;

/// Floor of the mean squared distance, world units squared, so that duplicate points get a finite log-scale
/// (3DGS).
const SQUARED_DISTANCE_MIN: f32 = 1e-7;
/// It is that of points whose squared distances have at least this median; where all lie closer, it is as
/// much less.
const USUAL_SQUARED_DISTANCE: f32 = 1e-4;

/// The scene's extent is this many times the radius of the camera centres (3DGS).
const EXTENT_MARGIN: f64 = 1.1;

/// Neighbours that decide a point's initial size.
pub(crate) const NEIGHBOURS: usize = 3;

/// Why a scene cannot be started from.
#[derive(Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InitialiseError {
    /// Three neighbours need at least four points.
    #[error(
        "the scene has {found} points, but the size of the first Gaussians needs at least {}; \
         check that the reconstruction's points were found", NEIGHBOURS + 1
    )]
    TooFewPoints {
        /// Points given.
        found: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error(
        "point {row} of the scene has a coordinate that is not finite; remove it from the reconstruction"
    )]
    NonFinite {
        /// Index of the point, in the order given.
        row: usize,
    },
    /// All cameras stand at one place, so the scene has no size.
    #[error(
        "{cameras} training {} at one place, so the size of the scene is unknown; add photos from other places \
         (--train-on-all trains on test photos, too), or set `extent` in a --config file",
        if *cameras == 1 { "camera stands" } else { "cameras stand" }
    )]
    NoExtent {
        /// Number of training cameras.
        cameras: usize,
    },
}

/// A point of a sparse reconstruction: position in world units, and 8-bit RGB.
pub type ColouredPoint = ([f32; 3], [u8; 3]);

/// One Gaussian a point, in the order given.
pub fn cloud_from_points(points: &[ColouredPoint]) -> Result<Gaussians, InitialiseError> {
    Ok(Seeds::new(points.to_vec())?.rows(0..points.len()))
}

/// What the first cloud is made from, a tenth of its size: a rank makes its own rows of the cloud, and no
/// others.
pub(crate) struct Seeds {
    points: Vec<ColouredPoint>,
    /// Mean squared distance to the nearest others; not below the least that is believed.
    squared: Vec<f32>,
}

impl Seeds {
    pub(crate) fn new(points: Vec<ColouredPoint>) -> Result<Self, InitialiseError> {
        check_points(&points)?;
        let positions: Vec<[f32; 3]> = points.iter().map(|point| point.0).collect();
        let mut squared = mean_squared_distances(&positions);
        let floor = floor(&squared);
        squared.iter_mut().for_each(|squared| *squared = squared.max(floor));
        Ok(Self { points, squared })
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    pub(crate) fn positions(&self) -> Vec<[f32; 3]> {
        self.points.iter().map(|point| point.0).collect()
    }

    /// The Gaussians of some points.
    pub(crate) fn rows(&self, rows: Range<usize>) -> Gaussians {
        let mut cloud = Gaussians::zeros(rows.len());
        cloud.opacity_logits.fill(logit(INITIAL_OPACITY));
        for (row, &(position, rgb)) in self.points[rows.clone()].iter().enumerate() {
            cloud.positions[row] = position;
            cloud.log_scales[row] = [self.squared[rows.start + row].sqrt().ln(); 3];
            for (channel, &value) in rgb.iter().enumerate() {
                cloud.sh[row][sh_index(channel, 0)] = dc_from_rgb(f32::from(value) / 255.0);
            }
        }
        cloud
    }
}

/// Least squared distance that is believed: in a small scene a small one.
fn floor(squared_distances: &[f32]) -> f32 {
    let mut sorted = squared_distances.to_vec();
    let (_, &mut median, _) = sorted.select_nth_unstable_by(squared_distances.len() / 2, f32::total_cmp);
    let part = (median / USUAL_SQUARED_DISTANCE).min(1.0);
    // The smallest scenes have squares that f32 holds as nothing, as duplicates have.
    if part > 1e-12 { part * SQUARED_DISTANCE_MIN } else { SQUARED_DISTANCE_MIN }
}

/// A cloud can be made of these points; what is wrong with them is said of the order given.
pub(crate) fn check_points(points: &[ColouredPoint]) -> Result<(), InitialiseError> {
    if points.len() <= NEIGHBOURS {
        return Err(InitialiseError::TooFewPoints { found: points.len() });
    }
    match points.iter().position(|(position, _)| position.iter().any(|v| !v.is_finite())) {
        Some(row) => Err(InitialiseError::NonFinite { row }),
        None => Ok(()),
    }
}

/// The points along a Morton curve through their bounding box (ties in the order given). Rows of the cloud
/// follow it from then on, so that Gaussians that share tiles share cache lines, and a crossover exchanges
/// whole regions.
pub fn in_spatial_order(points: &[ColouredPoint]) -> Vec<ColouredPoint> {
    let positions: Vec<[f32; 3]> = points.iter().map(|point| point.0).collect();
    morton_order(&positions).into_iter().map(|index| points[index as usize]).collect()
}

/// Size of the scene in world units: 1.1 times the largest distance of a training camera from their mean
/// centre.
///
/// The position rate and every size threshold of density control are multiples of it.
pub fn scene_extent<'a>(cameras: impl Iterator<Item = &'a Camera>) -> Result<f64, InitialiseError> {
    let centres: Vec<DVec3> = cameras.map(Camera::centre_in_world).collect();
    let (mean, radius) = mean_and_radius(&centres);
    // Poses are read from decimal text: a radius at rounding level means "one place".
    let rounding = 1e-9 * (1.0 + mean.length());
    if radius > rounding {
        Ok(EXTENT_MARGIN * radius)
    } else {
        Err(InitialiseError::NoExtent { cameras: centres.len() })
    }
}

/// The length that fixed settings of MCMC are in, world units: 1 where the extent is 1 to 10, as that of
/// published scenes; else what brings it there.
pub(crate) fn unit_of(extent: f64) -> f64 {
    extent / extent.clamp(1.0, 10.0)
}

/// Points and cameras that the median depth is taken of, at most: more do not move it.
const DEPTH_POINTS: usize = 1000;
const DEPTH_CAMERAS: usize = 100;

/// How far away what the cameras see is: the median camera z of the points in front of them, world units;
/// `None` where there are none.
pub(crate) fn median_depth<'a>(
    cameras: impl ExactSizeIterator<Item = &'a Camera>,
    points: &[ColouredPoint],
) -> Option<f64> {
    let [every_camera, every_point] = [(cameras.len(), DEPTH_CAMERAS), (points.len(), DEPTH_POINTS)]
        .map(|(all, most)| all.div_ceil(most).max(1));
    let cameras = cameras.step_by(every_camera);
    let depths_from = |camera: &'a Camera| {
        let positions =
            points.iter().step_by(every_point).map(|(position, _)| DVec3::from(position.map(f64::from)));
        positions.map(|position| camera.camera_from_world(position).z)
    };
    median(cameras.flat_map(depths_from).filter(|&depth| depth > 0.0))
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    fn camera_at(centre: DVec3) -> Camera {
        let rotation = DQuat::from_rotation_y(0.7);
        Camera {
            camera_from_world_rotation: rotation,
            camera_from_world_translation: -(rotation * centre),
            ..Camera::at_origin(8, 6, 8.0)
        }
    }

    #[test]
    fn a_unit_tetrahedron_of_points_gets_hand_computed_parameters() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]];
        let cloud = cloud_from_points(&positions.map(|position| (position, [255, 0, 128]))).unwrap();
        assert_eq!(cloud.positions, positions);
        // Squared distances from the origin: 1, 4 and 9.
        let expected = (14.0f32 / 3.0).sqrt().ln();
        assert!(cloud.log_scales[0].iter().all(|v| (v - expected).abs() < 1e-6), "{:?}", cloud.log_scales[0]);
        assert!((genesplat_core::gaussians::sigmoid(cloud.opacity_logits[2]) - 0.1).abs() < 1e-6);
        assert_eq!(cloud.rotations[1], [1.0, 0.0, 0.0, 0.0]);
        // (1 − 0.5) / C0 and its mirror image; everything view-dependent starts at zero.
        assert!((cloud.sh[3][0] - 1.772_453_9).abs() < 1e-5);
        assert!((cloud.sh[3][1] + 1.772_453_9).abs() < 1e-5);
        assert!(cloud.sh[3].iter().enumerate().all(|(k, &v)| k < 3 || v == 0.0));
    }

    #[test]
    fn duplicate_points_get_the_smallest_size_instead_of_minus_infinity() {
        let cloud = cloud_from_points(&[([1.0; 3], [0; 3]); 5]).unwrap();
        assert!((cloud.log_scales[0][0] - 1e-7f32.sqrt().ln()).abs() < 1e-5);
    }

    #[test]
    fn the_smallest_size_is_that_of_a_small_scene() {
        let row = |step: f32| {
            [0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0].map(|x| ([x * step, 0.0, 0.0], [0; 3]))
        };
        let size = |step: f32| cloud_from_points(&row(step)).unwrap().log_scales[0][0].exp();
        assert!((size(1.0) - 1e-7f32.sqrt()).abs() < 1e-9);
        assert!((size(1e-4) / size(1e-3) - 0.1).abs() < 1e-3 && size(1e-4) < 1e-4);
    }

    #[test]
    fn units_follow_the_extents_that_no_published_scene_has() {
        assert_eq!([1.0, 4.5, 10.0].map(unit_of), [1.0; 3]);
        assert_eq!([0.02, 300.0].map(unit_of), [0.02, 30.0]);
    }

    #[test]
    fn spatial_order_visits_octants_one_after_another() {
        let corner = |index: u32| std::array::from_fn(|axis| (index >> axis & 1) as f32);
        let point = |index: u32| -> ColouredPoint { (corner(index), [index as u8; 3]) };
        let ordered = in_spatial_order(&[6, 1, 7, 0, 3, 2, 5, 4].map(point));
        assert_eq!(ordered, [0, 1, 2, 3, 4, 5, 6, 7].map(point));
        // A point beside another one stays beside it, wherever it was listed.
        let near = ([0.01, 0.0, 0.99], [9; 3]);
        let ordered = in_spatial_order(&[point(4), point(7), point(0), near, point(1)]);
        assert_eq!(ordered.iter().map(|p| p.1[0]).collect::<Vec<_>>(), [0, 1, 9, 4, 7]);
    }

    #[test]
    fn unusable_points_are_named() {
        let error = cloud_from_points(&[([0.0; 3], [0; 3]); 3]).unwrap_err();
        assert_eq!(error, InitialiseError::TooFewPoints { found: 3 });
        assert!(error.to_string().contains("at least 4"), "{error}");
        let poisoned = [[0.0; 3], [0.0, f32::NAN, 0.0], [1.0; 3], [2.0; 3]].map(|p| (p, [0; 3]));
        assert_eq!(cloud_from_points(&poisoned).unwrap_err(), InitialiseError::NonFinite { row: 1 });
    }

    #[test]
    fn the_extent_is_measured_between_camera_centres() {
        let cameras = [DVec3::new(5.0, 0.0, 0.0), DVec3::new(9.0, 0.0, 0.0)].map(camera_at);
        let extent = scene_extent(cameras.iter()).unwrap();
        assert!((extent - 2.2).abs() < 1e-12, "{extent}");
    }

    #[test]
    fn depth_is_that_of_the_points_in_front() {
        let points = [-9.0, 1.0, 2.0, 7.0].map(|z| ([0.0, 0.0, z], [0; 3]));
        let camera = Camera { camera_from_world_translation: DVec3::Z, ..Camera::at_origin(8, 6, 8.0) };
        assert_eq!(median_depth([camera].iter(), &points), Some(3.0));
        assert_eq!(median_depth([camera].iter(), &points[..1]), None);
        let many: Vec<_> = (0..5000).map(|z| ([0.0, 0.0, z as f32], [0; 3])).collect();
        assert!((median_depth([camera].iter(), &many).unwrap() - 2500.0).abs() < 10.0);
    }

    #[test]
    fn cameras_at_one_place_have_no_extent() {
        let cameras = [camera_at(DVec3::new(0.1, 0.2, 0.3)); 3];
        assert_eq!(scene_extent(cameras.iter()).unwrap_err(), InitialiseError::NoExtent { cameras: 3 });
        assert_eq!(scene_extent([].iter()).unwrap_err(), InitialiseError::NoExtent { cameras: 0 });
    }
}
