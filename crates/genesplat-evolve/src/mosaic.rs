//! The mosaic search: a child of many mutants, piece by piece the one that made it better.
//!
//! Why. A cloud of a million Gaussians has seven million genes. A mutant that changes a share of them makes about half of
//! what it changes better and half worse, and its loss is the sum, which is worse; whole-individual selection ([`crate::genetic`])
//! finds nothing there. But a loss is a sum over pixels, and a Gaussian has part in few of them.
//!
//! How. Mutants are rendered, every Gaussian is credited with what changed in its own pixels ([`genesplat_core::credit`]), and
//! the child takes each block of neighbours from the mutant that made it best, if any made it better than it was. Steps are
//! measured in a Gaussian's own scale, along its own axes: what is thin moves little across. They grow while children
//! are better than their base, and shrink where they are not (Rechenberg's success rule, 1973).

use genesplat_core::covariance::world_offset;
use genesplat_core::{Credits, Gaussians, Genes, Rng, SparseDelta, Stream};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::config::{ConfigError, check, is_share};

/// Factors of the length of steps after a child that was better, and after one that was not.
const REACH_FACTORS: [f32; 2] = [1.1, 0.5];

/// Settings of the mosaic search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MosaicConfig {
    /// Children made one after the other. Default 20; from 0. Time grows in proportion.
    pub generations: u32,
    /// Mutants that a child is put together from. Default 12; at least 1. Time grows in proportion.
    pub mutants: u32,
    /// Training views that give credit, drawn anew for each generation. Default 6; at least 1. Time grows in proportion.
    pub views: usize,
    /// Share of the blocks that a mutant changes. Default 0.3; above 0, at most 1. With more, changes are harder to tell apart.
    pub share: f64,
    /// Standard deviation of the first steps: of positions in the Gaussian's own scale, along each of its axes; of
    /// log-scales; of opacity logits. Default 0.05; above 0.
    pub step: f32,
    /// Gaussians of a block, which change together: rows that follow each other, which are neighbours in clouds that we trained
    /// (along a Morton curve) and may lie anywhere in others. Default 1; at least 1. Where blocks begin differs between
    /// generations.
    pub block: u32,
    /// Views of a generation in which a Gaussian must be seen, or it stays as it is; where there are fewer views, all of
    /// them. Default 2; from 0.
    pub evidence: u32,
}

impl Default for MosaicConfig {
    fn default() -> Self {
        Self { generations: 20, mutants: 12, views: 6, share: 0.3, step: 0.05, block: 1, evidence: 2 }
    }
}

impl MosaicConfig {
    /// Checks every range; the first setting that is out of its range is named.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check("mutants", self.mutants, self.mutants > 0, "at least 1")?;
        check("views", self.views as f64, self.views > 0, "at least 1")?;
        check("share", self.share, is_share(self.share) && self.share > 0.0, "above 0 and at most 1")?;
        check("step", self.step, self.step > 0.0 && self.step.is_finite(), "a number above 0")?;
        check("block", self.block, self.block > 0, "at least 1")
    }
}

/// A search under way: [`Self::mutants`], credit, [`Self::child`], [`Self::tell`], until [`Self::is_finished`].
#[derive(Clone, Debug)]
pub struct MosaicSearch<'a> {
    config: &'a MosaicConfig,
    rng: Rng,
    generation: u32,
    /// Factor of the steps.
    reach: f32,
}

impl<'a> MosaicSearch<'a> {
    /// A search with its own random numbers.
    pub fn new(config: &'a MosaicConfig, rng: Rng) -> Self {
        Self { config, rng, generation: 0, reach: 1.0 }
    }

    /// Counted from 0.
    pub fn generation(&self) -> u32 {
        self.generation
    }

    /// All generations are over.
    pub fn is_finished(&self) -> bool {
        self.generation >= self.config.generations
    }

    /// The generation's mutants of `cloud`.
    pub fn mutants(&self, cloud: &Gaussians) -> Vec<SparseDelta> {
        (0..self.config.mutants).into_par_iter().map(|mutant| self.mutant(cloud, mutant)).collect()
    }

    fn mutant(&self, cloud: &Gaussians, mutant: u32) -> SparseDelta {
        let block_of = self.blocks();
        let changes = |row: &u32| {
            let draw = self.rng.at(Stream::Proposal, self.generation, mutant, block_of(*row));
            f64::from(draw.uniform(0)) < self.config.share
        };
        let rows: Vec<u32> = (0..cloud.len() as u32).filter(changes).collect();
        let genes = rows.iter().map(|&row| self.mutated(cloud, mutant, row)).collect();
        SparseDelta { rows, genes }
    }

    fn mutated(&self, cloud: &Gaussians, mutant: u32, row: u32) -> Genes {
        let length = self.config.step * self.reach;
        // A draw has four normal numbers, and a Gaussian seven genes.
        let draws = [0, 1].map(|half| self.rng.at(Stream::Mutation, self.generation, 2 * mutant + half, row));
        let [[x, y], [z, sx], [sy, sz], [opacity, _]] = [(0, 0), (0, 1), (1, 0), (1, 1)]
            .map(|(half, pair)| draws[half].normals(pair).map(|n| n * length));
        let index = row as usize;
        let [x, y, z] = world_offset(cloud.rotations[index], cloud.log_scales[index], [x, y, z]);
        let mut gene = cloud.genes(index);
        gene.iter_mut().zip([x, y, z, sx, sy, sz, opacity]).for_each(|(gene, step)| *gene += step);
        gene
    }

    /// The block that a row belongs to in this generation.
    fn blocks(&self) -> impl Fn(u32) -> u32 {
        let size = self.config.block;
        let offset = self.rng.at(Stream::Proposal, self.generation, u32::MAX, 0).below(0, size);
        move |row| (row + offset) / size
    }

    /// Takes each block from the mutant that made it best, if any made it better. Credit is from so many views; where they are
    /// fewer than the evidence that is wanted, all of them are enough.
    pub fn child(&self, mutants: &[SparseDelta], credits: &Credits, view_count: usize) -> SparseDelta {
        let evidence = self.config.evidence.min(view_count as u32);
        let block_of = self.blocks();
        // Of each row, the best change of its block, and what it then is.
        let mut best: Vec<(f64, Option<Genes>)> = vec![(0.0, None); credits.views.len()];
        for (mutant, changes) in mutants.iter().zip(&credits.changes) {
            let mut genes = mutant.genes.iter();
            for block in mutant.rows.chunk_by(|&a, &b| block_of(a) == block_of(b)) {
                let change: f64 = block.iter().map(|&row| f64::from(changes[row as usize])).sum();
                for (&row, gene) in block.iter().zip(&mut genes) {
                    let best = &mut best[row as usize];
                    if change < best.0 {
                        *best = (change, Some(*gene));
                    }
                }
            }
        }
        let mut child = SparseDelta::default();
        for (row, (&views, (_, gene))) in (0..).zip(credits.views.iter().zip(best)) {
            if let Some(gene) = gene.filter(|_| views >= evidence) {
                child.rows.push(row);
                child.genes.push(gene);
            }
        }
        child
    }

    /// The child was better than its base and took its place, or was not: on to the next generation.
    pub fn tell(&mut self, better: bool) {
        let [grow, shrink] = REACH_FACTORS;
        self.reach *= if better { grow } else { shrink };
        self.generation += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(n: usize) -> Gaussians {
        let mut cloud = Gaussians::zeros(n);
        cloud.rotations.fill([1.0, 0.0, 0.0, 0.0]);
        cloud
    }

    fn config() -> MosaicConfig {
        MosaicConfig { mutants: 3, share: 1.0, ..MosaicConfig::default() }
    }

    fn mutants_of(search: &MosaicSearch, n: usize) -> Vec<SparseDelta> {
        search.mutants(&cloud(n))
    }

    #[test]
    fn a_child_takes_every_piece_from_whoever_made_it_best() {
        let config = config();
        let search = MosaicSearch::new(&config, Rng::new(1));
        let mutants = mutants_of(&search, 5);
        let credits = Credits {
            changes: vec![
                vec![-1.0, 1.0, -1.0, -9.0, f32::NAN],
                vec![-2.0, 0.0, -1.0, -9.0, 0.5],
                vec![3.0, 2.0, -0.5, -9.0, -0.1],
            ],
            views: vec![2, 6, 2, 1, 3],
        };
        let child = search.child(&mutants, &credits, 6);
        // Row 1 is better as it was, row 3 was seen in one view only, and of equal ones the first counts.
        assert_eq!(child.rows, [0, 2, 4]);
        assert_eq!(child.genes, [mutants[1].genes[0], mutants[0].genes[2], mutants[2].genes[4]]);
        assert_eq!(
            search.child(&mutants, &credits, 1).rows,
            [0, 2, 3, 4],
            "where there is one view, it is enough"
        );
    }

    #[test]
    fn blocks_change_and_are_kept_together() {
        let config = MosaicConfig { block: 4, share: 0.5, ..config() };
        let search = MosaicSearch::new(&config, Rng::new(3));
        let mutants = mutants_of(&search, 41);
        let mut credits = Credits::zeros(3, 41);
        credits.views.fill(2);
        let block_of = search.blocks();
        for row in 0..41u32 {
            for other in (0..41).filter(|&other| block_of(other) == block_of(row)) {
                for mutant in &mutants {
                    assert_eq!(mutant.rows.contains(&row), mutant.rows.contains(&other));
                }
            }
        }
        // One row of the second block of a mutant is a little worse, and its neighbours are better.
        let block: Vec<u32> =
            mutants[0].rows.chunk_by(|&a, &b| block_of(a) == block_of(b)).nth(1).unwrap().to_vec();
        assert!(block.len() > 1);
        block.iter().for_each(|&row| credits.changes[0][row as usize] = -1.0);
        credits.changes[0][block[0] as usize] = 0.5;
        assert_eq!(search.child(&mutants, &credits, 6).rows, block);
    }

    #[test]
    fn steps_follow_the_own_scale_and_its_axes() {
        let mut cloud = cloud(2000);
        // Long along its first axis, which a quarter turn about z makes y.
        cloud.log_scales.fill([2.0, -3.0, 0.0]);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        cloud.rotations.fill([half, 0.0, 0.0, half]);
        let config = config();
        let search = MosaicSearch::new(&config, Rng::new(5));
        let mutant = search.mutants(&cloud).swap_remove(0);
        assert_eq!(mutant.rows.len(), 2000);
        let base = cloud.genes(0);
        let deviation = |gene: usize| {
            let squares = mutant.genes.iter().map(|genes| f64::from(genes[gene] - base[gene]).powi(2));
            (squares.sum::<f64>() / 2000.0).sqrt()
        };
        let expected = [-3f64, 2.0, 0.0].map(f64::exp).into_iter().chain([1.0; 4]);
        for (gene, scale) in expected.enumerate() {
            let ratio = deviation(gene) / (0.05 * scale);
            // Three standard errors of a deviation of 2,000 draws.
            assert!((ratio - 1.0).abs() < 0.048, "gene {gene}: {ratio}");
        }
    }

    #[test]
    fn steps_grow_with_success_and_shrink_without() {
        let config = config();
        let mut search = MosaicSearch::new(&config, Rng::new(1));
        let length = |search: &MosaicSearch| {
            let genes = mutants_of(search, 500).swap_remove(0).genes;
            genes.iter().map(|gene| gene[6].abs()).sum::<f32>()
        };
        let first = length(&search);
        search.tell(false);
        let shorter = length(&search);
        search.tell(true);
        assert_eq!((search.generation(), search.is_finished()), (2, false));
        assert!((shorter / first - 0.5).abs() < 0.1, "{shorter} after {first}");
        assert!((search.reach - 0.55).abs() < 1e-6);
    }

    /// Where each Gaussian has a loss of its own, and credit tells it, the search finds what all of them want.
    #[test]
    fn a_toy_with_exact_credit_is_solved() {
        let loss = |gene: &Genes| gene.iter().map(|&x| f64::from(x - 1.0).powi(2)).sum::<f64>();
        let config = MosaicConfig { generations: 200, step: 0.2, ..config() };
        let mut search = MosaicSearch::new(&config, Rng::new(8));
        let mut cloud = cloud(100);
        let total = |cloud: &Gaussians| (0..100).map(|row| loss(&cloud.genes(row))).sum::<f64>();
        let before = total(&cloud);
        while !search.is_finished() {
            let mutants = search.mutants(&cloud);
            let mut credits = Credits { views: vec![2; 100], ..Credits::zeros(3, 100) };
            for (mutant, changes) in mutants.iter().zip(&mut credits.changes) {
                for (&row, gene) in mutant.rows.iter().zip(&mutant.genes) {
                    changes[row as usize] = (loss(gene) - loss(&cloud.genes(row as usize))) as f32;
                }
            }
            let mut child = cloud.clone();
            child.apply(&search.child(&mutants, &credits, 6));
            let better = total(&child) < total(&cloud);
            if better {
                cloud = child;
            }
            search.tell(better);
        }
        assert!(total(&cloud) < 0.02 * before, "{} of {before}", total(&cloud));
    }

    #[test]
    fn settings_out_of_range_are_named() {
        for (config, name) in [
            (MosaicConfig { mutants: 0, ..config() }, "mutants"),
            (MosaicConfig { views: 0, ..config() }, "views"),
            (MosaicConfig { share: 0.0, ..config() }, "share"),
            (MosaicConfig { share: f64::NAN, ..config() }, "share"),
            (MosaicConfig { step: -1.0, ..config() }, "step"),
            (MosaicConfig { block: 0, ..config() }, "block"),
        ] {
            assert!(config.validate().unwrap_err().to_string().starts_with(name));
        }
        assert_eq!(MosaicConfig::default().validate(), Ok(()));
    }
}
