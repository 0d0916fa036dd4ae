//! What each stage costs, by the device's own clock.

use wgpu::{QuerySet, QuerySetDescriptor, QueryType};

use crate::Result;
use crate::device::Engine;

/// Passes that are timed between two readings, eight steps of eight passes; later ones are left out.
pub(crate) const TIMED_PASSES: u32 = 64;

/// Two timestamps for each pass, and the stage that it belongs to.
pub(crate) struct Timestamps {
    pub(crate) queries: QuerySet,
    pub(crate) stages: Vec<&'static str>,
}

impl Timestamps {
    pub(crate) fn new(engine: &Engine) -> Self {
        let descriptor =
            QuerySetDescriptor { label: Some("stages"), ty: QueryType::Timestamp, count: 2 * TIMED_PASSES };
        Self { queries: engine.device.create_query_set(&descriptor), stages: Vec::new() }
    }

    /// Seconds of each stage, in the order in which they began.
    pub(crate) fn seconds(&self, engine: &Engine) -> Result<Vec<(&'static str, f64)>> {
        let memory = engine.allocate("timestamps", 16 * u64::from(TIMED_PASSES))?;
        let mut encoder = engine.device.create_command_encoder(&Default::default());
        encoder.resolve_query_set(&self.queries, 0..2 * self.stages.len() as u32, &memory.buffer, 0);
        engine.submit([encoder.finish()]);
        let ticks: Vec<[u64; 2]> = engine.read_values(&memory, TIMED_PASSES.into())?;
        let second = 1e-9 * f64::from(engine.queue.get_timestamp_period());
        let passes = self
            .stages
            .iter()
            .zip(&ticks)
            .map(|(&stage, &[begin, end])| (stage, second * end.saturating_sub(begin) as f64));
        Ok(sum_by_stage(passes))
    }
}

fn sum_by_stage(passes: impl Iterator<Item = (&'static str, f64)>) -> Vec<(&'static str, f64)> {
    let mut stages: Vec<(&'static str, f64)> = Vec::new();
    for (name, seconds) in passes {
        match stages.iter_mut().find(|(stage, _)| *stage == name) {
            Some((_, sum)) => *sum += seconds,
            None => stages.push((name, seconds)),
        }
    }
    stages
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_of_a_stage_are_one_figure() {
        let passes = [("bin", 1.0), ("loss", 2.0), ("bin", 4.0)];
        assert_eq!(sum_by_stage(passes.into_iter()), [("bin", 5.0), ("loss", 2.0)]);
    }
}
