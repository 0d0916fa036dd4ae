//! Undoes the distortion of lenses: photos as a pinhole would have taken them.
//!
//! The model is OpenCV's: with `x, y` the pinhole's coordinates at depth 1 and `r² = x² + y²`,
//! `x' = x·R + 2 p1 x y + p2 (r² + 2 x²)`, `y' = y·R + p1 (r² + 2 y²) + 2 p2 x y`,
//! `R = 1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸` (OpenCV, "Camera Calibration and 3D Reconstruction"; except for `k4`, which
//! divides there: this one is nerfstudio's).

use genesplat_core::{Camera, Photo};

use super::resize::cubic;

/// Coefficients of a lens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Distortion {
    /// `k1` to `k4`.
    pub(crate) radial: [f64; 4],
    /// `p1`, `p2`.
    pub(crate) tangential: [f64; 2],
}

impl Distortion {
    /// True for a pinhole.
    pub(crate) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Where the lens maps a point of the pinhole's image plane at depth 1.
    fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let ([k1, k2, k3, k4], [p1, p2]) = (self.radial, self.tangential);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }
}

/// Largest change of the focal length, as a factor, with which a photo is undistorted.
const ZOOM_MAX: f64 = 4.0;

/// `photo`, taken by `camera` through a lens, as a pinhole sees it, and that pinhole; `None` if the lens is stronger
/// than its model can undo.
///
/// The size and the principal point stay. The focal length becomes the shortest with which every pixel shows part of
/// the photo, so no black rim is trained on.
pub(crate) fn undistort(photo: &Photo, camera: &Camera, lens: &Distortion) -> Option<(Photo, Camera)> {
    let zoom = min_zoom(camera, lens)?;
    let pinhole = Camera { focal_px: camera.focal_px.map(|focal| focal * zoom), ..*camera };
    let mut rgb = vec![0; photo.rgb.len()];
    let stride = 3 * photo.width as usize;
    rgb.chunks_exact_mut(stride).enumerate().for_each(|(row, values)| {
        for (column, value) in values.chunks_exact_mut(3).enumerate() {
            let source = source_pixel(camera, lens, zoom, [column as f64, row as f64]);
            value.copy_from_slice(&bicubic(photo, source));
        }
    });
    Some((Photo { rgb, ..*photo }, pinhole))
}

/// The pixel of the photo that the undistorted pixel `(u, v)` shows.
fn source_pixel(camera: &Camera, lens: &Distortion, zoom: f64, [u, v]: [f64; 2]) -> [f64; 2] {
    let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px);
    let [x, y] = lens.distort([(u + 0.5 - cx) / (zoom * fx), (v + 0.5 - cy) / (zoom * fy)]);
    [fx * x + cx - 0.5, fy * y + cy - 0.5]
}

/// The least factor of the focal length with which the rim of the undistorted photo lies inside the photo.
fn min_zoom(camera: &Camera, lens: &Distortion) -> Option<f64> {
    let (mut low, mut high) = (1.0 / ZOOM_MAX, ZOOM_MAX);
    if !rim_is_inside(camera, lens, high) {
        return None;
    }
    // 40 halvings: far below what a pixel can show.
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if rim_is_inside(camera, lens, middle) { high = middle } else { low = middle }
    }
    Some(high)
}

fn rim_is_inside(camera: &Camera, lens: &Distortion, zoom: f64) -> bool {
    let [right, bottom] = [camera.width - 1, camera.height - 1].map(f64::from);
    let along = |side: f64| (0..=side as u32).map(f64::from);
    let rows = along(right).flat_map(|u| [[u, 0.0], [u, bottom]]);
    let columns = along(bottom).flat_map(|v| [[0.0, v], [right, v]]);
    let is_inside = |at: [f64; 2]| {
        let [u, v] = source_pixel(camera, lens, zoom, at);
        (0.0..=right).contains(&u) && (0.0..=bottom).contains(&v) && moves_outwards(camera, lens, zoom, at)
    };
    rows.chain(columns).all(is_inside)
}

/// True when the distorted radius grows all the way from the middle to `(u, v)`. Beyond the radius where it turns
/// around, the polynomial folds the picture over.
fn moves_outwards(camera: &Camera, lens: &Distortion, zoom: f64, at: [f64; 2]) -> bool {
    const STEPS: u32 = 16;
    let middle = camera.principal_px.map(|c| c - 0.5);
    let distance = |step: u32| {
        let fraction = f64::from(step) / f64::from(STEPS);
        let between = [0, 1].map(|axis| middle[axis] + fraction * (at[axis] - middle[axis]));
        let [u, v] = source_pixel(camera, lens, zoom, between);
        (u - middle[0]).hypot(v - middle[1])
    };
    (0..STEPS).all(|step| distance(step) <= distance(step + 1))
}

/// The photo between its pixels, by Keys' cubic; `(u, v)` lies inside the photo.
fn bicubic(photo: &Photo, [u, v]: [f64; 2]) -> [u8; 3] {
    let (left, top) = (u.floor(), v.floor());
    let weights = |fraction: f64| [-1.0, 0.0, 1.0, 2.0].map(|offset| cubic(offset - fraction));
    let (across, down) = (weights(u - left), weights(v - top));
    let at = |first: f64, tap: usize, side: u32| (first as i64 + tap as i64 - 1).clamp(0, i64::from(side) - 1) as u32;
    let mut sums = [0.5; 3];
    for (row, down) in down.iter().enumerate() {
        for (column, across) in across.iter().enumerate() {
            let pixel = photo.pixel(at(left, column, photo.width), at(top, row, photo.height));
            for (sum, value) in sums.iter_mut().zip(pixel) {
                *sum += down * across * f64::from(value);
            }
        }
    }
    sums.map(|sum| sum as u8)
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    const LENS: Distortion = Distortion { radial: [-0.25, 0.08, 0.01, 0.0], tangential: [-0.004, 0.003] };

    fn camera() -> Camera {
        Camera {
            width: 120,
            height: 80,
            focal_px: [100.0, 101.0],
            principal_px: [58.5, 41.25],
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::ZERO,
        }
    }

    /// A smooth pattern on the plane at depth 1.
    fn pattern(x: f64, y: f64) -> u8 {
        (128.0 + 60.0 * (9.0 * x).sin() + 50.0 * (11.0 * y + 1.0).cos()) as u8
    }

    /// The photo that `camera` takes of the pattern through `lens`: each pixel is undistorted by fixed-point iteration.
    fn photograph(camera: &Camera, lens: &Distortion) -> Photo {
        let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px);
        let value = |index: u32| {
            let (u, v) = (f64::from(index % camera.width), f64::from(index / camera.width));
            let distorted = [(u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy];
            let mut undistorted = distorted;
            for _ in 0..50 {
                let again = lens.distort(undistorted);
                undistorted = [0, 1].map(|axis| undistorted[axis] + distorted[axis] - again[axis]);
            }
            [pattern(undistorted[0], undistorted[1]); 3]
        };
        let rgb = (0..camera.width * camera.height).flat_map(value).collect();
        Photo { width: camera.width, height: camera.height, rgb }
    }

    #[test]
    fn an_undistorted_photo_is_what_a_pinhole_takes() {
        let distorted = photograph(&camera(), &LENS);
        let (undistorted, pinhole) = undistort(&distorted, &camera(), &LENS).unwrap();
        let expected = photograph(&pinhole, &Distortion::default());
        let worst = |a: &Photo| a.rgb.iter().zip(&expected.rgb).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(worst(&undistorted) <= 3, "differs by {} of 255", worst(&undistorted));
        assert!(worst(&distorted) > 10, "the lens is too weak to test anything");
    }

    #[test]
    fn a_pinhole_stays_as_it_is() {
        let photo = photograph(&camera(), &Distortion::default());
        let (same, pinhole) = undistort(&photo, &camera(), &Distortion::default()).unwrap();
        assert!((pinhole.focal_px[0] - 100.0).abs() < 1e-6);
        assert_eq!(same, photo);
    }

    #[test]
    fn a_lens_that_folds_the_picture_over_is_refused_or_cut_before_the_fold() {
        let fold = Distortion { radial: [-1.0, 0.0, 0.0, 0.0], tangential: [0.0; 2] };
        let photo = photograph(&camera(), &Distortion::default());
        let (_, pinhole) = undistort(&photo, &camera(), &fold).unwrap();
        // r − r³ turns around at 1/√3.
        let corner = 60.0f64.hypot(40.0) / pinhole.focal_px[0];
        assert!(corner < 0.6, "{corner}");
        let hopeless = Distortion { radial: [f64::NAN; 4], tangential: [0.0; 2] };
        assert!(undistort(&photo, &camera(), &hopeless).is_none());
    }
}
