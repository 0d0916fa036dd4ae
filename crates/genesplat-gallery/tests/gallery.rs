//! The bundled scene: the same everywhere, geometrically sound, and readable as any COLMAP scene.

use genesplat_core::View;
use genesplat_gallery::{Gallery, GalleryOptions, generate};
use genesplat_io::{HoldOut, LoadOptions, load_scene};

fn small() -> GalleryOptions {
    GalleryOptions { width: 96, height: 64, views: 16, points: 300, seed: 0 }
}

/// Pixel of a world point in a view, if it is in front of the camera and inside the photo.
fn pixel(view: &View, point: [f32; 3]) -> Option<(u32, u32)> {
    let in_camera = view.camera.camera_from_world(point.map(f64::from).into());
    let [u, v] = view.camera.pixel_from_camera(in_camera).map(f64::round);
    let inside =
        (0.0..f64::from(view.camera.width)).contains(&u) && (0.0..f64::from(view.camera.height)).contains(&v);
    (in_camera.z > 0.0 && inside).then_some((u as u32, v as u32))
}

fn bytes(gallery: &Gallery) -> Vec<u8> {
    let photos = gallery.views.iter().flat_map(|view| view.photo.read().unwrap().rgb.clone());
    let points = gallery.points.iter().flat_map(|point| point.position).flat_map(f32::to_le_bytes);
    photos.chain(points).collect()
}

#[test]
fn the_number_of_threads_changes_nothing_and_the_seed_does() {
    let on = |threads: usize, options: GalleryOptions| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        bytes(&pool.install(|| generate(&options)))
    };
    let tiny = GalleryOptions { width: 48, height: 32, views: 3, points: 50, seed: 4 };
    let one = on(1, tiny);
    assert!(one == on(3, tiny), "photos or points depend on the number of threads");
    assert!(one != on(3, GalleryOptions { seed: 5, ..tiny }), "the seed has no effect");
}

#[test]
fn points_lie_where_their_colours_are_seen() {
    let gallery = generate(&small());
    assert_eq!((gallery.views.len(), gallery.points.len()), (16, 300));
    for point in &gallery.points {
        let seen: Vec<_> =
            gallery.views.iter().filter_map(|view| Some((view, pixel(view, point.position)?))).collect();
        assert!(seen.len() >= 2, "{point:?} is inside {} photos", seen.len());
        // In one photo its colour is a pixel's; its error moves it by a pixel at most or so.
        let near = |view: &View, (x, y): (u32, u32)| {
            let around = |at: u32, side: u32| at.saturating_sub(2)..=(at + 2).min(side - 1);
            let mut pixels = around(y, 64).flat_map(|y| around(x, 96).map(move |x| (x, y)));
            pixels.any(|(x, y)| view.photo.read().unwrap().pixel(x, y) == point.rgb)
        };
        assert!(
            seen.iter().any(|&(view, at)| near(view, at)),
            "{point:?} has a colour that no photo shows there"
        );
    }
}

#[test]
fn photos_show_a_room_and_not_a_wall() {
    for view in generate(&small()).views {
        let photo = view.photo.read().unwrap();
        let mean = photo.rgb.iter().map(|&v| f64::from(v)).sum::<f64>() / photo.rgb.len() as f64;
        assert!((60.0..200.0).contains(&mean), "{} has a mean of {mean}", view.name);
        let deviation = photo.rgb.iter().map(|&v| (f64::from(v) - mean).abs()).sum::<f64>();
        assert!(deviation / photo.rgb.len() as f64 > 15.0, "{} is flat", view.name);
    }
}

#[test]
fn on_disk_it_is_an_ordinary_colmap_scene() {
    let (folder, gallery) = (tempfile::tempdir().unwrap(), generate(&small()));
    gallery.write_colmap(folder.path()).unwrap();
    let loaded = load_scene(folder.path(), &LoadOptions::default(), &()).unwrap();
    let direct = gallery.into_scene(HoldOut::EveryEighth);
    assert_eq!((loaded.train.len(), loaded.test.len()), (14, 2));
    assert_eq!(loaded.points, direct.points);
    for (a, b) in loaded.train.iter().chain(&loaded.test).zip(direct.train.iter().chain(&direct.test)) {
        assert_eq!((&a.name, &a.photo.read().unwrap()), (&b.name, &b.photo.read().unwrap()));
        assert_eq!(a.camera.focal_px, b.camera.focal_px);
        assert!((a.camera.centre_in_world() - b.camera.centre_in_world()).length() < 1e-12);
    }
}

/// A test view at the rim would measure extrapolation.
#[test]
fn test_views_are_inside_the_box_of_the_training_views() {
    for views in [16, 48] {
        let options = GalleryOptions { width: 16, height: 16, views, points: 0, seed: 0 };
        let scene = generate(&options).into_scene(HoldOut::EveryEighth);
        let centres = |views: &[View]| views.iter().map(|v| v.camera.centre_in_world()).collect::<Vec<_>>();
        let train = centres(&scene.train);
        for centre in centres(&scene.test) {
            for axis in 0..3 {
                let coordinates = train.iter().map(|c| c[axis]);
                let low = coordinates.clone().fold(f64::INFINITY, f64::min);
                let high = coordinates.fold(f64::NEG_INFINITY, f64::max);
                assert!((low..=high).contains(&centre[axis]), "{views} views: {centre} leaves {low}..{high}");
            }
        }
    }
}
