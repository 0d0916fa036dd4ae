//! The order of events, call by call, on a schedule ten times shorter than the published one, intervals
//! included: densification after 50,
//! every 10, until 1500; resets every 300; size pruning after 300; 3000 iterations.

use std::sync::atomic::AtomicBool;

use genesplat_core::gaussians::logit;
use genesplat_core::{CloudRenderer, DensitySignal, Origin, Rng, ScreenFilter};
use genesplat_evolve::GeneticConfig;
use genesplat_train::observe::{DensifyLog, StepLog};
use genesplat_train::scene::filter_3d::filter_3d;
use genesplat_train::scene::initialise::{InitialiseError, cloud_from_points};
use genesplat_train::{
    Background, MethodName, Observer, Outcome, Silent, Start, TrainConfig, TrainError, train,
};

use crate::support::{Call, FakeBackend, added, points, views};

fn short_of(method: MethodName, change: impl FnOnce(&mut TrainConfig)) -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.1, ..TrainConfig::of(method) };
    config.method.densify_every = 10;
    change(&mut config);
    config
}

/// Of 3DGS.
fn short(change: impl FnOnce(&mut TrainConfig)) -> TrainConfig {
    short_of(MethodName::ThreeDgs, change)
}

fn run(backend: &mut FakeBackend, config: TrainConfig) -> Result<Outcome, TrainError> {
    run_observed(backend, config, &mut Silent)
}

fn run_observed(
    backend: &mut FakeBackend,
    config: TrainConfig,
    observer: &mut dyn Observer,
) -> Result<Outcome, TrainError> {
    let start = Start::Points(points(20));
    train(backend, &views(7), start, &config.resolve().unwrap(), observer, &AtomicBool::new(false))
}

/// Calls between the step of iteration `i` (included) and the next step.
fn iteration(backend: &FakeBackend, i: usize) -> &[Call] {
    let steps: Vec<usize> = (0..backend.calls.len())
        .filter(|&at| matches!(backend.calls[at], Call::Step(_)))
        .chain([backend.calls.len()])
        .collect();
    &backend.calls[steps[i - 1]..steps[i]]
}

#[test]
fn a_run_begins_with_views_and_cloud_and_makes_every_step() {
    let mut backend = FakeBackend::new();
    let outcome = run(&mut backend, short(|_| {})).unwrap();
    assert_eq!(backend.calls[0], Call::SetViews(7));
    assert_eq!(backend.calls[1], Call::Upload { rows: 20, moments: false, filter: false });
    assert_eq!(backend.steps().count(), 3000);
    // 60, 70, ..., 1490 densify, 3000 makes no step: the same 144 + 1 as at full length.
    assert_eq!(outcome.summary.optimiser_steps, 3000 - 144 - 1);
    assert_eq!(backend.steps().filter(|step| step.update.is_some()).count(), 2855);
    assert!(!outcome.summary.interrupted && outcome.checkpoint.is_none());
    assert_eq!((outcome.summary.iterations, outcome.summary.gaussians), (3000, 20));
}

#[test]
fn counters_stand_still_where_steps_are_lost() {
    let mut backend = FakeBackend::new();
    run(&mut backend, short(|_| {})).unwrap();
    let counters: Vec<Option<(u32, u32)>> =
        backend.steps().map(|step| step.update.map(|update| (update.step, update.opacity_step))).collect();
    assert_eq!(counters[58], Some((59, 59)));
    assert_eq!(counters[59], None, "iteration 60 densifies");
    assert_eq!(counters[60], Some((60, 60)));
    assert_eq!(counters[1489], None, "iteration 1490, too");
    assert_eq!(counters[1499], Some((1356, 1356)), "iteration 1500 does not");
    assert_eq!(counters[2998], Some((2855, 2855)));
    assert_eq!(counters[2999], None, "the last iteration makes no step");
}

#[test]
fn the_white_reset_costs_opacity_alone_a_step() {
    let mut backend = FakeBackend::new();
    run(&mut backend, short(|config| config.background = Background::White)).unwrap();
    let [Call::Step(step), Call::OpacityCeiling(ceiling)] = iteration(&backend, 50) else {
        panic!("iteration 50: {:?}", iteration(&backend, 50))
    };
    let update = step.update.unwrap();
    assert_eq!((update.step, update.opacity_step, *ceiling), (50, 0, 0.01));
    assert_eq!(step.settings.background, [1.0; 3]);
    let later = backend.steps().nth(1499).unwrap().update.unwrap();
    assert_eq!((later.step, later.opacity_step), (1356, 1355));
}

#[test]
fn densification_precedes_the_reset_and_the_search_follows_it() {
    let mut backend = FakeBackend::new();
    let genetic = GeneticConfig { generations: 2, population: 12, ..GeneticConfig::default() };
    let config = short(|config| config.genetic = Some(genetic));
    let outcome = run(&mut backend, config).unwrap();
    let kinds: Vec<&str> = iteration(&backend, 300)
        .iter()
        .map(|call| match call {
            Call::Step(_) => "step",
            Call::Edit(_) => "edit",
            Call::OpacityCeiling(_) => "reset",
            Call::Score { .. } => "score",
            Call::Genes { .. } => "apply",
            Call::ForgetGeneGradients => "clear",
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(kinds[..4], ["step", "edit", "reset", "score"]);
    assert_eq!(kinds.last(), Some(&"clear"), "gene sums start anew: {kinds:?}");
    let at: Vec<u32> = outcome.summary.stages.iter().map(|stage| stage.iteration).collect();
    assert_eq!(at, [300, 600, 900, 1200]);
    let genes: Vec<bool> = backend.steps().map(|step| step.statistics.genes).collect();
    assert!(genes[..1200].iter().all(|&on| on) && genes[1200..].iter().all(|&on| !on));
}

#[test]
fn statistics_rates_and_degrees_follow_the_schedule() {
    let mut backend = FakeBackend::new();
    run(&mut backend, short(|_| {})).unwrap();
    let steps: Vec<_> = backend.steps().collect();
    assert_eq!(steps[1498].statistics.density, Some(DensitySignal::Signed));
    assert_eq!(steps[1499].statistics.density, None);
    assert!(steps.iter().all(|step| !step.statistics.genes), "nobody reads gene sums");
    let degrees = [99, 100, 200, 300, 3000].map(|i| steps[i - 1].settings.sh_degree);
    assert_eq!(degrees, [0, 1, 2, 3, 3]);
    let first = steps[0].update.unwrap().rates;
    // Extent 2.2; one three-thousandth of the way from 1.6e-4 to 1.6e-6.
    let expected = 2.2 * 1.6e-4 * 0.01f64.powf(1.0 / 3000.0);
    assert!((f64::from(first.position) / expected - 1.0).abs() < 1e-6, "{}", first.position);
    assert_eq!((first.opacity, first.sh_dc, first.sh_rest), (0.05, 2.5e-3, 1.25e-4));
    assert_eq!((first.scale, first.rotation), (5e-3, 1e-3));
}

#[test]
fn a_cloud_has_all_of_its_colours_from_the_first_step_on() {
    let degrees = |start| {
        let mut backend = FakeBackend::new();
        let config = short(|config| config.iterations = 30).resolve().unwrap();
        train(&mut backend, &views(7), start, &config, &mut Silent, &AtomicBool::new(false)).unwrap();
        backend.steps().map(|step| step.settings.sh_degree).collect::<Vec<_>>()
    };
    assert_eq!(degrees(Start::Cloud(cloud_from_points(&points(20)).unwrap())), [3; 3]);
    assert_eq!(degrees(Start::Points(points(20))), [0; 3]);
}

#[test]
fn every_epoch_visits_every_view() {
    let mut backend = FakeBackend::new();
    run(&mut backend, short(|_| {})).unwrap();
    let visits: Vec<usize> = backend.steps().map(|step| step.view).collect();
    for epoch in visits.chunks_exact(7) {
        let mut sorted = epoch.to_vec();
        sorted.sort_unstable();
        assert_eq!(sorted, [0, 1, 2, 3, 4, 5, 6]);
    }
}

#[test]
fn rows_with_large_gradients_grow_beside_their_sources() {
    let mut backend = FakeBackend::new();
    backend.gradient = |row| if row % 10 == 3 { 3e-4 } else { 1e-4 };
    run(&mut backend, short(|config| config.method.densify_until = 700)).unwrap();
    let [Call::Step(_), Call::Edit(edit)] = iteration(&backend, 60) else {
        panic!("iteration 60: {:?}", iteration(&backend, 60))
    };
    // Points are 0.1 apart and the extent is 2.2, so all are larger than 0.022 and split.
    let rows = (0..20u32).flat_map(|row| std::iter::repeat_n(row, if row % 10 == 3 { 2 } else { 1 }));
    assert_eq!(edit.sources, rows.collect::<Vec<_>>());
    assert_eq!((added(edit), edit.iteration), (4, 60));
}

/// Up to a hundredth of the extent, which is 2.2.
#[test]
fn small_rows_are_cloned_and_large_ones_split() {
    let mut backend = FakeBackend::new();
    backend.gradient = |_| 3e-4;
    let mut cloud = cloud_from_points(&points(4)).unwrap();
    cloud.log_scales = [0.015f32, 0.03, 0.021, 0.023].map(|longest| [longest.ln(), -9.0, -9.0]).to_vec();
    let config = short(|config| config.iterations = 700).resolve().unwrap();
    train(&mut backend, &views(7), Start::Cloud(cloud), &config, &mut Silent, &AtomicBool::new(false))
        .unwrap();
    let edit = backend.edits().next().unwrap();
    let children = [0, 1].map(|child| Origin::SplitChild { child });
    assert_eq!(edit.sources, [0, 0, 1, 1, 2, 2, 3, 3]);
    for (origins, is_small) in edit.origins.chunks_exact(2).zip([true, false, true, false]) {
        assert_eq!(origins, if is_small { [Origin::Kept, Origin::Clone] } else { children });
    }
}

#[test]
fn every_random_draw_of_the_device_comes_from_the_seed() {
    let trained = |seed, method| {
        let mut backend = FakeBackend::new();
        backend.gradient = |row| if row % 10 == 3 { 3e-4 } else { 1e-4 };
        let config = short_of(method, |config| (config.seed, config.iterations) = (seed, 700));
        let cloud = run(&mut backend, config).unwrap().cloud;
        (cloud.positions, backend)
    };
    let ((first, device), (again, _)) = (trained(1, MethodName::ThreeDgs), trained(1, MethodName::ThreeDgs));
    let (other, _) = trained(2, MethodName::ThreeDgs);
    assert_eq!(first, again);
    let y = |positions: &[[f32; 3]]| positions.iter().map(|position| position[1]).collect::<Vec<_>>();
    // Nothing but the offset of split children moves the fake's y.
    assert!(y(&first).iter().any(|&y| y != 0.0) && y(&first) != y(&other), "children are drawn anew");
    let all_have =
        |device: &FakeBackend, rng| device.edits().count() > 0 && device.edits().all(|edit| edit.rng == rng);
    assert!(all_have(&device, Rng::new(1)));
    let (_, device) = trained(2, MethodName::Mcmc);
    assert!(all_have(&device, Rng::new(2)));
    let mut noise = device.steps().filter_map(|step| step.update?.mcmc);
    assert!(noise.all(|mcmc| mcmc.rng == Rng::new(2)));
}

#[test]
fn size_prunes_only_after_the_first_reset() {
    let mut backend = FakeBackend::new();
    let mut config = short(|_| {});
    config.method.prune_size = 0.08; // 0.176 world units: the line's ends are 0.216 wide, all others 0.141.
    let outcome = run(&mut backend, config).unwrap();
    let [Call::Step(_), Call::Edit(at_300), Call::OpacityCeiling(_)] = iteration(&backend, 300) else {
        panic!("iteration 300: {:?}", iteration(&backend, 300))
    };
    assert_eq!(at_300.sources.len(), 20);
    let Call::Edit(at_310) = &iteration(&backend, 310)[1] else { panic!("iteration 310 does not densify") };
    assert_eq!(at_310.sources, (1..19).collect::<Vec<u32>>());
    assert_eq!(outcome.cloud.len(), 18);
}

#[test]
fn pixel_gs_asks_for_another_signal_and_nothing_else() {
    let (mut plain, mut pixel) = (FakeBackend::new(), FakeBackend::new());
    run(&mut plain, short(|_| {})).unwrap();
    run(&mut pixel, short_of(MethodName::PixelGs, |_| {})).unwrap();
    let Some(DensitySignal::PixelWeighted { depth_threshold }) =
        pixel.steps().next().unwrap().statistics.density
    else {
        panic!("pixel-gs does not weight by pixels")
    };
    assert!((f64::from(depth_threshold) - 0.37 * 2.2).abs() < 1e-6);
    let updates = |backend: &FakeBackend| backend.steps().map(|step| step.update).collect::<Vec<_>>();
    assert_eq!(updates(&plain), updates(&pixel));
}

#[test]
fn antialiasing_is_a_filter_of_every_render() {
    let mut backend = FakeBackend::new();
    let config = short(|config| (config.antialiasing, config.iterations) = (true, 10));
    assert_eq!(config.clone().resolve().unwrap().render_settings().filter, ScreenFilter::Antialiased);
    run(&mut backend, config).unwrap();
    assert!(backend.steps().all(|step| step.settings.filter == ScreenFilter::Antialiased));
}

#[test]
fn mip_splatting_refreshes_its_filter_before_the_reset() {
    let mut backend = FakeBackend::new();
    run(&mut backend, short_of(MethodName::MipSplatting, |_| {})).unwrap();
    assert_eq!(backend.calls[1], Call::Upload { rows: 20, moments: false, filter: true });
    let at_300 = iteration(&backend, 300);
    assert!(
        matches!(at_300, [Call::Step(_), Call::Edit(_), Call::Filter(20), Call::OpacityCeiling(_)]),
        "{at_300:?}"
    );
    assert!(matches!(iteration(&backend, 1500), [Call::Step(_)]), "not at the end of densification");
    assert!(matches!(iteration(&backend, 2980), [Call::Step(_), Call::Filter(20)]));
    assert!(matches!(iteration(&backend, 2990), [Call::Step(_)]), "frozen at the end");
}

#[test]
fn every_row_of_mip_splatting_begins_with_its_own_filter() {
    let mut backend = FakeBackend::new();
    let points: Vec<_> = (0..20).map(|row| ([0.0, 0.01 * row as f32, 1.0 + row as f32], [128; 3])).collect();
    let config = short_of(MethodName::MipSplatting, |config| config.iterations = 10).resolve().unwrap();
    let stop = AtomicBool::new(false);
    let cloud =
        train(&mut backend, &views(7), Start::Points(points), &config, &mut Silent, &stop).unwrap().cloud;
    let views = views(7);
    assert_eq!(cloud.filter_3d, Some(filter_3d(&cloud.positions, views.iter().map(|view| &view.camera))));
    assert!(cloud.filter_3d.unwrap().windows(2).any(|pair| pair[0] != pair[1]));
}

#[test]
fn mcmc_adds_noise_in_every_step_and_relocates_instead_of_resetting() {
    let mut backend = FakeBackend::new();
    let config = short_of(MethodName::Mcmc, |config| config.max_gaussians = Some(27));
    let outcome = run(&mut backend, config).unwrap();
    let updates: Vec<_> = backend.steps().filter_map(|step| step.update).collect();
    for (update, step) in updates.iter().zip(1..) {
        let mcmc = update.mcmc.unwrap();
        assert_eq!(mcmc.counter, step, "no two steps share their noise");
        assert_eq!(mcmc.rng, Rng::new(0), "streams of the run's seed");
        assert_eq!(mcmc.noise_scale, update.rates.position * 5e5);
        assert_eq!((mcmc.opacity_weight, mcmc.scale_weight), (0.01, 0.01));
    }
    assert!(backend.steps().all(|step| step.statistics.density.is_none()), "nobody reads gradients");
    assert!(!backend.calls.iter().any(|call| matches!(call, Call::OpacityCeiling(_))));
    assert_eq!(updates.len(), 2999, "and no step is lost but the last");
    // A twentieth of 20 to 26 is one a time.
    let rows: Vec<usize> = backend.edits().map(|edit| edit.sources.len()).collect();
    assert_eq!((rows.len(), &rows[..9]), (244, &[21, 22, 23, 24, 25, 26, 27, 27, 27][..]));
    assert_eq!(outcome.cloud.len(), 27);
}

/// The gradients of a step's photos are summed, and each photo's loss has its regularisers.
#[test]
fn mcmc_regularises_once_for_each_photo_of_a_step() {
    let mut backend = FakeBackend::new();
    let config =
        short_of(MethodName::Mcmc, |config| (config.views_per_step, config.max_gaussians) = (4, Some(27)));
    run(&mut backend, config).unwrap();
    let updates = backend.steps().filter_map(|step| step.update);
    assert!(
        updates
            .map(|update| update.mcmc.unwrap())
            .all(|mcmc| (mcmc.opacity_weight, mcmc.scale_weight) == (0.04, 0.04))
    );
}

#[test]
fn mcmc_starts_small_and_half_transparent() {
    let mut backend = FakeBackend::new();
    let config = short_of(MethodName::Mcmc, |config| config.iterations = 1);
    let outcome = run(&mut backend, config).unwrap();
    let usual = cloud_from_points(&points(20)).unwrap();
    for row in 0..20 {
        assert_eq!(outcome.cloud.opacity_logits[row], 0.0, "a half");
        let ratio = (outcome.cloud.log_scales[row][0] - usual.log_scales[row][0]).exp();
        assert!((ratio - 0.1).abs() < 1e-6, "{ratio}");
    }
}

#[test]
fn random_backgrounds_change_every_iteration() {
    let mut backend = FakeBackend::new();
    run(&mut backend, short(|config| config.background = Background::Random)).unwrap();
    let colours: Vec<[f32; 3]> = backend.steps().map(|step| step.settings.background).collect();
    assert!(colours.windows(2).all(|pair| pair[0] != pair[1]));
    assert!(colours.iter().flatten().all(|v| (0.0..1.0).contains(v)));
}

#[derive(Default)]
struct Listener {
    notices: Vec<String>,
    densifications: Vec<DensifyLog>,
    reports: Vec<u32>,
    looks: Vec<u32>,
}

impl Observer for Listener {
    fn on_iteration(&mut self, log: &StepLog) {
        self.reports.extend(log.report.map(|_| log.iteration));
    }
    fn on_densify(&mut self, log: &DensifyLog) {
        self.densifications.push(*log);
    }
    fn notice(&mut self, text: &str) {
        self.notices.push(text.into());
    }
    fn wants_renders(&mut self, iteration: u32) -> bool {
        iteration == 17
    }
    fn on_renders(&mut self, iteration: u32, renderer: &mut CloudRenderer<'_>) {
        assert_eq!(renderer.render(&views(1)[0].camera).unwrap().width, views(1)[0].camera.width);
        self.looks.push(iteration);
    }
}

#[test]
fn the_cap_holds_and_is_told_once() {
    let (mut backend, mut listener) = (FakeBackend::new(), Listener::default());
    backend.gradient = |_| 1e-3;
    let config = short(|config| config.max_gaussians = Some(50));
    let outcome = run_observed(&mut backend, config, &mut listener).unwrap();
    assert_eq!(outcome.cloud.len(), 50);
    assert_eq!(listener.notices.len(), 1, "{:?}", listener.notices);
    assert!(listener.notices[0].contains("50 Gaussians"));
    assert_eq!(listener.densifications.len(), 144);
    assert!(listener.densifications.iter().all(|log| log.gaussians <= 50));
    assert_eq!(listener.reports, (1..=300).map(|k| 10 * k).collect::<Vec<_>>());
    assert_eq!(listener.looks, [17]);
}

#[test]
fn an_emptied_cloud_is_an_error() {
    let mut faint = cloud_from_points(&points(20)).unwrap();
    faint.opacity_logits.fill(logit(0.004));
    let (config, stop) = (short(|_| {}).resolve().unwrap(), AtomicBool::new(false));
    let start = Start::Cloud(faint);
    let error = train(&mut FakeBackend::new(), &views(7), start, &config, &mut Silent, &stop).unwrap_err();
    assert!(matches!(error, TrainError::NothingLeft { iteration: 60 }), "{error}");
}

#[test]
fn divergence_is_named() {
    let mut backend = FakeBackend::new();
    let error = run(&mut backend, short(|config| config.method.position_rate_start = 1e300)).unwrap_err();
    let text = error.to_string();
    assert!(
        text.starts_with("the position of Gaussian ") && text.contains("not finite after 59 optimiser steps"),
        "{text}"
    );
}

#[test]
fn missing_inputs_are_named() {
    let config = TrainConfig::of(MethodName::ThreeDgs).resolve().unwrap();
    let stop = AtomicBool::new(false);
    let run = |views: &[genesplat_core::View], start| {
        train(&mut FakeBackend::new(), views, start, &config, &mut Silent, &stop).unwrap_err()
    };
    assert!(matches!(run(&[], Start::Points(points(9))), TrainError::NoViews));
    assert!(matches!(run(&views(3), Start::Points(points(3))), TrainError::Initialise(_)));
    assert!(matches!(run(&views(3), Start::Cloud(Default::default())), TrainError::EmptyCloud));
    // As it was given, not in the order of the cloud's rows.
    let mut poisoned = points(9);
    poisoned[7].0[0] = f32::NAN;
    let error = run(&views(3), Start::Points(poisoned));
    assert!(matches!(error, TrainError::Initialise(InitialiseError::NonFinite { row: 7 })), "{error}");
}
