//! What training will take here: the steps are tried, and memory is reckoned.

use anyhow::Result;
use genesplat::io::Scene;
use genesplat::run::cost::{After, Cost};
use genesplat::run::device::{DeviceChoice, open};
use genesplat::run::scene;
use genesplat::train::{Schedule, virtual_picture_bytes};

/// Bytes a Gaussian takes in training with evolution: parameters, moments, statistics, intersections, the
/// mean of states. Peaks of `train SCENE --max-side 480 --iterations 7000`, photos taken off: fox 587 MB
/// (226,487), plush 593 MB (202,254).
const GAUSSIAN_BYTES: u64 = 2_600;
/// Bytes of a pixel of a photo, as long as photos stay in memory.
const PIXEL_BYTES: u64 = 3;

/// At most: a cloud whose gradients ask for fewer Gaussians than its cap allows takes less of both.
pub(super) struct Needs {
    pub(super) gaussians: usize,
    pub(super) memory_bytes: u64,
    cost: Cost,
}

impl Needs {
    /// Of runs with these settings on this machine's CPU.
    pub(super) fn of(scene: &Scene, schedule: &Schedule) -> Result<Self> {
        let cost = Cost::tried(&mut open(DeviceChoice::Cpu)?, scene, schedule, After::Scores(None))?;
        let gaussians = cost.steps[1].gaussians;
        let pixels: u64 = scene.train.iter().map(|view| view.photo.pixels() as u64).sum();
        let photo_bytes = (pixels * PIXEL_BYTES).min(scene::PHOTO_MEMORY)
            + virtual_picture_bytes(schedule, &scene.train) as u64;
        Ok(Self { gaussians, memory_bytes: gaussians as u64 * GAUSSIAN_BYTES + photo_bytes, cost })
    }

    /// Seconds of a run.
    pub(super) fn seconds(&self, scene: &Scene, schedule: &Schedule) -> f64 {
        self.cost.training_seconds(schedule, &scene.train) + self.cost.scoring_seconds
    }
}
