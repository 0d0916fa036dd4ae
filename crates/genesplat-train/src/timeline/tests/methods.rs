//! What differs between methods.

use super::*;

#[test]
fn the_last_two_fifths_are_averaged() {
    use MethodName::{Genesplat, ImprovedGs, Mcmc, MipSplatting, ThreeDgs};
    // Where density control ends early, too, when rows stay what they are for longer, and MCMC's lasts into
    // them.
    for (method, until) in [
        (Genesplat, 15_000),
        (ThreeDgs, 15_000),
        (ThreeDgs, 12_000),
        (ThreeDgs, 0),
        (MipSplatting, 15_000),
        (ImprovedGs, 15_000),
        (Mcmc, 25_000),
    ] {
        let schedule = schedule_of(method, |config| {
            (config.method.averaging, config.method.densify_until) = (true, until);
        });
        assert_eq!(iterations_with(&schedule, Event::TakeMean), [30_000]);
        let averaged = iterations_with(&schedule, Event::AddToMean);
        assert_eq!((averaged.len(), averaged[0], averaged[1], averaged[78]), (79, 18_150, 18_300, 29_850));
        assert_eq!(iterations_with(&schedule, Event::Search), [] as [u32; 0], "none of the paper's");
    }
    let none = schedule_of(Genesplat, |config| {
        (config.method.averaging, config.method.virtual_views) = (false, 0);
    });
    assert!((1..=30_000).all(|i| none.timeline().at(i).all(|event| !event.is_evolution())));
}

#[test]
fn runs_of_any_length_average_what_comes_after_three_fifths() {
    for iterations in 1..=1000u32 {
        let schedule = schedule_of(MethodName::Genesplat, |config| config.iterations = iterations);
        let part = |fraction: f64| (f64::from(iterations) * fraction).round() as u32;
        let (window, every) = (part(0.4), (part(0.05).max(1) / 10).max(1));
        let is_state = |i: &u32| iterations - i < window && (iterations - i).is_multiple_of(every);
        let wanted: Vec<u32> =
            if window > 1 { (1..iterations).filter(is_state).collect() } else { Vec::new() };
        assert_eq!(iterations_with(&schedule, Event::AddToMean), wanted);
        let taken = iterations_with(&schedule, Event::TakeMean);
        assert_eq!(taken, if window > 1 { vec![iterations] } else { Vec::new() });
        assert!(taken.is_empty() || !wanted.is_empty(), "a mean of no state");
    }
}

#[test]
fn ours_fits_its_schedule_into_the_run() {
    let short = schedule_of(MethodName::Genesplat, |config| config.iterations = 6000);
    let scaled = schedule_of(MethodName::Genesplat, |config| config.steps_scale = 0.2);
    for schedule in [&short, &scaled] {
        assert_eq!(schedule.iterations, 6000);
        let densify = Densification { from: 100, until: 3000, every: 100 };
        assert_eq!(schedule.timeline().densify, densify);
        assert_eq!(iterations_with(schedule, Event::ResetOpacity), [600, 1200, 1800, 2400]);
        assert_eq!(schedule.rates(2.0, 6000).position, 4e-6, "the last rate");
        assert!(
            (1..=6000).all(|i| step(schedule, i) != OptimiserStep::Later),
            "averages stand for large steps"
        );
        assert_eq!((schedule.sh_degree(199), schedule.sh_degree(200)), (0, 1));
    }
    let plain = schedule(|config| config.iterations = 6000);
    assert_eq!((plain.timeline().densify.from, plain.sh_degree(999)), (500, 0), "cut short");
    let improved =
        |averaging| schedule_of(MethodName::ImprovedGs, |config| config.method.averaging = averaging);
    assert_eq!(step(&improved(false), 15_001), OptimiserStep::Later, "as published");
    assert!(
        (1..=30_000).all(|i| step(&improved(true), i) != OptimiserStep::Later),
        "averages stand for them, too"
    );
}

#[test]
fn improved_gs_prunes_after_resets_and_steps_less_often_later() {
    let schedule = schedule_of(MethodName::ImprovedGs, |_| {});
    let timeline = schedule.timeline();
    let all = |due: &dyn Fn(u32) -> bool| (1..=30_000).filter(|&i| due(i)).collect::<Vec<_>>();
    assert_eq!(iterations_with(&schedule, Event::Densify).len(), 144);
    assert_eq!(all(&|i| timeline.has_recovered(i)), [3300, 6300, 9300, 12_300]);
    assert_eq!(all(&|i| timeline.prunes_slow(i)), [3300, 6300]);
    let budgets = [500, 640, 4000, 14_500, 14_900].map(|i| (1e6 * timeline.grown(i)).round());
    assert_eq!(budgets, [0.0, 1e5, 5e5, 1e6, 1e6]);
    assert!(!timeline.is_full(14_500) && timeline.is_full(14_600));
    let steps = |wanted| all(&|i| timeline.optimiser_step(i) == wanted).len();
    // The last iteration would be the 375th of twenty views.
    assert_eq!(steps(OptimiserStep::All), 15_000 - 144 + 1500 + 374);
    assert_eq!(steps(OptimiserStep::Lost), 145);
    let rates = |i| schedule.rates(2.0, i);
    assert_eq!((rates(30_000).position, rates(1).opacity), (4e-6, 0.025));
}

#[test]
fn improved_gs_scales_its_windows() {
    let tenth = schedule_of(MethodName::ImprovedGs, |config| config.steps_scale = 0.1);
    let timeline = tenth.timeline();
    // Resets at 300, 600, ...; opacities have a hundred iterations, and only the first nine hundred prune
    // what is slow.
    let all = |due: &dyn Fn(u32) -> bool| (1..=3000).filter(|&i| due(i)).collect::<Vec<_>>();
    assert_eq!(all(&|i| timeline.has_recovered(i)), [400, 700, 1000, 1300]);
    assert_eq!(all(&|i| timeline.prunes_slow(i)), [400, 700]);
    let late = all(&|i| timeline.optimiser_step(i) == OptimiserStep::Later);
    assert_eq!((late[0], late.len()), (1501, 750 - 150 + 749 - 37));
}

#[test]
fn ours_sees_photos_at_full_size_late_where_they_are_many() {
    let ours = schedule_of(MethodName::Genesplat, |config| config.iterations = 7000);
    let genetic = schedule_of(MethodName::Genesplat, |config| {
        (config.iterations, config.genetic) = (7000, Some(GeneticConfig::default()));
    });
    let at = |schedule: &Schedule, photos| iterations_with(&schedule.on(photos), Event::FullPhotos);
    assert_eq!((at(&ours, 87), at(&ours, 88)), (vec![], vec![2100]));
    assert_eq!(at(&genetic, 88), [] as [u32; 0], "a search judges photos as they are");
    let one = schedule_of(MethodName::Genesplat, |config| config.iterations = 1);
    assert_eq!(at(&one, 9), [1], "never is too late");
}

#[test]
fn ours_grows_gradually_unless_the_run_is_short() {
    let of = |iterations| schedule_of(MethodName::Genesplat, |config| config.iterations = iterations);
    let gradual = of(7000);
    let timeline = gradual.timeline();
    assert_eq!(timeline.densify.until, 3500);
    assert!(timeline.grown(3300) < 1.0 && timeline.is_full(3400));
    assert!((timeline.grown(1750) - 0.5f64.powf(1.5)).abs() < 0.03, "slowly at first");
    let root = 0.5f64.sqrt();
    let many = gradual.on(88);
    assert!((many.timeline().grown(1750) - root).abs() < 0.03, "along the root, where photos are many");
    assert!((of(4000).timeline().grown(1000) - root).abs() < 0.05, "along the root");
    let at_once = schedule_of(MethodName::Genesplat, |config| {
        (config.iterations, config.method.gradual_growth) = (7000, false);
    });
    assert!((at_once.timeline().grown(1750) - root).abs() < 0.03, "as published");
}

/// Towards what the photos can determine, which nobody can refuse before it is full.
#[test]
fn adaptive_control_grows_evenly_to_its_capacity_and_freely_without() {
    let grown = |capacity, i| schedule(|config| config.method.capacity = capacity).timeline().grown(i);
    assert_eq!([149, 7450, 14_900, 14_999].map(|i| grown(1.0, i)), [0.01, 0.5, 1.0, 1.0]);
    assert_eq!([1, 14_900].map(|i| grown(0.0, i)), [1.0; 2]);
}

#[test]
fn mcmc_densifies_longer_loses_no_step_and_resets_nothing() {
    let schedule = schedule_of(MethodName::Mcmc, |config| config.background = Background::White);
    let densify = iterations_with(&schedule, Event::Densify);
    assert_eq!((densify.len(), densify[0], densify[243]), (244, 600, 24_900));
    assert_eq!(iterations_with(&schedule, Event::ResetOpacity), [] as [u32; 0]);
    let lost = (1..=30_000).filter(|&i| step(&schedule, i) != OptimiserStep::All);
    assert_eq!(lost.collect::<Vec<_>>(), [30_000], "the last one only measures");
    assert_eq!(events(&schedule, 3000), [Event::Step, Event::Densify]);
}

#[test]
fn the_3d_filter_follows_densification_and_then_every_hundredth_iteration() {
    let schedule = schedule_of(MethodName::MipSplatting, |_| {});
    let refreshed = iterations_with(&schedule, Event::RefreshFilter);
    let late: Vec<u32> = refreshed.iter().copied().filter(|&i| i >= 15_000).collect();
    assert_eq!((late[0], late[late.len() - 1], late.len()), (15_100, 29_800, 148));
    assert_eq!((refreshed[0], refreshed.len()), (600, 144 + 148));
}
