//! `genesplat bench evolution`: how fast a population is scored, against rendering each individual in full.
//!
//! The state is the one that evolution meets: a cloud just after an opacity reset, and the initial population of the
//! paper's search. The *plain way* is our own render with all its culling, and the whole loss, one individual and view
//! after the other, all threads on each; the changes themselves are made off the clock. Both ways must find the same
//! losses.
//!
//! Memory is told in two figures: what the individuals themselves take, and what scoring them takes besides, which is what
//! grows with the number of views. Each row of figures starts from a scorer that remembers nothing. It is the scorer that counts:
//! to the system, memory that an earlier row has freed may look like that of this one.

use std::time::Instant;

use anyhow::Result;
use genesplat::core::backend::MomentPolicy;
use genesplat::core::gaussians::{logit, sigmoid};
use genesplat::core::{Backend, Gaussians, RenderSettings, Rng, SparseDelta, View};
use genesplat::evolve::{GeneticAlgorithm, Magnitude, PaperConfig};
use genesplat::kernels::cpu::CpuBackend;
use serde::Serialize;

use super::workload::Workload;
use crate::args::BenchEvolutionArgs;
use crate::{device, files, output, precious};

/// What a reset limits opacities to.
const RESET_OPACITY: f32 = 0.01;

/// What `--json` writes; keys are fixed.
#[derive(Serialize)]
struct Report {
    gaussians: usize,
    views: usize,
    individuals: usize,
    threads: usize,
    renders_per_second: f64,
    plain_renders_per_second: f64,
    ratio: f64,
    max_relative_difference: f64,
    /// The individuals, as differences from the cloud: their number and the rows that they change decide, not the views.
    population_bytes: usize,
    /// What scoring them takes at most beside the cloud, the photos and the individuals.
    scoring_bytes: usize,
    growth: Vec<Growth>,
    search: Vec<Generation>,
}

/// Scoring as a search goes on.
#[derive(Serialize)]
struct Generation {
    generation: u32,
    /// Mean share of the rows in which an individual differs from what most parents hold: what scoring it costs.
    changed: f64,
    /// The same from the cloud that the search began with.
    changed_from_base: f64,
    renders_per_second: f64,
}

/// Scoring at another size.
#[derive(Serialize)]
struct Growth {
    what: &'static str,
    gaussians: usize,
    individuals: usize,
    views: usize,
    renders_per_second: f64,
    population_bytes: usize,
    scoring_bytes: usize,
}

/// What it took to score some individuals on some views.
struct Scored {
    losses: Vec<f32>,
    seconds: f64,
    bytes: usize,
}

/// Times, prints, and writes the figures.
pub fn run(args: &BenchEvolutionArgs) -> Result<()> {
    args.json.as_deref().map_or(Ok(()), |path| precious::check_output(path, &[]))?;
    let backend = device::prepare_cpu(args.machine)?;
    let Workload { views, settings, cloud } = Workload::of(&args.workload)?;
    let population = args.population as usize;
    let judges: Vec<usize> = (0..views.len().min(args.views as usize)).collect();
    let mut bench = Bench::new(backend, views, just_reset(cloud), settings)?;
    let individuals = bench.founders(population)?;
    let Scored { losses, seconds, bytes: scoring_bytes } = bench.score(&individuals, &judges)?;
    let (plain, plain_seconds) = bench.plain(&individuals, &judges)?;
    let renders = losses.len() as f64;
    let report = Report {
        gaussians: bench.backend.len(),
        views: judges.len(),
        individuals: population,
        threads: rayon::current_num_threads(),
        renders_per_second: renders / seconds,
        plain_renders_per_second: renders / plain_seconds,
        ratio: plain_seconds / seconds,
        max_relative_difference: max_relative_difference(&losses, &plain),
        population_bytes: bytes(&individuals),
        scoring_bytes,
        growth: bench.growth(&individuals, &judges)?,
        search: bench.search(args.population, args.generations, &judges)?,
    };
    output::print(&report.to_text())?;
    args.json.as_ref().map_or(Ok(()), |path| files::write_json(path, &report))
}

/// The cloud as an opacity reset leaves it.
pub fn just_reset(mut cloud: Gaussians) -> Gaussians {
    let limited = |value: f32| logit(sigmoid(value).min(RESET_OPACITY));
    cloud.opacity_logits.iter_mut().for_each(|value| *value = limited(*value));
    cloud
}

fn bytes(individuals: &[SparseDelta]) -> usize {
    individuals.iter().map(SparseDelta::bytes).sum()
}

/// Between losses of two ways to find them; NaN where one of them is not a number.
pub fn max_relative_difference(actual: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(actual.len(), expected.len(), "both ways must find a loss for each individual and view");
    let difference = |(&a, &b): (&f32, &f32)| (f64::from(a) / f64::from(b) - 1.0).abs();
    // In the total order, NaN without a sign is above all else, while `f64::max` would drop it.
    actual.iter().zip(expected).map(difference).max_by(f64::total_cmp).unwrap_or(0.0)
}

/// The initial population of a paper search, which needs no loss.
pub fn founders(cloud: &Gaussians, population: usize) -> Result<Vec<SparseDelta>> {
    let algorithm = algorithm(cloud, population as u32, PaperConfig::default().generations)?;
    Ok(algorithm.deltas(0..population))
}

/// The paper's search, with steps that need no gradients. Nobody asks for the best, so the base's loss does not matter.
fn algorithm(cloud: &Gaussians, population: u32, generations: u32) -> Result<GeneticAlgorithm> {
    let paper = PaperConfig::default();
    let tournament = paper.tournament.min(population);
    let config = PaperConfig { generations, population, tournament, magnitude: Magnitude::Unit, ..paper };
    Ok(GeneticAlgorithm::new(config, cloud.all_genes(), None, 0.0, Rng::new(0))?)
}

struct Bench {
    backend: CpuBackend,
    views: Vec<View>,
    settings: RenderSettings,
}

impl Bench {
    fn new(
        mut backend: CpuBackend,
        views: Vec<View>,
        cloud: Gaussians,
        settings: RenderSettings,
    ) -> Result<Self> {
        backend.set_views(&views)?;
        backend.upload(cloud, None)?;
        Ok(Self { backend, views, settings })
    }

    fn founders(&mut self, population: usize) -> Result<Vec<SparseDelta>> {
        founders(&*self.backend.download()?, population)
    }

    /// What is shared between individuals counts, too.
    fn score(&mut self, individuals: &[SparseDelta], views: &[usize]) -> Result<Scored> {
        // Photos that are new, so that nothing is remembered from before, and no room is left.
        self.backend.set_views(&self.views)?;
        let clock = Instant::now();
        let losses = self.backend.score(individuals, views, &self.settings)?;
        let (seconds, bytes) = (clock.elapsed().as_secs_f64(), self.backend.scoring_bytes());
        Ok(Scored { losses, seconds, bytes })
    }

    fn plain(&mut self, individuals: &[SparseDelta], views: &[usize]) -> Result<(Vec<f32>, f64)> {
        let (mut losses, mut seconds) = (Vec::new(), 0.0);
        for individual in individuals {
            let base = self.backend.download()?.genes_of(&individual.rows);
            self.backend.apply(individual, MomentPolicy::Keep)?;
            let clock = Instant::now();
            losses.extend(views.iter().map(|&view| self.backend.loss_of_view(view, &self.settings)));
            seconds += clock.elapsed().as_secs_f64();
            self.backend.apply(&base, MomentPolicy::Keep)?;
        }
        Ok((losses, seconds))
    }

    /// How throughput changes over the generations of a search as training makes it, none for 0.
    fn search(&mut self, population: u32, generations: u32, views: &[usize]) -> Result<Vec<Generation>> {
        let mut search = algorithm(&*self.backend.download()?, population, generations)?;
        let mut found = Vec::new();
        while generations > 0 && !search.is_finished() {
            let clock = Instant::now();
            if !search.shift().is_empty() {
                self.backend.apply(search.shift(), MomentPolicy::Keep)?;
            }
            let individuals = search.deltas_from_consensus(0..search.ask());
            let losses = self.backend.score(&individuals, views, &self.settings)?;
            let seconds = clock.elapsed().as_secs_f64();
            found.push(Generation {
                generation: search.generation(),
                changed: self.share(individuals.iter().map(|individual| individual.rows.len())),
                changed_from_base: self.share((0..search.ask()).map(|index| search.delta(index).rows.len())),
                renders_per_second: losses.len() as f64 / seconds,
            });
            let mean = |losses: &[f32]| losses.iter().map(|&loss| f64::from(loss)).sum();
            search.tell(&losses.chunks(views.len()).map(mean).collect::<Vec<f64>>())?;
        }
        self.backend.apply(&search.way_back(), MomentPolicy::Keep)?;
        Ok(found)
    }

    /// Mean of some numbers of rows, as a share of all rows.
    fn share(&self, rows: impl ExactSizeIterator<Item = usize>) -> f64 {
        let all = rows.len() * self.backend.len();
        rows.sum::<usize>() as f64 / all as f64
    }

    /// How throughput and memory change when one thing is halved.
    fn growth(&mut self, individuals: &[SparseDelta], views: &[usize]) -> Result<Vec<Growth>> {
        let half = |count: usize| count.div_ceil(2);
        let fewer = &individuals[..half(individuals.len())];
        let mut rows = vec![
            self.row("half the individuals", fewer, views)?,
            self.row("half the views", individuals, &views[..half(views.len())])?,
        ];
        let cloud = self.backend.download()?.into_owned();
        let kept = (0..cloud.len() as u32).step_by(2).collect();
        self.backend.edit_rows(&genesplat::core::RowEdit::keep(kept))?;
        let of_half = self.founders(individuals.len())?;
        rows.push(self.row("half the Gaussians", &of_half, views)?);
        self.backend.upload(cloud, None)?;
        Ok(rows)
    }

    fn row(&mut self, what: &'static str, individuals: &[SparseDelta], views: &[usize]) -> Result<Growth> {
        let Scored { losses, seconds, bytes: scoring_bytes } = self.score(individuals, views)?;
        Ok(Growth {
            what,
            gaussians: self.backend.len(),
            individuals: individuals.len(),
            views: views.len(),
            renders_per_second: losses.len() as f64 / seconds,
            population_bytes: bytes(individuals),
            scoring_bytes,
        })
    }
}

/// As text.
fn memory_text(population_bytes: usize, scoring_bytes: usize) -> String {
    let [population, scoring] = [population_bytes, scoring_bytes].map(|bytes| bytes as f64 / 1e6);
    format!("{population:>10.1} MB of individuals,{scoring:>10.1} MB to score them")
}

impl Report {
    fn to_text(&self) -> String {
        let growth = self.growth.iter().map(|row| {
            let Growth { what, renders_per_second, population_bytes, scoring_bytes, .. } = row;
            let memory = memory_text(*population_bytes, *scoring_bytes);
            format!("{what:<24}{renders_per_second:>8.1} renders/s{memory}")
        });
        let search = self.search.iter().map(|row| {
            let Generation { generation, changed, changed_from_base, renders_per_second } = row;
            let [near, far] = [changed, changed_from_base].map(|share| 100.0 * share);
            format!(
                "\ngeneration {generation:<13}{renders_per_second:>8.1} renders/s, {near:.1} % of the rows scored, {far:.1} % \
                 other than at the start"
            )
        });
        format!(
            "{} Gaussians just after an opacity reset, {} individuals on {} views, {} threads\n\
             scoring                 {:>8.1} renders/s{}\n\
             plain way               {:>8.1} renders/s\n\
             ratio                   {:>8.2} x\n\
             largest relative difference of a loss {:.1e}\n{}{}",
            self.gaussians,
            self.individuals,
            self.views,
            self.threads,
            self.renders_per_second,
            memory_text(self.population_bytes, self.scoring_bytes),
            self.plain_renders_per_second,
            self.ratio,
            self.max_relative_difference,
            growth.collect::<Vec<_>>().join("\n"),
            search.collect::<String>(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_that_differ_are_seen_and_so_is_nan() {
        let losses = [0.5, 0.25, 1.0];
        assert_eq!(max_relative_difference(&losses, &losses), 0.0);
        assert_eq!(max_relative_difference(&[0.5, 0.375, 1.0], &losses), 0.5);
        for poison in [f32::NAN, -f32::NAN] {
            assert!(max_relative_difference(&[0.5, poison, 1.0], &losses).is_nan());
            assert!(max_relative_difference(&losses, &[poison, 0.25, 1.0]).is_nan());
        }
    }

    #[test]
    #[should_panic = "a loss for each"]
    fn a_missing_loss_is_seen() {
        max_relative_difference(&[0.5], &[0.5, 0.25]);
    }
}
