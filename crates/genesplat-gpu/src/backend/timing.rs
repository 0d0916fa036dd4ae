//! What stages cost, and what the device's memory can do.

use std::time::{Duration, Instant};

use super::held::GpuBackend;
use crate::Result;
use crate::device::timing::Timestamps;
use crate::device::{BUFFER_BYTES_STEP, Grid, Memory, Recorder, shaders};

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

    /// Bytes a second that the device's memory reads and writes, both counted, when a kernel copies `bytes`,
    /// or as many as it can see, again and again: by the host's clock, many copies less a few, so without
    /// what it takes to submit and to wait. Before that it copies for as long as clocks take to rise.
    pub fn memory_bandwidth(&mut self, bytes: u64) -> Result<f64> {
        const COPIES: [u32; 2] = [16, 80];
        self.finish_queued_steps()?;
        let bytes = bytes.min(self.engine.binding_bytes / BUFFER_BYTES_STEP * BUFFER_BYTES_STEP);
        let from = self.engine.allocate("bytes to copy", bytes)?;
        let to = self.engine.allocate("a copy of bytes", bytes)?;
        let began = Instant::now();
        while began.elapsed() < WARM_UP {
            self.seconds_of_copies(&from, &to, COPIES[0])?;
        }
        let few = self.seconds_of_copies(&from, &to, COPIES[0])?;
        let many = self.seconds_of_copies(&from, &to, COPIES[1])?;
        let rate = |copies: u32, seconds: f64| 2.0 * f64::from(copies) * from.bytes as f64 / seconds;
        // Where the machine was disturbed during the few, the many alone are a lower bound.
        let is_sound = few < many;
        Ok(if is_sound { rate(COPIES[1] - COPIES[0], many - few) } else { rate(COPIES[1], many) })
    }

    fn seconds_of_copies(&self, from: &Memory, to: &Memory, times: u32) -> Result<f64> {
        let mut recorder = Recorder::new(&self.engine, None);
        let grid = Grid::Items(from.bytes / BUFFER_BYTES_STEP);
        (0..times).for_each(|_| recorder.run(&shaders::COPY, &[from.all(), to.all()], grid));
        let clock = Instant::now();
        recorder.submit();
        self.engine.wait().map(|()| clock.elapsed().as_secs_f64())
    }
}

/// What a card's clock needs to rise, and more.
const WARM_UP: Duration = Duration::from_millis(300);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::engine;

    #[test]
    fn a_copy_is_whole_and_its_speed_is_known() {
        let Some(engine) = engine() else { return };
        let values: Vec<u32> = (0..10_004).collect();
        let [from, to] =
            [values.clone(), vec![0; values.len()]].map(|values| engine.upload("values", &values));
        let (from, to) = (from.unwrap(), to.unwrap());
        let mut gpu = GpuBackend::on(engine).unwrap();
        assert!(gpu.seconds_of_copies(&from, &to, 2).unwrap() > 0.0);
        assert!(gpu.engine.read_values::<u32>(&to, 10_004).unwrap() == values);
        assert!(gpu.memory_bandwidth(1 << 20).unwrap() > 0.0);
    }
}
