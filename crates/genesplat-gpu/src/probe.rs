//! What a device's subgroups really do. WGSL promises neither that a subgroup's invocations are neighbours nor that all of them
//! are there, translators and drivers get ballots wrong, and a sort that loses keys says nothing. So a kernel looks before any
//! other relies on it.

use genesplat_core::BackendError;
use wgpu::ErrorFilter;

use crate::engine::Engine;
use crate::layout::GROUP;
use crate::recorder::{Grid, Recorder};
use crate::shaders;

/// Invocations of a subgroup, if subgroups do on this device what kernels rely on.
pub(crate) fn subgroup_seats(engine: &Engine) -> Result<Option<u32>, BackendError> {
    // A kernel that does not compile here is an answer, too.
    let scopes =
        [ErrorFilter::Validation, ErrorFilter::Internal].map(|kind| engine.device.push_error_scope(kind));
    let found = engine.allocate("subgroups", 4 * u64::from(GROUP))?;
    let mut recorder = Recorder::new(engine, None);
    recorder.run(&shaders::PROBE_SUBGROUPS, &[found.all()], Grid::Groups(1));
    recorder.submit();
    let seats: Vec<u32> = engine.read_values(&found, GROUP.into())?;
    let errors = scopes.into_iter().rev().filter_map(|scope| pollster::block_on(scope.pop()));
    let is_right = errors.count() == 0 && seats[0] > 0 && seats.iter().all(|&here| here == seats[0]);
    Ok(is_right.then_some(seats[0]))
}
