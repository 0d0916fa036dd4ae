//! What stages cost, and what the device's memory can do.

use std::time::Instant;

use super::held::GpuBackend;
use crate::Result;
use crate::device::Recorder;
use crate::device::timing::Timestamps;

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

    /// Waits for the device and returns the seconds of each stage since the last call (of the first 64
    /// passes); none unless they are timed.
    pub fn take_stage_seconds(&mut self) -> Result<Vec<(&'static str, f64)>> {
        self.finish_queued_steps()?;
        let Some(timestamps) = &mut self.timestamps else { return Ok(Vec::new()) };
        let seconds =
            if timestamps.stages.is_empty() { Vec::new() } else { timestamps.seconds(&self.engine)? };
        timestamps.stages.clear();
        Ok(seconds)
    }

    /// Bytes a second that the device's memory reads and writes, both counted, when `bytes` are copied again
    /// and again: by the host's clock, many copies less a few, so without what it takes to submit and to
    /// wait.
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
