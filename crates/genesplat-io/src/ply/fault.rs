//! Gaussians that cannot be shown: which they are, and the cloud without them.

use std::fmt;

use genesplat_core::Gaussians;

use crate::listing::{COORDINATE_MAX, position_problem};

/// Largest magnitude of any parameter that is believed. The squares of such values, and the sums of many, fit
/// in f32.
const VALUE_MAX: f32 = COORDINATE_MAX as f32;
/// The logarithm of that.
const LOG_SCALE_MAX: f32 = 20.723_266;

/// What is wrong with a Gaussian that cannot be shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// 0-based.
    pub row: usize,
    /// The first parameter that is wrong.
    pub parameter: &'static str,
    problem: &'static str,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the {} of Gaussian {} {}", self.parameter, self.row, self.problem)
    }
}

impl Fault {
    fn of(cloud: &Gaussians, row: usize) -> Option<Self> {
        let fault = |(parameter, problem)| Self { row, parameter, problem };
        let not_finite = |parameter| (parameter, "is not finite");
        let filter = cloud.filter_3d.as_ref().map_or(0.0, |filters| filters[row]);
        let bad_filter = (!(filter.is_finite() && filter >= 0.0)).then_some("filter_3D");
        let first = cloud.non_finite_of(row).or(bad_filter).map(not_finite);
        first.or_else(|| beyond(cloud, row, filter)).map(fault)
    }
}

/// The first parameter of a row that overflows where it is used, and what is wrong with it.
fn beyond(cloud: &Gaussians, row: usize, filter: f32) -> Option<(&'static str, &'static str)> {
    let problem = position_problem(cloud.positions[row].map(f64::from));
    let position = problem.map(|problem| ("position", problem));
    let is_beyond = |values: &[f32]| values.iter().any(|value| value.abs() > VALUE_MAX);
    let is_huge = cloud.log_scales[row].iter().any(|value| *value > LOG_SCALE_MAX);
    let size = is_huge.then_some(("log-scale", "is that of a size beyond 1e9 world units"));
    let others = [
        ("log-scale", is_beyond(&cloud.log_scales[row])),
        ("rotation", is_beyond(&cloud.rotations[row])),
        ("opacity", is_beyond(&[cloud.opacity_logits[row]])),
        ("colour", is_beyond(&cloud.sh[row])),
        ("filter_3D", is_beyond(&[filter])),
    ];
    let other = || {
        others.iter().find(|(_, is_beyond)| *is_beyond).map(|(parameter, _)| (*parameter, "lies beyond 1e9"))
    };
    position.or(size).or_else(other)
}

/// The values of a cloud without faults, so far from what is a fault that a format may round them.
pub(crate) fn away_from_faults(cloud: &mut Gaussians) {
    /// More than the floats and fractions of any format are rounded by.
    const ROUNDING: f32 = 1e-5;
    let value_max = VALUE_MAX * (1.0 - ROUNDING);
    for values in [cloud.positions.as_flattened_mut(), cloud.sh.as_flattened_mut()] {
        values.iter_mut().for_each(|value| *value = value.clamp(-value_max, value_max));
    }
    let log_scales = cloud.log_scales.as_flattened_mut().iter_mut();
    log_scales.for_each(|value| *value = value.min(LOG_SCALE_MAX * (1.0 - ROUNDING)));
}

/// What is wrong with each Gaussian that cannot be shown, row by row.
pub(crate) fn faults(cloud: &Gaussians) -> impl Iterator<Item = Fault> {
    (0..cloud.len()).filter_map(|row| Fault::of(cloud, row))
}

/// The Gaussians that can be shown, and what is wrong with each of the others, in the order of their rows.
pub fn leave_out_faults(cloud: Gaussians) -> (Gaussians, Vec<Fault>) {
    let faults: Vec<Fault> = faults(&cloud).collect();
    if faults.is_empty() {
        return (cloud, faults);
    }
    let mut left_out = faults.iter().map(|fault| fault.row as u32).peekable();
    let rows: Vec<u32> = (0..cloud.len() as u32).filter(|row| left_out.next_if_eq(row).is_none()).collect();
    (cloud.gather(&rows), faults)
}
