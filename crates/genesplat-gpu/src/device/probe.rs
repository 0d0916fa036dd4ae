//! What a device's subgroups really do. WGSL promises neither that a subgroup's invocations are neighbours
//! nor that all of them are there, and drivers get ballots wrong. So a kernel tests it before any other
//! relies on it.

use wgpu::ErrorFilter;

use crate::Result;
use crate::device::{Engine, Grid, Recorder, shaders};
use crate::layout::GROUP;

/// Invocations of a subgroup, if subgroups do on this device what kernels rely on.
pub(crate) fn subgroup_width(engine: &Engine) -> Result<Option<u32>> {
    let widths = attempt(engine, || {
        let found = engine.allocate("subgroups", 4 * u64::from(GROUP))?;
        let mut recorder = Recorder::new(engine, None);
        recorder.run(&shaders::PROBE_SUBGROUPS, &[found.all()], Grid::Groups(1));
        recorder.submit();
        engine.read_values::<u32>(&found, GROUP.into())
    })?;
    let is_right = |widths: &Vec<u32>| widths[0] > 0 && widths.iter().all(|&width| width == widths[0]);
    Ok(widths.filter(is_right).map(|widths| widths[0]))
}

/// What `run` comes to; `None` where the device refuses a kernel of it, as one that does not compile here:
/// that is an answer, too.
pub(crate) fn attempt<T>(engine: &Engine, run: impl FnOnce() -> Result<T>) -> Result<Option<T>> {
    let scopes =
        [ErrorFilter::Validation, ErrorFilter::Internal].map(|kind| engine.device.push_error_scope(kind));
    let result = run();
    let errors = scopes.into_iter().rev().filter_map(|scope| pollster::block_on(scope.pop()));
    if errors.count() > 0 { Ok(None) } else { result.map(Some) }
}
