//! Mutation (section 3.2): `x_mutated = x + alpha * u_i * sigma_x * N(0, 1)` (Eq. 4).
//!
//! What the paper leaves open, and how it is decided here:
//! - **Which Gaussians**: exactly `round(selection_fraction * N)`, a fresh uniform subset for each
//!   individual.
//! - **Which genes**: each of the three groups of a selected Gaussian mutates with the mutation rate,
//!   independently; then all its components move, each by its own normal number.
//! - **`x_base`**: the value that the child has before the mutation. The value in the base would undo what
//!   was inherited.
//! - **`sigma_x`**: the standard deviation (`1/N`) of each gene over the base that the search began with.
//! - **The space**: genes move as the optimiser sees them, log-scales and opacity logits, where every value
//!   is valid.

use genesplat_core::{GENES, Genes, Rng, Stream};

use super::magnitude::{GeneGradients, Magnitudes};
use super::sampling::{Address, choose_rows};
use crate::config::{ConfigError, GeneticConfig};
use crate::individual::group::Group;
use crate::individual::{Genome, Mutations, Parents};

/// All that Eq. 4 needs besides the individual; fixed for a search.
#[derive(Debug)]
pub(crate) struct Mutation {
    rng: Rng,
    /// alpha times sigma_x of each component, in units of the gene.
    step: Genes,
    magnitudes: Magnitudes,
    /// Rows of the base.
    total: u32,
    /// Of which one mutation selects so many.
    selected: u32,
}

/// The most Gaussians that the addresses of [`Mutation::draw`] can tell apart.
pub(crate) const MAX_GAUSSIANS: usize = (u32::MAX / DRAWS_PER_ROW) as usize;

/// Draws a row: coins; position and opacity; scale.
const DRAWS_PER_ROW: u32 = 3;

impl Mutation {
    /// For a validated configuration and a finite base.
    pub(crate) fn new(
        config: &GeneticConfig,
        base: &[Genes],
        gradients: Option<GeneGradients>,
        rng: Rng,
    ) -> Result<Self, ConfigError> {
        let gradients = checked(gradients.filter(|_| config.uses_gradients()), base.len())?;
        let magnitudes = Magnitudes::new(config.magnitude, gradients.as_ref())?;
        let step = sigma(base).map(|sigma| (config.intensity * sigma) as f32);
        let total = base.len() as u32;
        Ok(Self { rng, step, magnitudes, total, selected: config.selected(total) })
    }

    /// The child of `parents` after the mutation at `address`.
    pub(crate) fn apply(
        &self,
        parents: Parents<'_>,
        shared: &[Genes],
        address: Address,
        rate: f64,
    ) -> Genome {
        Genome::child(parents, &self.draw(address, rate), shared)
    }

    /// Bytes held besides the base.
    pub(crate) fn bytes(&self) -> usize {
        self.magnitudes.bytes()
    }

    /// Decides the mutation at `address`: which rows, which groups, how far.
    fn draw(&self, address: Address, rate: f64) -> Mutations {
        let rows = choose_rows(&self.rng, Stream::GeneSelection, address, self.total, self.selected);
        let magnitudes = self.magnitudes.over(&rows);
        let mut mutations = Mutations::default();
        for &row in &rows {
            let draw = |index: u32| {
                let counter = DRAWS_PER_ROW * row + index;
                self.rng.at(Stream::Mutation, address.generation, address.individual, counter)
            };
            let coins = draw(0);
            let mutates = |group: Group| f64::from(coins.uniform(group as usize)) < rate;
            let u = |group| magnitudes.u(group, row);
            if mutates(Group::Position) {
                let ([x, y], [z, _]) = (draw(1).normals(0), draw(1).normals(1));
                mutations.position.push(row, self.moved(Group::Position, u(Group::Position), [x, y, z]));
            }
            if mutates(Group::Scale) {
                let ([x, y], [z, _]) = (draw(2).normals(0), draw(2).normals(1));
                mutations.scale.push(row, self.moved(Group::Scale, u(Group::Scale), [x, y, z]));
            }
            if mutates(Group::Opacity) {
                // The number that position leaves over.
                let [_, o] = draw(1).normals(1);
                mutations.opacity.push(row, self.moved(Group::Opacity, u(Group::Opacity), [o]));
            }
        }
        mutations
    }

    /// `alpha * u_i * sigma_x * N(0, 1)` for the components of a group (Eq. 4).
    fn moved<const W: usize>(&self, group: Group, u: f32, normals: [f32; W]) -> [f32; W] {
        let step: [f32; W] = group.of(&self.step);
        std::array::from_fn(|component| step[component] * u * normals[component])
    }
}

/// `sigma_x` of each gene over the base; all zero for an empty base.
fn sigma(base: &[Genes]) -> [f64; GENES] {
    std::array::from_fn(|gene| {
        let values = || base.iter().map(|genes| f64::from(genes[gene]));
        let n = base.len().max(1) as f64;
        let mean = values().sum::<f64>() / n;
        (values().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt()
    })
}

/// Fails where gradients are not those of a cloud of `n` rows.
fn checked(gradients: Option<GeneGradients>, n: usize) -> Result<Option<GeneGradients>, ConfigError> {
    let Some(gradients) = gradients else { return Ok(None) };
    let (sums, views) = (gradients.sum.len(), gradients.views.len());
    if (sums, views) != (n, n) {
        return Err(ConfigError::GradientRows { sums, views, base: n });
    }
    match first_non_finite(&gradients.sum) {
        Some(row) => Err(ConfigError::GradientNotFinite { row }),
        None => Ok(Some(gradients)),
    }
}

/// The first row with a gene that is not finite.
pub(crate) fn first_non_finite(rows: &[[f32; GENES]]) -> Option<usize> {
    rows.iter().position(|gene| gene.iter().any(|value| !value.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Magnitude;
    use genesplat_core::SparseDelta;

    /// A base whose component `c` has standard deviation `c + 1`.
    fn base(n: usize) -> Vec<Genes> {
        let sign = |row: usize| if row.is_multiple_of(2) { 1.0 } else { -1.0 };
        (0..n).map(|row| std::array::from_fn(|c| sign(row) * (c + 1) as f32)).collect()
    }

    fn mutation(config: &GeneticConfig, base: &[Genes], gradients: Option<GeneGradients>) -> Mutation {
        Mutation::new(config, base, gradients, Rng::new(3)).expect("valid")
    }

    fn mutant(mutation: &Mutation, base: &[Genes], address: Address, rate: f64) -> SparseDelta {
        mutation.apply(Parents::One(&Genome::unchanged(base.len())), base, address, rate).to_delta(base)
    }

    /// Differences from the base of `individuals` mutants, component by component; unchanged genes left out.
    fn moves(mutation: &Mutation, base: &[Genes], rate: f64, individuals: u32) -> [Vec<f64>; GENES] {
        let mut moves = [(); GENES].map(|()| Vec::new());
        for individual in 0..individuals {
            let address = Address { generation: 1, individual };
            let delta = mutant(mutation, base, address, rate);
            for (&row, gene) in delta.rows.iter().zip(&delta.genes) {
                for (component, moves) in moves.iter_mut().enumerate() {
                    let by = f64::from(gene[component] - base[row as usize][component]);
                    moves.extend((by != 0.0).then_some(by));
                }
            }
        }
        moves
    }

    fn mean_and_std(values: &[f64]) -> (f64, f64) {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (mean, (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
    }

    #[test]
    fn moves_are_normal_with_standard_deviation_alpha_sigma() {
        let base = base(1000);
        let config =
            GeneticConfig { magnitude: Magnitude::Unit, selection_fraction: 0.5, ..GeneticConfig::default() };
        let moves = moves(&mutation(&config, &base, None), &base, 0.5, 40);
        for (component, moves) in moves.iter().enumerate() {
            let n = moves.len() as f64;
            // 40 individuals x 500 selected x rate 0.5; four and a half standard errors in each check.
            assert!(
                (n - 10_000.0).abs() < 4.5 * (20_000.0f64 * 0.25).sqrt(),
                "component {component}: {n} moves"
            );
            let expected = 0.1 * (component + 1) as f64;
            let (mean, std) = mean_and_std(moves);
            assert!(mean.abs() < 4.5 * expected / n.sqrt(), "component {component}: mean {mean}");
            assert!((std / expected - 1.0).abs() < 4.5 / (2.0 * n).sqrt(), "component {component}: {std}");
            let within = moves.iter().filter(|x| x.abs() < expected).count() as f64 / n;
            assert!(
                (within - 0.6827).abs() < 4.5 * (0.6827 * 0.3173 / n).sqrt(),
                "component {component}: {within}"
            );
        }
    }

    #[test]
    fn components_move_independently() {
        let base = base(500);
        let config =
            GeneticConfig { magnitude: Magnitude::Unit, selection_fraction: 1.0, ..GeneticConfig::default() };
        let moves = moves(&mutation(&config, &base, None), &base, 1.0, 20);
        let n = moves[0].len();
        assert!(moves.iter().all(|column| column.len() == n), "at rate 1 every gene moves");
        for a in 0..GENES {
            for b in a + 1..GENES {
                let product = |(x, y): (&f64, &f64)| x * y / (0.01 * (a + 1) as f64 * (b + 1) as f64);
                let correlation = moves[a].iter().zip(&moves[b]).map(product).sum::<f64>() / n as f64;
                assert!(correlation.abs() < 4.5 / (n as f64).sqrt(), "{a} and {b}: {correlation}");
            }
        }
    }

    #[test]
    fn groups_mutate_independently() {
        let base = base(4000);
        let config =
            GeneticConfig { magnitude: Magnitude::Unit, selection_fraction: 1.0, ..GeneticConfig::default() };
        let address = Address { generation: 1, individual: 0 };
        let Mutations { position, scale, opacity } = mutation(&config, &base, None).draw(address, 0.5);
        for (a, b) in
            [(&position.rows, &scale.rows), (&scale.rows, &opacity.rows), (&opacity.rows, &position.rows)]
        {
            let both = a.iter().filter(|row| b.contains(row)).count();
            // Four and a half standard errors of a quarter.
            assert!(both.abs_diff(1000) < 124, "{both}");
        }
    }

    #[test]
    fn u_scales_the_move() {
        // Half of the Gaussians have no gradient in a group, half have one: z is -1 and +1, u is 0.2689 and
        // 0.7311.
        let base = base(1000);
        for group in Group::ALL {
            let (first, genes) = (group.start(), group.start()..group.start() + group.width());
            let gradient = |row, gene| if row < 500 || !genes.contains(&gene) { 0.0 } else { 3.0 };
            let sum = (0..1000).map(|row| std::array::from_fn(|gene| gradient(row, gene))).collect();
            let gradients = GeneGradients { sum, views: vec![2; 1000] };
            let config = GeneticConfig { selection_fraction: 1.0, ..GeneticConfig::default() };
            let mutation = mutation(&config, &base, Some(gradients));
            let mut squares = [0.0f64; 2];
            for individual in 0..20 {
                let delta = mutant(&mutation, &base, Address { generation: 1, individual }, 1.0);
                for (&row, gene) in delta.rows.iter().zip(&delta.genes) {
                    let by = f64::from(gene[first] - base[row as usize][first]);
                    squares[usize::from(row >= 500)] += by.powi(2) / 10_000.0;
                }
            }
            for (square, u) in squares.into_iter().zip([0.268_941, 0.731_059]) {
                // alpha = 0.1, sigma of column c = c + 1; four and a half standard errors of 10,000 draws.
                let expected = 0.1 * (first + 1) as f64 * u;
                assert!(
                    (square.sqrt() / expected - 1.0).abs() < 4.5 / 20_000f64.sqrt(),
                    "{group:?}: {square}"
                );
            }
        }
    }

    #[test]
    fn each_individual_of_each_generation_mutates_in_its_own_way() {
        let base = base(1000);
        let config =
            GeneticConfig { magnitude: Magnitude::Unit, selection_fraction: 1.0, ..GeneticConfig::default() };
        let mutation = mutation(&config, &base, None);
        let at = |generation, individual| mutation.draw(Address { generation, individual }, 0.5);
        // All rows are selected, so that only coins and normal numbers can differ.
        let draws = [at(1, 2), at(1, 3), at(2, 2)];
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            assert_ne!(draws[a].position.rows, draws[b].position.rows);
            assert_ne!(draws[a].position.by[0], draws[b].position.by[0]);
        }
        assert_eq!(draws[0], at(1, 2));
    }

    #[test]
    fn exactly_the_selected_fraction_is_touched() {
        let base = base(1000);
        let config = GeneticConfig { magnitude: Magnitude::Unit, ..GeneticConfig::default() };
        let mutation = mutation(&config, &base, None);
        let touched = |rate| {
            let address = Address { generation: 0, individual: 0 };
            mutant(&mutation, &base, address, rate).rows.len()
        };
        assert_eq!((touched(1.0), touched(0.0)), (100, 0));
    }

    #[test]
    fn a_gene_that_would_overflow_keeps_its_value() {
        let base: Vec<Genes> =
            (0..100).map(|row| [if row % 2 == 0 { f32::MAX } else { -f32::MAX }; GENES]).collect();
        let config = GeneticConfig {
            magnitude: Magnitude::Unit,
            intensity: 1.0,
            selection_fraction: 1.0,
            ..GeneticConfig::default()
        };
        let mutation = mutation(&config, &base, None);
        let address = Address { generation: 0, individual: 0 };
        let delta = mutant(&mutation, &base, address, 1.0);
        assert_eq!(delta.rows.len(), 100);
        assert_eq!(first_non_finite(&delta.genes), None);
        assert!(delta.genes.iter().zip(&base).any(|(gene, old)| gene[0] == old[0]), "half would overflow");
        assert!(delta.genes.iter().zip(&base).any(|(gene, old)| gene[0] != old[0]), "half would not");
    }
}
