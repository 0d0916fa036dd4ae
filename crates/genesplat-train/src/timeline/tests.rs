use genesplat_core::{DensitySignal, LearningRates};
use genesplat_evolve::GeneticConfig;

use super::*;
use crate::config::StepBudget;
use crate::method::MethodName;
use crate::schedule::Schedule;

fn schedule_of(method: MethodName, change: impl FnOnce(&mut TrainConfig)) -> Schedule {
    let mut config = TrainConfig::of(method);
    change(&mut config);
    Schedule::new(config)
}

/// Of 3DGS.
fn schedule(change: impl FnOnce(&mut TrainConfig)) -> Schedule {
    schedule_of(MethodName::ThreeDgs, change)
}

fn iterations_with(schedule: &Schedule, event: Event) -> Vec<u32> {
    let timeline = schedule.timeline();
    let all: Vec<u32> =
        (1..=schedule.iterations).filter(|&i| timeline.at(i).any(|due| due == event)).collect();
    assert!(all.iter().copied().eq((1..=schedule.iterations).filter(|&i| timeline.is(event, i))));
    assert_eq!(
        (timeline.first(event), timeline.last(event)),
        (all.first().copied(), all.last().copied()),
        "{event:?}"
    );
    all
}

/// What is done in an iteration, in order.
fn events(schedule: &Schedule, i: u32) -> Vec<Event> {
    schedule.timeline().at(i).collect()
}

fn step(schedule: &Schedule, i: u32) -> OptimiserStep {
    schedule.timeline().optimiser_step(i)
}

#[test]
fn multiples_are_those_from_one_number_to_before_another() {
    for (every, from, until) in
        (1..9).flat_map(|every| (0..20).flat_map(move |from| (0..25).map(move |until| (every, from, until))))
    {
        let when = When::multiples(every, from, until);
        let wanted: Vec<u32> = (from.max(1)..until).filter(|i| i.is_multiple_of(every)).collect();
        assert_eq!(when.iter().collect::<Vec<_>>(), wanted, "{every}, {from}, {until}");
        assert!((0..30).all(|i| when.contains(i) == wanted.contains(&i)), "{every}, {from}, {until}");
        assert_eq!(when.is_never(), wanted.is_empty());
    }
}

#[test]
fn counting_back_leaves_the_end_out() {
    for (end, every, after) in
        (1..20).flat_map(|end| (1..6).flat_map(move |every| (0..end).map(move |after| (end, every, after))))
    {
        let when = When::back_from(end, every, after);
        let wanted: Vec<u32> = (after + 1..end).filter(|i| (end - i).is_multiple_of(every)).collect();
        assert_eq!(when.iter().collect::<Vec<_>>(), wanted, "{end}, {every}, {after}");
    }
    assert_eq!(When::once(7).iter().collect::<Vec<_>>(), [7]);
}

#[test]
fn the_published_schedule_densifies_144_times_and_resets_4_times() {
    let schedule = schedule(|_| {});
    let densify = iterations_with(&schedule, Event::Densify);
    assert_eq!((densify.len(), densify[0], densify[143]), (144, 600, 14_900));
    assert_eq!(iterations_with(&schedule, Event::ResetOpacity), [3000, 6000, 9000, 12_000]);
    assert_eq!(iterations_with(&schedule, Event::Search), [] as [u32; 0]);
    assert_eq!(schedule.timeline().size_prune_after, 3000);
}

#[test]
fn lost_steps_leave_29_855() {
    let schedule = schedule(|_| {});
    let made = (1..=30_000).filter(|&i| step(&schedule, i) == OptimiserStep::All).count();
    assert_eq!(made, 29_855);
    assert_eq!(step(&schedule, 30_000), OptimiserStep::Lost);
}

/// Every fourth iteration steps, at twice the rates, and none but the last is lost.
#[test]
fn a_step_of_four_views_is_twice_as_long() {
    let [one, four] = [1, 4].map(|views| schedule(|config| config.views_per_step = views));
    let made = (1..30_000).filter(|&i| step(&four, i).moves());
    assert!(made.eq((4..30_000).step_by(4)));
    assert_eq!((step(&four, 601), step(&four, 30_000)), (OptimiserStep::Later, OptimiserStep::Lost));
    let [one, four] = [one.rates(2.0, 500), four.rates(2.0, 500)];
    let all = |rates: LearningRates| {
        [rates.position, rates.sh_dc, rates.sh_rest, rates.opacity, rates.scale, rates.rotation]
    };
    assert!(all(one).into_iter().zip(all(four)).all(|(one, four)| (four / one - 2.0).abs() < 1e-6));
}

/// 3000 is no multiple of 16, and 18,000 comes when Improved-GS has steps of five views.
#[test]
fn a_reset_cuts_a_step_of_several_views_short() {
    let around = |schedule: &Schedule, reset: u32| [reset - 1, reset, reset + 1].map(|i| step(schedule, i));
    let cut = [OptimiserStep::Later, OptimiserStep::AllButOpacity, OptimiserStep::Later];
    let sixteen = schedule(|config| config.views_per_step = 16);
    assert_eq!([3000, 6000, 9000].map(|reset| around(&sixteen, reset)), [cut; 3]);
    assert_eq!(
        [2992, 3008].map(|i| step(&sixteen, i)),
        [OptimiserStep::All; 2],
        "others stay where they were"
    );
    let late = schedule_of(MethodName::ImprovedGs, |config| config.method.densify_until = 20_000);
    assert_eq!(around(&late, 18_000), cut);
}

#[test]
fn a_shorter_schedule_loses_no_more_steps_than_the_published_one() {
    let lost = |change: fn(&mut TrainConfig)| {
        let schedule = schedule(change);
        let lost = (1..schedule.iterations).filter(|&i| step(&schedule, i) == OptimiserStep::Lost);
        lost.collect::<Vec<_>>()
    };
    let tenth: Vec<u32> = (1..15).map(|hundreds| 100 * hundreds).collect();
    assert_eq!(lost(|config| config.steps_scale = 0.1), tenth);
    assert_eq!(lost(|config| config.steps_scale = 0.01), [100]);
    assert_eq!(lost(|config| config.method.densify_every = 9), [] as [u32; 0], "nothing would be learnt");
}

#[test]
fn no_interval_is_scaled_below_a_hundred_iterations() {
    let scaled = |scale: f64, every: u32| {
        let schedule = schedule(|config| (config.steps_scale, config.method.densify_every) = (scale, every));
        (schedule.timeline().densify.every, schedule.timeline().reset_every)
    };
    assert_eq!(scaled(0.1, 100), (100, 300));
    assert_eq!(scaled(0.1, 1000), (100, 300));
    assert_eq!(scaled(0.01, 100), (100, 100));
    assert_eq!(scaled(0.5, 300), (150, 1500));
    assert_eq!(scaled(0.5, 20), (20, 1500), "less than a hundred is kept where it was asked for");
    assert_eq!(scaled(2.0, 100), (200, 6000));
}

#[test]
fn a_white_background_resets_once_more_and_costs_opacity_one_step() {
    let schedule = schedule(|config| config.background = Background::White);
    assert_eq!(iterations_with(&schedule, Event::ResetOpacity), [500, 3000, 6000, 9000, 12_000]);
    assert_eq!(step(&schedule, 500), OptimiserStep::AllButOpacity);
    assert_eq!(step(&schedule, 3000), OptimiserStep::Lost, "it densifies, too");
    assert_eq!(events(&schedule, 500), [Event::Step, Event::ResetOpacity]);
}

/// Where it falls on another one.
#[test]
fn two_resets_of_an_iteration_are_one() {
    let schedule =
        schedule(|config| (config.background, config.method.reset_every) = (Background::White, 500));
    assert_eq!(events(&schedule, 500), [Event::Step, Event::ResetOpacity]);
    assert!(iterations_with(&schedule, Event::ResetOpacity).into_iter().eq((500..15_000).step_by(500)));
}

#[test]
fn without_density_control_not_even_white_resets() {
    let schedule =
        schedule(|config| (config.background, config.method.densify_until) = (Background::White, 0));
    assert_eq!(iterations_with(&schedule, Event::ResetOpacity), [] as [u32; 0]);
    assert_eq!(iterations_with(&schedule, Event::Densify), [] as [u32; 0]);
}

#[test]
fn the_search_follows_the_four_resets_but_not_the_white_one() {
    let schedule = schedule(|config| {
        config.genetic = Some(GeneticConfig::default());
        config.background = Background::White;
    });
    assert_eq!(iterations_with(&schedule, Event::Search), [3000, 6000, 9000, 12_000]);
    assert_eq!(events(&schedule, 3000), [Event::Step, Event::Densify, Event::ResetOpacity, Event::Search]);
}

#[test]
fn extra_steps_come_where_the_search_would() {
    let stages = |change: fn(&mut TrainConfig)| iterations_with(&schedule(change), Event::Search);
    assert_eq!(stages(|_| {}), [] as [u32; 0]);
    let extra = schedule(|config| config.extra_steps = Some(StepBudget::Steps(7)));
    let searched = stages(|config| config.genetic = Some(GeneticConfig::default()));
    assert_eq!(iterations_with(&extra, Event::Search), searched);
    assert!(!extra.statistics(None, 1).genes, "nobody reads them");
}

#[test]
fn events_have_their_order() {
    use Event::{
        AddToMean, Densify, RefreshFilter, RefreshVirtualViews, ResetOpacity, Search, Step, TakeMean,
    };
    let searching = |method| schedule_of(method, |config| config.genetic = Some(GeneticConfig::default()));
    let mip = searching(MethodName::MipSplatting);
    assert_eq!(events(&mip, 3000), [Step, Densify, RefreshFilter, ResetOpacity, Search]);
    let ours = searching(MethodName::Genesplat);
    assert_eq!(events(&ours, 9000), [Step, RefreshVirtualViews, Densify, ResetOpacity, Search]);
    assert_eq!(events(&ours, 18_300), [Step, RefreshVirtualViews, AddToMean]);
    assert_eq!(events(&ours, 30_000), [Step, TakeMean]);
    for schedule in [mip, ours] {
        let all = schedule.timeline().events();
        assert!(all.is_sorted_by_key(|(event, _)| event));
        assert!((1..=30_000).all(|i| events(&schedule, i).is_sorted_by(|a, b| a < b)), "and none twice");
    }
}

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
    let budgets = [500, 640, 4000, 14_500, 14_900].map(|i| (1e6 * timeline.grown(i, 40)).round());
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
fn ours_grows_gradually_unless_the_run_is_short() {
    let of = |iterations| schedule_of(MethodName::Genesplat, |config| config.iterations = iterations);
    let gradual = of(7000);
    let timeline = gradual.timeline();
    assert_eq!(timeline.densify.until, 3500);
    assert!(timeline.grown(3300, 140) < 1.0 && timeline.is_full(3400));
    assert!((timeline.grown(1750, 140) - 0.5f64.powf(1.5)).abs() < 0.03, "slowly at first");
    let root = 0.5f64.sqrt();
    assert!((timeline.grown(1750, 141) - root).abs() < 0.03, "along the root, where photos are many");
    assert!((of(4000).timeline().grown(1000, 9) - root).abs() < 0.05, "along the root");
    let at_once = schedule_of(MethodName::Genesplat, |config| {
        (config.iterations, config.method.gradual_growth) = (7000, false);
    });
    assert!((at_once.timeline().grown(1750, 9) - root).abs() < 0.03, "as published");
}

/// Towards what the photos can determine, which nobody can refuse before it is full.
#[test]
fn adaptive_control_grows_evenly_to_its_capacity_and_freely_without() {
    let grown = |capacity, i| schedule(|config| config.method.capacity = capacity).timeline().grown(i, 9);
    assert_eq!([149, 7450, 14_900, 14_999].map(|i| grown(1.0, i)), [0.01, 0.5, 1.0, 1.0]);
    assert_eq!([1, 14_900].map(|i| grown(0.0, i)), [1.0; 2]);
}

#[test]
fn a_run_that_is_cut_short_keeps_its_events() {
    let short = schedule(|config| config.iterations = 7000);
    assert_eq!(iterations_with(&short, Event::Densify).last(), Some(&6900));
    assert_eq!(iterations_with(&short, Event::ResetOpacity), [3000, 6000]);
    assert_eq!(short.timeline().size_prune_after, 3000);
}

/// An interval that is as short as given is not scaled, and nothing is pruned by size before the first
/// iteration.
#[test]
fn size_counts_from_the_first_reset_on_at_the_latest() {
    let after = |steps_scale, reset_every| {
        let schedule = schedule(|config| {
            (config.steps_scale, config.method.reset_every) = (steps_scale, reset_every);
        });
        schedule.timeline().size_prune_after
    };
    assert_eq!(
        [after(1.0, 3000), after(0.1, 3000), after(1.0, 1000), after(0.005, 45)],
        [3000, 300, 1000, 15]
    );
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

#[test]
fn scaling_keeps_the_shape_and_truncation_keeps_the_rates() {
    let tenth = schedule(|config| config.steps_scale = 0.1);
    assert_eq!(tenth.iterations, 3000);
    let densify = iterations_with(&tenth, Event::Densify);
    assert_eq!(
        (densify.len(), densify[0], densify[13]),
        (14, 100, 1400),
        "windows are scaled, intervals as far as may be"
    );
    assert_eq!(iterations_with(&tenth, Event::ResetOpacity), [300, 600, 900, 1200]);
    let short = schedule(|config| config.iterations = 3000);
    assert_eq!(iterations_with(&short, Event::ResetOpacity), [] as [u32; 0], "the last one only measures");
    assert_eq!(iterations_with(&short, Event::Densify).last(), Some(&2900));
    let extent = 2.0;
    let long = schedule(|_| {});
    assert_eq!(short.rates(extent, 3000), long.rates(extent, 3000));
    assert_eq!(tenth.rates(extent, 300), long.rates(extent, 3000));
}

#[test]
fn the_end_of_a_run_is_no_checkpoint() {
    let schedule = schedule(|config| config.checkpoint_every = 10_000);
    assert!((1..=30_000).filter(|&i| schedule.is_checkpoint(i)).eq([10_000, 20_000]));
}

#[test]
fn the_position_rate_decays_a_hundredfold() {
    let schedule = schedule(|_| {});
    let at = |i| f64::from(schedule.rates(5.0, i).position);
    for (i, expected) in [(0, 8e-4), (15_000, 8e-5), (30_000, 8e-6), (40_000, 8e-6)] {
        assert!((at(i) / expected - 1.0).abs() < 1e-6, "iteration {i}: {}", at(i));
    }
}

#[test]
fn the_degree_rises_at_the_start_of_every_thousandth_iteration() {
    let schedule = schedule(|_| {});
    let degrees: Vec<u8> = [1, 999, 1000, 1999, 2000, 3000, 9000].map(|i| schedule.sh_degree(i)).to_vec();
    assert_eq!(degrees, [0, 0, 1, 1, 2, 3, 3]);
}

#[test]
fn statistics_end_with_densification_and_gene_sums_with_the_last_search() {
    let schedule = schedule(|config| config.genetic = Some(GeneticConfig::default()));
    let at = |i| schedule.statistics(Some(DensitySignal::Signed), i);
    assert!(at(14_999).density.is_some() && at(15_000).density.is_none());
    assert!(at(12_000).genes && !at(12_001).genes);
}

#[test]
fn both_kinds_are_visited_one_after_another() {
    use Visit::{Photo, Virtual};
    let steps = VirtualSteps { from: 6, every: 4 };
    let visits = (1..=14).map(|i| steps.visit(i));
    let later = [Photo(6), Photo(7), Virtual(0), Photo(8), Photo(9), Photo(10), Virtual(1), Photo(11)];
    assert!(visits.eq((0..6).map(Photo).chain(later)));
    assert!((1..1000).all(|tens| matches!(steps.visit(10 * tens), Photo(_))), "their loss is logged");
}

/// A run of ours of 7000 iterations.
fn looking(change: impl FnOnce(&mut TrainConfig)) -> Schedule {
    schedule_of(MethodName::Genesplat, |config| {
        config.iterations = 7000;
        change(config);
    })
}

#[test]
fn pictures_are_made_before_resets_and_later_as_often_as_density_control_works() {
    let schedule = looking(|_| {});
    let refreshed = iterations_with(&schedule, Event::RefreshVirtualViews);
    assert_eq!((&refreshed[..4], refreshed.last()), (&[2100, 2800, 3500, 3600][..], Some(&6900)));
    let resets = [2100, 2800, 3500].map(|i| schedule.timeline().is(Event::ResetOpacity, i));
    assert_eq!(resets, [true, true, false]);
    let order = events(&schedule, 2100);
    assert_eq!(order, [Event::Step, Event::RefreshVirtualViews, Event::Densify, Event::ResetOpacity]);
}

#[test]
fn pictures_of_runs_of_any_length_are_made_where_they_are_due() {
    for (iterations, background) in (10..=700).flat_map(|i| [(i, Background::Black), (i, Background::White)])
    {
        let schedule = schedule_of(MethodName::Genesplat, |config| {
            (config.iterations, config.background) = (iterations, background);
        });
        let timeline = schedule.timeline();
        let is_ripe = |i: u32| {
            let is_late = i >= timeline.reset_until && i.is_multiple_of(timeline.densify.every);
            timeline.is(Event::ResetOpacity, i) || is_late
        };
        let from = (f64::from(iterations) * 0.3).round() as u32;
        let wanted: Vec<u32> = (from.max(1)..iterations).filter(|&i| is_ripe(i)).collect();
        assert_eq!(
            iterations_with(&schedule, Event::RefreshVirtualViews),
            wanted,
            "{iterations}, {background:?}"
        );
    }
}

#[test]
fn the_more_photos_the_fewer_looks() {
    let asked = looking(|config| config.method.virtual_views = 1);
    let every = |photos| asked.virtual_steps(photos).map(|steps| steps.every);
    assert_eq!([1, 2, 16, 17, 32, 110].map(every), [None, Some(2), Some(2), Some(4), Some(4), Some(14)]);
    assert_eq!(asked.virtual_steps(9).map(|steps| steps.from), Some(2100));
}

#[test]
fn runs_that_learn_photos_by_heart_look_between_them() {
    let has =
        |iterations, photos| looking(|config| config.iterations = iterations).virtual_steps(photos).is_some();
    assert!(has(7000, 2) && has(7000, 28) && !has(7000, 29), "250 looks at each");
    assert!(has(30_000, 120) && !has(30_000, 121));
}

#[test]
fn virtual_views_belong_to_our_method() {
    assert!(looking(|_| {}).virtual_steps(9).is_some());
    assert!(looking(|config| config.method.virtual_views = 0).virtual_steps(9).is_none());
    for method in MethodName::ALL.into_iter().filter(|method| *method != MethodName::Genesplat) {
        let schedule = schedule_of(method, |_| {});
        assert!(schedule.virtual_steps(9).is_none(), "{method}");
        assert_eq!(iterations_with(&schedule, Event::RefreshVirtualViews), [] as [u32; 0]);
    }
}

#[test]
fn a_timeline_can_be_read() {
    let lines = |method, change: fn(&mut TrainConfig)| schedule_of(method, change).timeline().lines();
    let published = [
        "densify every 100 from 600 to 14,900",
        "opacity reset every 3,000 from 3,000 to 12,000",
        "a degree more of the spherical harmonics every 1,000",
    ];
    assert_eq!(lines(MethodName::ThreeDgs, |_| {}), published);
    let improved = [
        "densify every 100 from 600 to 14,900",
        "opacity reset every 3,000 from 3,000 to 12,000",
        "prune what recovered slowest from a reset at 3,300, 6,300",
        "a degree more of the spherical harmonics every 1,000",
        "a step for every 5 photos after 15,000",
        "a step for every 20 photos after 22,500",
    ];
    assert_eq!(lines(MethodName::ImprovedGs, |_| {}), improved);
    let ours = [
        "pictures of virtual views every 600 from 1,800 to 2,400",
        "pictures of virtual views every 100 from 3,000 to 5,900",
        "densify every 100 from 200 to 2,900",
        "opacity reset every 600 from 600 to 2,400",
        "add the state to the mean every 30 from 3,630 to 5,970",
        "take the mean at 6,000",
        "prune what recovered slowest from a reset at 700, 1,300",
        "a degree more of the spherical harmonics every 200",
    ];
    assert_eq!(lines(MethodName::Genesplat, |config| config.iterations = 6000), ours);
}
