//! The genetic algorithm of "An Evolutionary Boost to Gaussian Splatting Optimization". It knows no renderer,
//! file or clock.
//!
//! [`GeneticAlgorithm`] is Algorithm 1 turned inside out: it *asks* for the losses of individuals and is
//! *told* them. An individual is a sparse difference from a state that all share; how memory grows is stated
//! in [`population`].
//!
//! ```
//! use genesplat_core::{Genes, Rng, SparseDelta};
//! use genesplat_evolve::{GeneticAlgorithm, GeneticConfig, Magnitude};
//!
//! // Fifty Gaussians that would like all their genes to be zero.
//! let base: Vec<Genes> = (0..50).map(|row| [1.0 + (row % 7) as f32; 7]).collect();
//! let loss = |delta: &SparseDelta| {
//!     let mut genes = base.clone();
//!     delta.rows.iter().zip(&delta.genes).for_each(|(&row, gene)| genes[row as usize] = *gene);
//!     genes.as_flattened().iter().map(|&x| f64::from(x).powi(2)).sum::<f64>()
//! };
//! let config = GeneticConfig { generations: 20, magnitude: Magnitude::Unit, ..GeneticConfig::default() };
//! let base_loss = loss(&SparseDelta::default());
//! let mut search = GeneticAlgorithm::new(config, base.clone(), None, base_loss, Rng::new(7))?;
//! while !search.is_finished() {
//!     let losses: Vec<f64> = (0..search.ask()).map(|index| loss(&search.delta(index))).collect();
//!     search.tell(&losses)?;
//! }
//! assert!(search.best_loss() < base_loss);
//! assert_eq!(search.best().map(loss), Some(search.best_loss()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | what it decides |
//! |---|---|
//! | [`genetic`], [`config`] | Algorithm 1, the settings of Table 1, and the rates of each generation |
//! | [`population`], `individual` | how individuals are stored, what that costs, what a generation has in common |
//! | `operators` | selection, crossover, mutation (Eq. 4), survival |
//!
//! Every random number is addressed by generation, individual and row, so neither threads nor the order of
//! scoring can change a result; and a search is resumed by building it again and telling it the recorded
//! losses.

pub mod config;
pub mod genetic;
mod individual;
mod operators;
pub mod population;

pub use config::{ConfigError, Crossover, GeneticConfig, Magnitude, Rates};
pub use genetic::{GeneticAlgorithm, TellError};
pub use operators::magnitude::GeneGradients;
pub use operators::survival::LossStatistics;
