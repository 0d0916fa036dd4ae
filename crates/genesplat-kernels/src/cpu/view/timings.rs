//! Time spent in each stage of a training step.

use std::time::Instant;

/// Seconds spent in each stage since the counters were last taken.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageSeconds {
    /// Projection and colours.
    pub project: f64,
    /// Depth sort and tile lists.
    pub bin: f64,
    /// Forward blending, composition included.
    pub rasterise: f64,
    /// Loss and its gradient.
    pub loss: f64,
    /// Backward blending.
    pub rasterise_backward: f64,
    /// Backward projection, statistics and Adam.
    pub update: f64,
}

/// Runs `work` and adds the time it took.
pub(crate) fn timed<T>(total: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *total += start.elapsed().as_secs_f64();
    result
}
