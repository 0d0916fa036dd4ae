//! Published scenes, where they are at hand (`GENESPLAT_DATA`).

use crate::common::real_scene;
use genesplat_io::{LoadOptions, PhotoSize, load_scene, read_ply};

#[test]
fn colmap_scenes_load_whole() {
    for (name, photos, points, size) in [
        ("fox", 50usize, 14_678, [539, 960]),
        ("fern", 20, 10_091, [747, 560]),
        ("plush", 97, 25_784, [640, 480]),
    ] {
        let Some(folder) = real_scene(name) else { continue };
        let options = LoadOptions { size: PhotoSize::Downscale(4), ..LoadOptions::default() };
        let scene = load_scene(&folder, &options, &()).unwrap();
        assert_eq!((scene.name.as_str(), scene.points.len()), (name, points));
        assert_eq!((scene.train.len() + scene.test.len(), scene.test.len()), (photos, photos.div_ceil(8)));
        for view in scene.train.iter().chain(&scene.test) {
            let side = |full: u32| (f64::from(full) / 4.0).round_ties_even() as u32;
            assert_eq!([view.camera.width, view.camera.height], size.map(side));
            assert_eq!(
                view.photo.read().unwrap().rgb.len() as u32,
                3 * view.photo.read().unwrap().width * view.photo.read().unwrap().height
            );
        }
        let mean = seen_fraction(&scene);
        assert!(mean > 0.15, "{name}: on average a view sees {mean} of the points; the poses are wrong");
    }
}

/// Mean fraction of the points that lie in front of a view and inside its image.
fn seen_fraction(scene: &genesplat_io::Scene) -> f64 {
    let inside = |view: &genesplat_core::View, point: &genesplat_io::Point| {
        let in_camera = view.camera.camera_from_world(point.position.map(f64::from).into());
        let [u, v] = view.camera.pixel_from_camera(in_camera);
        let [w, h] = [view.camera.width, view.camera.height].map(f64::from);
        in_camera.z > 0.0 && (0.0..w).contains(&u) && (0.0..h).contains(&v)
    };
    let pairs = (scene.train.len() * scene.points.len()) as f64;
    let seen =
        scene.train.iter().flat_map(|view| scene.points.iter().filter(move |point| inside(view, point)));
    seen.count() as f64 / pairs
}

#[test]
fn a_blender_scene_loads_whole() {
    let Some(folder) = real_scene("lego") else { return };
    let scene = load_scene(&folder, &LoadOptions::default(), &()).unwrap();
    assert_eq!((scene.train.len(), scene.test.len(), scene.points.len()), (50, 25, 100_000));
    let camera = scene.train[0].camera;
    assert_eq!((camera.width, camera.height), (200, 200));
    // Every camera of this data set is about 4 units from the object at the origin, and looks at it.
    for view in scene.train.iter().chain(&scene.test) {
        assert!((view.camera.centre_in_world().length() - 4.03).abs() < 0.05);
        assert!(view.camera.camera_from_world(glam::DVec3::ZERO).z > 4.0);
        assert_eq!(view.photo.read().unwrap().pixel(0, 0), [0; 3], "transparent on black");
    }
}

#[test]
fn a_scene_with_distorted_photos_loads_and_names_what_is_absent() {
    let Some(folder) = real_scene("fox_transforms") else { return };
    let options = LoadOptions { size: PhotoSize::Downscale(4), ..LoadOptions::default() };
    let scene = load_scene(&folder, &options, &()).unwrap();
    assert_eq!((scene.train.len(), scene.test.len()), (43, 7));
    assert!(scene.notices[0].starts_with("17 of the 67 photos"), "{}", scene.notices[0]);
    let camera = scene.train[0].camera;
    // Less than a quarter of 540x960: what the lens leaves without content is cut off.
    assert_eq!((camera.width, camera.height), (133, 237));
    assert!((camera.focal_px[0] / (687.76 / 4.0) - 1.0).abs() < 0.05);
    assert!(seen_fraction(&scene) > 0.1);
}

#[test]
fn a_splat_of_another_trainer_loads() {
    let Some(folder) = real_scene("peer") else { return };
    let cloud = read_ply(&folder.join("opensplat_fox.ply")).unwrap();
    assert_eq!(cloud.len(), 33_979);
    assert_eq!(cloud.first_non_finite(), None);
}
