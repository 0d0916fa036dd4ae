//! Dilation of a projected covariance, and the dimming that makes up for it (Kerbl et al. 2023; Yu et al.
//! 2024, section
//! 5.2; constants of their released code).
//!
//! Derivatives are the true ones. Mip-Splatting's released backward adds 1e-6 to some denominators, and
//! 3DGS's antialiasing differentiates the wrong determinant; neither is followed.

use genesplat_core::ScreenFilter;

use crate::project::Symmetric2;

/// Floor of the determinant ratio under the square root of 3DGS's antialiasing.
const ANTIALIASED_RATIO_MIN: f64 = 2.5e-5;

/// Mip-Splatting's stabiliser: floor of both determinants (px⁴), at which a splat vanishes, and addend
/// elsewhere.
const MIP_EPSILON: f64 = 1e-6;

/// A filtered covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered {
    /// Dilated covariance, px².
    pub covariance_px: Symmetric2,
    /// Factor on the opacity.
    pub compensation: f64,
    /// Derivative of `compensation` by the entries of the covariance before dilation.
    pub compensation_slope: Symmetric2,
}

/// Applies `filter` to a projected covariance (px²).
pub fn apply(filter: ScreenFilter, before: Symmetric2) -> Filtered {
    let dilation = f64::from(filter.dilation());
    let after = Symmetric2 { xx: before.xx + dilation, xy: before.xy, yy: before.yy + dilation };
    let (compensation, by_before, by_after) = match filter {
        ScreenFilter::Classic => (1.0, 0.0, 0.0),
        ScreenFilter::Antialiased => antialiased(before.determinant(), after.determinant()),
        ScreenFilter::Mip => mip(before.determinant(), after.determinant()),
    };
    let slope = |d: Symmetric2, by: f64| Symmetric2 { xx: by * d.yy, xy: -2.0 * by * d.xy, yy: by * d.xx };
    Filtered {
        covariance_px: after,
        compensation,
        compensation_slope: slope(before, by_before) + slope(after, by_after),
    }
}

/// `sqrt(max(floor, det0/det1))` and its derivatives by both determinants.
fn antialiased(before: f64, after: f64) -> (f64, f64, f64) {
    let ratio = before / after;
    if ratio <= ANTIALIASED_RATIO_MIN {
        return (ANTIALIASED_RATIO_MIN.sqrt(), 0.0, 0.0);
    }
    let compensation = ratio.sqrt();
    (compensation, 0.5 / (compensation * after), -0.5 * compensation / after)
}

/// `sqrt(det0/(det1 + ε) + ε)`, or 0 where a determinant is at or below ε, and its derivatives by both.
fn mip(before: f64, after: f64) -> (f64, f64, f64) {
    if before <= MIP_EPSILON || after <= MIP_EPSILON {
        return (0.0, 0.0, 0.0);
    }
    let denominator = after + MIP_EPSILON;
    let compensation = (before / denominator + MIP_EPSILON).sqrt();
    let by_ratio = 0.5 / compensation;
    (compensation, by_ratio / denominator, -by_ratio * before / (denominator * denominator))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: Symmetric2 = Symmetric2 { xx: 2.0, xy: 0.5, yy: 1.0 };

    #[test]
    fn hand_computed_values() {
        // det0 = 2·1 − 0.25 = 1.75.
        let classic = apply(ScreenFilter::Classic, BEFORE);
        assert!((classic.covariance_px.xx - 2.3).abs() < 1e-7 && classic.covariance_px.xy == 0.5);
        assert_eq!(classic.compensation, 1.0);
        // det1 = 2.3·1.3 − 0.25 = 2.74.
        let antialiased = apply(ScreenFilter::Antialiased, BEFORE);
        assert!((antialiased.compensation - (1.75f64 / 2.74).sqrt()).abs() < 1e-7);
        // det1 = 2.1·1.1 − 0.25 = 2.06.
        let mip = apply(ScreenFilter::Mip, BEFORE);
        assert!((mip.compensation - (1.75f64 / 2.060_001 + 1e-6).sqrt()).abs() < 1e-7);
    }

    #[test]
    fn a_needle_is_floored_or_vanishes() {
        let needle = Symmetric2 { xx: 1e-7, xy: 0.0, yy: 1.0 };
        assert_eq!(apply(ScreenFilter::Antialiased, needle).compensation, 0.005);
        assert_eq!(apply(ScreenFilter::Antialiased, needle).compensation_slope, Symmetric2::default());
        assert_eq!(apply(ScreenFilter::Mip, needle).compensation, 0.0);
        assert_eq!(apply(ScreenFilter::Mip, needle).compensation_slope, Symmetric2::default());
    }
}
