//! Steps on pictures that the cloud has made of what lies between the photos.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use genesplat_core::{Photo, TrainStep, View};
use genesplat_train::{Background, Outcome, Silent, Start, TrainConfig, TrainError, train};

use crate::support::{Call, FakeBackend, Keep, Told, points, views};

const PHOTOS: usize = 8;

fn config() -> TrainConfig {
    let usual = TrainConfig::default();
    let mut config =
        TrainConfig { iterations: 1000, checkpoint_every: 990, max_gaussians: Some(60), ..usual };
    config.method.virtual_views = 1;
    config
}

fn run(
    backend: &mut FakeBackend,
    config: TrainConfig,
    views: &[View],
    start: Start,
) -> Result<Outcome, TrainError> {
    train(backend, views, start, &config.resolve().unwrap(), &mut Silent, &AtomicBool::new(false))
}

fn steps_of(config: TrainConfig) -> FakeBackend {
    let mut backend = FakeBackend::new();
    run(&mut backend, config, &views(PHOTOS), Start::Points(points(20))).unwrap();
    backend
}

#[test]
fn every_second_late_step_looks_between_the_photos() {
    let backend = steps_of(config());
    let on_virtual: Vec<usize> =
        (1..).zip(backend.steps()).filter(|(_, step)| step.view >= PHOTOS).map(|(i, _)| i).collect();
    assert!(on_virtual.iter().copied().eq((301..1000).step_by(2)), "from the first reset after 30 % on");
    let mut seen = [0; 2 * PHOTOS];
    for step in backend.steps() {
        seen[step.view] += 1;
        assert!(
            step.view < PHOTOS || step.statistics.density.is_none(),
            "photos alone say where the cloud grows"
        );
    }
    // Cameras on a circle have two neighbours each.
    assert!(seen[..PHOTOS].iter().all(|&visits| (81..=82).contains(&visits)), "{seen:?}");
    assert!(seen[PHOTOS..].iter().all(|&visits| (43..=44).contains(&visits)), "{seen:?}");
    let set = |call: &&Call| matches!(call, Call::SetViews(views) if *views == 2 * PHOTOS);
    // At 300, 400 (resets) and from 500 on.
    assert_eq!(backend.calls.iter().filter(set).count(), 7);
}

/// Sixteen at a time.
#[test]
fn all_pictures_are_made_again() {
    let mut keep = Keep::default();
    let resolved = TrainConfig { checkpoint_every: 330, ..config() }.resolve().unwrap();
    let (start, stop) = (Start::Points(points(20)), AtomicBool::new(false));
    train(&mut FakeBackend::new(), &views(40), start, &resolved, &mut keep, &stop).unwrap();
    let [first, last] = [0, 2].map(|at| &keep.0[at].virtual_pictures);
    let changed = first.iter().zip(last).filter(|(first, last)| first != last).count();
    // Each of six looks leaves three in five out.
    assert!(first.len() == 40 && changed > 32, "{changed} of {}", first.len());
}

#[test]
fn pictures_have_the_background_that_they_were_made_with() {
    let backend = steps_of(TrainConfig { background: Background::Random, ..config() });
    let (on_virtual, on_photos): (Vec<&TrainStep>, Vec<&TrainStep>) =
        backend.steps().partition(|step| step.view >= PHOTOS);
    assert!(on_virtual.iter().all(|step| step.settings.background == on_virtual[0].settings.background));
    assert!(on_photos.windows(2).all(|pair| pair[0].settings.background != pair[1].settings.background));
}

#[test]
fn without_them_all_steps_look_at_photos() {
    let mut without = config();
    without.method.virtual_views = 0;
    let backend = steps_of(without);
    assert!(backend.steps().all(|step| step.view < PHOTOS));
    assert!(backend.calls.iter().all(|call| !matches!(call, Call::SetViews(views) if *views != PHOTOS)));
}

#[test]
fn a_checkpoint_goes_on_with_photos_of_its_size_alone() {
    let mut keep = Keep::default();
    let resolved = config().resolve().unwrap();
    let start = Start::Points(points(20));
    train(&mut FakeBackend::new(), &views(PHOTOS), start, &resolved, &mut keep, &AtomicBool::new(false))
        .unwrap();
    let checkpoint = keep.0.pop().unwrap();
    assert_eq!(checkpoint.virtual_pictures.len(), PHOTOS);
    let resume_as = |config: TrainConfig, views: &[View]| {
        let start = Start::Checkpoint(Box::new(checkpoint.clone()));
        run(&mut FakeBackend::new(), config, views, start)
    };
    let resume = |views: &[View]| resume_as(config(), views);
    assert!(resume(&views(PHOTOS)).is_ok());
    // Ten steps on photos alone.
    assert!(resume_as(TrainConfig { iterations: 1000, ..TrainConfig::default() }, &views(PHOTOS)).is_ok());
    let mut larger = views(PHOTOS);
    for view in &mut larger {
        view.camera = view.camera.resized(5, 5);
        view.photo = Arc::new(Photo { width: 5, height: 5, rgb: vec![0; 75] }).into();
    }
    let error = resume(&larger).unwrap_err();
    assert!(matches!(error, TrainError::OtherPhotos), "{error}");
}

#[test]
fn the_user_is_told() {
    let told = |config: TrainConfig| {
        let mut told = Told::default();
        let start = Start::Points(points(20));
        let (resolved, stop) = (config.resolve().unwrap(), AtomicBool::new(false));
        train(&mut FakeBackend::new(), &views(PHOTOS), start, &resolved, &mut told, &stop).unwrap();
        told.notices.into_iter().find(|text| text.contains("method.virtual_views"))
    };
    let said = told(config()).unwrap();
    assert!(
        said.starts_with("from iteration 300 on one step in 2") && said.contains("the 8 photos"),
        "{said}"
    );
    assert_eq!(
        told(TrainConfig { iterations: 1000, ..TrainConfig::default() }),
        None,
        "not with 125 looks at each"
    );
}
