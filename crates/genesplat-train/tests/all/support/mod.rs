//! What the tests of the pipeline share: a backend without a renderer, a scene, and observers.

mod fake;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use genesplat_core::{Camera, Origin, Photo, RowEdit, View};
use genesplat_train::observe::{DensifyLog, StepLog};
use genesplat_train::scene::initialise::ColouredPoint;
use genesplat_train::{Checkpoint, Observer, Outcome, StageRecord, Start};
use glam::DVec3;

pub(crate) use self::fake::{Call, Failure, FakeBackend};

/// Views on a circle of radius 2 around the origin, named in order: the extent is 2.2.
pub(crate) fn views(n: usize) -> Vec<View> {
    let photo = Arc::new(Photo { width: 4, height: 4, rgb: vec![0; 48] });
    (0..n)
        .map(|index| {
            let angle = index as f64 / n as f64 * std::f64::consts::TAU;
            let camera = Camera {
                camera_from_world_translation: DVec3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 0.0),
                ..Camera::at_origin(4, 4, 4.0)
            };
            View {
                name: format!("{index:03}.png"),
                camera,
                photo: photo.clone().into(),
                mask: None,
                depth: None,
            }
        })
        .collect()
}

/// Points on a line, 0.1 apart.
pub(crate) fn points(n: usize) -> Vec<ColouredPoint> {
    (0..n).map(|row| ([0.1 * row as f32, 0.0, 1.0], [128; 3])).collect()
}

/// New rows of an edit that are not old ones kept.
pub(crate) fn added(edit: &RowEdit) -> usize {
    edit.origins.iter().filter(|&&origin| origin != Origin::Kept).count()
}

/// Goes on from a checkpoint as it is written and read.
pub(crate) fn resumed(checkpoint: &Checkpoint) -> Start {
    let mut bytes = Vec::new();
    checkpoint.write(&mut bytes).unwrap();
    Start::Checkpoint(Box::new(Checkpoint::read(bytes.as_slice()).unwrap()))
}

/// The stages of a run, but for the time that they took.
pub(crate) fn timeless(outcome: &Outcome) -> Vec<StageRecord> {
    outcome.summary.stages.iter().map(|stage| StageRecord { seconds: 0.0, ..*stage }).collect()
}

/// Sets the flag during an iteration, as Ctrl-C would.
pub(crate) struct StopAt<'a>(pub u32, pub &'a AtomicBool);

impl Observer for StopAt<'_> {
    fn on_iteration(&mut self, log: &StepLog) {
        self.1.fetch_or(log.iteration == self.0, Ordering::Relaxed);
    }
}

/// Keeps the checkpoints of a run.
#[derive(Default)]
pub(crate) struct Keep(pub Vec<Checkpoint>);

impl Observer for Keep {
    fn on_checkpoint(&mut self, checkpoint: Checkpoint) {
        self.0.push(checkpoint);
    }
}

/// Remembers what users are told, and how large the cloud became.
#[derive(Default)]
pub(crate) struct Told {
    pub notices: Vec<String>,
    pub sizes: Vec<(u32, usize)>,
}

impl Observer for Told {
    fn notice(&mut self, text: &str) {
        self.notices.push(text.to_owned());
    }
    fn on_densify(&mut self, log: &DensifyLog) {
        self.sizes.push((log.iteration, log.gaussians));
    }
}
