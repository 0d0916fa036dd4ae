//! Undoes the distortion of lenses: photos as a pinhole would have taken them.
//!
//! The pinhole is the one of COLMAP's `image_undistorter` with its default settings (`blank_pixels` 0): focal
//! lengths stay, and the picture is cut to the largest rectangle, with the principal point at the same
//! fraction of its sides, that shows nothing but the photo. So a reconstruction trains to the same result
//! whether COLMAP has undistorted it or not. Where a lens folds the picture over, the rectangle is made
//! smaller until it ends before the fold.

use genesplat_core::{Camera, Photo};

use super::lens::Lens;
use super::mask::PhotoMask;
use super::resize::resize;

/// Least and largest side of the undistorted picture, as a factor of the photo's (COLMAP,
/// `UndistortCameraOptions`).
const SCALES: [f64; 2] = [0.2, 2.0];
/// A rim may lie so far outside of the photo, px: the pixel there is that of the photo's own rim.
const RIM_TOLERANCE_PX: f64 = 1.0;

/// The pinhole that takes the undistorted photo of `camera`; `None` if its lens is stronger than its model
/// can undo.
pub(crate) fn pinhole(camera: &Camera, lens: &Lens) -> Option<Camera> {
    let scales = [0, 1].map(|axis| content_scale(camera, lens, axis).clamp(SCALES[0], SCALES[1]));
    let cut = |part: f64| cut_to(camera, scales.map(|scale| part * scale));
    let shows_photo = |part: f64| shows_photo_only(&cut(part), camera, lens);
    if shows_photo(1.0) {
        return Some(cut(1.0));
    }
    let (mut low, mut high) = (0.05, 1.0);
    if !shows_photo(low) {
        return None;
    }
    // 14 halvings: finer than a pixel.
    for _ in 0..14 {
        let middle = 0.5 * (low + high);
        if shows_photo(middle) { low = middle } else { high = middle }
    }
    Some(cut(low))
}

/// How long a side along `axis` may be, as a factor of the photo's, before one of its ends leaves the photo
/// somewhere.
fn content_scale(camera: &Camera, lens: &Lens, axis: usize) -> f64 {
    let sides = [camera.width, camera.height];
    let (side, centre) = (f64::from(sides[axis]), camera.principal_px[axis]);
    let rim = |at: f64| {
        (0..sides[1 - axis]).filter_map(move |across| {
            let mut shown = [f64::from(across) + 0.5; 2];
            shown[axis] = at;
            // Beyond a fold, another point than the one that is shown has the same place.
            let point = lens.undistort(normalised(camera, shown)).filter(|point| lens.grows_to(*point))?;
            Some(camera.focal_px[axis] * point[axis] + centre)
        })
    };
    let near = rim(0.5).fold(f64::NEG_INFINITY, f64::max);
    let far = rim(side - 0.5).fold(f64::INFINITY, f64::min);
    ((centre - near) / centre).min((far - centre) / (side - 0.5 - centre))
}

/// `camera` with sides of these factors of its own, whole pixels, and the principal point at the same
/// fraction of them.
fn cut_to(camera: &Camera, scales: [f64; 2]) -> Camera {
    let cut = |side: u32, scale: f64| ((f64::from(side) * scale) as u32).max(1);
    let [width, height] = [cut(camera.width, scales[0]), cut(camera.height, scales[1])];
    let resized = camera.resized(width, height);
    Camera { focal_px: camera.focal_px, ..resized }
}

/// True when the rim of `pinhole`'s picture lies inside the photo, and the lens has not folded before it.
fn shows_photo_only(pinhole: &Camera, camera: &Camera, lens: &Lens) -> bool {
    const POINTS_A_SIDE: u32 = 256;
    let [right, bottom] = [pinhole.width, pinhole.height].map(f64::from);
    let along = |side: f64| (0..=POINTS_A_SIDE).map(move |i| side * f64::from(i) / f64::from(POINTS_A_SIDE));
    let rows = along(right).flat_map(|u| [[u, 0.0], [u, bottom]]);
    let columns = along(bottom).flat_map(|v| [[0.0, v], [right, v]]);
    let inside = -RIM_TOLERANCE_PX;
    let is_shown = |at: [f64; 2]| {
        let point = normalised(pinhole, at);
        let [u, v] = source(camera, lens, point);
        let (width, height) = (f64::from(camera.width) - inside, f64::from(camera.height) - inside);
        (inside..=width).contains(&u) && (inside..=height).contains(&v) && lens.grows_to(point)
    };
    rows.chain(columns).all(is_shown)
}

/// Pixels from the corner to the image plane at depth 1.
fn normalised(camera: &Camera, at_px: [f64; 2]) -> [f64; 2] {
    [0, 1].map(|axis| (at_px[axis] - camera.principal_px[axis]) / camera.focal_px[axis])
}

/// Where the photo of `camera` shows a point of the image plane at depth 1: pixels from its corner.
fn source(camera: &Camera, lens: &Lens, point: [f64; 2]) -> [f64; 2] {
    let shown = lens.distort(point);
    [0, 1].map(|axis| camera.focal_px[axis] * shown[axis] + camera.principal_px[axis])
}

/// Where the photo of `camera` shows what a picture of `pinhole` shows at a place, both pixels from the
/// corner.
pub(crate) fn source_px(camera: &Camera, lens: &Lens, pinhole: &Camera, at_px: [f64; 2]) -> [f64; 2] {
    source(camera, lens, normalised(pinhole, at_px))
}

/// `photo`, taken by `camera` through a lens, as [`pinhole`] takes it, at a width and height that are not
/// above its own.
///
/// Photo and picture are handled at twice that size, or at their own where that is smaller: the pixels
/// between which the resampling interpolates are then finer than those that are kept, so it does not blur
/// them.
pub(crate) fn undistort(
    photo: &Photo,
    camera: &Camera,
    lens: &Lens,
    pinhole: &Camera,
    size: [u32; 2],
) -> Photo {
    let (camera, fine) = fine_cameras(camera, pinhole, size);
    resize(&resample(&resize(photo, camera.width, camera.height), &camera, lens, &fine), size[0], size[1])
}

/// The same of its mask: a pixel counts where all that [`undistort`] mixes there does.
pub(crate) fn undistort_mask(
    mask: &PhotoMask,
    camera: &Camera,
    lens: &Lens,
    pinhole: &Camera,
    size: [u32; 2],
) -> PhotoMask {
    let (camera, fine) = fine_cameras(camera, pinhole, size);
    let reduced = mask.resized([camera.width, camera.height]);
    let map = Map::of(&camera, lens, &fine);
    let counts = |[u, v]: [f64; 2]| {
        let [columns, rows] = [taps(floor(u), camera.width), taps(floor(v), camera.height)];
        rows.iter().all(|&row| columns.iter().all(|&column| reduced.counts_at(column, row)))
    };
    let counts = (0..fine.height).flat_map(|row| map.row(row).into_iter().map(counts)).collect();
    PhotoMask { size: [fine.width, fine.height], counts }.resized(size)
}

/// The cameras of the photo and of the picture at the size at which they are handled.
fn fine_cameras(camera: &Camera, pinhole: &Camera, [width, height]: [u32; 2]) -> (Camera, Camera) {
    let fine = pinhole.resized(pinhole.width.min(2 * width), pinhole.height.min(2 * height));
    let reduced = |side: u32, part: u32, whole: u32| {
        (f64::from(side) * f64::from(part) / f64::from(whole)).round().max(1.0) as u32
    };
    let [across, down] = [
        reduced(camera.width, fine.width, pinhole.width),
        reduced(camera.height, fine.height, pinhole.height),
    ];
    (camera.resized(across, down), fine)
}

/// Where a photo shows what a pinhole shows: for each row of pixels exactly at some of them, and by cubics in
/// between, which are off by less than a thousandth of a pixel.
struct Map<'a> {
    camera: &'a Camera,
    lens: &'a Lens,
    pinhole: &'a Camera,
    nodes: u32,
    /// Distance of two nodes, px.
    spacing: f64,
    /// For each column the first of four nodes, and their weights.
    columns: Vec<(usize, [f64; 4])>,
}

impl<'a> Map<'a> {
    fn of(camera: &'a Camera, lens: &'a Lens, pinhole: &'a Camera) -> Self {
        const SPACING_MAX_PX: u32 = 16;
        let last = pinhole.width - 1;
        let nodes = (last.div_ceil(SPACING_MAX_PX) + 1).max(4);
        let spacing = (f64::from(last) / f64::from(nodes - 1)).max(1.0);
        let column = |column: u32| {
            let at = f64::from(column) / spacing;
            // Two nodes to either side, where there are as many.
            let first = (floor(at) - 1).clamp(0, i64::from(nodes) - 4) as usize;
            (first, through_four(at - first as f64))
        };
        Self { camera, lens, pinhole, nodes, spacing, columns: (0..pinhole.width).map(column).collect() }
    }

    /// Coordinates of pixel centres, for each column.
    fn row(&self, row: u32) -> Vec<[f64; 2]> {
        let Self { camera, lens, pinhole, .. } = self;
        let node = |node: u32| {
            let at = [f64::from(node) * self.spacing + 0.5, f64::from(row) + 0.5];
            source(camera, lens, normalised(pinhole, at)).map(|at| at - 0.5)
        };
        let nodes: Vec<[f64; 2]> = (0..self.nodes).map(node).collect();
        let between = |(first, weights): &(usize, [f64; 4])| {
            let near = nodes[*first..].iter().zip(weights);
            near.fold([0.0; 2], |[u, v], (node, weight)| [u + weight * node[0], v + weight * node[1]])
        };
        self.columns.iter().map(between).collect()
    }
}

/// Lagrange's weights at `t` for values at 0, 1, 2 and 3.
fn through_four(t: f64) -> [f64; 4] {
    let [a, b, c, d] = [t, t - 1.0, t - 2.0, t - 3.0];
    [b * c * d / -6.0, a * c * d / 2.0, a * b * d / -2.0, a * b * c / 6.0]
}

/// Without a call of the library's.
pub(super) fn floor(value: f64) -> i64 {
    let whole = value as i64;
    whole - i64::from(value < whole as f64)
}

/// The four pixels along one axis that are mixed around the two from `first` on; beyond the rim, the rim.
pub(super) fn taps(first: i64, side: u32) -> [usize; 4] {
    [-1, 0, 1, 2].map(|offset| (first.saturating_add(offset)).clamp(0, i64::from(side) - 1) as usize)
}

/// What `pinhole` takes of what `camera` has taken through `lens`.
fn resample(photo: &Photo, camera: &Camera, lens: &Lens, pinhole: &Camera) -> Photo {
    let map = Map::of(camera, lens, pinhole);
    let mut rgb = Vec::with_capacity(3 * pinhole.width as usize * pinhole.height as usize);
    for row in 0..pinhole.height {
        map.row(row).into_iter().for_each(|at| rgb.extend(bicubic(photo, at)));
    }
    Photo { width: pinhole.width, height: pinhole.height, rgb }
}

/// The photo between its pixels, by Keys' cubic; beyond its rim, the rim.
pub(super) fn bicubic(photo: &Photo, [u, v]: [f64; 2]) -> [u8; 3] {
    let (left, top) = (floor(u), floor(v));
    let (across, down) = (cubic_weights((u - left as f64) as f32), cubic_weights((v - top as f64) as f32));
    let [columns, rows] = [taps(left, photo.width), taps(top, photo.height)];
    let stride = 3 * photo.width as usize;
    // Down each of the four columns first: vectors take their twelve values side by side.
    let mut mixed = [0.0; 12];
    for (row, weight) in rows.into_iter().zip(down) {
        let row = &photo.rgb[stride * row..stride * (row + 1)];
        match row[3 * columns[0]..].first_chunk::<12>() {
            Some(values) if columns[3] == columns[0] + 3 => {
                mixed.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * f32::from(*value));
            }
            _ => (0..12).for_each(|at| mixed[at] += weight * f32::from(row[3 * columns[at / 3] + at % 3])),
        }
    }
    let sum =
        |channel: usize| (0..4).fold(0.5, |sum, column| sum + across[column] * mixed[3 * column + channel]);
    [sum(0) as u8, sum(1) as u8, sum(2) as u8]
}

/// Keys' cubic with a = −0.5 at distances of `1 + t`, `t`, `1 − t` and `2 − t`.
fn cubic_weights(t: f32) -> [f32; 4] {
    let rest = 1.0 - t;
    let outer = |t: f32, rest: f32| -0.5 * t * rest * rest;
    let inner = |t: f32| (1.5 * t - 2.5) * t * t + 1.0;
    [outer(t, rest), inner(t), inner(rest), outer(rest, t)]
}

#[cfg(test)]
mod tests {

    use super::super::lens::{Polynomial, Projection};
    use super::*;

    fn brown(radial: [f64; 3], tangential: [f64; 2]) -> Lens {
        let [k1, k2, k3] = radial;
        let polynomial =
            Polynomial { radial: [k1, k2, k3, 0.0, 0.0, 0.0], tangential, ..Polynomial::default() };
        Lens { polynomial, ..Lens::default() }
    }

    fn barrel() -> Lens {
        brown([-0.25, 0.08, 0.01], [-0.004, 0.003])
    }

    fn camera() -> Camera {
        Camera { focal_px: [100.0, 101.0], principal_px: [58.5, 41.25], ..Camera::at_origin(120, 80, 100.0) }
    }

    /// The photo that `camera` takes through `lens` of a smooth pattern on the plane at depth 1.
    fn photograph(camera: &Camera, lens: &Lens) -> Photo {
        let value = |index: u32| {
            let at = [index % camera.width, index / camera.width].map(|at| f64::from(at) + 0.5);
            let [x, y] = lens.undistort(normalised(camera, at)).unwrap_or([0.0; 2]);
            [(128.0 + 60.0 * (9.0 * x).sin() + 50.0 * (11.0 * y + 1.0).cos()) as u8; 3]
        };
        let rgb = (0..camera.width * camera.height).flat_map(value).collect();
        Photo { width: camera.width, height: camera.height, rgb }
    }

    fn undistorted(lens: &Lens, divisor: u32) -> (Photo, Camera) {
        let (photo, pinhole) = (photograph(&camera(), lens), pinhole(&camera(), lens).unwrap());
        let size = [pinhole.width / divisor, pinhole.height / divisor];
        (undistort(&photo, &camera(), lens, &pinhole, size), pinhole.resized(size[0], size[1]))
    }

    fn worst(a: &Photo, b: &Photo) -> u8 {
        assert_eq!((a.width, a.height), (b.width, b.height));
        a.rgb.iter().zip(&b.rgb).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
    }

    #[test]
    fn an_undistorted_photo_is_what_a_pinhole_takes() {
        let fisheye = Lens { projection: Projection::Fisheye, ..Lens::default() };
        let pincushion = brown([0.3, 0.0, 0.0], [0.0; 2]);
        for lens in [barrel(), pincushion, fisheye] {
            let (photo, pinhole) = undistorted(&lens, 1);
            let expected = photograph(&pinhole, &Lens::default());
            assert!(worst(&photo, &expected) <= 3, "{lens:?} differs by {} of 255", worst(&photo, &expected));
            let (left_alone, _) = undistorted(&Lens::default(), 1);
            let bent = resize(&photograph(&camera(), &lens), left_alone.width, left_alone.height);
            assert!(worst(&bent, &left_alone) > 10, "{lens:?} is too weak to test anything");
        }
    }

    #[test]
    fn the_map_is_exact_to_a_thousandth_of_a_pixel() {
        let fisheye = Lens { projection: Projection::Fisheye, ..Lens::default() };
        for (lens, side) in
            [(barrel(), 640), (fisheye, 640), (brown([0.3, 0.0, 0.0], [0.01, 0.0]), 97), (barrel(), 3)]
        {
            let camera = camera().resized(side, side);
            let map = Map::of(&camera, &lens, &camera);
            assert_eq!(map.row(0).len(), side as usize);
            for row in [0, side / 3, side - 1] {
                for (column, [u, v]) in (0..).zip(map.row(row)) {
                    let at = [column, row].map(|at: u32| f64::from(at) + 0.5);
                    let exact = source(&camera, &lens, normalised(&camera, at)).map(|at| at - 0.5);
                    assert!(
                        (u - exact[0]).hypot(v - exact[1]) < 1e-3,
                        "{lens:?}: {u}, {v} instead of {exact:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_reduced_photo_is_what_the_same_pinhole_takes_with_fewer_pixels() {
        let (photo, pinhole) = undistorted(&barrel(), 3);
        let expected = photograph(&pinhole, &Lens::default());
        assert!(worst(&photo, &expected) <= 8, "differs by {} of 255", worst(&photo, &expected));
    }

    #[test]
    fn the_largest_rectangle_without_a_border_is_kept() {
        let lens = barrel();
        let whole = pinhole(&camera(), &lens).unwrap();
        assert_eq!(whole.focal_px, camera().focal_px);
        assert!(shows_photo_only(&whole, &camera(), &lens));
        let larger = [0, 1].map(|axis| {
            let mut scales = [1.0; 2];
            scales[axis] = 1.08;
            shows_photo_only(&cut_to(&whole, scales), &camera(), &lens)
        });
        assert_eq!(larger, [false; 2], "there was more to show");
    }

    #[test]
    fn a_lens_that_folds_the_picture_over_is_refused_or_cut_before_the_fold() {
        let pinhole_of = |radial| pinhole(&camera(), &brown(radial, [0.0; 2]));
        let cut = pinhole_of([-1.0, 0.0, 0.0]).unwrap();
        // r - r³ turns around at 1/√3.
        let corner = normalised(&cut, [0.0; 2]);
        assert!((0.3..0.6).contains(&corner[0].hypot(corner[1])), "{corner:?}");
        assert_eq!(pinhole_of([f64::NAN, 0.0, 0.0]), None);
    }
}
