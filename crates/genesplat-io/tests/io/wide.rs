//! Photos of all around and wide fisheyes: what is cut out of them is what pinholes see of a painted sphere.
//!
//! The photos are taken here by formulas of their own: nerfstudio's of a sphere, and OpenCV's of a fisheye.

use std::f64::consts::{PI, TAU};
use std::fs;
use std::path::Path;

use genesplat_core::{Camera, Photo, View};
use genesplat_io::photos::write_png;
use genesplat_io::{HoldOut, LoadOptions, PhotoSize, Scene, SceneError, list_scene, load_scene};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use crate::common::matrix;

/// Of a photo of all around, px.
const SIZE: [u32; 2] = [192, 96];
/// Values of 255 by which a view may differ from what a pinhole sees.
const TOLERANCE: u8 = 5;

/// What lies far away in this direction of the world.
fn painted(direction: DVec3) -> [u8; 3] {
    let DVec3 { x, y, z } = direction.normalize();
    let value = |at: f64| (128.0 + 110.0 * (3.0 * at).sin()) as u8;
    [value(x + 0.4 * y), value(y - 0.7 * z + 1.0), value(z + 0.5 * x + 2.0)]
}

fn pose(index: usize) -> Camera {
    let angle = 0.4 + 0.3 * index as f64;
    Camera {
        camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, angle, -0.2, 0.9 * angle),
        camera_from_world_translation: DVec3::new(0.1, index as f64, 3.0),
        ..Camera::at_origin(1, 1, 1.0)
    }
}

/// A photo whose pixel `(u, v)` shows this direction of the camera's frame, or nothing.
fn taken([width, height]: [u32; 2], pose: &Camera, direction: impl Fn([f64; 2]) -> Option<DVec3>) -> Photo {
    let world_from_camera = pose.rotation().transpose();
    let value = |at: u32| {
        let at = [at % width, at / width].map(|at| f64::from(at) + 0.5);
        direction(at).map_or([0; 3], |direction| painted(world_from_camera * direction))
    };
    Photo { width, height, rgb: (0..width * height).flat_map(value).collect() }
}

/// nerfstudio: theta = -pi x and phi = pi (0.5 - y) in axes with y up and z backwards, where x is in (-1, 1)
/// from left to right and y in (-0.5, 0.5) from below.
fn around([u, v]: [f64; 2]) -> Option<DVec3> {
    let [width, height] = SIZE.map(f64::from);
    let (theta, phi) = (-PI * (2.0 * u / width - 1.0), PI * v / height);
    let [x, y, z] = [-theta.sin() * phi.sin(), phi.cos(), -theta.cos() * phi.sin()];
    Some(DVec3::new(x, -y, -z))
}

fn round_photo(index: usize) -> Photo {
    taken(SIZE, &pose(index), around)
}

fn description(photos: usize) -> Value {
    let frame = |index: usize| {
        let file = format!("images/{index}.png");
        json!({"file_path": file, "transform_matrix": matrix(&pose(index))})
    };
    json!({"camera_model": "EQUIRECTANGULAR", "w": SIZE[0], "h": SIZE[1],
        "frames": (0..photos).map(frame).collect::<Vec<_>>()})
}

fn write_round(folder: &Path, photos: usize) {
    for index in 0..photos {
        write_png(&folder.join(format!("images/{index}.png")), &round_photo(index)).unwrap();
    }
    fs::write(folder.join("transforms.json"), description(photos).to_string()).unwrap();
}

/// A COLMAP scene of one photo, `images/0.png`, of this camera.
fn write_colmap(folder: &Path, camera: &str, photo: &Photo) {
    let model = folder.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    fs::write(model.join("cameras.txt"), format!("1 {camera}\n")).unwrap();
    let Camera { camera_from_world_rotation: q, camera_from_world_translation: t, .. } = pose(0);
    let line = format!("1 {} {} {} {} {} {} {} 1 0.png\n\n", q.w, q.x, q.y, q.z, t.x, t.y, t.z);
    fs::write(model.join("images.txt"), line).unwrap();
    write_png(&folder.join("images/0.png"), photo).unwrap();
}

fn options(size: PhotoSize) -> LoadOptions {
    LoadOptions { size, hold_out: HoldOut::None, with_points: false, ..LoadOptions::default() }
}

fn load(folder: &Path, size: PhotoSize) -> Scene {
    load_scene(folder, &options(size), &()).unwrap()
}

/// The direction in the world that a view's camera looks at in the middle of a pixel.
fn seen(camera: &Camera, [column, row]: [u32; 2]) -> DVec3 {
    let at = |axis: usize, pixel: u32| {
        (f64::from(pixel) + 0.5 - camera.principal_px[axis]) / camera.focal_px[axis]
    };
    camera.rotation().transpose() * DVec3::new(at(0, column), at(1, row), 1.0)
}

fn pixels(view: &View) -> impl Iterator<Item = [u32; 2]> {
    let Camera { width, height, .. } = view.camera;
    (0..height).flat_map(move |row| (0..width).map(move |column| [column, row]))
}

fn counts(view: &View, [column, row]: [u32; 2]) -> bool {
    view.mask.as_ref().is_none_or(|mask| mask.counts[(row * view.camera.width + column) as usize])
}

/// The most by which what counts of a view differs from what `camera` would see.
fn worst(view: &View, camera: &Camera) -> u8 {
    let photo = view.photo.read().unwrap();
    let differ = |pixel: [u32; 2]| {
        let (there, expected) = (photo.pixel(pixel[0], pixel[1]), painted(seen(camera, pixel)));
        there.iter().zip(expected).map(|(there, expected)| there.abs_diff(expected)).max().unwrap()
    };
    pixels(view).filter(|pixel| counts(view, *pixel)).map(differ).max().unwrap_or(0)
}

fn worst_of(views: &[View]) -> u8 {
    views.iter().map(|view| worst(view, &view.camera)).max().unwrap()
}

fn centre_of(view: &View) -> DVec3 {
    view.camera.centre_in_world()
}

#[test]
fn views_of_a_photo_of_all_around_are_what_pinholes_see() {
    let folder = tempfile::tempdir().unwrap();
    write_round(folder.path(), 2);
    let scene = load(folder.path(), PhotoSize::Auto);
    let names: Vec<&str> = scene.train.iter().map(|view| &*view.name).collect();
    assert_eq!(names[..3], ["0.front.png", "0.right.png", "0.back.png"]);
    assert_eq!((names.len(), scene.photo_of("1.up.png"), scene.photo_of("1.png")), (12, "1.png", "1.png"));
    assert!(worst_of(&scene.train) <= TOLERANCE, "{}", worst_of(&scene.train));
    // A radian has as many pixels in the middle of a face as in the photo.
    let camera = scene.train[0].camera;
    assert_eq!((camera.width, camera.height, camera.focal_px), (61, 61, [30.5; 2]));
    assert!((f64::from(SIZE[0]) / TAU - 30.5).abs() < 0.5);
    for view in &scene.train[6..] {
        assert!(centre_of(view).distance(pose(1).centre_in_world()) < 1e-9 && view.mask.is_none());
    }
    assert!(scene.notices.iter().any(|notice| notice.contains("2 photos show more than a pinhole can")));
    let small = load(folder.path(), PhotoSize::MaxSide(24));
    assert_eq!(small.train[0].camera.focal_px, [12.0; 2]);
    assert!(worst_of(&small.train) <= TOLERANCE, "{}", worst_of(&small.train));
}

#[test]
fn a_turned_face_and_a_seam_that_is_a_pixel_off_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    write_round(folder.path(), 1);
    let scene = load(folder.path(), PhotoSize::Auto);
    for (index, view) in scene.train.iter().enumerate() {
        let camera = view.camera;
        let quarter = DQuat::from_rotation_z(0.5 * PI) * camera.camera_from_world_rotation;
        let turned = Camera { camera_from_world_rotation: quarter, ..camera };
        assert!(worst(view, &turned) > 10 * TOLERANCE, "face {index}, turned");
        let another = scene.train[(index + 1) % 6].camera.camera_from_world_rotation;
        assert!(worst(view, &Camera { camera_from_world_rotation: another, ..camera }) > 10 * TOLERANCE);
    }
    let mut shifted = round_photo(0);
    shifted.rgb.rotate_right(3);
    write_png(&folder.path().join("images/0.png"), &shifted).unwrap();
    let off = load(folder.path(), PhotoSize::Auto).train;
    assert!(off.iter().all(|view| worst(view, &view.camera) > TOLERANCE), "a pixel to the right");
    // One column beside the seam has the other's colours.
    let (mut torn, width) = (round_photo(0), 3 * SIZE[0] as usize);
    torn.rgb.chunks_exact_mut(width).for_each(|row| row.copy_within(3..6, width - 3));
    write_png(&folder.path().join("images/0.png"), &torn).unwrap();
    let off = load(folder.path(), PhotoSize::Auto).train;
    let worst: Vec<bool> = off.iter().map(|view| worst(view, &view.camera) > TOLERANCE).collect();
    assert_eq!(worst[..4], [false, false, true, false], "the seam lies behind");
}

#[test]
fn colmaps_model_is_the_same_sphere() {
    let folder = tempfile::tempdir().unwrap();
    write_colmap(folder.path(), "EQUIRECTANGULAR 192 96 192 96", &round_photo(0));
    let scene = load(folder.path(), PhotoSize::Auto);
    assert_eq!(scene.train.len(), 6);
    assert!(worst_of(&scene.train) <= TOLERANCE, "{}", worst_of(&scene.train));
}

/// `OPENCV_FISHEYE` with one coefficient, of 190 degrees across and a rim that is black.
const FISHEYE: &str = "OPENCV_FISHEYE 200 180 60 58 101 88 0.01 0 0 0";

fn through_fisheye([u, v]: [f64; 2]) -> Option<DVec3> {
    let [x, y] = [(u - 101.0) / 60.0, (v - 88.0) / 58.0];
    let r = x.hypot(y);
    // θ (1 + 0.01 θ²) = r, by halving.
    let (mut low, mut high) = (0.0, PI);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        if middle * (1.0 + 0.01 * middle * middle) < r { low = middle } else { high = middle }
    }
    (low < 3.0).then(|| DVec3::new(x / r * low.sin(), y / r * low.sin(), low.cos()))
}

#[test]
fn a_fisheye_beyond_a_pinhole_is_cut_and_what_it_does_not_show_is_masked() {
    let folder = tempfile::tempdir().unwrap();
    write_colmap(folder.path(), FISHEYE, &taken([200, 180], &pose(0), through_fisheye));
    for size in [PhotoSize::Auto, PhotoSize::MaxSide(60)] {
        let views = load(folder.path(), size).train;
        let names: Vec<&str> = views.iter().map(|view| &*view.name).collect();
        assert_eq!(names, ["0.front.png", "0.right.png", "0.left.png", "0.up.png", "0.down.png"]);
        assert!(worst_of(&views) <= TOLERANCE, "{size:?}: {}", worst_of(&views));
        let left_out = |view: &View| pixels(view).filter(|pixel| !counts(view, *pixel)).count();
        assert!(left_out(&views[0]) == 0 && left_out(&views[1]) > 0);
        // What lies ahead is shown by some view.
        for step in 0..400 {
            let (azimuth, angle) = (0.7 * f64::from(step), 80f64.to_radians() * f64::from(step) / 400.0);
            let ahead = DVec3::new(azimuth.cos() * angle.sin(), azimuth.sin() * angle.sin(), angle.cos());
            let in_world = pose(0).rotation().transpose() * ahead;
            let shows = |view: &View| {
                let at = view.camera.rotation() * in_world;
                let pixel = view.camera.pixel_from_camera(at).map(f64::round);
                let sides = [view.camera.width, view.camera.height].map(f64::from);
                let is_inside = (0..2).all(|axis| pixel[axis] >= 0.0 && pixel[axis] < sides[axis]);
                at.z > 0.0 && is_inside && counts(view, pixel.map(|at| at as u32))
            };
            assert!(views.iter().any(shows), "{angle} from the axis");
        }
    }
    // What a pinhole can show stays one photo.
    write_colmap(folder.path(), "OPENCV_FISHEYE 200 180 120 118 101 88 0.01 0 0 0", &round_photo(0));
    write_png(&folder.path().join("images/0.png"), &taken([200, 180], &pose(0), around)).unwrap();
    assert_eq!(load(folder.path(), PhotoSize::Auto).train[0].name, "0.png");
}

#[test]
fn a_mask_hides_in_every_view_what_it_hides_in_the_photo() {
    let folder = tempfile::tempdir().unwrap();
    write_round(folder.path(), 1);
    // Who holds the camera, and a strip at the seam.
    let is_hidden = |[u, v]: [f64; 2]| v > 80.0 || !(4.0..188.0).contains(&u);
    let level = |at: u32| {
        let at = [at % SIZE[0], at / SIZE[0]].map(|at| f64::from(at) + 0.5);
        [if is_hidden(at) { 0 } else { 255 }; 3]
    };
    let mask =
        Photo { width: SIZE[0], height: SIZE[1], rgb: (0..SIZE[0] * SIZE[1]).flat_map(level).collect() };
    write_png(&folder.path().join("masks/0.png"), &mask).unwrap();
    for (size, most) in [(PhotoSize::Auto, 0.05), (PhotoSize::MaxSide(30), 0.12)] {
        let scene = load(folder.path(), size);
        let (mut lost, mut all) = (0, 0);
        for view in &scene.train {
            for pixel in pixels(view) {
                let DVec3 { x, y, z } = pose(0).rotation() * seen(&view.camera, pixel).normalize();
                let at = [(x.atan2(z) / TAU + 0.5) * 192.0, (y.asin() / PI + 0.5) * 96.0];
                assert!(!(is_hidden(at) && counts(view, pixel)), "{}: {at:?} is hidden", view.name);
                lost += usize::from(!is_hidden(at) && !counts(view, pixel));
                all += 1;
            }
        }
        assert!((lost as f64) < most * all as f64, "{size:?}: the mask grew over {lost} of {all} pixels");
    }
    // A photo of which nothing counts is left out, with all its views.
    write_png(&folder.path().join("masks/0.png"), &Photo { rgb: vec![0; mask.rgb.len()], ..mask }).unwrap();
    let refused = load_scene(folder.path(), &options(PhotoSize::Auto), &()).unwrap_err().to_string();
    assert!(refused.contains("hide all of its training photos"), "{refused}");
}

#[test]
fn all_views_of_a_photo_are_trained_on_or_held_out() {
    let folder = tempfile::tempdir().unwrap();
    write_round(folder.path(), 9);
    let load = |hold_out: HoldOut| {
        let options = LoadOptions { hold_out, with_points: false, ..LoadOptions::default() };
        load_scene(folder.path(), &options, &()).unwrap()
    };
    let held_out = |scene: &Scene| {
        let mut photos: Vec<String> =
            scene.test.iter().map(|view| scene.photo_of(&view.name).to_owned()).collect();
        photos.dedup();
        (photos, scene.test.len(), scene.train.len())
    };
    assert_eq!(held_out(&load(HoldOut::EveryEighth)), (vec!["0.png".to_owned(), "8.png".into()], 12, 42));
    let named = HoldOut::Photos(vec!["images/3.png".into()]);
    assert_eq!(held_out(&load(named)), (vec!["3.png".to_owned()], 6, 48));
    assert_eq!(load(HoldOut::None).digests.photos.len(), 9, "a digest for each photo");
    let list = list_scene(folder.path(), &LoadOptions::default()).unwrap();
    assert_eq!(list.view_name("3.up", folder.path()).unwrap(), "3.up.png");
    let refused = list.view_name("3.png", folder.path()).unwrap_err().to_string();
    assert!(
        refused.contains("3.png, which is cut into views; name one of them, as 3.front.png"),
        "{refused}"
    );
    // Its name would be that of two views.
    write_png(&folder.path().join("images/3.left.png"), &round_photo(1)).unwrap();
    let mut lists = description(4);
    lists["frames"][0]["file_path"] = json!("images/3.left.png");
    fs::write(folder.path().join("transforms.json"), lists.to_string()).unwrap();
    let refused = load_scene(folder.path(), &LoadOptions::default(), &()).unwrap_err().to_string();
    assert!(refused.contains("3.left.png, which one of them would be called; rename it"), "{refused}");
}

#[test]
fn what_is_no_whole_sphere_is_refused() {
    let refusal = |write: &dyn Fn(&Path)| -> String {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path());
        let refused: SceneError = load_scene(folder.path(), &options(PhotoSize::Auto), &()).unwrap_err();
        refused.to_string()
    };
    let by_transforms = refusal(&|folder| {
        write_round(folder, 1);
        let mut narrow = description(1);
        narrow["w"] = json!(150);
        fs::write(folder.join("transforms.json"), narrow.to_string()).unwrap();
    });
    let by_colmap = refusal(&|folder| write_colmap(folder, "EQUIRECTANGULAR 150 96 150 96", &round_photo(0)));
    for refused in [by_transforms, by_colmap] {
        assert!(
            refused.contains("150x96 pixels are not twice as wide as high; export them whole"),
            "{refused}"
        );
    }
}
