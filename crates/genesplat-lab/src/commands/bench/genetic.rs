//! `genesplat-lab bench genetic`: how fast a population is scored, against rendering each individual in full.
//!
//! The state is the one that the search meets: a cloud just after an opacity reset, and the initial
//! population of the paper's search. The *plain way* is a full render and the whole loss, one individual and
//! view after the other; the changes themselves are made off the clock. Both ways must find the same losses.

use std::time::Instant;

use anyhow::Result;
use genesplat::core::gaussians::{logit, sigmoid};
use genesplat::core::{Device, Edit, Gaussians, Held, RenderSettings, Renderer, Rng, SparseDelta};
use genesplat::evolve::{GeneticAlgorithm, GeneticConfig, Magnitude};
use genesplat::kernels::cpu::CpuBackend;
use serde::Serialize;

use super::workload::Source;
use super::{prepare_cpu, print_figures};
use crate::args::BenchGeneticArgs;

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
    /// As differences from the cloud.
    population_bytes: usize,
    /// What scoring them takes at most beside the cloud, the photos and the individuals.
    scoring_bytes: usize,
}

pub(crate) fn run(args: &BenchGeneticArgs) -> Result<()> {
    let mut backend = prepare_cpu(args.machine)?;
    let (views, settings, cloud) = Source::of_cpu(&args.workload)?;
    let scored: Vec<usize> = (0..views.len().min(args.views as usize)).collect();
    let cloud = just_reset(cloud);
    let individuals = founders(&cloud, args.population)?;
    backend.set_views(&views)?;
    backend.upload(cloud.into())?;
    let clock = Instant::now();
    let losses = backend.score(&individuals, &scored, &settings)?;
    let (seconds, scoring_bytes) = (clock.elapsed().as_secs_f64(), backend.scoring_bytes());
    let (plain, plain_seconds) = score_plainly(&mut backend, &individuals, &scored, &settings)?;
    let renders = losses.len() as f64;
    let report = Report {
        gaussians: backend.gaussian_count(),
        views: scored.len(),
        individuals: individuals.len(),
        threads: rayon::current_num_threads(),
        renders_per_second: renders / seconds,
        plain_renders_per_second: renders / plain_seconds,
        ratio: plain_seconds / seconds,
        max_relative_difference: max_relative_difference(&losses, &plain),
        population_bytes: individuals.iter().map(SparseDelta::bytes).sum(),
        scoring_bytes,
    };
    print_figures(&report)?;
    args.json.write(&report)
}

/// The cloud as an opacity reset leaves it.
pub(crate) fn just_reset(mut cloud: Gaussians) -> Gaussians {
    let limited = |value: f32| logit(sigmoid(value).min(RESET_OPACITY));
    cloud.opacity_logits.iter_mut().for_each(|value| *value = limited(*value));
    cloud
}

/// Between losses of two ways to find them; NaN where one of them is not a number.
pub(crate) fn max_relative_difference(actual: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(actual.len(), expected.len(), "both ways must find a loss for each individual and view");
    let difference = |(&a, &b): (&f32, &f32)| (f64::from(a) / f64::from(b) - 1.0).abs();
    // In the total order, NaN without a sign is above all else, while `f64::max` would drop it.
    actual.iter().zip(expected).map(difference).max_by(f64::total_cmp).unwrap_or(0.0)
}

/// The initial population of a search whose steps need no gradients.
pub(crate) fn founders(cloud: &Gaussians, population: u32) -> Result<Vec<SparseDelta>> {
    let usual = GeneticConfig::default();
    let tournament = usual.tournament.min(population);
    let config = GeneticConfig { population, tournament, magnitude: Magnitude::Unit, ..usual };
    let algorithm = GeneticAlgorithm::new(config, cloud.all_genes(), None, 0.0, Rng::new(0))?;
    Ok(algorithm.deltas_from_consensus(0..population as usize))
}

/// Losses of full renders of the individuals, and the seconds that these take.
fn score_plainly(
    backend: &mut CpuBackend,
    individuals: &[SparseDelta],
    views: &[usize],
    settings: &RenderSettings,
) -> Result<(Vec<f32>, f64)> {
    let (mut losses, mut seconds) = (Vec::new(), 0.0);
    for individual in individuals {
        let base = backend.download()?.genes_of(&individual.rows);
        backend.edit(Edit::Genes(individual))?;
        let clock = Instant::now();
        let measured = backend.measure(Held::Cloud, views, settings)?;
        losses.extend(measured.into_iter().map(|measured| measured.loss));
        seconds += clock.elapsed().as_secs_f64();
        backend.edit(Edit::Genes(&base))?;
    }
    Ok((losses, seconds))
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
