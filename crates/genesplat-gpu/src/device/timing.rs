//! What each stage costs, by the device's own clock.

use std::time::Instant;

use wgpu::{QuerySet, QuerySetDescriptor, QueryType};

use crate::Result;
use crate::backend::GpuBackend;
use crate::device::{Engine, Recorder};

/// Passes that are timed between two readings, eight steps of eight passes; later ones are left out.
pub(crate) const TIMED_PASSES: u32 = 64;

/// Two timestamps for each pass, and the stage that it belongs to.
pub(crate) struct Timestamps {
    pub(crate) queries: QuerySet,
    pub(crate) stages: Vec<&'static str>,
}

impl Timestamps {
    fn new(engine: &Engine) -> Self {
        let descriptor =
            QuerySetDescriptor { label: Some("stages"), ty: QueryType::Timestamp, count: 2 * TIMED_PASSES };
        Self { queries: engine.device.create_query_set(&descriptor), stages: Vec::new() }
    }

    /// Seconds of each stage, in the order in which they began.
    fn seconds(&self, engine: &Engine) -> Result<Vec<(&'static str, f64)>> {
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

impl GpuBackend {
    /// From here on, stages are timed; false where the device has no clock.
    pub fn start_timing(&mut self) -> bool {
        self.timestamps = self.engine.timestamps.then(|| Timestamps::new(&self.engine));
        self.timestamps.is_some()
    }

    /// From here on, stages are not timed.
    pub fn stop_timing(&mut self) {
        self.timestamps = None;
    }

    /// Waits for the device and returns the seconds of each stage since the last call (of the first 64 passes); none
    /// unless they are timed.
    pub fn take_stage_seconds(&mut self) -> Result<Vec<(&'static str, f64)>> {
        self.finish_queued_steps()?;
        let Some(timestamps) = &mut self.timestamps else { return Ok(Vec::new()) };
        let seconds = if timestamps.stages.is_empty() { Vec::new() } else { timestamps.seconds(&self.engine)? };
        timestamps.stages.clear();
        Ok(seconds)
    }

    /// Bytes a second that the device's memory reads and writes, both counted, when `bytes` are copied again and again:
    /// by the host's clock, many copies less a few, so without what it takes to submit and to wait.
    pub fn memory_bandwidth(&mut self, bytes: u64) -> Result<f64> {
        const COPIES: [u32; 2] = [16, 80];
        self.finish_queued_steps()?;
        let from = self.engine.allocate("bytes to copy", bytes)?;
        let to = self.engine.allocate("a copy of bytes", bytes)?;
        let seconds = |times| {
            let mut recorder = Recorder::new(&self.engine, None);
            (0..times).for_each(|_| recorder.copy(&from, &to));
            let clock = Instant::now();
            recorder.submit();
            self.engine.wait().map(|()| clock.elapsed().as_secs_f64())
        };
        seconds(1)?;
        let [few, many] = [seconds(COPIES[0])?, seconds(COPIES[1])?];
        let rate = |copies: u32, seconds: f64| 2.0 * f64::from(copies) * from.bytes as f64 / seconds;
        // Where the machine was disturbed during the few, the many alone are a lower bound.
        let is_sound = few < many;
        Ok(if is_sound { rate(COPIES[1] - COPIES[0], many - few) } else { rate(COPIES[1], many) })
    }
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
