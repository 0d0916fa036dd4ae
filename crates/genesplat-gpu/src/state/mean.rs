//! The mean of a run's recent states on the device ([`genesplat_core::state_mean`]).

use genesplat_core::{Held, StateMean};

use crate::Result;
use crate::device::{Engine, Grid, Part, Recorder, shaders};
use crate::state::rows::{edit_uniform, run_vectors};
use crate::state::{LateColours, Parameters, RowWindow, Settled, State};

pub(crate) struct DeviceMean {
    states: u32,
    /// Its 3D filter is none before [`State::prepare`].
    mean: Parameters,
}

/// Puts back what [`download`] gave.
pub(super) fn upload(engine: &Engine, given: &StateMean) -> Result<Option<DeviceMean>> {
    match given.states() {
        0 => Ok(None),
        states => {
            Parameters::upload(engine, "a mean", given.mean()).map(|mean| Some(DeviceMean { states, mean }))
        }
    }
}

pub(super) fn download(engine: &Engine, rows: u64, held: Option<&DeviceMean>) -> Result<StateMean> {
    match held {
        Some(DeviceMean { states, mean }) => Ok(StateMean::new(*states, mean.download(engine, rows, false)?)),
        None => Ok(StateMean::default()),
    }
}

impl State {
    /// Adds the cloud to the mean.
    pub(crate) fn add_to_mean(&mut self, engine: &Engine) -> Result<()> {
        let trained = self.trained.settled(engine);
        // Whatever needs memory comes first: a mean never counts a state that it does not hold.
        let states = 1 + self.mean.as_ref().map_or(0, |held| held.states);
        let edit = edit_uniform(engine, [0; 2], 0, 1.0 / states as f32)?;
        if self.mean.is_none() {
            self.mean =
                Some(DeviceMean { states: 0, mean: Parameters::zeros(engine, "a mean", trained.rows)? });
        }
        let Some(held) = &mut self.mean else { return Ok(()) };
        held.states = states;
        let mut recorder = Recorder::new(engine, None);
        for window in &trained.windows {
            let Settled { cloud, .. } = trained;
            for (values, means) in [(&cloud.geometry, &held.mean.geometry), (&cloud.sh, &held.mean.sh)] {
                let parts = [window.uniform.all(), edit.all(), values.at(window), means.at(window)];
                run_vectors(&mut recorder, &shaders::AVERAGE, &[], &parts, window, values.floats);
            }
        }
        recorder.submit();
        Ok(())
    }

    /// Makes what is held ready to be rendered: it has all steps of its colours, and the cloud's 3D filter.
    pub(crate) fn prepare(&self, engine: &Engine, held: Held) {
        let Some(DeviceMean { mean, .. }) = self.mean.as_ref().filter(|_| held == Held::Mean) else { return };
        let Settled { windows, cloud, has_filter, .. } = self.trained.settled(engine);
        let mut recorder = Recorder::new(engine, None);
        for window in windows.iter().filter(|_| *has_filter) {
            let parts = [window.uniform.all(), cloud.geometry.at(window), mean.geometry.at(window)];
            recorder.run(&shaders::COPY_FILTER, &parts, Grid::Items(window.count));
        }
        recorder.submit();
    }

    /// Geometry and colours of the cloud, or of the mean; before the first state, of the cloud. A mean's
    /// colours have no step to make once it is prepared.
    pub(crate) fn held_at(&self, held: Held, window: &RowWindow) -> (Part<'_>, LateColours<'_>) {
        let ([geometry, ..], colours) =
            (self.trained.geometry_at(window), self.trained.late_colours_at(window));
        match (held, &self.mean) {
            (Held::Mean, Some(DeviceMean { mean, .. })) => {
                let [_, first, second] = colours.values;
                let values = [mean.sh.at(window), first, second];
                (mean.geometry.at(window), LateColours { values, ..colours })
            }
            _ => (geometry, colours),
        }
    }

    /// The mean takes the cloud's place, and is emptied.
    pub(crate) fn take_mean(&mut self, engine: &Engine) {
        self.prepare(engine, Held::Mean);
        if let Some(DeviceMean { mean, .. }) = self.mean.take() {
            self.trained.set_cloud(engine, mean);
        }
    }
}
