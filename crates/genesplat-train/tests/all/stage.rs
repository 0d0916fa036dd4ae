//! The paper's search: it never makes things worse, and stops when told; and its control, which costs what it
//! says.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use genesplat_core::{Gaussians, TrainStep};
use genesplat_evolve::{Crossover, GeneticConfig, Magnitude};
use genesplat_train::observe::{GenerationLog, StageLog};
use genesplat_train::scene::initialise::cloud_from_points;
use genesplat_train::{
    Background, MethodName, Observer, Outcome, Silent, StageKind, StageRecord, Start, StepBudget,
    TrainConfig, TrainError, search, train,
};

use crate::support::{Call, FakeBackend, points, views};

const GENERATIONS: u32 = 4;
const POPULATION: u32 = 12;

/// Bolder than the paper, so that thirty Gaussians improve within a generation.
fn genetic() -> GeneticConfig {
    GeneticConfig {
        generations: GENERATIONS,
        population: POPULATION,
        initial_mutation_rate: 0.5,
        mutation_rates: [0.5; 3],
        ..GeneticConfig::default()
    }
}

fn config() -> TrainConfig {
    TrainConfig { genetic: Some(genetic()), ..TrainConfig::default() }
}

fn cloud() -> Gaussians {
    cloud_from_points(&points(30)).unwrap()
}

fn run(backend: &mut FakeBackend, config: TrainConfig, stop: &AtomicBool) -> Result<Outcome, TrainError> {
    search(backend, &views(20), cloud(), &config.resolve().unwrap(), &mut Silent, stop)
}

/// What was applied: moves to where individuals are scored from, the way back, and the best.
fn applied(backend: &FakeBackend) -> Vec<&Call> {
    backend.calls.iter().filter(|call| matches!(call, Call::Genes { .. })).collect()
}

#[test]
fn a_better_individual_replaces_the_base() {
    let mut backend = FakeBackend::new();
    let outcome = run(&mut backend, config(), &AtomicBool::new(false)).unwrap();
    let stage = outcome.summary.stages[0];
    assert!(stage.fitness_after < stage.fitness_before, "{stage:?}");
    assert_eq!(stage.generations, GENERATIONS + 1, "the initial population counts");
    let expected = Call::Genes { rows: stage.changed };
    assert_eq!(applied(&backend).last(), Some(&&expected));
    assert_ne!(outcome.cloud, cloud());
    // What was promised is what the device now holds.
    let squares: f64 = outcome.cloud.positions.iter().map(|p| f64::from(p[0] - 3.0).powi(2)).sum();
    assert!((squares / 30.0 - stage.fitness_after).abs() < 1e-6);
    assert!(!outcome.summary.interrupted);
}

#[test]
fn an_optimal_base_stays_as_it_is() {
    let mut backend = FakeBackend::new();
    let mut optimal = cloud();
    optimal.positions.iter_mut().for_each(|position| position[0] = backend.target);
    let config = config().resolve().unwrap();
    let stop = AtomicBool::new(false);
    let outcome = search(&mut backend, &views(20), optimal.clone(), &config, &mut Silent, &stop).unwrap();
    let stage = outcome.summary.stages[0];
    assert_eq!((stage.fitness_before, stage.fitness_after, stage.changed), (0.0, 0.0, 0));
    assert!(!applied(&backend).is_empty(), "the cloud was elsewhere in between, or this means nothing");
    assert_eq!(outcome.cloud, optimal);
}

#[test]
fn an_equal_individual_is_not_better() {
    let mut backend = FakeBackend::new();
    backend.poison = Some(0.25);
    let outcome = run(&mut backend, config(), &AtomicBool::new(false)).unwrap();
    assert_eq!(outcome.cloud, cloud());
}

#[test]
fn a_base_that_cannot_be_scored_is_an_error() {
    let mut backend = FakeBackend::new();
    backend.poison = Some(f32::NAN);
    let error = run(&mut backend, config(), &AtomicBool::new(false)).unwrap_err();
    assert!(matches!(error, TrainError::NoFitness { .. }), "{error}");
}

#[test]
fn six_spread_views_serve_all_generations_alike() {
    let mut backend = FakeBackend::new();
    run(&mut backend, config(), &AtomicBool::new(false)).unwrap();
    let scored: Vec<_> = backend
        .calls
        .iter()
        .filter_map(|call| match call {
            Call::Score { views, settings, .. } => Some((views, settings)),
            _ => None,
        })
        .collect();
    assert!(scored.len() > GENERATIONS as usize && scored.windows(2).all(|pair| pair[0] == pair[1]));
    let (views, settings) = scored[0];
    assert_eq!(views.len(), 6);
    assert!(views.windows(2).all(|pair| [3, 4].contains(&(pair[1] - pair[0]))), "20 / 6 apart: {views:?}");
    assert_eq!(settings.sh_degree, 3);
}

#[test]
fn gene_gradients_come_from_one_pass_over_all_views_without_a_step() {
    let mut backend = FakeBackend::new();
    run(&mut backend, config(), &AtomicBool::new(false)).unwrap();
    let mut seen: Vec<usize> = backend.steps().map(|step| step.view).collect();
    seen.sort_unstable();
    assert_eq!(seen, (0..20).collect::<Vec<_>>());
    assert!(backend.steps().all(|step| step.update.is_none() && step.statistics.genes));
}

#[test]
fn stopping_within_a_stage_keeps_the_best_so_far() {
    let stop = Arc::new(AtomicBool::new(false));
    let mut backend = FakeBackend::new();
    // The base, the initial population, one generation; then the flag is seen.
    backend.stop_after = Some((3, stop.clone()));
    let outcome = run(&mut backend, config(), &stop).unwrap();
    let stage = outcome.summary.stages[0];
    assert!(outcome.summary.interrupted);
    assert_eq!(stage.generations, 2);
    assert!(stage.fitness_after < stage.fitness_before, "{stage:?}");
    let expected = Call::Genes { rows: stage.changed };
    assert_eq!(applied(&backend).last(), Some(&&expected));
    let squares: f64 = outcome.cloud.positions.iter().map(|p| f64::from(p[0] - 3.0).powi(2)).sum();
    assert!(
        (squares / 30.0 - stage.fitness_after).abs() < 1e-6,
        "the base came back before the best was applied"
    );
}

#[test]
fn the_observer_follows_the_generations() {
    #[derive(Default)]
    struct Listener(Vec<StageLog>, Vec<GenerationLog>, Vec<StageRecord>);
    impl Observer for Listener {
        fn on_stage_start(&mut self, log: &StageLog) {
            self.0.push(log.clone());
        }
        fn on_generation(&mut self, log: &GenerationLog) {
            self.1.push(*log);
        }
        fn on_stage_end(&mut self, record: &StageRecord) {
            self.2.push(*record);
        }
    }
    let (mut backend, mut listener) = (FakeBackend::new(), Listener::default());
    let resolved = config().resolve().unwrap();
    let stop = AtomicBool::new(false);
    search(&mut backend, &views(20), cloud(), &resolved, &mut listener, &stop).unwrap();
    let Listener(starts, generations, ends) = listener;
    assert_eq!((starts.len(), generations.len(), ends.len()), (1, GENERATIONS as usize + 1, 1));
    assert_eq!((starts[0].views.len(), starts[0].generations), (6, GENERATIONS));
    assert!(generations.windows(2).all(|pair| pair[1].best <= pair[0].best), "never worse");
    let founders = &generations[0];
    assert!(founders.mean > founders.generation_best && founders.spread > Some(0.0), "{founders:?}");
    assert_eq!(generations[GENERATIONS as usize].best, ends[0].fitness_after);
    // Renders: the base once, then whatever had no fitness yet, on six views each.
    let scored: usize = backend
        .calls
        .iter()
        .map(|call| if let Call::Score { individuals, .. } = call { *individuals } else { 0 })
        .sum();
    assert_eq!(ends[0].renders, 6 * scored as u64);
}

#[test]
fn the_search_is_the_same_for_all_methods() {
    let found = |method| {
        let mut backend = FakeBackend::new();
        let config = TrainConfig { genetic: Some(genetic()), ..TrainConfig::of(method) };
        let outcome = run(&mut backend, config, &AtomicBool::new(false)).unwrap();
        assert_eq!(outcome.summary.stages[0].kind, StageKind::Genetic);
        assert_eq!(backend.calls.last(), Some(&Call::ForgetGeneGradients));
        (outcome.cloud.positions, outcome.cloud.log_scales, outcome.cloud.opacity_logits)
    };
    let ours = found(MethodName::Genesplat);
    for method in MethodName::ALL.into_iter().filter(|method| method.resets()) {
        assert_eq!(found(method), ours, "{method}");
    }
}

#[test]
fn each_stage_draws_its_own_founders() {
    let genetic = Some(GeneticConfig { generations: 0, ..genetic() });
    let config = TrainConfig { steps_scale: 0.1, genetic, ..TrainConfig::of(MethodName::ThreeDgs) };
    let mut backend = FakeBackend::new();
    let (start, config, stop) =
        (Start::Points(points(30)), config.resolve().unwrap(), AtomicBool::new(false));
    let outcome = train(&mut backend, &views(20), start, &config, &mut Silent, &stop).unwrap();
    // The base, and founders.
    let populations = backend.scored_rows.chunks_exact(1 + POPULATION as usize);
    let founders: HashSet<&[Vec<u32>]> = populations.map(|rows| &rows[1..]).collect();
    assert_eq!((outcome.summary.gaussians, founders.len()), (30, outcome.summary.stages.len()));
    assert!(founders.len() > 1);
}

/// Each changes the search.
#[test]
fn options_of_the_search_reach_it() {
    let found = |change: fn(&mut GeneticConfig)| {
        let (mut backend, mut genetic) = (FakeBackend::new(), genetic());
        change(&mut genetic);
        let config = TrainConfig { genetic: Some(genetic), ..TrainConfig::default() };
        let outcome = run(&mut backend, config, &AtomicBool::new(false)).unwrap();
        (outcome.cloud, backend.steps().count())
    };
    let (plain, passes) = found(|_| ());
    assert_eq!(passes, 20, "gene gradients of all views");
    let (unit, passes) = found(|genetic| genetic.magnitude = Magnitude::Unit);
    assert_eq!(passes, 0, "which nobody asks for then");
    let (uniform, _) = found(|genetic| genetic.crossover = Crossover::Uniform);
    let (bold, _) = found(|genetic| genetic.intensity = 0.2);
    let (few, _) = found(|genetic| genetic.views = 2);
    assert!([unit, uniform, bold].iter().all(|cloud| *cloud != plain));
    assert_eq!(few, plain, "all views show the same here");
}

#[test]
fn as_many_views_are_scored_as_the_settings_say() {
    let mut backend = FakeBackend::new();
    let genetic = Some(GeneticConfig { views: 2, ..genetic() });
    run(&mut backend, TrainConfig { genetic, ..TrainConfig::default() }, &AtomicBool::new(false)).unwrap();
    let is_right = |call: &Call| !matches!(call, Call::Score { views, .. } if views.len() != 2);
    assert!(backend.calls.iter().all(is_right));
}

/// Steps of a run of 30 iterations, the last of which makes none.
const STEPS: usize = 30;

/// Those before the reset.
const BEFORE: usize = STEPS - 1;

/// So short, and with a reset at the end of its last iteration but one.
fn short() -> TrainConfig {
    let mut config = TrainConfig { iterations: STEPS as u32, ..TrainConfig::of(MethodName::ThreeDgs) };
    config.method.reset_every = BEFORE as u32;
    config
}

/// Trains with extra steps after the reset.
fn extra_steps(budget: StepBudget, background: Background) -> (FakeBackend, Outcome) {
    let (mut backend, start) = (FakeBackend::new(), Start::Points(points(30)));
    let config = TrainConfig { background, extra_steps: Some(budget), ..short() }.resolve().unwrap();
    let stop = AtomicBool::new(false);
    let outcome = train(&mut backend, &views(20), start, &config, &mut Silent, &stop).unwrap();
    assert_eq!(outcome.summary.stages[0].kind, StageKind::ExtraSteps);
    (backend, outcome)
}

/// Those between the reset and the last iteration.
fn extra(backend: &FakeBackend) -> Vec<&TrainStep> {
    let steps: Vec<_> = backend.steps().collect();
    steps[BEFORE..steps.len() - 1].to_vec()
}

#[test]
fn extra_steps_are_made_at_rates_that_stand_still() {
    let (backend, outcome) = extra_steps(StepBudget::Seconds(0.01), Background::Black);
    let updates: Vec<_> = extra(&backend).iter().map(|step| step.update.unwrap()).collect();
    assert!(!updates.is_empty());
    assert!(updates.iter().all(|update| update.rates == updates[0].rates));
    assert!(updates.iter().zip(STEPS as u32..).all(|(update, step)| update.step == step));
    assert!(
        extra(&backend).iter().all(|step| step.statistics == Default::default()),
        "density control sees nothing"
    );
    let stage = outcome.summary.stages[0];
    assert_eq!((stage.renders, stage.generations), (updates.len() as u64, 0));
    assert!(stage.seconds >= 0.01 && applied(&backend).is_empty());
}

#[test]
fn so_many_extra_steps_do_not_look_at_the_clock() {
    let (backend, outcome) = extra_steps(StepBudget::Steps(7), Background::Black);
    assert_eq!((backend.steps().count(), outcome.summary.stages[0].renders), (STEPS + 7, 7));
    let (backend, outcome) = extra_steps(StepBudget::Seconds(0.0), Background::Black);
    assert_eq!((backend.steps().count(), outcome.summary.stages[0].renders), (STEPS, 0));
}

#[test]
fn every_extra_step_has_a_random_background_of_its_own() {
    let (backend, _) = extra_steps(StepBudget::Seconds(0.01), Background::Random);
    let colours: Vec<[u32; 3]> =
        backend.steps().map(|step| step.settings.background.map(f32::to_bits)).collect();
    let distinct: HashSet<&[u32; 3]> = colours.iter().collect();
    assert!(
        colours.len() > STEPS + 1 && distinct.len() == colours.len(),
        "{} of {}",
        distinct.len(),
        colours.len()
    );
}

#[test]
fn extra_steps_of_a_cloud_that_has_diverged_name_the_row() {
    let (mut backend, start) = (FakeBackend::new(), Start::Points(points(30)));
    let mut config = TrainConfig { extra_steps: Some(StepBudget::Steps(7)), ..short() };
    config.method.position_rate_start = 1e300;
    let config = config.resolve().unwrap();
    let stop = AtomicBool::new(false);
    let error = train(&mut backend, &views(20), start, &config, &mut Silent, &stop).unwrap_err().to_string();
    assert!(error.starts_with("the position of Gaussian "), "{error}");
}
