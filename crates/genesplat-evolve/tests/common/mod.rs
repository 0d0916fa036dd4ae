//! Toy functions that stand in for a renderer.

#![allow(dead_code, reason = "each test binary uses some of these")]

use std::ops::Range;

use genesplat_core::{Genes, Rng, SparseDelta, Stream};
use genesplat_evolve::{GeneticAlgorithm, GeneticConfig, Magnitude};

/// `n` Gaussians with standard normal genes.
pub(crate) fn normal_base(n: u32) -> Vec<Genes> {
    let rng = Rng::new(99);
    let gene = |row| {
        let draws = [rng.at(Stream::Test, 1, row, 0), rng.at(Stream::Test, 1, row, 1)];
        std::array::from_fn(|gene| draws[gene / 4].normals(gene / 2 % 2)[gene % 2])
    };
    (0..n).map(gene).collect()
}

/// The genes of an individual.
pub(crate) fn applied(base: &[Genes], delta: &SparseDelta) -> Vec<Genes> {
    let mut genes = base.to_vec();
    delta.rows.iter().zip(&delta.genes).for_each(|(&row, gene)| genes[row as usize] = *gene);
    genes
}

/// Mean of the squared genes.
pub(crate) fn sphere(base: &[Genes], delta: &SparseDelta) -> f64 {
    let genes = applied(base, delta);
    genes.as_flattened().iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / (7 * base.len().max(1)) as f64
}

/// Small and gradient-free.
pub(crate) fn small(generations: u32, population: u32) -> GeneticConfig {
    GeneticConfig { generations, population, magnitude: Magnitude::Unit, ..GeneticConfig::default() }
}

/// A search on the sphere.
pub(crate) fn on_sphere(config: GeneticConfig, base: &[Genes], seed: u64) -> GeneticAlgorithm {
    let base_loss = sphere(base, &SparseDelta::default());
    GeneticAlgorithm::new(config, base.to_vec(), None, base_loss, Rng::new(seed)).expect("valid settings")
}

/// Several individuals of a generation, as differences from the base.
pub(crate) fn deltas(search: &GeneticAlgorithm, indices: Range<usize>) -> Vec<SparseDelta> {
    indices.map(|index| search.delta(index)).collect()
}

/// Runs a search to its end.
pub(crate) fn run(mut search: GeneticAlgorithm, loss: impl Fn(&SparseDelta) -> f64) -> GeneticAlgorithm {
    while !search.is_finished() {
        let losses: Vec<f64> = deltas(&search, 0..search.ask()).iter().map(&loss).collect();
        search.tell(&losses).expect("one loss each");
    }
    search
}
