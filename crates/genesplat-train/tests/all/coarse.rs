//! A run in haste sees large photos at half of their size at first.

use std::sync::atomic::AtomicBool;

use genesplat_core::{Photo, View};
use genesplat_train::{MethodName, Outcome, Start, TrainConfig, train};

use crate::support::{Call, FakeBackend, Keep, points, resumed, timeless, views};

const PHOTOS: usize = 20;

/// Fifty looks at each photo.
fn config(method: MethodName) -> TrainConfig {
    TrainConfig {
        iterations: 1000,
        checkpoint_every: 200,
        max_gaussians: Some(60),
        ..TrainConfig::of(method)
    }
}

/// The first pixel is white, and black around it: the first of the half is darker.
fn photos(width: u32) -> Vec<View> {
    let mut photo = Photo { width, height: 2, rgb: vec![0; 6 * width as usize] };
    photo.rgb[..3].fill(200);
    let of_size =
        |view: View| View { camera: view.camera.resized(width, 2), photo: photo.clone().into(), ..view };
    views(PHOTOS).into_iter().map(of_size).collect()
}

/// The end, the device, and what was kept on the way.
fn run(method: MethodName, width: u32, start: Start) -> (Outcome, FakeBackend, Keep) {
    let (mut backend, mut keep) = (FakeBackend::new(), Keep::default());
    let (schedule, stop) = (config(method).resolve().unwrap(), AtomicBool::new(false));
    let outcome = train(&mut backend, &photos(width), start, &schedule, &mut keep, &stop).unwrap();
    (outcome, backend, keep)
}

fn from_points(method: MethodName, width: u32) -> (Outcome, FakeBackend, Keep) {
    run(method, width, Start::Points(points(20)))
}

#[test]
fn large_photos_are_seen_at_half_of_their_size_for_three_tenths_of_the_run() {
    // The fake device's gradients, and so its result, depend on what photos show.
    let [large, small] = [400, 399].map(|width| from_points(MethodName::Genesplat, width).0.cloud);
    assert_ne!(large, small, "a quarter as bright");
    let [large, small] = [400, 399].map(|width| from_points(MethodName::ImprovedGs, width).0.cloud);
    assert_eq!(large, small, "a published method sees all of each");
    let (_, backend, _) = from_points(MethodName::Genesplat, 400);
    let calls = backend.calls.iter().filter(|call| matches!(call, Call::SetViews(_) | Call::Step(_)));
    let at = calls.enumerate().filter(|(_, call)| matches!(call, Call::SetViews(PHOTOS)));
    assert!(at.map(|(at, _)| at).eq([0, 301]), "before the first step, and after three hundred");
}

#[test]
fn a_run_goes_on_with_photos_of_the_size_that_it_had() {
    let (whole, _, keep) = from_points(MethodName::Genesplat, 400);
    let iterations: Vec<u32> = keep.0.iter().map(|checkpoint| checkpoint.cursor.iteration).collect();
    assert_eq!(iterations, [201, 401, 601, 801]);
    for checkpoint in &keep.0[..2] {
        let (outcome, ..) = run(MethodName::Genesplat, 400, resumed(checkpoint));
        assert_eq!(outcome.cloud, whole.cloud, "from {:?}", checkpoint.cursor);
        assert_eq!(timeless(&outcome), timeless(&whole));
    }
}
