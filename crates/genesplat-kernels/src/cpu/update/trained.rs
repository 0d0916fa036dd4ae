//! What the optimiser moves. Only a step of training sees colours that are behind; all others get them as
//! they should be.

use fearless_simd::Level;
use genesplat_core::{Gaussians, Moments, RenderSettings};

use super::ColourSteps;
use crate::cpu::view::{Pinhole, Splats, project::project_coloured};

/// A cloud and its moments, the colours of which may have steps to make.
#[derive(Default)]
pub(crate) struct Trained {
    pub(super) cloud: Gaussians,
    pub(super) moments: Moments,
    pub(super) colour_steps: ColourSteps,
}

impl Trained {
    /// Moments that are empty are zeros.
    pub(crate) fn new(cloud: Gaussians, moments: Moments) -> Self {
        let moments = moments.or_zeros(cloud.len());
        Self { cloud, moments, colour_steps: ColourSteps::default() }
    }

    /// How many Gaussians there are.
    pub(crate) fn rows(&self) -> usize {
        self.cloud.len()
    }

    pub(crate) fn has_filter_3d(&self) -> bool {
        self.cloud.filter_3d.is_some()
    }

    /// Gradients of other views wait for a step.
    pub(crate) fn has_pending(&self) -> bool {
        !self.moments.pending.is_empty()
    }

    /// The cloud and its moments, which have made all steps, to be read or changed.
    pub(crate) fn settled(&mut self, level: Level) -> (&mut Gaussians, &mut Moments) {
        self.colour_steps.make_up(level, &mut self.cloud.sh, &mut self.moments);
        (&mut self.cloud, &mut self.moments)
    }

    /// The cloud alone, likewise.
    pub(crate) fn cloud(&mut self, level: Level) -> &mut Gaussians {
        self.settled(level).0
    }

    /// The same by value; nothing is left.
    pub(crate) fn take(&mut self, level: Level) -> (Gaussians, Moments) {
        self.settled(level);
        let Self { cloud, moments, .. } = std::mem::take(self);
        (cloud, moments)
    }

    /// Room for the step that is next: of colours, and for gradients that it keeps.
    pub(crate) fn prepare_step(&mut self, level: Level, keeps_gradients: bool) {
        // Where gradients of other views wait, any row may make the step, with a splat in this view or
        // without.
        if self.colour_steps.is_full() || self.has_pending() {
            self.settled(level);
        }
        if keeps_gradients && !self.has_pending() {
            self.moments.pending = Moments::column(self.rows());
        }
    }

    /// The splats of one view. Their colours make the steps that they have yet to make.
    pub(crate) fn project(
        &mut self,
        level: Level,
        camera: &Pinhole,
        settings: &RenderSettings,
        out: &mut Splats,
    ) {
        let mut colours = std::mem::take(&mut self.cloud.sh);
        let late = self.colour_steps.late_rows(&mut colours, &mut self.moments);
        project_coloured(level, &self.cloud, late, camera, settings, out);
        self.cloud.sh = colours;
    }
}
