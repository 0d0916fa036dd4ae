mod methods;
mod virtual_views;

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

/// 7,000 steps look 80 times at each of 87 photos.
#[test]
fn rates_are_higher_where_each_photo_is_seen_seldom() {
    let schedule = schedule_of(MethodName::Genesplat, |config| config.iterations = 7000);
    let [few, many] = [87, 88].map(|photos| schedule.on(photos));
    let [usual, hasty] = [&few, &many].map(|schedule| schedule.rates(2.0, 1));
    assert_eq!(usual, schedule.rates(2.0, 1));
    assert!(few.timeline().first(Event::ResetOpacity).is_some());
    assert_eq!(many.timeline().first(Event::ResetOpacity), None);
    let ratio = |of: fn(&LearningRates) -> f32| of(&hasty) / of(&usual);
    assert!((ratio(|rates| rates.position) - 4.0).abs() < 0.01, "it falls to the same end");
    assert_eq!(
        [ratio(|r| r.sh_dc), ratio(|r| r.sh_rest), ratio(|r| r.opacity), ratio(|r| r.scale)],
        [2.0; 4]
    );
    assert_eq!([hasty.position_reach, usual.position_reach], [Some(0.1); 2]);
    let published = schedule_of(MethodName::ImprovedGs, |_| {}).rates(2.0, 1);
    assert_eq!(published.position_reach, None, "steps as its authors have them");
    assert_eq!(hasty.rotation, usual.rotation);
    assert!(schedule.lines(88).iter().any(|line| line.contains("few looks")));
    assert!(!schedule.lines(87).iter().any(|line| line.contains("few looks")));
    let mut config = TrainConfig { iterations: 7000, ..TrainConfig::default() };
    config.method.few_looks = 0;
    let none = config.resolve().unwrap();
    assert_eq!(none.on(7000), none);
    let published = TrainConfig { iterations: 7000, ..TrainConfig::of(MethodName::ImprovedGs) };
    let published = published.resolve().unwrap();
    assert_eq!(published.on(7000), published);
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
