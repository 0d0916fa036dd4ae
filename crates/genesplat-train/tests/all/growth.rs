//! How far a cloud grows: to what was asked for, or to what the photos can determine; and what users hear of
//! it.

use std::sync::atomic::AtomicBool;

use genesplat_train::{MethodName, Observer, Start, TrainConfig, train};

use crate::support::{FakeBackend, Told, points, views};

const VIEWS: usize = 6;

/// 300 iterations; density control ends after 150.
fn config(method: MethodName) -> TrainConfig {
    let mut config = TrainConfig { steps_scale: 0.01, ..TrainConfig::of(method) };
    (config.method.densify_every, config.method.reset_every) = (1, 30);
    config.method.prune_size = 10.0;
    config
}

fn run_observed(backend: &mut FakeBackend, config: TrainConfig, observer: &mut dyn Observer) {
    let (start, config) = (Start::Points(points(20)), config.resolve().unwrap());
    train(backend, &views(VIEWS), start, &config, observer, &AtomicBool::new(false)).unwrap();
}

/// Runs with twenty Gaussians that always want to grow.
fn grow(method: MethodName, capacity: f64, limit: Option<usize>) -> Told {
    let mut backend = FakeBackend::new();
    backend.gradient = |row| if row < 20 { 1e-3 } else { 0.0 };
    let mut config = TrainConfig { max_gaussians: limit, ..config(method) };
    config.method.capacity = capacity;
    let mut told = Told::default();
    run_observed(&mut backend, config, &mut told);
    told
}

/// The factor at which the photos determine fifty Gaussians, and a bit: their pixels over 2 · √6 are 19.6,
/// those of one over 0.3 are 53.3.
fn capacity_of_fifty() -> f64 {
    let photo = &views(1)[0].photo;
    let pixels = VIEWS as f64 * f64::from(photo.width()) * f64::from(photo.height());
    50.5 / (pixels / (2.0 * (VIEWS as f64).sqrt()))
}

#[test]
fn a_cloud_grows_to_what_the_photos_can_determine() {
    let capacity = capacity_of_fifty();
    for method in [MethodName::ThreeDgs, MethodName::PixelGs, MethodName::MipSplatting] {
        let full = grow(method, capacity, None);
        // From iteration 6 to 149, evenly.
        let is_even = |&(i, rows): &(u32, usize)| rows <= (50 * i as usize / 149).max(20);
        assert!(full.sizes.iter().all(is_even), "{:?}", full.sizes);
        assert_eq!(full.sizes.last(), Some(&(149, 50)));
        assert!(
            full.notices[0].contains("149: the limit of 50 Gaussians from the photos (method.capacity)")
                && full.notices[0].ends_with("more wanted to grow)"),
            "{:?}",
            full.notices
        );
        let limited = grow(method, capacity, Some(40));
        assert_eq!(limited.sizes.last(), Some(&(149, 40)));
        assert!(limited.notices[0].contains("limit of 40 Gaussians is reached"), "{:?}", limited.notices);
        assert_eq!(grow(method, capacity, Some(60)).sizes.last(), Some(&(149, 50)));
        assert!(grow(method, 0.0, None).sizes.last().unwrap().1 > 60);
    }
}

#[test]
fn who_sets_a_limit_hears_at_once_that_the_photos_determine_fewer() {
    let told = |method, capacity, max_gaussians| {
        let mut config = TrainConfig { max_gaussians, ..config(method) };
        config.method.capacity = capacity;
        let mut told = Told::default();
        run_observed(&mut FakeBackend::new(), config, &mut told);
        told.notices.into_iter().filter(|notice| notice.contains("no further")).collect::<Vec<_>>()
    };
    use MethodName::{ImprovedGs, ThreeDgs};
    let fifty = capacity_of_fifty();
    for (method, limit) in [(ThreeDgs, Some(60)), (ImprovedGs, Some(60)), (ImprovedGs, None)] {
        let [notice] = &told(method, fifty, limit)[..] else { panic!("one notice of {method}, {limit:?}") };
        assert!(
            notice.contains("no further than 50 Gaussians") && notice.contains("method.capacity"),
            "{notice}"
        );
        assert_eq!(notice.contains("limit of 60"), limit.is_some(), "{notice}");
    }
    assert!(told(ImprovedGs, 0.0, Some(60)).is_empty());
    for (method, limit) in [(ThreeDgs, None), (ThreeDgs, Some(40)), (ImprovedGs, Some(50))] {
        assert!(told(method, fifty, limit).is_empty());
    }
}

#[test]
fn a_run_too_short_to_grow_says_so() {
    let told = |method, iterations, until| {
        let mut config = TrainConfig { iterations, ..TrainConfig::of(method) };
        config.method.densify_until = until;
        let mut told = Told::default();
        run_observed(&mut FakeBackend::new(), config, &mut told);
        told.notices.into_iter().filter(|notice| notice.contains("nothing grows")).collect::<Vec<_>>()
    };
    let [notice] = &told(MethodName::Genesplat, 200, 15_000)[..] else { panic!("one notice") };
    assert!(notice.contains("ends before iteration 100"), "{notice}");
    assert!(told(MethodName::Genesplat, 201, 15_000).is_empty());
    for method in [MethodName::ThreeDgs, MethodName::ImprovedGs] {
        assert!(told(method, 900, 0).is_empty(), "it was switched off");
        assert!(told(method, 500, 15_000).is_empty(), "cut short as it was asked for");
    }
}
