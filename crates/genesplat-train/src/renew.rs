//! Renewal on trial: now and then the Gaussians that nobody would miss make room for more where most is wrong.
//!
//! Why. 3DGS looks for the right Gaussians in the first half of a run and then leaves them as they are. By that time many
//! are worth next to nothing, while others stand for more than one Gaussian can show. Gradients cannot mend that: what is
//! not there has no gradient.
//!
//! How. There are never more Gaussians than the photos feed: with few pixels to each, a cloud learns photos by heart, and
//! nothing that comes later makes it forget them. Once density control has ended, in the second half of the run, a
//! twentieth of it apart, every Gaussian is weighed ([`genesplat_core::merit`]), and a share of the cloud is renewed
//! ([`genesplat_evolve::renewal`]). A new Gaussian needs some gradient steps before it is worth anything, so a renewal is
//! judged when the next one is due: if the *guard* views are rendered worse by then than before it, the state before it
//! comes back, moments and all, and the steps in between were in vain. (What guards have seen before is said in `guards`.)
//! Recombination (`recombine`) comes first wherever both are due, so that the states which guards compare are alike free of
//! the noise of single steps. Only a renewal that begins as soon as density control has ended has none before it, so what
//! it is compared with is as it is after any step, and the first trial is the easier for that.
//!
//! Prior art: 3DGS-MCMC relocates by opacity (Kheradmand et al., 2024), "Revising Densification" grows by error (Rota Bulò
//! et al., 2024); neither weighs, or takes anything back. In MCMC renewal takes over from relocation at half of the run.

use std::time::Instant;

use genesplat_core::{Backend, Gaussians, Merit, Moments, Origin};
use genesplat_evolve::renewal;

use crate::guards::{StageViews, Verdict};
use crate::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::TrainError;
use crate::trainer::Trainer;
use crate::views::spread_evenly;

/// A renewal that has yet to prove itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// What is reported of it, as if it had succeeded; what guards say of it in the end is not in it yet.
    pub record: StageRecord,
    /// The cloud before it.
    pub cloud: Gaussians,
    /// Adam's moments before it.
    pub moments: Moments,
}

impl Trial {
    /// What guards say of the state before it.
    fn before(&self) -> Verdict {
        let [psnr, _] = self.record.guard_psnr.expect("a renewal has guards");
        Verdict { loss: self.record.fitness_before, psnr }
    }

    /// All columns have the same number of rows, and guards were asked.
    pub(crate) fn is_consistent(&self) -> bool {
        let columns = [&self.cloud, &self.moments.first, &self.moments.second];
        self.record.guard_psnr.is_some()
            && columns.iter().all(|columns| columns.is_consistent() && columns.len() == self.cloud.len())
    }
}

/// Clouds that a trial keeps: one, and its two moments.
const CLOUDS_KEPT: usize = 3;

impl<B: Backend> Trainer<'_, B> {
    /// Judges the renewal that is on trial, and begins the next one if there is to be one.
    pub(crate) fn renew(&mut self, i: u32) -> Result<(), TrainError> {
        let clock = Instant::now();
        let guards = self.guards();
        let verdict = self.verdict(&guards, i)?;
        let is_first = self.trial.is_none();
        let Verdict { loss, psnr } = self.end_trial(verdict, clock)?;
        // The verdict is on the account of the trial that it ends, if there is one.
        let clock = if is_first { clock } else { Instant::now() };
        if self.schedule.renews(i) {
            let record = StageRecord::begun(StageKind::Renewal, i, loss, Some(psnr));
            // The verdict that it is compared with; the one that ends it is the next one's.
            let renders = guards.len() as u64;
            self.begin_trial(StageRecord { generations: 1, renders, ..record }, clock)?;
        }
        Ok(())
    }

    /// The same in all trials of a run, so that one verdict ends a trial and begins the next. Steps and weighing see them, too.
    fn guards(&self) -> Vec<usize> {
        StageViews::new(self.views, self.config.evolution.recombine.guards, self.rng).guards
    }

    /// Keeps what was renewed, or takes it back, if there is a trial; returns what guards say of the state that stays.
    fn end_trial(&mut self, verdict: Verdict, clock: Instant) -> Result<Verdict, TrainError> {
        let Some(trial) = &self.trial else { return Ok(verdict) };
        let (mut record, before) = (trial.record, trial.before());
        let stays = if verdict.psnr >= before.psnr {
            verdict
        } else {
            // Copies: where the device has no room for them, what it holds is still on trial.
            self.backend.upload(trial.cloud.clone(), Some(trial.moments.clone()))?;
            record.changed = 0;
            before
        };
        record.fitness_after = stays.loss;
        record.guard_psnr = Some([before.psnr, stays.psnr]);
        record.seconds += clock.elapsed().as_secs_f64();
        self.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: Some(verdict.psnr),
            ..GenerationLog::of(&record, Some(verdict.loss))
        });
        self.forget_trial(record);
        Ok(stays)
    }

    /// The state before the renewal on trial, if there is one, and guards do not find better what has become of it so far.
    pub(crate) fn better_before_trial(&mut self) -> Result<Option<Gaussians>, TrainError> {
        let Some(trial) = self.trial.take() else { return Ok(None) };
        let now = self.verdict(&self.guards(), self.cursor.iteration)?;
        Ok((now.psnr < trial.before().psnr).then_some(trial.cloud))
    }

    /// The trial is over, and the state is whole again: what is left of the phase is the next renewal, which whoever resumes
    /// begins likewise.
    fn forget_trial(&mut self, record: StageRecord) {
        self.trial = None;
        self.end_stage(record);
    }

    /// Weighs all Gaussians, and renews a share of them, if there are any to renew.
    fn begin_trial(&mut self, mut record: StageRecord, clock: Instant) -> Result<(), TrainError> {
        let i = record.iteration;
        let merits = self.weigh(&mut record)?;
        let edit = renewal::plan(&merits, self.config.evolution.renewal.share, i);
        record.changed = edit.origins.iter().filter(|origin| matches!(origin, Origin::Twin { .. })).count();
        if record.changed == 0 {
            return Ok(());
        }
        record.population_bytes = (CLOUDS_KEPT * self.backend.len() * Gaussians::BYTES_PER_ROW) as u64;
        let cloud = self.backend.download()?.into_owned();
        let moments = self.backend.download_moments()?.into_owned();
        self.backend.edit_rows(&edit)?;
        record.seconds = clock.elapsed().as_secs_f64();
        self.tell_of_stage(&record, &self.guards(), record.generations);
        self.trial = Some(Trial { record, cloud, moments });
        Ok(())
    }

    /// Weighs on as many training views as there is time for. What none of them shows is worth nothing if they are all
    /// there are, and is not judged otherwise.
    fn weigh(&mut self, record: &mut StageRecord) -> Result<Vec<Merit>, TrainError> {
        let (i, settings) = (record.iteration, self.settings(record.iteration));
        let views = spread_evenly(self.views, self.schedule.views_weighed, &self.rng, i);
        let mut merits = self.backend.weigh(&views, &settings)?;
        if views.len() < self.views.len() {
            merits
                .iter_mut()
                .filter(|merit| merit.weight == 0.0)
                .for_each(|merit| merit.weight = f32::INFINITY);
        }
        record.renders += views.len() as u64;
        Ok(merits)
    }
}
