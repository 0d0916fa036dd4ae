//! When ours looks at virtual views, and makes their pictures.

use super::*;

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
