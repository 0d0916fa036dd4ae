//! The contract: a search is a function of its inputs and of the losses it is told. Neither the number of
//! threads nor the order in which individuals are asked for changes a bit.

mod common;

use common::{normal_base, on_sphere, run, small, sphere};
use genesplat_core::SparseDelta;
use genesplat_evolve::{Crossover, GeneticConfig};

fn result(threads: usize, crossover: Crossover) -> (Option<SparseDelta>, f64) {
    let base = normal_base(500);
    let config = GeneticConfig { crossover, ..small(10, 30) };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started");
    let search = pool.install(|| run(on_sphere(config, &base, 12), |delta| sphere(&base, delta)));
    (search.best().cloned(), search.best_loss())
}

#[test]
fn one_two_and_seven_threads_agree_to_the_bit() {
    for crossover in [Crossover::Points { points: 1 }, Crossover::default(), Crossover::Uniform] {
        let one = result(1, crossover);
        assert!(one.0.is_some(), "the search must find something for the comparison to mean anything");
        assert_eq!(one, result(2, crossover));
        assert_eq!(one, result(7, crossover));
    }
}

#[test]
fn another_seed_gives_another_search() {
    let base = normal_base(500);
    let best = |seed| run(on_sphere(small(3, 30), &base, seed), |delta| sphere(&base, delta)).best().cloned();
    assert_ne!(best(1), best(2));
    assert_eq!(best(1), best(1));
}
