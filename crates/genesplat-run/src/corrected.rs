//! What is put right before training: where cameras stand, and the exposure of photos.

use std::sync::atomic::AtomicBool;

use anyhow::Result;
use genesplat_io::{Scene, Spill};
use genesplat_train::TrainConfig;

use crate::cameras::{self, Cameras};
use crate::device::Device;
use crate::exposure::{self, Corrections, Exposure};
use crate::inputs::Inputs;
use crate::output;

/// What was put right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Corrected {
    /// How cameras were moved, if they were.
    pub cameras: Option<Cameras>,
    /// The exposure of photos, if they were brought to one.
    pub exposure: Option<Exposure>,
}

/// What decides on it.
pub struct Asked<'a> {
    /// What is asked for.
    pub corrections: Corrections,
    /// The run's.
    pub train: &'a TrainConfig,
    /// Where photos go that are in a file.
    pub spill: Option<&'a Spill>,
    /// Set by Ctrl-C and SIGTERM.
    pub stop: &'a AtomicBool,
}

impl Corrected {
    /// Puts right in `scene` what is worth it, and says so; `open` opens the device of the run, if it is
    /// needed.
    pub fn of(scene: &mut Scene, asked: &Asked<'_>, open: impl FnOnce() -> Result<Device>) -> Result<Self> {
        let mut corrected = Self::default();
        if asked.corrections == Corrections::Off {
            return Ok(corrected);
        }
        corrected.move_cameras(cameras::told_by_points(scene), scene);
        let background = asked.train.background.fixed_colour();
        corrected.exposure = exposure::decide(scene, asked.corrections, background)?;
        let exposure = corrected.exposure.as_ref();
        exposure.map_or(Ok(()), |exposure| exposure.bring(scene, asked.spill))?;
        let is_untold = !cameras::have_points(scene);
        if is_untold && (asked.corrections == Corrections::On || cameras::is_long_enough(asked.train)) {
            let found = cameras::told_by_photos(scene, asked.train, &mut open()?, asked.stop)?;
            corrected.move_cameras(found, scene);
        }
        Ok(corrected)
    }

    /// What a run put right that goes on.
    pub fn again(began: Inputs, scene: &mut Scene, spill: Option<&Spill>) -> Result<Self> {
        let corrected = Self { cameras: began.cameras, exposure: began.exposure };
        corrected.cameras.iter().for_each(|cameras| cameras.apply(scene));
        corrected.exposure.as_ref().map_or(Ok(()), |exposure| exposure.bring(scene, spill))?;
        Ok(corrected)
    }

    fn move_cameras(&mut self, found: Option<Cameras>, scene: &mut Scene) {
        let Some(cameras) = found else { return };
        output::tell(&cameras.told());
        cameras.apply(scene);
        self.cameras = Some(cameras);
    }
}
