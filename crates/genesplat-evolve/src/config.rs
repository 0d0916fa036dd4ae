//! The settings of the paper's genetic search (its Table 1). Where the paper is silent, the doc of a setting
//! says so.

use serde::{Deserialize, Serialize};

/// Settings of one search. [`GeneticConfig::default`] is Table 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "snake_case")]
pub struct GeneticConfig {
    /// Training views that fitness is measured on, spread evenly over the views in order of name, the same in
    /// all searches of a run. Default 6; at least 1.
    pub views: usize,
    /// K, generations bred after the initial population. Default 100; from 0. Time grows in proportion.
    pub generations: u32,
    /// P, individuals a generation. Default 100; from 1. Time grows in proportion; memory hardly does.
    pub population: u32,
    /// T, individuals drawn for each tournament, without replacement. Default 10; 1 to P.
    pub tournament: u32,
    /// Fraction of the population carried over unchanged. Default 0.10; `round(fraction * P)` must be below
    /// P.
    pub elite_fraction: f64,
    /// Fraction of the Gaussians that a mutation may touch, drawn afresh for each individual: exactly
    /// `round(fraction * N)`, and at least one. Default 0.10; above 0, up to 1.
    pub selection_fraction: f64,
    /// alpha of Eq. 4: the step in units of `u_i` times the parameter's standard deviation. Default 0.10;
    /// from 0.
    pub intensity: f64,
    /// Probability that a gene group of a selected Gaussian mutates in the initial population. Default 0.03;
    /// 0 to 1.
    pub initial_mutation_rate: f64,
    /// The same in the early, middle and late generations. Default 0.15, 0.05, 0.02; each 0 to 1.
    pub mutation_rates: [f64; 3],
    /// Probability that a pair of parents is crossed rather than copied, in the early, middle and late
    /// generations. Default 0.85, 0.70, 0.50; each 0 to 1.
    pub crossover_rates: [f64; 3],
    /// Where early ends and where middle ends, as fractions of K. Default 0.30, 0.70; 0 to 1, ascending.
    /// Generation k of K (from 1) is early while `(k - 1) / K` is below the first.
    pub rate_breaks: [f64; 2],
    /// How two parents are recombined. Default `{ kind = "points", points = 100 }`; or `{ kind = "uniform"
    /// }`.
    pub crossover: Crossover,
    /// Where `u_i` of Eq. 4 comes from. Default `gradient`; or `unit`.
    pub magnitude: Magnitude,
}

/// Recombination of two parents (section 3.1) into two complementary children.
///
/// The paper does not say where a cut may fall. Here cuts fall *between Gaussians*, in the order of the
/// cloud's rows; only `Uniform` mixes within a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Crossover {
    /// Distinct cuts: `points + 1` segments are exchanged alternately (1 or 100 in the paper). Where a cloud
    /// has fewer places for a cut, all are used.
    Points {
        /// Number of cuts; from 1.
        points: u32,
    },
    /// A coin for each gene group (position, scale, opacity) of each Gaussian.
    Uniform,
}

/// Where `u_i` of Eq. 4 comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Magnitude {
    /// From gene gradients, standardised over the selected Gaussians and squashed into (0, 1).
    #[default]
    Gradient,
    /// `u_i = 1`: fully gradient-free.
    Unit,
}

impl Default for Crossover {
    fn default() -> Self {
        Self::Points { points: 100 }
    }
}

impl Default for GeneticConfig {
    fn default() -> Self {
        Self {
            views: 6,
            generations: 100,
            population: 100,
            tournament: 10,
            elite_fraction: 0.10,
            selection_fraction: 0.10,
            intensity: 0.10,
            initial_mutation_rate: 0.03,
            mutation_rates: [0.15, 0.05, 0.02],
            crossover_rates: [0.85, 0.70, 0.50],
            rate_breaks: [0.30, 0.70],
            crossover: Crossover::default(),
            magnitude: Magnitude::default(),
        }
    }
}

/// The rates of one generation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Probability that a gene group of a selected Gaussian mutates.
    pub mutation: f64,
    /// Probability that a pair is crossed.
    pub crossover: f64,
}

impl GeneticConfig {
    /// True when a search needs [`crate::GeneGradients`].
    pub fn uses_gradients(&self) -> bool {
        self.magnitude == Magnitude::Gradient
    }

    /// E, individuals carried over unchanged.
    pub fn elites(&self) -> u32 {
        (self.elite_fraction * f64::from(self.population)).round() as u32
    }

    /// k, Gaussians of a cloud of `n` that one mutation selects.
    pub fn selected(&self, n: u32) -> u32 {
        ((self.selection_fraction * f64::from(n)).round() as u32).clamp(n.min(1), n)
    }

    /// Individuals that a whole search scores: `P + K * (P - E)`.
    pub fn evaluations(&self) -> u64 {
        let (population, children) = (self.population, self.population.saturating_sub(self.elites()));
        u64::from(population) + u64::from(self.generations) * u64::from(children)
    }

    /// The rates that make generation `generation`: 0 is the initial population, then 1 to K.
    pub fn rates(&self, generation: u32) -> Rates {
        let Some(bred_before) = generation.checked_sub(1) else {
            return Rates { mutation: self.initial_mutation_rate, crossover: 0.0 };
        };
        // As near to the fraction as the literal 0.30 is, so that the comparison is exact at the breaks.
        let progress = f64::from(bred_before) / f64::from(self.generations);
        let piece = self.rate_breaks.iter().filter(|&&end| progress >= end).count();
        Rates { mutation: self.mutation_rates[piece], crossover: self.crossover_rates[piece] }
    }

    /// Checks every range; the first setting that is out of its range is named.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check("views", self.views as f64, self.views >= 1, "at least 1")?;
        check("population", self.population, self.population >= 1, "at least 1")?;
        let fits = (1..=self.population).contains(&self.tournament);
        check("tournament", self.tournament, fits, "between 1 and population")?;
        check_fraction("elite_fraction", self.elite_fraction)?;
        let has_children = self.elites() < self.population;
        check("elite_fraction", self.elite_fraction, has_children, "low enough to leave room for a child")?;
        let selects = is_fraction(self.selection_fraction) && self.selection_fraction > 0.0;
        check("selection_fraction", self.selection_fraction, selects, "above 0 and at most 1")?;
        let is_step = self.intensity.is_finite() && self.intensity >= 0.0;
        check("intensity", self.intensity, is_step, "finite and not negative")?;
        check_fraction("initial_mutation_rate", self.initial_mutation_rate)?;
        self.mutation_rates.into_iter().try_for_each(|rate| check_fraction("mutation_rates", rate))?;
        self.crossover_rates.into_iter().try_for_each(|rate| check_fraction("crossover_rates", rate))?;
        self.rate_breaks.into_iter().try_for_each(|end| check_fraction("rate_breaks", end))?;
        let [early, middle] = self.rate_breaks;
        check("rate_breaks", middle, early <= middle, "in ascending order")?;
        match self.crossover {
            Crossover::Points { points } => check("crossover.points", points, points >= 1, "at least 1"),
            Crossover::Uniform => Ok(()),
        }
    }
}

fn is_fraction(value: f64) -> bool {
    (0.0..=1.0).contains(&value)
}

fn check_fraction(setting: &'static str, value: f64) -> Result<(), ConfigError> {
    check(setting, value, is_fraction(value), "between 0 and 1")
}

fn check(
    setting: &'static str,
    value: impl Into<f64>,
    holds: bool,
    allowed: &'static str,
) -> Result<(), ConfigError> {
    if holds { Ok(()) } else { Err(ConfigError::OutOfRange { setting, value: value.into(), allowed }) }
}

/// Why a search cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A setting makes no sense.
    #[error("{setting} is {value}, but must be {allowed}")]
    OutOfRange {
        /// Name of the field.
        setting: &'static str,
        /// What it was set to.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// [`Magnitude::Gradient`] without gradients.
    #[error("no gene gradients were accumulated; set magnitude to \"unit\", which needs none")]
    MissingGradients,
    /// Gradients of another cloud.
    #[error(
        "there are gene gradients of {sums} Gaussians and view counts of {views}, but the base has {base}"
    )]
    GradientRows {
        /// Rows of the sums.
        sums: usize,
        /// Rows of the view counts.
        views: usize,
        /// Rows of the base.
        base: usize,
    },
    /// A NaN or an infinity in the gradient sums.
    #[error(
        "the gene gradient of Gaussian {row} is not finite; lower the learning rates or set magnitude to \"unit\""
    )]
    GradientNotFinite {
        /// Row of the base.
        row: usize,
    },
    /// A NaN or an infinity in the base.
    #[error("Gaussian {row} of the base has a gene that is not finite; remove it before evolving")]
    BaseNotFinite {
        /// Row of the base.
        row: usize,
    },
    /// The base could not be judged.
    #[error(
        "the loss of the base is {loss}, so individuals have nothing to be better than; check the render"
    )]
    BaseLossNotFinite {
        /// What was given.
        loss: f64,
    },
    /// Random numbers are addressed with 32 bits.
    #[error("the base has {rows} Gaussians, more than the {limit} that random numbers can be addressed for")]
    TooManyGaussians {
        /// Rows of the base.
        rows: usize,
        /// The most that is possible.
        limit: usize,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_change_exactly_at_the_breaks() {
        let config = GeneticConfig::default();
        let pieces: Vec<(u32, f64, f64)> = [0, 1, 30, 31, 70, 71, 100]
            .into_iter()
            .map(|generation| {
                let rates = config.rates(generation);
                (generation, rates.mutation, rates.crossover)
            })
            .collect();
        let expected = [
            (0, 0.03, 0.0),
            (1, 0.15, 0.85),
            (30, 0.15, 0.85),
            (31, 0.05, 0.70),
            (70, 0.05, 0.70),
            (71, 0.02, 0.50),
            (100, 0.02, 0.50),
        ];
        assert_eq!(pieces, expected);
    }

    #[test]
    fn every_multiple_of_ten_generations_is_split_30_40_30() {
        for tens in 1..=100u32 {
            let config = GeneticConfig { generations: 10 * tens, ..GeneticConfig::default() };
            let count =
                |rate: f64| (1..=10 * tens).filter(|&k| config.rates(k).mutation == rate).count() as u32;
            assert_eq!([count(0.15), count(0.05), count(0.02)], [3 * tens, 4 * tens, 3 * tens]);
        }
    }

    #[test]
    fn table_1_is_valid_and_survives_toml() {
        let config = GeneticConfig::default();
        assert_eq!(config.validate(), Ok(()));
        assert_eq!((config.elites(), config.evaluations()), (10, 9100));
        let text = toml::to_string(&config).expect("plain values");
        assert_eq!(toml::from_str::<GeneticConfig>(&text), Ok(config));
        let partial: GeneticConfig =
            toml::from_str("crossover = { kind = \"uniform\" }\nmagnitude = \"unit\"").unwrap();
        assert_eq!((partial.crossover, partial.magnitude), (Crossover::Uniform, Magnitude::Unit));
        assert!(toml::from_str::<GeneticConfig>("tournaments = 3").is_err(), "unknown names are refused");
        assert!(toml::from_str::<GeneticConfig>("crossover = { kind = \"points\", cuts = 3 }").is_err());
    }

    #[test]
    fn at_least_one_gaussian_is_selected() {
        let config = GeneticConfig::default();
        assert_eq!([0, 1, 4, 14, 16, 1000].map(|n| config.selected(n)), [0, 1, 1, 1, 2, 100]);
        let all = GeneticConfig { selection_fraction: 1.0, ..config };
        assert_eq!(all.selected(7), 7);
    }

    #[test]
    fn each_setting_out_of_range_is_named() {
        type Change = fn(&mut GeneticConfig);
        let changes: [(Change, &str); 13] = [
            (|c| c.views = 0, "views is 0, but must be at least 1"),
            (|c| c.population = 0, "population is 0, but must be at least 1"),
            (|c| c.tournament = 0, "tournament is 0, but must be between 1 and population"),
            (|c| c.tournament = 101, "tournament is 101, but must be between 1 and population"),
            (
                |c| c.elite_fraction = 1.0,
                "elite_fraction is 1, but must be low enough to leave room for a child",
            ),
            (|c| c.elite_fraction = -0.5, "elite_fraction is -0.5, but must be between 0 and 1"),
            (|c| c.selection_fraction = 0.0, "selection_fraction is 0, but must be above 0 and at most 1"),
            (|c| c.intensity = f64::NAN, "intensity is NaN, but must be finite and not negative"),
            (|c| c.initial_mutation_rate = 1.5, "initial_mutation_rate is 1.5, but must be between 0 and 1"),
            (|c| c.mutation_rates[2] = -0.1, "mutation_rates is -0.1, but must be between 0 and 1"),
            (|c| c.crossover_rates[0] = f64::NAN, "crossover_rates is NaN, but must be between 0 and 1"),
            (|c| c.rate_breaks = [0.7, 0.3], "rate_breaks is 0.3, but must be in ascending order"),
            (
                |c| c.crossover = Crossover::Points { points: 0 },
                "crossover.points is 0, but must be at least 1",
            ),
        ];
        for (change, sentence) in changes {
            let mut config = GeneticConfig::default();
            change(&mut config);
            assert_eq!(config.validate().map_err(|error| error.to_string()), Err(sentence.to_owned()));
        }
    }
}
