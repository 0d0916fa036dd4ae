//! Lenses: where a real camera shows what a pinhole would show at a point of its image plane at depth 1.
//!
//! Every model is a projection, which scales the distance from the axis, and then a polynomial. The
//! polynomial is Brown's as OpenCV writes it: with `r² = x² + y²`,
//! `x' = x·R + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴`, `y' = y·R + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4
//! r⁴`, `R = (1 + k1 r² + k2 r⁴ + ...) / (1 + d1 r² + d2 r⁴ + d3 r⁶)`.
//! Sources: OpenCV, "Camera Calibration and 3D Reconstruction"; COLMAP's documentation of its camera models;
//! Devernay and Faugeras 2001 (field of view), Fitzgibbon 2001 (division), Khomutenko et al. 2016 (enhanced
//! unified model).

use std::f64::consts::FRAC_PI_2;

/// What bends a photo; the default is a pinhole, which bends nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lens {
    pub(crate) projection: Projection,
    pub(crate) polynomial: Polynomial,
}

/// How the distance `r` from the axis grows with the angle `θ` between ray and axis; a pinhole's is `tan θ`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Projection {
    #[default]
    Perspective,
    /// `θ`.
    Fisheye,
    /// `atan(2 tan θ tan(ω/2)) / ω`.
    FieldOfView { omega: f64 },
    /// `r' = r (1 + k r'²)`, with the pinhole's `r`.
    Division { k: f64 },
    /// `r / (α sqrt(β r² + 1) + 1 − α)`.
    EnhancedUnified { alpha: f64, beta: f64 },
    /// No `r`, but longitude and latitude: all around.
    Equirectangular,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Polynomial {
    /// `k1`, `k2`, ...
    pub(crate) radial: [f64; 6],
    pub(crate) divisor: [f64; 3],
    /// `p1`, `p2`.
    pub(crate) tangential: [f64; 2],
    /// `[s1, s2]` and `[s3, s4]`.
    pub(crate) prism: [[f64; 2]; 2],
    /// Whether the tangential and prism terms are those of the point that the radial ones have moved.
    pub(crate) radial_first: bool,
}

impl Lens {
    /// True for a pinhole.
    pub(crate) fn is_pinhole(&self) -> bool {
        *self == Self::default()
    }

    /// Whether photos show all around, and their left and right ends meet.
    pub(crate) fn is_round(&self) -> bool {
        self.projection == Projection::Equirectangular
    }

    /// All that it is: which projection, and the coefficients.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        let projection = match self.projection {
            Projection::Perspective => [0.0; 3],
            Projection::Fisheye => [1.0, 0.0, 0.0],
            Projection::FieldOfView { omega } => [2.0, omega, 0.0],
            Projection::Division { k } => [3.0, k, 0.0],
            Projection::EnhancedUnified { alpha, beta } => [4.0, alpha, beta],
            Projection::Equirectangular => [5.0, 0.0, 0.0],
        };
        let Polynomial { radial, divisor, tangential, prism, radial_first } = self.polynomial;
        let order = [f64::from(u8::from(radial_first))];
        [&projection[..], &radial, &divisor, &tangential, prism.as_flattened(), &order].concat()
    }

    /// Where the lens shows the point `(x, y)` of the pinhole's image plane; not finite where it shows it
    /// nowhere.
    pub(crate) fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        self.show([x, y, 1.0])
    }

    /// The same of what lies in this direction of the camera's frame, which may be behind it.
    pub(crate) fn show(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        if self.projection == Projection::Equirectangular {
            return [x.atan2(z), y.atan2(x.hypot(z))];
        }
        let factor = self.projection.factor((x * x + y * y).sqrt(), z);
        self.polynomial.bend([factor * x, factor * y])
    }

    /// The inverse of [`Self::distort`]; `None` where no ray in front of the camera is shown.
    pub(crate) fn undistort(&self, shown: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = self.polynomial.unbend(shown)?;
        let factor = self.projection.inverse_factor(x.hypot(y))?;
        Some([factor * x, factor * y])
    }

    /// True when the distance from the axis grows all the way to `point`: where it turns around, the model
    /// folds the picture over.
    pub(crate) fn grows_to(&self, point: [f64; 2]) -> bool {
        const STEPS: u32 = 32;
        let distance = |step: u32| {
            let fraction = f64::from(step) / f64::from(STEPS);
            let [x, y] = self.distort(point.map(|coordinate| fraction * coordinate));
            x.hypot(y)
        };
        (0..STEPS).all(|step| distance(step) <= distance(step + 1))
    }
}

impl Projection {
    /// The lens's distance from the axis, divided by that of a point at depth `z`, `r`.
    fn factor(self, r: f64, z: f64) -> f64 {
        match self {
            Self::Perspective | Self::FieldOfView { omega: 0.0 } | Self::Equirectangular => ahead(z),
            Self::Fisheye => angle_over(r, z),
            Self::FieldOfView { omega } => {
                let steepness = 2.0 * (0.5 * omega).tan();
                angle_over(r * steepness, z) * steepness / omega
            }
            Self::Division { k } => 2.0 / (z + (z * z - 4.0 * k * r * r).sqrt()),
            Self::EnhancedUnified { alpha, beta } => {
                1.0 / (alpha * (beta * r * r + z * z).sqrt() + (1.0 - alpha) * z)
            }
        }
    }

    /// The pinhole's distance from the axis, divided by the lens's, `r`.
    fn inverse_factor(self, r: f64) -> Option<f64> {
        let factor = match self {
            Self::Perspective | Self::FieldOfView { omega: 0.0 } => 1.0,
            Self::Fisheye if r < FRAC_PI_2 => 1.0 / over(r, r.tan()),
            Self::FieldOfView { omega } if r * omega < FRAC_PI_2 => {
                omega / (2.0 * (0.5 * omega).tan() * over(r * omega, (r * omega).tan()))
            }
            Self::Division { k } => 1.0 / (1.0 + k * r * r),
            Self::EnhancedUnified { alpha, beta } => {
                let root = (1.0 - (2.0 * alpha - 1.0) * beta * r * r).sqrt();
                (alpha * root + 1.0 - alpha) / (1.0 - alpha * alpha * beta * r * r)
            }
            Self::Fisheye | Self::FieldOfView { .. } | Self::Equirectangular => return None,
        };
        (factor.is_finite() && factor > 0.0).then_some(factor)
    }
}

/// What a pinhole shows: nothing behind it.
fn ahead(z: f64) -> f64 {
    if z > 0.0 { 1.0 / z } else { f64::NAN }
}

/// The angle between the axis and a point at the distance `r` from it and depth `z`, divided by `r`.
fn angle_over(r: f64, z: f64) -> f64 {
    if r < 1e-12 { ahead(z) } else { r.atan2(z) / r }
}

/// `value / of` for two that vanish together, with a ratio of 1.
fn over(value: f64, of: f64) -> f64 {
    if of.abs() < 1e-12 { 1.0 } else { value / of }
}

impl Polynomial {
    fn bend(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let series = |coefficients: &[f64]| 1.0 + r2 * coefficients.iter().rfold(0.0, |sum, k| k + r2 * sum);
        let radial = series(&self.radial) / series(&self.divisor);
        let moved = [radial * x, radial * y];
        let ([x, y], [p1, p2]) = (if self.radial_first { moved } else { [x, y] }, self.tangential);
        let r2 = x * x + y * y;
        let prism = self.prism.map(|[s1, s2]| r2 * (s1 + s2 * r2));
        [
            moved[0] + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + prism[0],
            moved[1] + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + prism[1],
        ]
    }

    /// The inverse of [`Self::bend`], by Newton's method from `bent` on.
    fn unbend(&self, bent: [f64; 2]) -> Option<[f64; 2]> {
        const ITERATIONS_MAX: u32 = 100;
        const STEP: f64 = 1e-6;
        let [mut x, mut y] = bent;
        for _ in 0..ITERATIONS_MAX {
            let at = |x, y| {
                let [bx, by] = self.bend([x, y]);
                [bx - bent[0], by - bent[1]]
            };
            let ([u, v], right, left) = (at(x, y), at(x + STEP, y), at(x - STEP, y));
            let (below, above) = (at(x, y + STEP), at(x, y - STEP));
            let slope = |after: f64, before: f64| (after - before) / (2.0 * STEP);
            let (ux, vx) = (slope(right[0], left[0]), slope(right[1], left[1]));
            let (uy, vy) = (slope(below[0], above[0]), slope(below[1], above[1]));
            let determinant = ux * vy - uy * vx;
            let (dx, dy) = ((u * vy - v * uy) / determinant, (v * ux - u * vx) / determinant);
            (x, y) = (x - dx, y - dy);
            match dx.hypot(dy) {
                step if !step.is_finite() => return None,
                step if step < 1e-10 => return Some([x, y]),
                _ => {}
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BROWN: Polynomial = Polynomial {
        radial: [-0.2, 0.05, 0.01, -0.002, 0.0, 0.0],
        divisor: [0.02, -0.01, 0.003],
        tangential: [-0.004, 0.003],
        prism: [[0.002, -0.001], [-0.003, 0.0005]],
        radial_first: false,
    };

    fn lenses() -> Vec<Lens> {
        let projections = [
            Projection::Perspective,
            Projection::Fisheye,
            Projection::FieldOfView { omega: 0.9 },
            Projection::FieldOfView { omega: 0.0 },
            Projection::Division { k: -0.15 },
            Projection::EnhancedUnified { alpha: 0.6, beta: 1.1 },
        ];
        let polynomials = [Polynomial::default(), BROWN, Polynomial { radial_first: true, ..BROWN }];
        let pairs = projections
            .into_iter()
            .flat_map(|projection| polynomials.map(|polynomial| (projection, polynomial)));
        pairs.map(|(projection, polynomial)| Lens { projection, polynomial }).collect()
    }

    #[test]
    fn undistorting_is_the_inverse_of_distorting() {
        for lens in lenses() {
            for point in [[0.0, 0.0], [1e-9, 0.0], [0.3, -0.2], [-0.7, 0.5], [0.05, 0.6]] {
                let [x, y] = lens.undistort(lens.distort(point)).unwrap();
                assert!((x - point[0]).hypot(y - point[1]) < 1e-8, "{lens:?} at {point:?}: {x}, {y}");
            }
        }
    }

    #[test]
    fn near_the_axis_a_fisheye_is_a_pinhole_and_far_from_it_shows_less() {
        let fisheye = Lens { projection: Projection::Fisheye, ..Lens::default() };
        assert!((fisheye.distort([1e-4, 0.0])[0] - 1e-4).abs() < 1e-10);
        assert!((fisheye.distort([1.0, 0.0])[0] - std::f64::consts::FRAC_PI_4).abs() < 1e-12);
        assert_eq!(fisheye.undistort([1.6, 0.0]), None, "behind the camera");
    }

    #[test]
    fn a_fold_is_seen() {
        let radial = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let lens = Lens { polynomial: Polynomial { radial, ..Polynomial::default() }, ..Lens::default() };
        // r - r³ turns around at 1/√3.
        assert!(lens.grows_to([0.55, 0.0]) && !lens.grows_to([0.6, 0.0]));
        assert!(
            !Lens { projection: Projection::Division { k: 1.0 }, ..Lens::default() }.grows_to([0.0, 2.0])
        );
    }
}
