//! Means of a run's recent states on the device, and blends of them ([`genesplat_core::averages`]).

use genesplat_core::averages::{StateMean, WINDOW_HALVES};
use genesplat_core::{Blend, WindowAverages};

use crate::Result;
use crate::device::{Engine, Recorder, shaders};
use crate::stages::rows::{edit_uniform, run_vectors};
use crate::state::{Column, Parameters, State};

pub(crate) struct DeviceMean {
    states: u32,
    mean: Parameters,
}

/// Puts back what [`download`] gave.
pub(super) fn upload(engine: &Engine, averages: &WindowAverages) -> Result<[Option<DeviceMean>; WINDOW_HALVES]> {
    let half = |given: &StateMean| match given.states() {
        0 => Ok(None),
        states => Parameters::upload(engine, "an average", given.mean()).map(|mean| Some(DeviceMean { states, mean })),
    };
    let [older, younger] = averages.halves();
    Ok([half(older)?, half(younger)?])
}

pub(super) fn download(
    engine: &Engine,
    rows: u64,
    averages: &[Option<DeviceMean>; WINDOW_HALVES],
) -> Result<WindowAverages> {
    let half = |held: &Option<DeviceMean>| match held {
        Some(DeviceMean { states, mean }) => Ok(StateMean::new(*states, mean.download(engine, rows, false)?)),
        None => Ok(StateMean::default()),
    };
    let [older, younger] = averages;
    Ok(WindowAverages::new([half(older)?, half(younger)?]))
}

impl State {
    /// Adds the cloud to the mean of a half.
    pub(crate) fn average(&mut self, engine: &Engine, half: usize) -> Result<()> {
        self.make_up(engine);
        // Whatever needs memory comes first: a mean never counts a state that it does not hold.
        let states = 1 + self.averages[half].as_ref().map_or(0, |held| held.states);
        let edit = edit_uniform(engine, [0; 2], 0, 1.0 / states as f32)?;
        if self.averages[half].is_none() {
            let mean = Parameters::zeros(engine, "an average", self.rows)?;
            self.averages[half] = Some(DeviceMean { states: 0, mean });
        }
        let Some(held) = &mut self.averages[half] else { return Ok(()) };
        held.states = states;
        let mut recorder = Recorder::new(engine, None);
        for window in &self.windows {
            for (values, means) in [(&self.cloud.geometry, &held.mean.geometry), (&self.cloud.sh, &held.mean.sh)] {
                let parts = [window.uniform.all(), edit.all(), values.at(window), means.at(window)];
                run_vectors(&mut recorder, &shaders::AVERAGE, &[], &parts, window, values.floats);
            }
        }
        recorder.submit();
        Ok(())
    }

    /// Forgets the averages, which are of rows that have changed.
    pub(crate) fn clear_averages(&mut self) {
        self.averages = Default::default();
        self.blended = None;
    }

    /// Makes a blend of the cloud and the averages, beside the cloud.
    pub(crate) fn make_blend(&mut self, engine: &Engine, blend: &Blend) -> Result<()> {
        self.make_up(engine);
        if self.blended.is_none() {
            self.blended = Some(Parameters::zeros(engine, "a blend of averages", self.rows)?);
        }
        let Some(blended) = &self.blended else { return Ok(()) };
        // A half without states has no say.
        let [older, younger] =
            self.averages.each_ref().map(|half| half.as_ref().map_or(&self.cloud, |held| &held.mean));
        let [older_weight, younger_weight] = blend.weights;
        let weights = engine.upload("weights of a blend", &[[older_weight, younger_weight, 0.0, 0.0]])?;
        let mut recorder = Recorder::new(engine, None);
        for window in &self.windows {
            let mut run = |columns: [&Column; 4], is_geometry: u32| {
                let [cloud, older, younger, blended] = columns.map(|column| column.at(window));
                let parts = [window.uniform.all(), weights.all(), cloud, older, younger, blended];
                let overrides = [("IS_GEOMETRY", is_geometry)];
                let floats = columns[0].floats;
                run_vectors(&mut recorder, &shaders::BLEND_AVERAGES, &overrides, &parts, window, floats);
            };
            let clouds = [&self.cloud, older, younger, blended];
            run(clouds.map(|values| &values.geometry), 1);
            run(clouds.map(|values| &values.sh), 0);
        }
        recorder.submit();
        Ok(())
    }

    /// The blend takes the cloud's place, and the averages are emptied.
    pub(crate) fn blend(&mut self, engine: &Engine, blend: &Blend) -> Result<()> {
        if *blend != Blend::default() {
            self.make_blend(engine, blend)?;
            if let Some(blended) = self.blended.take() {
                self.cloud = blended;
            }
        }
        self.clear_averages();
        Ok(())
    }
}
