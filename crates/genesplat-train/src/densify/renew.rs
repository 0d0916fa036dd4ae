//! Renewal on trial: the Gaussians of least contribution are replaced by splitting those of largest error; rolled back
//! if guard PSNR falls. For Pixel-GS, MCMC and finished splats; where the cloud grows by selection it was worth nothing.
//!
//! 3DGS looks for the right Gaussians in the first half of a run and then leaves them as they are, though many
//! contribute next to nothing, while others stand for more detail than one can show. Gradients cannot mend that: a
//! Gaussian that is not there has no gradient. So every twentieth of the run, contributions are measured and a
//! fraction of the cloud is renewed ([`genesplat_evolve::renewal`]). New Gaussians need some steps, so a renewal is
//! judged when the next one is due. Weight averaging comes first wherever both are due: the states that guards compare
//! are alike free of the noise of single steps.
//!
//! Prior art: 3DGS-MCMC relocates by opacity (Kheradmand et al., 2024), "Revising Densification" grows by error (Rota
//! Bulò et al., 2024); neither takes anything back.

use std::time::Instant;

use genesplat_core::constants::ALPHA_MIN;
use genesplat_core::gaussians::sigmoid;
use genesplat_core::{Contribution, Gaussians, Genes, Held, Origin};
use genesplat_evolve::renewal;

use crate::evolution::{GuardScore, guards};
use crate::run::TrainError;
use crate::run::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::trainer::Trainer;
use crate::scene::views::spread_evenly;

/// The guard score of the state before a trial.
fn before(trial: &StageRecord) -> GuardScore {
    let [psnr, _] = trial.guard_psnr.expect("a renewal has guards");
    GuardScore { loss: trial.fitness_before, psnr }
}

/// Clouds that a trial keeps, on the device: one, and its two moments.
const CLOUDS_KEPT: usize = 3;

impl Trainer<'_> {
    /// Judges the renewal that is on trial, and begins the next one if there is to be one.
    pub(crate) fn renew(&mut self, i: u32) -> Result<(), TrainError> {
        let clock = Instant::now();
        let guards = self.trial_guards();
        let score = self.guard_score(Held::Cloud, &guards, i)?;
        let is_first = self.trial.is_none();
        let GuardScore { loss, psnr } = self.end_trial(score, clock)?;
        // The time of the score counts for the trial that it ends, if there is one.
        let clock = if is_first { clock } else { Instant::now() };
        if self.schedule.renews(i) {
            let record = StageRecord::begun(StageKind::Renewal, i, loss, Some(psnr));
            // The score that it is compared with; the one that ends it is the next one's.
            let renders = guards.len() as u64;
            self.begin_trial(StageRecord { generations: 1, renders, ..record }, clock)?;
        }
        Ok(())
    }

    /// The same in all trials of a run, so that one score ends a trial and begins the next.
    fn trial_guards(&self) -> Vec<usize> {
        guards(self.views, &self.rng)
    }

    /// Keeps what was renewed, or rolls it back, if there is a trial; returns the guard score of the state that stays.
    fn end_trial(&mut self, score: GuardScore, clock: Instant) -> Result<GuardScore, TrainError> {
        let Some(mut record) = self.trial else { return Ok(score) };
        let before = before(&record);
        let stays = if score.psnr >= before.psnr {
            score
        } else {
            // Where that fails, what the device holds is still on trial.
            self.backend.roll_back()?;
            record.changed = 0;
            before
        };
        record.fitness_after = stays.loss;
        record.guard_psnr = Some([before.psnr, stays.psnr]);
        record.seconds += clock.elapsed().as_secs_f64();
        self.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: Some(score.psnr),
            ..GenerationLog::of(&record, Some(score.loss))
        });
        // The state is whole again: what is left of the phase is the next renewal, which whoever resumes begins
        // likewise.
        self.backend.drop_snapshot();
        self.trial = None;
        self.end_stage(record);
        Ok(stays)
    }

    /// If a renewal is on trial, goes back to the state before it where guards do not find better what has become of it so
    /// far.
    pub(crate) fn judge_open_trial(&mut self) -> Result<(), TrainError> {
        let Some(trial) = self.trial else { return Ok(()) };
        let now = self.guard_score(Held::Cloud, &self.trial_guards(), self.cursor.iteration)?;
        if now.psnr < before(&trial).psnr {
            self.backend.roll_back()?;
        }
        self.backend.drop_snapshot();
        self.trial = None;
        Ok(())
    }

    /// Renews a fraction of the Gaussians, if there are any to renew.
    fn begin_trial(&mut self, mut record: StageRecord, clock: Instant) -> Result<(), TrainError> {
        let i = record.iteration;
        let contributions = self.contributions(&mut record)?;
        let edit = renewal::plan(&contributions, self.config.evolution.renewal.fraction, self.rng, i);
        record.changed = edit.origins.iter().filter(|origin| matches!(origin, Origin::Twin { .. })).count();
        if record.changed == 0 {
            return Ok(());
        }
        record.population_bytes = (CLOUDS_KEPT * self.backend.gaussian_count() * Gaussians::BYTES_PER_ROW) as u64;
        self.backend.edit_rows_on_trial(&edit)?;
        record.seconds = clock.elapsed().as_secs_f64();
        self.tell_of_stage(&record, &self.trial_guards(), record.generations);
        self.trial = Some(record);
        Ok(())
    }

    /// Contributions to as many training views as there is time for. A Gaussian that none of them shows is spared, unless
    /// they are all there are or it is too faint to be shown by any.
    fn contributions(&mut self, record: &mut StageRecord) -> Result<Vec<Contribution>, TrainError> {
        let (i, settings) = (record.iteration, self.settings(record.iteration));
        let views = spread_evenly(self.views, self.schedule.contribution_views(), &self.rng, i);
        let mut contributions = self.backend.contributions(&views, &settings)?;
        if views.len() < self.views.len() {
            let genes = self.backend.genes()?;
            let could_show = |genes: &Genes| sigmoid(genes[6]) > ALPHA_MIN;
            let unseen =
                contributions.iter_mut().zip(&genes).filter(|(of, genes)| of.weight == 0.0 && could_show(genes));
            unseen.for_each(|(of, _)| of.weight = f32::INFINITY);
        }
        record.renders += views.len() as u64;
        Ok(contributions)
    }
}
