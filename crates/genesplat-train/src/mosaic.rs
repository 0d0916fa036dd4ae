//! The mosaic search ([`genesplat_evolve::mosaic`]) as a stage: generation after generation, a child of many mutants takes the
//! cloud's place if photos agree that gave no credit.
//!
//! Where it belongs. On a cloud that gradients have not brought to its end, a few seconds of it are worth something, and it
//! asks for neither gradients nor moments: `refine` runs it on splats of any trainer. A finished cloud of our own has no
//! piece that a random step makes better for good; the stage finds that out, and leaves the cloud as it is.

use std::time::Instant;

use genesplat_core::{Backend, Gaussians, Genes, RenderSettings, SparseDelta, backend::MomentPolicy};
use genesplat_evolve::MosaicSearch;

use crate::checkpoint::{Checkpoint, Cursor};
use crate::guards::{StageViews, Verdict};
use crate::observe::{GenerationLog, StageKind, StageRecord};
use crate::run::TrainError;
use crate::trainer::Trainer;

/// A search under way.
struct Mosaic<'a> {
    iteration: u32,
    begun: Instant,
    settings: RenderSettings,
    views: StageViews,
    search: MosaicSearch<'a>,
    /// What the device holds.
    cloud: Gaussians,
    /// What guards say of it.
    verdict: Verdict,
}

impl<'a, B: Backend> Trainer<'a, B> {
    /// Returns a checkpoint when it was stopped; the best so far counts, but a resumed run repeats the stage in full.
    pub(crate) fn mosaic(&mut self, cursor: Cursor) -> Result<Option<Box<Checkpoint>>, TrainError> {
        let mut mosaic = self.begin_mosaic(cursor.iteration)?;
        let all_rows: Vec<u32> = (0..mosaic.cloud.len() as u32).collect();
        let original = mosaic.cloud.genes_of(&all_rows);
        let Verdict { loss, psnr } = mosaic.verdict;
        let record = StageRecord::begun(StageKind::Mosaic, cursor.iteration, loss, Some(psnr));
        let mut record = StageRecord { renders: mosaic.views.guards.len() as u64, ..record };
        // The first counts as the initial population.
        let generations = self.config.evolution.mosaic.generations.saturating_sub(1);
        self.tell_of_stage(&record, &mosaic.views.guards, generations);
        if let Err(error) = self.search_mosaic(&mut mosaic, &mut record) {
            // Whoever resumes begins anew.
            self.backend.apply(&original, MomentPolicy::Keep)?;
            self.torn = false;
            return Err(error);
        }
        let interrupted = !mosaic.search.is_finished();
        let checkpoint = if interrupted { self.capture_before(&original, &mosaic, cursor)? } else { None };
        record.guard_psnr = Some([psnr, mosaic.verdict.psnr]);
        let is_changed = |&(row, genes): &(usize, &Genes)| mosaic.cloud.genes(row) != *genes;
        record.changed = original.genes.iter().enumerate().filter(is_changed).count();
        record.seconds = mosaic.begun.elapsed().as_secs_f64();
        self.end_stage(record);
        Ok(checkpoint)
    }

    fn begin_mosaic(&mut self, iteration: u32) -> Result<Mosaic<'a>, TrainError> {
        let (begun, rng) = (Instant::now(), self.rng.fork(iteration));
        let views = StageViews::new(self.views, self.config.evolution.recombine.guards, rng);
        let verdict = self.verdict(&views.guards, iteration)?;
        let cloud = self.healthy_cloud()?.into_owned();
        Ok(Mosaic {
            iteration,
            begun,
            settings: self.settings(iteration),
            search: MosaicSearch::new(&self.config.evolution.mosaic, rng),
            views,
            cloud,
            verdict,
        })
    }

    /// Generation after generation, until the last one or a stop.
    fn search_mosaic(&mut self, mosaic: &mut Mosaic, record: &mut StageRecord) -> Result<(), TrainError> {
        while !mosaic.search.is_finished() && !self.stopped() {
            self.next_child(mosaic, record)?;
        }
        Ok(())
    }

    /// One generation: what credit puts together is tried.
    fn next_child(&mut self, mosaic: &mut Mosaic, record: &mut StageRecord) -> Result<(), TrainError> {
        let mutants = mosaic.search.mutants(&mosaic.cloud);
        let count = self.config.evolution.mosaic.views;
        let views = mosaic.views.of_generation(mosaic.search.generation(), count);
        let credits = self.backend.credit(&mutants, &views, &mosaic.settings)?;
        let child = mosaic.search.child(&mutants, &credits, views.len());
        let bytes = mutants.iter().map(|mutant| mutant.bytes() as u64).sum();
        record.population_bytes = record.population_bytes.max(bytes);
        record.renders += ((mutants.len() + 1) * views.len() + mosaic.views.guards.len()) as u64;
        let (verdict, accepted) = self.try_child(mosaic, &child)?;
        record.fitness_after = mosaic.verdict.loss;
        record.seconds = mosaic.begun.elapsed().as_secs_f64();
        self.observer.on_generation(&GenerationLog {
            accepted: Some(accepted),
            guard_psnr: Some(verdict.psnr),
            ..GenerationLog::of(record, Some(verdict.loss))
        });
        record.generations += 1;
        Ok(())
    }

    /// The child takes the cloud's place if guards agree. Returns what they say of it, and how many Gaussians changed.
    fn try_child(
        &mut self,
        mosaic: &mut Mosaic,
        child: &SparseDelta,
    ) -> Result<(Verdict, usize), TrainError> {
        self.torn = true;
        self.backend.apply(child, MomentPolicy::Keep)?;
        let verdict = self.verdict(&mosaic.views.guards, mosaic.iteration)?;
        let better = verdict.improves(&mosaic.verdict);
        mosaic.search.tell(better);
        if !better {
            self.backend.apply(&mosaic.cloud.genes_of(&child.rows), MomentPolicy::Keep)?;
            return Ok((verdict, 0));
        }
        mosaic.verdict = verdict;
        mosaic.cloud.apply(child);
        Ok((verdict, child.rows.len()))
    }

    /// The state before the stage, for a run that will repeat it.
    fn capture_before(
        &mut self,
        original: &SparseDelta,
        mosaic: &Mosaic,
        cursor: Cursor,
    ) -> Result<Option<Box<Checkpoint>>, TrainError> {
        self.backend.apply(original, MomentPolicy::Keep)?;
        let mut checkpoint = Some(self.capture(cursor)?);
        let applied = self.backend.apply(&mosaic.cloud.genes_of(&original.rows), MomentPolicy::Keep);
        self.or_hand_over(applied, &mut checkpoint)?;
        Ok(checkpoint)
    }
}
