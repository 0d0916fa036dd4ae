use genesplat_core::Photo;
use genesplat_gallery::{GalleryOptions, generate};
use genesplat_io::HoldOut;
use glam::DVec3;

use super::*;
use crate::device::{DeviceChoice, open};

fn scene(side: u32) -> Scene {
    let options = GalleryOptions { width: side, height: side, views: 12, points: 1500, seed: 1 };
    generate(&options).into_scene(HoldOut::EveryEighth)
}

/// Another motion for each photo, of about this size.
fn disturbed(scene: &Scene, turn: f64, shift: f64) -> Scene {
    let motion = |at: usize| {
        let wave = |phase: f64| (7.3 * at as f64 + phase).sin();
        Motion {
            turn: [0.0, 2.0, 4.0].map(|phase| turn * wave(phase)),
            shift: [1.0, 3.0, 5.0].map(|phase| shift * wave(phase)),
        }
    };
    let views = scene.train.iter().chain(&scene.test);
    let photos = views.enumerate().map(|(at, view)| (view.name.clone(), motion(at))).collect();
    let mut scene = scene.clone();
    Cameras { by: Evidence::Photos { explained: 1.0 }, photos }.apply(&mut scene);
    scene
}

/// The largest distances of pixels' rays and of centres.
fn apart(one: &Scene, other: &Scene) -> [f64; 2] {
    let views =
        |scene: &Scene| scene.train.iter().chain(&scene.test).map(|view| view.camera).collect::<Vec<_>>();
    let pairs = views(one).into_iter().zip(views(other));
    pairs.fold([0.0, 0.0], |[turn, shift], (one, other)| {
        let axis = one.axis_in_world().distance(other.axis_in_world());
        let centre: f64 = one.centre_in_world().distance(other.centre_in_world());
        [turn.max(axis), shift.max(centre)]
    })
}

#[test]
fn points_bring_every_camera_back_and_leave_right_ones_alone() {
    let right = scene(64);
    assert_eq!(told_by_points(&right), None);
    let mut moved = disturbed(&right, 0.02, 0.05);
    let cameras = told_by_points(&moved).unwrap();
    assert_eq!(cameras.photos.len(), 12, "test photos, too");
    let before = apart(&moved, &right);
    cameras.apply(&mut moved);
    let after = apart(&moved, &right);
    assert!(before[0] > 0.02 && after[0] < 1e-4 && after[1] < 1e-3, "{before:?} {after:?}");
    assert!(cameras.told().contains("12 cameras are moved"), "{}", cameras.told());
    // Points that say nothing, and what many of them say wrongly.
    let mut silent = disturbed(&right, 0.02, 0.05);
    silent.seen.values_mut().flatten().for_each(|sight| sight.ray = None);
    assert!(told_by_points(&silent).is_none() && !have_points(&silent) && have_points(&right));
    let mut wrong = right.clone();
    let noise = |at: usize| (0.37 * at as f32).sin() * 0.2;
    for sights in wrong.seen.values_mut() {
        let rays = sights.iter_mut().enumerate();
        rays.for_each(|(at, sight)| sight.ray = sight.ray.map(|[x, y]| [x + noise(at), y - noise(3 * at)]));
    }
    assert_eq!(told_by_points(&wrong), None, "no motion makes these fit");
}

/// One photo in ten is matched to something else.
#[test]
fn what_is_matched_wrongly_moves_no_camera() {
    let right = scene(64);
    let mut moved = disturbed(&right, 0.02, 0.05);
    for sights in moved.seen.values_mut() {
        sights.iter_mut().step_by(10).for_each(|sight| sight.ray = Some([0.3, -0.2]));
    }
    told_by_points(&moved).unwrap().apply(&mut moved);
    assert!(apart(&moved, &right)[0] < 4e-3, "{:?}", apart(&moved, &right));
}

#[test]
fn parts_of_a_photo_move_together() {
    let mut scene = scene(16);
    let names = [scene.train[0].name.clone(), scene.train[1].name.clone()];
    scene.whole = names.map(|name| (name, "photo".to_owned())).into();
    let centres = |scene: &Scene| [0, 1, 2].map(|at| scene.train[at].camera.centre_in_world());
    let before = centres(&scene);
    let motion = Motion { turn: [0.0; 3], shift: [1.0, 2.0, 3.0] };
    let cameras =
        Cameras { by: Evidence::Photos { explained: 0.5 }, photos: [("photo".to_owned(), motion)].into() };
    cameras.apply(&mut scene);
    let moved = centres(&scene);
    let shifts = [0, 1, 2].map(|at| moved[at] - before[at]);
    assert!(shifts[0].distance(DVec3::new(1.0, 2.0, 3.0)) < 1e-9 && shifts[1].distance(shifts[0]) < 1e-9);
    assert_eq!(shifts[2], DVec3::ZERO);
    assert_eq!(cameras.only(|name| name != "photo").photos.len(), 0);
}

/// A device that shows a picture which its camera alone decides.
struct Painting;

impl genesplat_core::Renderer for Painting {
    fn describe(&self) -> String {
        "a painting".into()
    }

    fn gaussian_count(&self) -> usize {
        0
    }

    fn download(
        &mut self,
    ) -> Result<std::borrow::Cow<'_, genesplat_core::Gaussians>, genesplat_core::BackendError> {
        Ok(std::borrow::Cow::Owned(genesplat_core::Gaussians::zeros(0)))
    }

    /// A smooth pattern on a curved wall.
    fn render(
        &mut self,
        camera: &genesplat_core::Camera,
        _: &genesplat_core::RenderSettings,
    ) -> Result<genesplat_core::Image, genesplat_core::BackendError> {
        let mut image = genesplat_core::Image::zeros(camera.width, camera.height);
        let pixels = (camera.width * camera.height) as usize;
        let back = camera.rotation().transpose();
        for at in 0..pixels {
            let (x, y) = (at as u32 % camera.width, at as u32 / camera.width);
            let ray = back
                * DVec3::new(
                    (f64::from(x) + 0.5 - camera.principal_px[0]) / camera.focal_px[0],
                    (f64::from(y) + 0.5 - camera.principal_px[1]) / camera.focal_px[1],
                    1.0,
                );
            // A sphere of radius 5 around the origin.
            let centre = camera.centre_in_world();
            let (b, c) = (
                centre.dot(ray) / ray.length_squared(),
                (centre.length_squared() - 25.0) / ray.length_squared(),
            );
            let hit = centre + ray * (-b + (b * b - c).sqrt());
            let wave = |phase: f64| 0.5 + 0.4 * (3.0 * hit.x + phase).sin() * (2.5 * hit.y - phase).cos();
            (0..3).for_each(|channel| image.planes[channel * pixels + at] = wave(channel as f64) as f32);
        }
        Ok(image)
    }
}

#[test]
fn a_photo_moves_its_camera_to_where_it_was_taken() {
    let settings = genesplat_core::RenderSettings::default();
    let camera = genesplat_core::Camera::at_origin(64, 48, 50.0);
    let taken = Motion { turn: [0.01, -0.02, 0.03], shift: [0.05, 0.1, -0.08] }.of_camera(&camera);
    let photo = genesplat_core::Renderer::render(&mut Painting, &taken, &settings).unwrap();
    let plane = photo.planes.len() / 3;
    let value = |at: usize| (255.0 * photo.planes[at % 3 * plane + at / 3]).round() as u8;
    let rgb = (0..3 * plane).map(value).collect();
    let photo = Photo { width: 64, height: 48, rgb }.into();
    let mut views = [View { name: "a".into(), camera, photo, mask: None, depth: None }];
    let pixel = align::Pixel::of(&camera, 5.0);
    let mut judged = Vec::new();
    for _ in 0..6 {
        let aligned = align::align(&mut Painting, &views, &settings, pixel).unwrap();
        views[0].camera = aligned.step.of_camera(&views[0].camera);
        judged.push(aligned.judged);
    }
    let found = &views[0].camera;
    assert!(found.axis_in_world().distance(taken.axis_in_world()) < 1e-3, "{judged:?}");
    assert!(found.centre_in_world().distance(taken.centre_in_world()) < 5e-3, "{judged:?}");
    assert!(judged[0][1] < 0.2 * judged[0][0] && judged.windows(2).all(|pair| pair[1][0] <= pair[0][1]));
}

/// A whole search, in small: what is right is left alone, and what is not is told apart.
#[test]
fn photos_tell_cameras_that_are_wrong_from_right_ones() {
    let mut right = scene(48);
    right.seen.clear();
    let config = TrainConfig::default();
    let (mut device, never) = (open(DeviceChoice::Cpu).unwrap(), AtomicBool::new(false));
    let mut told = |scene: &Scene| told_by_photos(scene, &config, &mut device, &never).unwrap();
    assert_eq!(told(&right), None);
    let moved = disturbed(&right, 0.03, 0.05);
    let cameras = told(&moved).unwrap();
    assert_eq!(cameras.photos.len(), right.train.len(), "no test photo is looked at");
    assert_eq!(told(&moved).unwrap(), cameras, "the same again");
    let stopped = AtomicBool::new(true);
    let none = told_by_photos(&moved, &config, &mut open(DeviceChoice::Cpu).unwrap(), &stopped).unwrap();
    assert_eq!(none, None);
}
