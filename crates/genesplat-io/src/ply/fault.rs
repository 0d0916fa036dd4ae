//! Gaussians that cannot be shown: which they are, and the cloud without them.

use std::fmt;

use genesplat_core::Gaussians;

use crate::listing::position_problem;

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
        let filter_3d = || {
            let filter = cloud.filter_3d.as_ref().map_or(0.0, |filters| filters[row]);
            (!(filter.is_finite() && filter >= 0.0)).then_some("filter_3D")
        };
        let fault = |parameter, problem| Self { row, parameter, problem };
        match cloud.non_finite_of(row).or_else(filter_3d) {
            Some(parameter) => Some(fault(parameter, "is not finite")),
            None => position_problem(cloud.positions[row].map(f64::from)).map(|problem| fault("position", problem)),
        }
    }
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
