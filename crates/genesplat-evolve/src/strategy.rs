//! An evolution strategy for a genome of a few numbers: a normal distribution that moves, widens and stretches towards
//! what selection favours.
//!
//! Every generation draws individuals around a mean, and the better half, weighted by rank, becomes the next mean. Two
//! paths remember where the mean went: one that is longer than chance would have it widens the steps, a shorter one
//! narrows them; the other stretches single genes. This is the separable CMA-ES (Ros & Hansen, "A simple modification in
//! CMA-ES achieving linear time and space complexity", PPSN 2008). Its constants follow those of Hansen, "The CMA evolution
//! strategy: a tutorial", 2016, and are simpler in places: the worse half has no weights, and how fast the stretch's path
//! forgets depends on the number of genes alone. Only the order of losses matters, so they may come from other views in
//! every generation.
//!
//! Like [`crate::GeneticAlgorithm`] it asks and is told. Every number comes from
//! `Rng::at(Stream::Proposal, generation, individual, pair of genes)`.

use genesplat_core::{Rng, Stream};

use crate::record::LossStatistics;
use crate::survival::Ranking;

/// The search. The state is a few vectors of the genome's length.
#[derive(Clone, Debug)]
pub struct EvolutionStrategy {
    constants: Constants,
    rng: Rng,
    generation: u32,
    mean: Vec<f64>,
    /// Step length, in the genome's units.
    sigma: f64,
    /// Squared stretch of each gene.
    variances: Vec<f64>,
    /// Where the mean went lately, in steps of unit length: for the length, and for the stretch.
    length_path: Vec<f64>,
    stretch_path: Vec<f64>,
}

/// What follows from the number of genes.
#[derive(Clone, Debug)]
struct Constants {
    individuals: usize,
    /// Weights of the better half, best first; they sum to 1.
    weights: Vec<f64>,
    /// How many equally weighted parents would average as much noise away.
    effective_parents: f64,
    length_rate: f64,
    length_damping: f64,
    stretch_path_rate: f64,
    rank_one_rate: f64,
    rank_many_rate: f64,
    /// Expected length of a vector of standard normal numbers.
    expected_length: f64,
}

impl Constants {
    fn new(genes: usize) -> Self {
        let n = genes as f64;
        let individuals = 4 + (3.0 * n.ln()) as usize;
        let parents = individuals / 2;
        let raw: Vec<f64> =
            (1..=parents).map(|rank| (parents as f64 + 0.5).ln() - (rank as f64).ln()).collect();
        let sum: f64 = raw.iter().sum();
        let weights: Vec<f64> = raw.iter().map(|weight| weight / sum).collect();
        let effective_parents = 1.0 / weights.iter().map(|weight| weight * weight).sum::<f64>();
        let length_rate = (effective_parents + 2.0) / (n + effective_parents + 5.0);
        // Diagonal only: there is less to learn, so the rates may be larger by (n + 2) / 3.
        let faster = (n + 2.0) / 3.0;
        let rank_one_rate = (faster * 2.0 / ((n + 1.3).powi(2) + effective_parents)).min(0.5);
        let many = 2.0 * (effective_parents - 2.0 + 1.0 / effective_parents);
        let rank_many_rate = faster * many / ((n + 2.0).powi(2) + effective_parents);
        let excess = ((effective_parents - 1.0) / (n + 1.0)).sqrt() - 1.0;
        Self {
            individuals,
            weights,
            effective_parents,
            length_rate,
            length_damping: 1.0 + 2.0 * excess.max(0.0) + length_rate,
            stretch_path_rate: 4.0 / (n + 4.0),
            rank_one_rate,
            rank_many_rate: rank_many_rate.min(1.0 - rank_one_rate),
            expected_length: n.sqrt() * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n)),
        }
    }
}

impl EvolutionStrategy {
    /// Starts around `start` with steps of length `sigma`.
    ///
    /// # Panics
    /// When the genome is empty.
    pub fn new(start: Vec<f64>, sigma: f64, rng: Rng) -> Self {
        assert!(!start.is_empty(), "a genome has genes");
        let genes = start.len();
        Self {
            constants: Constants::new(genes),
            rng,
            generation: 0,
            mean: start,
            sigma,
            variances: vec![1.0; genes],
            length_path: vec![0.0; genes],
            stretch_path: vec![0.0; genes],
        }
    }

    /// Individuals in a generation, for a genome of this length.
    pub fn individuals(genes: usize) -> usize {
        Constants::new(genes).individuals
    }

    /// The individuals of this generation.
    pub fn ask(&self) -> Vec<Vec<f64>> {
        (0..self.constants.individuals).map(|individual| self.individual(individual)).collect()
    }

    fn individual(&self, index: usize) -> Vec<f64> {
        let normal = |gene: usize| {
            let draw = self.rng.at(Stream::Proposal, self.generation, index as u32, (gene / 2) as u32);
            f64::from(draw.normals(0)[gene % 2])
        };
        let value = |gene: usize| self.mean[gene] + self.sigma * self.variances[gene].sqrt() * normal(gene);
        (0..self.mean.len()).map(value).collect()
    }

    /// The losses of what [`Self::ask`] gave, in order; one that is not finite counts as the worst. Returns what they were
    /// like. When none is finite, the strategy stays where it is and narrows its steps.
    ///
    /// # Panics
    /// When there are more or fewer losses than individuals.
    pub fn tell(&mut self, losses: &[f64]) -> Option<LossStatistics> {
        let individuals = self.ask();
        assert_eq!(losses.len(), individuals.len(), "one loss for each individual");
        self.generation += 1;
        let ranking = Ranking::new(losses);
        let statistics = LossStatistics::of(&ranking);
        if statistics.is_some() {
            // Weights that are left over weigh the mean itself, which stays.
            let count = self.constants.weights.len().min(ranking.finite().len());
            let parents = (0..count).map(|rank| &individuals[ranking.individual(rank as u32)]);
            // Steps of the better half, in units of sigma.
            let step = |individual: &Vec<f64>| -> Vec<f64> {
                individual.iter().zip(&self.mean).map(|(x, m)| (x - m) / self.sigma).collect()
            };
            self.move_by(&parents.map(step).collect::<Vec<_>>());
        } else {
            self.sigma /= 2.0;
        }
        statistics
    }

    fn move_by(&mut self, steps: &[Vec<f64>]) {
        let Constants { weights, effective_parents, .. } = &self.constants;
        let weighted = |gene: usize, power: i32| -> f64 {
            weights.iter().zip(steps).map(|(weight, step)| weight * step[gene].powi(power)).sum()
        };
        let step: Vec<f64> = (0..self.mean.len()).map(|gene| weighted(gene, 1)).collect();
        let spread: Vec<f64> = (0..self.mean.len()).map(|gene| weighted(gene, 2)).collect();
        let parents = *effective_parents;
        for (mean, step) in self.mean.iter_mut().zip(&step) {
            *mean += self.sigma * step;
        }
        let stalled = self.follow(&step, parents);
        self.stretch(&spread, stalled);
        let length = norm(&self.length_path) / self.constants.expected_length;
        self.sigma *= (self.constants.length_rate / self.constants.length_damping * (length - 1.0)).exp();
    }

    /// Updates the paths; true when the mean runs away so fast that its path must not stretch single genes.
    fn follow(&mut self, step: &[f64], parents: f64) -> bool {
        let Constants { length_rate, stretch_path_rate, expected_length, .. } = self.constants;
        let gain = (length_rate * (2.0 - length_rate) * parents).sqrt();
        for ((path, step), variance) in self.length_path.iter_mut().zip(step).zip(&self.variances) {
            *path = (1.0 - length_rate) * *path + gain * step / variance.sqrt();
        }
        let settled = (1.0 - (1.0 - length_rate).powi(2 * self.generation as i32)).sqrt();
        let genes = step.len() as f64;
        let runs = norm(&self.length_path) / settled >= (1.4 + 2.0 / (genes + 1.0)) * expected_length;
        let gain = if runs { 0.0 } else { (stretch_path_rate * (2.0 - stretch_path_rate) * parents).sqrt() };
        for (path, step) in self.stretch_path.iter_mut().zip(step) {
            *path = (1.0 - stretch_path_rate) * *path + gain * step;
        }
        runs
    }

    fn stretch(&mut self, spread: &[f64], stalled: bool) {
        let Constants { rank_one_rate, rank_many_rate, stretch_path_rate, .. } = self.constants;
        // What the stalled path does not add is kept of the old variance.
        let kept = if stalled { rank_one_rate * stretch_path_rate * (2.0 - stretch_path_rate) } else { 0.0 };
        let old = 1.0 - rank_one_rate - rank_many_rate + kept;
        for ((variance, path), spread) in self.variances.iter_mut().zip(&self.stretch_path).zip(spread) {
            *variance = old * *variance + rank_one_rate * path * path + rank_many_rate * spread;
        }
    }

    /// The best guess: the middle of the distribution.
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// Length of its steps.
    #[cfg(test)]
    fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Generations told.
    pub fn generation(&self) -> u32 {
        self.generation
    }
}

fn norm(vector: &[f64]) -> f64 {
    vector.iter().map(|value| value * value).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(genes: usize, generations: u32, seed: u64, loss: impl Fn(&[f64]) -> f64) -> EvolutionStrategy {
        let mut strategy = EvolutionStrategy::new(vec![0.0; genes], 0.5, Rng::new(seed));
        for _ in 0..generations {
            let losses: Vec<f64> = strategy.ask().iter().map(|individual| loss(individual)).collect();
            strategy.tell(&losses);
        }
        strategy
    }

    fn distance(strategy: &EvolutionStrategy, optimum: impl Fn(usize) -> f64) -> f64 {
        let offset = |(gene, x): (usize, &f64)| (x - optimum(gene)).powi(2);
        strategy.mean().iter().enumerate().map(offset).sum::<f64>().sqrt()
    }

    #[test]
    fn it_finds_the_bottom_of_a_bowl() {
        for genes in [1, 2, 12] {
            let bowl = |x: &[f64]| x.iter().map(|x| (x - 1.5).powi(2)).sum::<f64>();
            let strategy = search(genes, 150, 3, bowl);
            assert!(distance(&strategy, |_| 1.5) < 1e-4, "{genes} genes: {:?}", strategy.mean());
            assert!(strategy.sigma() < 1e-3 && strategy.generation() == 150);
        }
    }

    #[test]
    fn it_learns_which_genes_matter_most() {
        let steep = |gene: usize| 10f64.powi(gene as i32);
        let ellipsoid =
            |x: &[f64]| x.iter().enumerate().map(|(k, x)| steep(k) * (x - 1.0).powi(2)).sum::<f64>();
        let strategy = search(5, 300, 4, ellipsoid);
        assert!(distance(&strategy, |_| 1.0) < 1e-3, "{:?}", strategy.mean());
        let [flat, .., steepest] = strategy.variances[..] else { panic!("five genes") };
        assert!(flat > 100.0 * steepest, "the flat gene has the longer steps");
    }

    #[test]
    fn it_moves_towards_the_optimum_under_noise() {
        let noise = |x: &[f64]| (x[0] * 12_345.678).sin() * 0.3;
        let strategy = search(4, 60, 5, |x| x.iter().map(|x| (x - 1.0).powi(2)).sum::<f64>() + noise(x));
        assert!(distance(&strategy, |_| 1.0) < 0.5, "{:?}", strategy.mean());
    }

    #[test]
    fn only_the_order_of_losses_matters() {
        let bowl = |x: &[f64]| x.iter().map(|x| (x - 1.5).powi(2)).sum::<f64>();
        let (plain, bent) = (search(3, 20, 6, bowl), search(3, 20, 6, |x| bowl(x).sqrt().exp()));
        assert_eq!(plain.mean(), bent.mean());
    }

    #[test]
    fn what_is_not_finite_is_never_a_parent() {
        let cliff = |x: &[f64]| if x[0] > 0.2 { f64::NAN } else { -x[0] };
        for generations in 1..=40 {
            let strategy = search(2, generations, 7, cliff);
            assert!(strategy.mean()[0] <= 0.2, "{generations} generations: {:?}", strategy.mean());
        }
        assert!(search(2, 40, 7, cliff).mean()[0] > 0.0);
        let nowhere = search(2, 10, 8, |_| f64::INFINITY);
        assert_eq!(nowhere.mean(), [0.0; 2]);
        assert!(nowhere.sigma() < 0.5);
    }

    #[test]
    fn the_first_generation_is_as_it_was_asked_for() {
        let individuals = EvolutionStrategy::individuals(12);
        let strategy = EvolutionStrategy::new(vec![2.0; 12], 0.3, Rng::new(9));
        let genes: Vec<f64> = strategy.ask().concat();
        assert_eq!((individuals, genes.len()), (11, 132));
        let mean = genes.iter().sum::<f64>() / 132.0;
        let variance = genes.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 131.0;
        assert!((mean - 2.0).abs() < 0.1, "{mean}");
        assert!((variance.sqrt() - 0.3).abs() < 0.06, "{variance}");
        assert_eq!(strategy.ask(), strategy.ask());
    }
}
