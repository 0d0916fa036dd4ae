use super::*;
use crate::config::{EvolutionMode, StepBudget};

/// Of the published trainer, unless `change` says otherwise.
fn schedule(change: impl FnOnce(&mut TrainConfig)) -> Schedule {
    let mut config = TrainConfig::published();
    change(&mut config);
    Schedule::new(config)
}

fn iterations_with(schedule: &Schedule, phase: Phase) -> Vec<u32> {
    (1..=schedule.iterations).filter(|&i| schedule.phases(i).any(|due| due == phase)).collect()
}

#[test]
fn the_published_schedule_densifies_144_times_and_resets_4_times() {
    let schedule = schedule(|_| {});
    let densify = iterations_with(&schedule, Phase::Densify);
    assert_eq!((densify.len(), densify[0], densify[143]), (144, 600, 14_900));
    assert_eq!(iterations_with(&schedule, Phase::ResetOpacity), [3000, 6000, 9000, 12_000]);
    assert_eq!(iterations_with(&schedule, Phase::Evolve), [] as [u32; 0]);
    assert!(!schedule.prunes_by_size(3000) && schedule.prunes_by_size(3100));
}

#[test]
fn lost_steps_leave_29_855() {
    let schedule = schedule(|_| {});
    let made = (1..=30_000).filter(|&i| schedule.optimiser_step(i) == OptimiserStep::All).count();
    assert_eq!(made, 29_855);
    assert_eq!(schedule.optimiser_step(30_000), OptimiserStep::Lost);
}

/// Every fourth iteration steps, at twice the rates, and none but the last is lost.
#[test]
fn a_step_of_four_views_is_twice_as_long() {
    let [one, four] = [1, 4].map(|views| schedule(|config| config.views_per_step = views));
    let made = (1..30_000).filter(|&i| four.optimiser_step(i).moves());
    assert!(made.eq((4..30_000).step_by(4)));
    assert_eq!((four.optimiser_step(601), four.optimiser_step(30_000)), (OptimiserStep::Later, OptimiserStep::Lost));
    let [one, four] = [one.rates(2.0, 500), four.rates(2.0, 500)];
    let all =
        |rates: LearningRates| [rates.position, rates.sh_dc, rates.sh_rest, rates.opacity, rates.scale, rates.rotation];
    assert!(all(one).into_iter().zip(all(four)).all(|(one, four)| (four / one - 2.0).abs() < 1e-6));
}

/// 3000 is no multiple of 16, and 18,000 comes when Improved-GS has steps of five views.
#[test]
fn a_reset_cuts_a_step_of_several_views_short() {
    let around = |schedule: &Schedule, reset: u32| [reset - 1, reset, reset + 1].map(|i| schedule.optimiser_step(i));
    let cut = [OptimiserStep::Later, OptimiserStep::AllButOpacity, OptimiserStep::Later];
    let sixteen = schedule(|config| config.views_per_step = 16);
    assert_eq!([3000, 6000, 9000].map(|reset| around(&sixteen, reset)), [cut; 3]);
    assert_eq!([2992, 3008].map(|i| sixteen.optimiser_step(i)), [OptimiserStep::All; 2], "others stay where they were");
    let late = schedule(|config| (config.variant, config.densify.until) = (Variant::ImprovedGs, 20_000));
    assert_eq!(around(&late, 18_000), cut);
}

#[test]
fn a_shorter_schedule_loses_no_more_steps_than_the_published_one() {
    let lost = |change: fn(&mut TrainConfig)| {
        let schedule = schedule(change);
        let lost = (1..schedule.iterations).filter(|&i| schedule.optimiser_step(i) == OptimiserStep::Lost);
        lost.collect::<Vec<_>>()
    };
    let tenth: Vec<u32> = (1..15).map(|hundreds| 100 * hundreds).collect();
    assert_eq!(lost(|config| config.steps_scale = 0.1), tenth);
    assert_eq!(lost(|config| config.steps_scale = 0.01), [100]);
    assert_eq!(lost(|config| config.densify.every = 9), [] as [u32; 0], "nothing would be learnt");
}

#[test]
fn no_interval_is_scaled_below_a_hundred_iterations() {
    let scaled = |scale: f64, every: u32| {
        let schedule = schedule(|config| (config.steps_scale, config.densify.every) = (scale, every));
        (schedule.densify_every, schedule.reset_every)
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
    assert_eq!(iterations_with(&schedule, Phase::ResetOpacity), [500, 3000, 6000, 9000, 12_000]);
    assert_eq!(schedule.optimiser_step(500), OptimiserStep::AllButOpacity);
    assert_eq!(schedule.optimiser_step(3000), OptimiserStep::Lost, "it densifies, too");
    assert_eq!(schedule.phases(500).collect::<Vec<_>>(), [Phase::Step, Phase::ResetOpacity]);
}

#[test]
fn without_density_control_not_even_white_resets() {
    let schedule = schedule(|config| (config.background, config.densify.until) = (Background::White, 0));
    assert_eq!(iterations_with(&schedule, Phase::ResetOpacity), [] as [u32; 0]);
}

#[test]
fn evolution_follows_the_four_resets_but_not_the_white_one() {
    let schedule = schedule(|config| {
        config.evolution.mode = EvolutionMode::Paper;
        config.background = Background::White;
    });
    assert_eq!(schedule.stages().collect::<Vec<_>>(), [3000, 6000, 9000, 12_000]);
    assert_eq!(
        schedule.phases(3000).collect::<Vec<_>>(),
        [Phase::Step, Phase::Densify, Phase::ResetOpacity, Phase::Evolve]
    );
}

#[test]
fn other_triggers_move_the_stage_and_a_stride_thins_it() {
    let with = |trigger, stride| {
        schedule(|config| {
            config.evolution.mode = EvolutionMode::Paper;
            (config.evolution.trigger, config.evolution.stride) = (trigger, stride);
        })
    };
    let before = with(Trigger::BeforeReset, 2);
    assert_eq!(before.stages().collect::<Vec<_>>(), [6000, 12_000]);
    let phases = [Phase::Step, Phase::Densify, Phase::Evolve, Phase::ResetOpacity];
    assert_eq!(before.phases(6000).collect::<Vec<_>>(), phases);
    assert_eq!(with(Trigger::AfterDensify, 1).stages().count(), 144);
    let quarter = with(Trigger::BeforeDensify, 36);
    assert_eq!(quarter.stages().collect::<Vec<_>>(), [4100, 7700, 11_300, 14_900]);
    let phases = [Phase::Step, Phase::Evolve, Phase::Densify];
    assert_eq!(quarter.phases(4100).collect::<Vec<_>>(), phases);
    let once = with(Trigger::AtEnd, 1);
    assert_eq!(once.stages().collect::<Vec<_>>(), [30_000]);
    assert_eq!(once.phases(30_000).collect::<Vec<_>>(), [Phase::Step, Phase::Evolve]);
}

#[test]
fn the_evolution_stage_has_its_place_by_the_trigger() {
    use Phase::{AddToMean, Densify, Evolve, RefreshFilter, RefreshVirtualViews, Renew, ResetOpacity, Step, TakeMean};
    let late = [AddToMean, TakeMean, Renew];
    for (trigger, early) in [
        (Trigger::BeforeDensify, [Step, Evolve, Densify, RefreshFilter, ResetOpacity]),
        (Trigger::AfterDensify, [Step, Densify, RefreshFilter, Evolve, ResetOpacity]),
        (Trigger::BeforeReset, [Step, Densify, RefreshFilter, Evolve, ResetOpacity]),
        (Trigger::AfterReset, [Step, Densify, RefreshFilter, ResetOpacity, Evolve]),
        (Trigger::AtEnd, [Step, Densify, RefreshFilter, ResetOpacity, Evolve]),
    ] {
        let order = [&[Step, RefreshVirtualViews], &early[1..], &late].concat();
        assert_eq!(Phase::order(trigger)[..], order, "{trigger:?}");
        let schedule = schedule(|config| config.evolution.trigger = trigger);
        assert_eq!(schedule.order()[..], order);
        assert!(order.iter().zip(0..).all(|(&phase, place)| schedule.place(phase) == place));
    }
}

#[test]
fn extra_steps_come_where_the_search_would() {
    let stages = |change: fn(&mut TrainConfig)| schedule(change).stages().collect::<Vec<_>>();
    let budget = Some(StepBudget::Steps(7));
    assert_eq!(stages(|_| {}), [] as [u32; 0]);
    let extra = schedule(|config| config.evolution.extra_steps = budget);
    assert_eq!(extra.stages().collect::<Vec<_>>(), stages(|config| config.evolution.mode = EvolutionMode::Paper));
    assert!(!extra.statistics(None, 1).genes, "nobody reads them");
}

/// With renewals, since the variant's own density control grows.
fn renewing(change: impl FnOnce(&mut TrainConfig)) -> Schedule {
    schedule(|config| {
        config.evolution.mode = EvolutionMode::Renew;
        config.evolution.renewal.selection = false;
        change(config);
    })
}

/// Windows are a tenth of the run.
fn averaging(change: impl FnOnce(&mut TrainConfig)) -> Schedule {
    renewing(|config| {
        config.evolution.renewal.every = 0.1;
        change(config);
    })
}

#[test]
fn weight_averaging_comes_at_the_end_of_each_window_in_which_rows_stay() {
    let full = averaging(|_| {});
    assert_eq!(full.stages().count(), 0, "none of the paper's");
    assert_eq!(iterations_with(&full, Phase::TakeMean), [18_000, 21_000, 24_000, 27_000, 30_000]);
    let averaged = iterations_with(&full, Phase::AddToMean);
    // Ten states a window, but for the last step of the run.
    assert_eq!((averaged.len(), averaged[0], averaged[1], averaged[48]), (49, 15_300, 15_600, 29_700));
    // MCMC moves rows until half of the run: there is a window more than in a run that densifies as long.
    let mcmc = averaging(|config| config.variant = Variant::Mcmc);
    assert_eq!(iterations_with(&mcmc, Phase::TakeMean), iterations_with(&full, Phase::TakeMean));
    // A window needs half its length after density control, which a run that is cut short ends at 65 %.
    let short = averaging(|config| config.iterations = 7000);
    assert_eq!(iterations_with(&short, Phase::TakeMean), [4900, 5600, 6300, 7000]);
    let none = averaging(|config| {
        (config.evolution.renewal.averaging, config.evolution.renewal.until) = (false, Some(0.0));
    });
    assert!((1..=30_000).all(|i| none.phases(i).all(|phase| !phase.is_evolution())));
}

#[test]
fn without_renewals_the_last_two_fifths_are_one_window() {
    // Where density control ends early, too, when rows stay what they are for longer.
    for (selection, until) in [(true, 15_000), (false, 15_000), (true, 12_000), (false, 0)] {
        let schedule = renewing(|config| {
            (config.evolution.renewal.selection, config.evolution.renewal.until) = (selection, Some(0.0));
            config.densify.until = until;
        });
        assert_eq!(iterations_with(&schedule, Phase::Renew), [] as [u32; 0]);
        assert_eq!(iterations_with(&schedule, Phase::TakeMean), [30_000]);
        let averaged = iterations_with(&schedule, Phase::AddToMean);
        assert_eq!((averaged.len(), averaged[0], averaged[1], averaged[78]), (79, 18_150, 18_300, 29_850));
    }
}

#[test]
fn growth_by_selection_fits_its_schedule_into_the_run() {
    let selecting = |change: fn(&mut TrainConfig)| {
        schedule(|config| {
            config.evolution.mode = EvolutionMode::Renew;
            change(config);
        })
    };
    let short = selecting(|config| config.iterations = 6000);
    let scaled = selecting(|config| config.steps_scale = 0.2);
    for schedule in [&short, &scaled] {
        assert_eq!((schedule.iterations, schedule.densify_from, schedule.densify_until), (6000, 100, 3000));
        assert_eq!(iterations_with(schedule, Phase::ResetOpacity), [600, 1200, 1800, 2400]);
        assert_eq!(schedule.rates(2.0, 6000).position, 4e-6, "the last rate");
        assert!(
            (1..=6000).all(|i| schedule.optimiser_step(i) != OptimiserStep::Later),
            "averages stand for large steps"
        );
        assert_eq!((schedule.sh_degree(199), schedule.sh_degree(200)), (0, 1));
    }
    let plain = renewing(|config| config.iterations = 6000);
    assert_eq!((plain.densify_from, plain.sh_degree(999)), (500, 0), "cut short");
    let unaveraged = selecting(|config| {
        (config.variant, config.evolution.renewal.averaging) = (Variant::ImprovedGs, false);
    });
    assert_eq!(unaveraged.optimiser_step(15_001), OptimiserStep::Later, "as published");
}

#[test]
fn improved_gs_prunes_after_resets_and_steps_less_often_later() {
    let schedule = schedule(|config| config.variant = Variant::ImprovedGs);
    let all = |due: &dyn Fn(u32) -> bool| (1..=30_000).filter(|&i| due(i)).collect::<Vec<_>>();
    assert_eq!(iterations_with(&schedule, Phase::Densify).len(), 144);
    assert_eq!(all(&|i| schedule.has_recovered(i)), [3300, 6300, 9300, 12_300]);
    assert_eq!(all(&|i| schedule.prunes_slow(i)), [3300, 6300]);
    assert_eq!(all(&|i| schedule.score_views(i) != 10), [3400, 6400]);
    assert_eq!(schedule.score_views(3400), usize::MAX, "all");
    let bounded = self::schedule(|config| config.evolution.mode = EvolutionMode::Renew);
    assert_eq!([3300, 3400, 3500].map(|i| bounded.score_views(i)), [10, 600, 10], "selection asks 2 % of 30,000");
    assert!(!schedule.prunes_by_size(14_900));
    let budgets = [500, 640, 4000, 14_500, 14_900].map(|i| (1e6 * schedule.budget(i)).round());
    assert_eq!(budgets, [0.0, 1e5, 5e5, 1e6, 1e6]);
    assert!(!schedule.is_budget_full(14_500) && schedule.is_budget_full(14_600));
    let steps = |step| all(&|i| schedule.optimiser_step(i) == step).len();
    // The last iteration would be the 375th of twenty views.
    assert_eq!(steps(OptimiserStep::All), 15_000 - 144 + 1500 + 374);
    assert_eq!(steps(OptimiserStep::Lost), 145);
    let rates = |i| schedule.rates(2.0, i);
    assert_eq!((rates(30_000).position, rates(1).opacity), (4e-6, 0.025));
}

#[test]
fn improved_gs_scales_its_windows_and_ends_growth_where_renewal_begins() {
    let tenth = schedule(|config| (config.variant, config.steps_scale) = (Variant::ImprovedGs, 0.1));
    // Resets at 300, 600, ...; opacities have a hundred iterations, and only the first nine hundred prune what is slow.
    let all = |due: &dyn Fn(u32) -> bool| (1..=3000).filter(|&i| due(i)).collect::<Vec<_>>();
    assert_eq!(all(&|i| tenth.has_recovered(i)), [400, 700, 1000, 1300]);
    assert_eq!(all(&|i| tenth.prunes_slow(i)), [400, 700]);
    assert_eq!(all(&|i| tenth.score_views(i) != 10), [500, 800]);
    let late = all(&|i| tenth.optimiser_step(i) == OptimiserStep::Later);
    assert_eq!((late[0], late.len()), (1501, 750 - 150 + 749 - 37));
    let renewing = schedule(|config| {
        (config.variant, config.iterations) = (Variant::ImprovedGs, 7000);
        config.evolution.mode = EvolutionMode::Renew;
    });
    assert_eq!(renewing.densify_until, 3500);
    assert!(renewing.budget(3300) < 1.0 && renewing.is_budget_full(3400));
    assert!((renewing.budget(1750) - 0.5f64.powf(1.5)).abs() < 0.03, "slowly at first");
    let short = schedule(|config| {
        (config.variant, config.iterations) = (Variant::ImprovedGs, 4000);
        config.evolution.mode = EvolutionMode::Renew;
    });
    assert!((short.budget(1000) - 0.5f64.sqrt()).abs() < 0.05, "along the root");
}

fn renewals(change: impl FnOnce(&mut TrainConfig)) -> Vec<u32> {
    let schedule = renewing(change);
    (1..=schedule.iterations).filter(|&i| schedule.renews(i)).collect()
}

#[test]
fn renewal_begins_when_density_control_has_ended_and_leaves_time_to_learn() {
    let full = renewing(|_| {});
    let begun = renewals(|_| {});
    assert_eq!(begun, [15_000, 16_500, 18_000, 19_500, 21_000, 22_500]);
    assert_eq!(iterations_with(&full, Phase::Renew), [&begun[..], &[24_000]].concat(), "the last is only judged");
    assert_eq!(full.phases(18_000).collect::<Vec<_>>(), [Phase::Step, Phase::AddToMean, Phase::TakeMean, Phase::Renew]);
    // MCMC would relocate until 25,000.
    let mcmc = renewing(|config| config.variant = Variant::Mcmc);
    assert_eq!(iterations_with(&mcmc, Phase::Renew), iterations_with(&full, Phase::Renew));
    assert_eq!(iterations_with(&mcmc, Phase::Densify).last(), Some(&14_900));
}

#[test]
fn renewals_of_runs_of_all_lengths() {
    let cut_short =
        |variant, iterations| renewals(|config| (config.variant, config.iterations) = (variant, iterations));
    for (iterations, begun) in [
        (300, vec![195, 210, 225]),
        (1800, vec![1170, 1260, 1350]),
        (2000, vec![1300, 1400, 1500]),
        (3000, vec![1950, 2100, 2250]),
        (7000, vec![4550, 4900, 5250]),
        (23_080, vec![15_002, 16_156, 17_310]),
        (24_000, vec![15_600, 16_800, 18_000]),
        (40_000, vec![20_000, 22_000, 24_000, 26_000, 28_000, 30_000]),
    ] {
        assert_eq!(cut_short(Variant::ThreeDgs, iterations), begun);
    }
    for (iterations, begun) in [
        (300, [150, 165, 180, 195, 210, 225]),
        (1800, [900, 990, 1080, 1170, 1260, 1350]),
        (2000, [1000, 1100, 1200, 1300, 1400, 1500]),
        (3000, [1500, 1650, 1800, 1950, 2100, 2250]),
        (7000, [3500, 3850, 4200, 4550, 4900, 5250]),
        (30_000, [15_000, 16_500, 18_000, 19_500, 21_000, 22_500]),
    ] {
        assert_eq!(cut_short(Variant::Mcmc, iterations), begun);
        let scale = f64::from(iterations) / 30_000.0;
        assert_eq!(renewals(|config| config.steps_scale = scale), begun, "the same of the whole schedule");
    }
    // Where nothing is densified, or only for a while, renewal waits for the second half all the same.
    for until in [0, 10_000] {
        let begun = renewals(|config| config.densify.until = until);
        assert_eq!(begun, [15_000, 16_500, 18_000, 19_500, 21_000, 22_500]);
    }
}

#[test]
fn states_are_averaged_before_a_renewal_unless_density_control_has_just_ended() {
    for (iterations, until) in
        [(24_000, 15_000), (40_000, 15_000), (23_080, 15_000), (30_000, 10_000), (30_000, 16_000)]
            .into_iter()
            .chain((100..=1000).map(|iterations| (iterations, 15_000)))
    {
        let schedule = renewing(|config| (config.iterations, config.densify.until) = (iterations, until));
        let averaged = iterations_with(&schedule, Phase::TakeMean);
        let settled = schedule.densify_until + schedule.window().unwrap() / 2;
        let renewed = iterations_with(&schedule, Phase::Renew);
        assert!(!renewed.is_empty(), "{iterations} iterations");
        for i in renewed.into_iter().filter(|&i| i >= settled) {
            assert!(averaged.contains(&i), "{iterations} iterations: {i} is not one of {averaged:?}");
        }
    }
}

#[test]
fn with_renewal_a_run_that_is_cut_short_leaves_time_to_renew() {
    let short = |mode| renewing(|config| (config.evolution.mode, config.iterations) = (mode, 7000));
    let (renewing, plain) = (short(EvolutionMode::Renew), short(EvolutionMode::Off));
    assert_eq!(iterations_with(&renewing, Phase::Densify).last(), Some(&4500));
    assert_eq!(iterations_with(&renewing, Phase::ResetOpacity), [3000]);
    assert_eq!(iterations_with(&plain, Phase::Densify).last(), Some(&6900));
    assert_eq!(iterations_with(&plain, Phase::ResetOpacity), [3000, 6000]);
    assert!(plain.prunes_by_size(3100) && !renewing.prunes_by_size(3100), "contributions decide there");
}

#[test]
fn mcmc_densifies_longer_loses_no_step_and_resets_nothing() {
    let schedule = schedule(|config| {
        (config.variant, config.background) = (Variant::Mcmc, Background::White);
        config.evolution.mode = EvolutionMode::Paper;
    });
    let densify = iterations_with(&schedule, Phase::Densify);
    assert_eq!((densify.len(), densify[0], densify[243]), (244, 600, 24_900));
    assert_eq!(iterations_with(&schedule, Phase::ResetOpacity), [] as [u32; 0]);
    let lost = (1..=30_000).filter(|&i| schedule.optimiser_step(i) != OptimiserStep::All);
    assert_eq!(lost.collect::<Vec<_>>(), [30_000], "the last one only measures");
    assert_eq!(schedule.stages().collect::<Vec<_>>(), [3000, 6000, 9000, 12_000], "where 3DGS resets");
    assert_eq!(schedule.phases(3000).collect::<Vec<_>>(), [Phase::Step, Phase::Densify, Phase::Evolve]);
}

#[test]
fn the_3d_filter_follows_densification_and_then_every_hundredth_iteration() {
    let schedule = schedule(|config| config.variant = Variant::MipSplatting);
    let refreshed = iterations_with(&schedule, Phase::RefreshFilter);
    let late: Vec<u32> = refreshed.iter().copied().filter(|&i| i >= 15_000).collect();
    assert_eq!((late[0], late[late.len() - 1], late.len()), (15_100, 29_800, 148));
    assert_eq!((refreshed[0], refreshed.len()), (600, 144 + 148));
}

#[test]
fn scaling_keeps_the_shape_and_truncation_keeps_the_rates() {
    let tenth = schedule(|config| config.steps_scale = 0.1);
    assert_eq!(tenth.iterations, 3000);
    let densify = iterations_with(&tenth, Phase::Densify);
    assert_eq!(
        (densify.len(), densify[0], densify[13]),
        (14, 100, 1400),
        "windows are scaled, intervals as far as may be"
    );
    assert_eq!(iterations_with(&tenth, Phase::ResetOpacity), [300, 600, 900, 1200]);
    let short = schedule(|config| config.iterations = 3000);
    assert_eq!(iterations_with(&short, Phase::ResetOpacity), [] as [u32; 0], "the last one only measures");
    assert_eq!(iterations_with(&short, Phase::Densify).last(), Some(&2900));
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
fn statistics_end_with_densification_and_gene_sums_with_the_last_stage() {
    let schedule = schedule(|config| config.evolution.mode = EvolutionMode::Paper);
    let at = |i| schedule.statistics(Some(DensitySignal::Signed), i);
    assert!(at(14_999).density.is_some() && at(15_000).density.is_none());
    assert!(at(12_000).genes && !at(12_001).genes);
}
