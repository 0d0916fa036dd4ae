//! Recombination: the states that a run has just passed through breed a child that takes the place of the last one.
//!
//! Why. Adam's steps on single views keep every parameter in motion around its optimum, to the last iteration: the rates
//! of all parameters but positions are constant. At the same time much still drifts, slowly, in directions that no
//! single step can tell from that noise. The states of the last twentieth of a run hold both: their mean is free of the
//! noise, and the way from the older half of them to the younger one points where the run is going. A child is the mean
//! plus some way along that line (extended line recombination). Its genome is two numbers, or two for each group of
//! parameters, and a genome that small can be judged by a few renders, where the paper's, of seven numbers a Gaussian,
//! cannot.
//!
//! How. While rows stay what they are, the run is cut into windows. In each, states are averaged into two parents
//! ([`genesplat_core::lineage`]); at its end an evolution strategy ([`genesplat_evolve::strategy`]) searches the genome
//! on training views that change from generation to generation. What it finds must also be better on *guard* views, held
//! back from its search, or the run goes on as if nothing had been. No gradient is computed.
//!
//! Prior art under other names: Izmailov et al., "Averaging weights leads to wider optima and better generalization",
//! 2018; Zhang et al., "Lookahead optimizer", 2019.

use std::time::Instant;

use genesplat_core::lineage::{PARAMETER_GROUPS, PARENTS};
use genesplat_core::{Backend, BackendError, Blend, Gaussians, RenderSettings, Rng};
use genesplat_evolve::strategy::EvolutionStrategy;

use crate::checkpoint::{Checkpoint, Cursor};
use crate::guards::{StageViews, Verdict, mean_loss};
use crate::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::TrainError;
use crate::trainer::Trainer;

/// Genes of a group of parameters: how far towards the mean of the states, and how far along the line.
const GENES: usize = 2;
/// Where the search starts: near the mean, and half-way from there to the end of the line.
const START: [f64; GENES] = [0.8, 0.6];
/// First length of its steps.
const STEP: f64 = 0.3;
/// Runs of so many steps, and longer ones, have the generations that the configuration asks for. A generation takes as many
/// renders however short the run is: the last stage's three take 198 with the defaults, a ninth of so many steps, and a larger
/// share of fewer. Fewer generations were measured to cost next to nothing (`docs/evolution-history.md`).
const FULL_SEARCH: u32 = 1800;

/// What a run of so many steps has of the generations that are wanted: fewer in proportion to [`FULL_SEARCH`], but one.
fn affordable(wanted: u32, steps: u32) -> u32 {
    let in_proportion = u64::from(wanted) * u64::from(steps) / u64::from(FULL_SEARCH);
    u32::try_from(in_proportion.max(1)).map_or(wanted, |generations| generations.min(wanted))
}

/// The child that a genome stands for. With the parents' mean `m` and the cloud `c`, gene 0 weighs `m − c`, and gene 1 the
/// way from the older parent to the younger one. A parent without states makes the other one the mean.
fn blend(genome: &[f64], has_states: [bool; PARENTS]) -> Blend {
    let of_group = |group: usize| -> [f32; PARENTS] {
        let genes = if genome.len() == GENES { genome } else { &genome[group * GENES..] };
        let (mean, line) = (genes[0], genes[1]);
        match has_states {
            [true, true] => [(0.5 * mean - line) as f32, (0.5 * mean + line) as f32],
            _ => [mean as f32; PARENTS],
        }
    };
    Blend { weights: std::array::from_fn::<_, PARAMETER_GROUPS, _>(of_group) }
}

/// One stage.
struct Line {
    iteration: u32,
    begun: Instant,
    views: StageViews,
    settings: RenderSettings,
    rng: Rng,
    /// Which parents have states.
    parents: [bool; PARENTS],
    generations: u32,
    /// Groups of parameters with genes of their own.
    groups: usize,
}

impl Line {
    fn child(&self, genome: &[f64]) -> Blend {
        blend(genome, self.parents)
    }
}

impl<B: Backend> Trainer<'_, B> {
    /// Breeds a child of the window that ends here, and keeps the better of it and the cloud. Returns a checkpoint when
    /// it was stopped; the best so far counts, but a resumed run repeats the stage in full.
    pub(crate) fn recombine(&mut self, cursor: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        if self.backend.remembered() == [0; PARENTS] {
            return Ok(None);
        }
        let line = self.line(cursor.iteration);
        let before = self.verdict(&line.views.guards, line.iteration)?;
        let Verdict { loss, psnr } = before;
        let record = StageRecord::begun(StageKind::Recombination, line.iteration, loss, Some(psnr));
        let mut record = StageRecord { population_bytes: self.bytes_of_line(&line), ..record };
        let genome = self.search_line(&line, &mut record)?;
        let chosen = self.ask_guards(&line, &genome, before, &mut record)?;
        let interrupted = record.generations < line.generations;
        let mut checkpoint = if interrupted { Some(self.capture(cursor)?) } else { None };
        match chosen {
            Some(child) => {
                let bred = self.backend.breed(&child);
                self.or_hand_over(bred, &mut checkpoint)?;
            }
            None => self.backend.forget(),
        }
        record.seconds = line.begun.elapsed().as_secs_f64();
        self.end_stage(record);
        Ok(checkpoint)
    }

    /// What is found at the end of the run is kept: there a longer genome is worth its renders.
    fn line(&self, iteration: u32) -> Line {
        let (config, rng) = (&self.config.evolution.recombine, self.rng.fork(iteration));
        let steps = self.schedule.iterations;
        let is_last = iteration == steps;
        let wanted = if is_last { config.last_generations } else { config.generations };
        Line {
            iteration,
            begun: Instant::now(),
            views: StageViews::new(self.views, config.guards, rng),
            settings: self.settings(iteration),
            rng,
            parents: self.backend.remembered().map(|states| states > 0),
            generations: affordable(wanted, steps),
            groups: if is_last { PARAMETER_GROUPS } else { 1 },
        }
    }

    /// The best genome that the evolution strategy finds until it ends or is stopped.
    fn search_line(&mut self, line: &Line, record: &mut StageRecord) -> Result<Vec<f64>, TrainError> {
        // The first counts as the initial population; the guards' choice is the last.
        self.tell_of_stage(record, &line.views.guards, line.generations);
        let mut strategy = EvolutionStrategy::new(START.repeat(line.groups), STEP, line.rng);
        while strategy.generation() < line.generations && !self.stopped() {
            let count = self.config.evolution.recombine.views;
            let views = line.views.of_generation(strategy.generation(), count);
            let blends: Vec<Blend> = strategy.ask().iter().map(|genome| line.child(genome)).collect();
            let judgements = self.backend.judge(&blends, &views, &line.settings)?;
            let losses: Vec<f64> = judgements.chunks_exact(views.len()).map(mean_loss).collect();
            let population = strategy.tell(&losses);
            record.renders += judgements.len() as u64;
            record.seconds = line.begun.elapsed().as_secs_f64();
            // Losses are those of the generation's own views, so the best so far is the guards' last word.
            self.observer.on_generation(&GenerationLog {
                mean: population.map(|losses| losses.mean),
                spread: population.map(|losses| losses.std),
                ..GenerationLog::of(record, population.map(|losses| losses.best))
            });
            record.generations += 1;
        }
        Ok(strategy.mean().to_vec())
    }

    /// The last generation of a stage: the guards choose between the cloud, what was found, and the plain mean; `None` is the cloud.
    fn ask_guards(
        &mut self,
        line: &Line,
        genome: &[f64],
        before: Verdict,
        record: &mut StageRecord,
    ) -> Result<Option<Blend>, TrainError> {
        let finalists = [line.child(genome), line.child(&[1.0, 0.0])];
        let verdicts = self.verdicts(line, &finalists)?;
        record.renders += ((finalists.len() + 1) * line.views.guards.len()) as u64;
        let (mut chosen, mut best) = (None, before);
        for (finalist, verdict) in finalists.into_iter().zip(&verdicts) {
            if verdict.improves(&best) {
                (chosen, best) = (Some(finalist), *verdict);
            }
        }
        record.fitness_after = best.loss;
        record.guard_psnr = Some([before.psnr, best.psnr]);
        record.changed = if chosen.is_some() { self.backend.len() } else { 0 };
        record.seconds = line.begun.elapsed().as_secs_f64();
        let fittest = verdicts.iter().min_by(|a, b| a.loss.total_cmp(&b.loss));
        self.observer.on_generation(&GenerationLog {
            accepted: Some(record.changed),
            guard_psnr: fittest.map(|verdict| verdict.psnr),
            ..GenerationLog::of(record, fittest.map(|verdict| verdict.loss))
        });
        Ok(chosen)
    }

    fn verdicts(&mut self, line: &Line, blends: &[Blend]) -> Result<Vec<Verdict>, BackendError> {
        let guards = &line.views.guards;
        let judgements = self.backend.judge(blends, guards, &line.settings)?;
        Ok(judgements.chunks_exact(guards.len()).map(Verdict::of).collect())
    }

    /// What the parents and a child take, in bytes.
    fn bytes_of_line(&self, line: &Line) -> u64 {
        let parents = line.parents.into_iter().filter(|&has_states| has_states).count();
        ((parents + 1) * self.backend.len() * Gaussians::BYTES_PER_ROW) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RecombineConfig;

    #[test]
    fn runs_of_1800_steps_and_more_have_all_generations() {
        for steps in [1800, 1801, 7000, 30_000, 1_000_000, u32::MAX] {
            for wanted in (0..100).chain([u32::MAX]) {
                assert_eq!(affordable(wanted, steps), wanted, "{steps} steps");
            }
        }
    }

    #[test]
    fn in_shorter_runs_the_search_takes_no_larger_share_of_the_steps_or_one_generation() {
        let RecombineConfig { last_generations, views, .. } = RecombineConfig::default();
        let renders = EvolutionStrategy::individuals(PARAMETER_GROUPS * GENES) * views;
        let search = |steps| affordable(last_generations, steps) * renders as u32;
        assert_eq!([300, 1000, 1199, 1200, 1799].map(search), [66, 66, 66, 132, 132]);
        assert_eq!([1800, 30_000].map(search), [198; 2]);
        assert!((600..1800).all(|steps| search(steps) * 1800 <= steps * 198));
        assert_eq!(affordable(0, 300), 0, "where there is to be no search, there is none");
    }
}
