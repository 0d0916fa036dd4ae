//! `transforms.json` scenes: poses, lenses, splits, what is missing, and what is wrong.

mod odd;
mod points;

use std::fs;
use std::path::Path;

use genesplat_core::Camera;
use genesplat_core::constants::NEAR_DEPTH;
use genesplat_io::{HoldOut, LoadOptions, Scene, load_scene, photos};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use self::points::ascii_points;
use crate::common::{matrix, tiny_photo};

/// A camera of a photo of 40x30 px.
fn camera(index: usize) -> Camera {
    Camera {
        width: 40,
        height: 30,
        focal_px: [44.0, 45.0],
        principal_px: [19.5, 16.0],
        camera_from_world_rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.3 * index as f64, -0.2, 0.9),
        camera_from_world_translation: DVec3::new(0.1, index as f64, 3.0),
        near: NEAR_DEPTH,
    }
}

fn frames(range: std::ops::Range<usize>, path: impl Fn(usize) -> String) -> Vec<Value> {
    range
        .map(|i| json!({"file_path": path(i), "transform_matrix": matrix(&camera(i)), "sharpness": 3.5}))
        .collect()
}

/// A nerfstudio scene of three photos.
fn nerfstudio() -> Value {
    json!({"w": 40.0, "h": 30, "fl_x": 44, "fl_y": 45, "cx": 19.5, "cy": 16.0, "aabb_scale": 4,
        "camera_model": "OPENCV", "k1": 0.0, "frames": frames(0..3, |i| format!("./images/{i}.png"))})
}

fn write(folder: &Path, name: &str, description: &Value) {
    for index in 0..3 {
        let photo = folder.join(format!("images/{index}.png"));
        photos::write_png(&photo, &tiny_photo(index, [40, 30])).unwrap();
    }
    fs::write(folder.join(name), description.to_string()).unwrap();
}

fn load(folder: &Path) -> Result<Scene, genesplat_io::SceneError> {
    load_scene(folder, &LoadOptions::default(), &())
}

fn load_description(description: &Value) -> Result<Scene, genesplat_io::SceneError> {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", description);
    load(folder.path())
}

fn assert_same_camera(a: &Camera, b: &Camera) {
    assert_eq!(
        (a.width, a.height, a.focal_px, a.principal_px),
        (b.width, b.height, b.focal_px, b.principal_px)
    );
    assert!((a.centre_in_world() - b.centre_in_world()).length() < 1e-9);
    assert!((a.rotation() - b.rotation()).to_cols_array().iter().all(|v| v.abs() < 1e-9));
}

#[test]
fn poses_and_intrinsics_are_the_cameras() {
    let scene = load_description(&nerfstudio()).unwrap();
    assert_eq!((scene.train.len(), scene.test.len(), scene.points.len()), (2, 1, 100_000));
    for (index, view) in scene.test.iter().chain(&scene.train).enumerate() {
        assert_eq!(view.name, format!("{index}.png"));
        assert_eq!(*view.photo.read().unwrap(), tiny_photo(index, [40, 30]));
        assert_same_camera(&view.camera, &camera(index));
    }
    assert!(scene.notices[0].contains("no points"));
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    let looked_at = LoadOptions { with_points: false, ..LoadOptions::default() };
    let scene = load_scene(folder.path(), &looked_at, &()).unwrap();
    assert!(scene.points.is_empty() && scene.notices.is_empty(), "{:?}", scene.notices);
}

#[test]
fn a_photo_may_have_its_own_intrinsics() {
    let mut description = nerfstudio();
    description["frames"][1]["fl_x"] = json!(50.0);
    let scene = load_description(&description).unwrap();
    assert_eq!(scene.train[0].camera.focal_px, [50.0, 45.0]);
    assert_eq!(scene.train[1].camera.focal_px, [44.0, 45.0]);
    // In words of its own, too.
    let frame = description["frames"][1].as_object_mut().unwrap();
    frame.remove("fl_x");
    frame.insert("camera_angle_x".into(), json!(2.0 * (20.0f64 / 50.0).atan()));
    let [x, y] = load_description(&description).unwrap().train[0].camera.focal_px;
    assert!((x - 50.0).abs() < 1e-9 && y == 45.0, "{x} {y}");
}

#[test]
fn fields_of_view_are_each_of_their_side() {
    let mut description = nerfstudio();
    let lens = description.as_object_mut().unwrap();
    lens.retain(|key, _| !key.starts_with("fl_"));
    lens.insert("camera_angle_x".into(), json!(2.0 * (20.0f64 / 44.0).atan()));
    let focal = |description: &Value| load_description(description).unwrap().train[0].camera.focal_px;
    let is = |found: [f64; 2], wanted: [f64; 2]| found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9);
    assert!(is(focal(&description), [44.0, 44.0]), "square pixels");
    description["camera_angle_y"] = json!(2.0 * (15.0f64 / 45.0).atan());
    assert!(is(focal(&description), [44.0, 45.0]));
    description["fl_y"] = json!(46.0);
    assert!(is(focal(&description), [44.0, 46.0]), "a length wins over an angle");
}

/// Trained on under one name and tested on under the other, a photo would be judged by itself.
#[test]
fn two_entries_that_find_one_photo_are_refused() {
    for [first, second] in [["0", "0.PNG"], ["0.jpg", "0.png"], ["0.jpeg", "0"]] {
        let mut description = nerfstudio();
        description["frames"][0]["file_path"] = json!(format!("images/{first}"));
        description["frames"][1]["file_path"] = json!(format!("./images/{second}"));
        let error = load_description(&description).unwrap_err().to_string();
        let words = ["transforms.json lists", first, second, "images/0.png is the only photo for both"];
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

#[test]
fn a_frame_names_its_mask() {
    let folder = tempfile::tempdir().unwrap();
    let mut description = nerfstudio();
    description["frames"][1]["mask_path"] = json!("./hide/it.png");
    description["frames"][2]["mask_path"] = Value::Null;
    write(folder.path(), "transforms.json", &description);
    let sentence = load(folder.path()).unwrap_err().to_string();
    assert!(
        sentence.contains("names the mask \"hide/it.png\"") && sentence.contains("put it there"),
        "{sentence}"
    );
    let left = genesplat_core::Photo {
        width: 40,
        height: 30,
        rgb: (0..3600).map(|i| if i / 3 % 40 < 20 { 1 } else { 0 }).collect(),
    };
    photos::write_png(&folder.path().join("hide/it.png"), &left).unwrap();
    let scene = load(folder.path()).unwrap();
    assert_eq!(scene.train.iter().map(|view| view.counted_pixels()).collect::<Vec<_>>(), [600, 1200]);
    assert!(
        scene.notices.iter().any(|notice| notice.contains("1 of 3 photos have a mask")),
        "{:?}",
        scene.notices
    );
}

#[test]
fn listed_test_photos_are_held_out() {
    let mut description = nerfstudio();
    description["test_filenames"] = json!(["./images/2.png"]);
    description["train_filenames"] = json!(["./images/0.png", "./images/1.png"]);
    let scene = load_description(&description).unwrap();
    assert_eq!((scene.train.len(), scene.test[0].name.as_str()), (2, "2.png"));

    // Written otherwise than in the list of frames.
    description["test_filenames"] = json!(["images/./2.png"]);
    let scene = load_description(&description).unwrap();
    assert_eq!((scene.train.len(), scene.test[0].name.as_str()), (2, "2.png"));

    // Test photos must not be trained on because of a typo.
    description["test_filenames"] = json!(["./images/2.png", "./image/1.png"]);
    let error = load_description(&description).unwrap_err().to_string();
    assert!(error.contains("image/1.png") && error.contains("test_filenames"), "{error}");
}

#[test]
fn lists_of_file_names_say_what_each_photo_is_for() {
    // Of photos 0, 1 and 2, the lists to train, to validate and to test on; then what is trained and tested
    // on.
    let cases: [[&[usize]; 5]; 10] = [
        [&[1], &[], &[2], &[1], &[2]],
        [&[1], &[2], &[], &[1], &[2]],
        [&[1], &[0], &[2], &[1], &[2]],
        [&[1, 2], &[], &[], &[1, 2], &[0]],
        [&[0, 1, 2], &[], &[], &[0, 1, 2], &[]],
        [&[], &[1], &[], &[0, 2], &[1]],
        [&[], &[1], &[2], &[0], &[2]],
        [&[], &[1], &[1], &[0, 2], &[1]],
        [&[], &[], &[1], &[0, 2], &[1]],
        [&[], &[], &[], &[1, 2], &[0]],
    ];
    for [lists @ .., train, test] in cases {
        let mut description = nerfstudio();
        for (key, photos) in ["train_filenames", "val_filenames", "test_filenames"].iter().zip(lists) {
            description[key] = photos.iter().map(|photo| format!("images/{photo}.png")).collect();
        }
        let scene = load_description(&description).unwrap();
        let found = [&scene.train, &scene.test].map(|views| views.iter().map(|view| view.name.clone()));
        let wanted = [train, test].map(|photos| photos.iter().map(|photo| format!("{photo}.png")));
        let [found, wanted] = [found.map(Vec::from_iter), wanted.map(Vec::from_iter)];
        assert_eq!(found, wanted, "{lists:?}");
        let unused = 3 - train.len() - test.len();
        let says =
            scene.notices.iter().any(|notice| notice.starts_with(&format!("{unused} of the 3 photos")));
        assert_eq!((says, scene.photos.len()), (unused > 0, 3), "{lists:?}: {:?}", scene.notices);
    }
}

#[test]
fn lists_of_file_names_must_make_sense() {
    let both = |key: &str| {
        let mut description = nerfstudio();
        description["train_filenames"] = json!(["images/0.png", "images/1.png"]);
        description[key] = json!(["./images/1.png"]);
        load_description(&description).unwrap_err().to_string()
    };
    for sentence in ["val_filenames", "test_filenames"].map(both) {
        assert!(sentence.contains("has images/1.png both in") && sentence.contains("remove"), "{sentence}");
    }
    let mut description = nerfstudio();
    description["train_filenames"] = json!(["images/0.png", "images/7.png"]);
    let sentence = load_description(&description).unwrap_err().to_string();
    assert!(sentence.contains("images/7.png in its train_filenames"), "{sentence}");
}

#[test]
fn absent_photos_are_left_out_with_a_notice() {
    let mut description = nerfstudio();
    description["frames"].as_array_mut().unwrap().extend(frames(3..5, |i| format!("images/{i}.png")));
    let scene = load_description(&description).unwrap();
    assert_eq!(scene.train.len() + scene.test.len(), 3);
    assert!(scene.notices[0].starts_with("2 of the 5 photos") && scene.notices[0].contains("3.png"));
}

#[test]
fn names_of_other_machines_are_found_in_the_folder_of_photos() {
    let styles: [fn(usize) -> String; 4] = [
        |i| format!(".\\images\\{i}.png"),
        |i| format!("C:\\scans\\mine\\images\\{i}.png"),
        |i| format!("/home/me/scan/images/{i}.png"),
        |i| format!("../scan/{i}.png"),
    ];
    for path in styles {
        let mut description = nerfstudio();
        description["frames"] = json!(frames(0..3, path));
        description["test_filenames"] = json!([path(2)]);
        let scene = load_description(&description).unwrap();
        assert_eq!((scene.train.len(), scene.test[0].name.as_str()), (2, "2.png"), "{}", path(0));
        description["frames"] = json!(frames(3..6, path));
        description["test_filenames"] = json!([]);
        assert!(load_description(&description).is_err());
    }
}

#[test]
fn a_file_may_begin_with_a_mark() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    fs::write(folder.path().join("transforms.json"), format!("\u{feff}{}", nerfstudio())).unwrap();
    assert_eq!(load(folder.path()).unwrap().train.len(), 2);
}

#[test]
fn models_of_cameras_have_names_in_small_letters_too() {
    for model in ["opencv", "PERSPECTIVE", "perspective", "Simple_Radial"] {
        let mut description = nerfstudio();
        description["camera_model"] = json!(model);
        assert_eq!(load_description(&description).unwrap().train.len(), 2, "{model}");
    }
}

#[test]
fn a_distorted_photo_is_undistorted() {
    let mut description = nerfstudio();
    description["k1"] = json!(0.1);
    let scene = load_description(&description).unwrap();
    let view = &scene.train[0];
    assert_ne!(*view.photo.read().unwrap(), tiny_photo(1, [40, 30]));
    // A lens that pulls the corners outwards sees less of the world: of the pinhole's picture, the rim is cut
    // off.
    assert_eq!(view.camera.focal_px, [44.0, 45.0]);
    assert_eq!(
        [view.camera.width, view.camera.height],
        [view.photo.read().unwrap().width, view.photo.read().unwrap().height]
    );
    assert!(
        (36..40).contains(&view.camera.width) && (26..30).contains(&view.camera.height),
        "{:?}",
        view.camera
    );
}

#[test]
fn a_fisheye_is_told_by_its_model_or_by_a_flag() {
    let load = |key: &str, value| {
        let mut description = nerfstudio();
        description[key] = value;
        load_description(&description).unwrap().train.remove(0)
    };
    let (by_model, by_flag) =
        (load("camera_model", json!("OPENCV_FISHEYE")), load("is_fisheye", json!(true)));
    assert_eq!(by_model.photo.read().unwrap(), by_flag.photo.read().unwrap());
    // A pinhole needs more of its image plane for what a fisheye sees.
    assert!(by_flag.camera.width > 40 && by_flag.camera.focal_px == [44.0, 45.0], "{:?}", by_flag.camera);
}

#[test]
fn blender_scenes_keep_their_own_split_and_background() {
    let folder = tempfile::tempdir().unwrap();
    for split in ["train", "test"] {
        fs::create_dir(folder.path().join(split)).unwrap();
        for index in 0..2 {
            let glass = image::RgbaImage::from_pixel(32, 32, image::Rgba([10, 20, 30, 0]));
            glass.save(folder.path().join(format!("{split}/r_{index}.png"))).unwrap();
        }
        let description = json!({"camera_angle_x": 2.0 * (0.5f64).atan(),
            "frames": frames(0..2, |i| format!("./{split}/r_{i}"))});
        fs::write(folder.path().join(format!("transforms_{split}.json")), description.to_string()).unwrap();
    }
    let options = LoadOptions { background: [255; 3], ..LoadOptions::default() };
    let scene = load_scene(folder.path(), &options, &()).unwrap();
    let names = |views: &[genesplat_core::View]| views.iter().map(|v| v.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&scene.train), ["train_r_0.png", "train_r_1.png"]);
    assert_eq!(names(&scene.test), ["test_r_0.png", "test_r_1.png"]);
    assert_eq!(scene.train[0].photo.read().unwrap().pixel(3, 3), [255; 3]);
    // Half the width over the tangent of half the field of view, in both directions.
    scene.train[0].camera.focal_px.iter().for_each(|focal| assert!((focal - 32.0).abs() < 1e-9));
    assert!(scene.points.iter().all(|p| p.position.iter().all(|v| v.abs() <= 1.3) && p.rgb == [127; 3]));
    let with =
        |hold_out| load_scene(folder.path(), &LoadOptions { hold_out, ..options.clone() }, &()).unwrap();
    assert_eq!(with(HoldOut::None).train.len(), 4);
    assert_eq!(names(&with(HoldOut::Photos(vec!["train/r_1.png".into()])).test), ["train_r_1.png"]);

    // What is wrong with a test photo is to be looked for in the file that lists it.
    let photo = folder.path().join("test/r_1.png");
    let whole = fs::read(&photo).unwrap();
    let blames_test = || load(folder.path()).unwrap_err().to_string().contains("transforms_test.json");
    fs::remove_file(&photo).unwrap();
    let scene = load(folder.path()).unwrap();
    assert!(
        scene.test.len() == 1
            && scene.notices.iter().any(|notice| notice.contains("transforms_test.json lists do not"))
    );
    let description = folder.path().join("transforms_test.json");
    let listed = fs::read_to_string(&description).unwrap();
    fs::write(&description, listed.replacen('{', "{\"w\": 32, \"h\": 16, ", 1)).unwrap();
    fs::write(&photo, whole).unwrap();
    assert!(blames_test(), "half of all are of another shape");
    fs::write(&description, listed).unwrap();

    // Points that the file of the training photos names are taken instead of random ones.
    let list = folder.path().join("transforms_train.json");
    let mut description: Value = serde_json::from_slice(&fs::read(&list).unwrap()).unwrap();
    description["ply_file_path"] = json!("points.ply");
    fs::write(&list, description.to_string()).unwrap();
    let ply = ascii_points("", "uchar", "1 2 3 4 5 6\n0 0 0 7 8 9\n");
    fs::write(folder.path().join("points.ply"), ply).unwrap();
    let scene = load(folder.path()).unwrap();
    assert_eq!((scene.points.len(), scene.points[1].rgb, scene.notices.len()), (4, [7, 8, 9], 1));
    assert!(scene.notices[0].starts_with("4 of 4 photos are transparent in parts"), "{:?}", scene.notices);
}

#[test]
fn mistakes_are_named() {
    type Spoil = fn(&mut Value);
    let cases: [(Spoil, &str); 13] = [
        (|d| d["frames"] = json!([]), "lists no photos"),
        (|d| d["frames"] = json!("none"), "not a valid description"),
        (|d| d["frames"][0]["transform_matrix"] = json!([[1, 0, 0, 0]]), "fewer than three rows"),
        (|d| d["frames"][0]["transform_matrix"][0] = json!([0, 0, 0, 0]), "is not a rotation"),
        (|d| d["frames"][0]["transform_matrix"][0][3] = json!("x"), "not a valid description"),
        (|d| d["frames"][0]["transform_matrix"][0][3] = json!(1e25), "lies beyond 1e9 world units"),
        (|d| d["frames"][0]["file_path"] = json!("../../etc/passwd"), "not a path inside"),
        (|d| d["fl_x"] = json!(-3.0), "focal length that is not a positive number"),
        (
            |d| {
                _ = ["fl_x", "fl_y"].map(|key| d.as_object_mut().unwrap().remove(key));
            },
            "none of fl_x, fl_y, camera_angle_x and camera_angle_y",
        ),
        (|d| d["w"] = json!(0), "impossible image size"),
        (|d| d["w"] = json!(80), "which is another shape"),
        (
            |d| d["camera_model"] = json!("FULL_OPENCV"),
            "reads only PINHOLE, SIMPLE_PINHOLE, OPENCV, SIMPLE_RADIAL, RADIAL, OPENCV_FISHEYE, RADIAL_FISHEYE, \
             SIMPLE_RADIAL_FISHEYE, EQUIRECTANGULAR; undistort",
        ),
        (
            |d| d["ply_file_path"] = json!("../p.ply"),
            "the ply_file_path \"../p.ply\", which is not a path inside",
        ),
    ];
    for (spoil, expected) in cases {
        let mut description = nerfstudio();
        spoil(&mut description);
        let sentence = load_description(&description).unwrap_err().to_string();
        assert!(sentence.contains(expected) && !sentence.contains('\n'), "{sentence}");
    }
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("transforms.json"), nerfstudio().to_string()).unwrap();
    let sentence = load(folder.path()).unwrap_err().to_string();
    assert!(sentence.contains("none of the 3 photos"), "{sentence}");
}

#[test]
fn a_description_cut_anywhere_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    let path = folder.path().join("transforms.json");
    let whole = fs::read(&path).unwrap();
    for length in 0..whole.len() {
        fs::write(&path, &whole[..length]).unwrap();
        assert!(load(folder.path()).is_err(), "cut to {length} of {} bytes", whole.len());
    }
}
