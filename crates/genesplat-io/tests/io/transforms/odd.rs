//! Odd `transforms.json` files that programs and people write.

use std::fs;
use std::num::NonZeroU32;

use genesplat_io::colmap::Form;
use genesplat_io::{HoldOut, LoadOptions, load_scene, photos};
use serde_json::{Value, json};

use super::{assert_same_camera, camera, load, load_description, nerfstudio, write};
use crate::common::{tiny_model, tiny_photo, write_scene};

fn scale(description: &mut Value, frame: usize, factor: f64) {
    for row in 0..3 {
        for column in 0..3 {
            let value = &mut description["frames"][frame]["transform_matrix"][row][column];
            *value = json!(factor * value.as_f64().unwrap());
        }
    }
}

#[test]
fn one_scale_of_all_poses_is_divided_out() {
    for factor in [1.37, 0.01, 250.0] {
        let mut description = nerfstudio();
        (0..3).for_each(|frame| scale(&mut description, frame, factor));
        let scene = load_description(&description).unwrap();
        assert_same_camera(&scene.train[0].camera, &camera(1));
        let told = format!("are scaled by {factor:.4}, which is divided out");
        assert!(scene.notices[0].contains(&told), "{:?}", scene.notices);
    }
    let mut description = nerfstudio();
    scale(&mut description, 1, 1.37);
    let refused = load_description(&description).unwrap_err().to_string();
    assert!(refused.contains("images/1.png is not a rotation"), "{refused}");
}

/// As engines with left-handed axes write them.
#[test]
fn mirrored_poses_are_told_apart() {
    let mut description = nerfstudio();
    for frame in 0..3 {
        for row in 0..3 {
            let value = &mut description["frames"][frame]["transform_matrix"][row][0];
            *value = json!(-value.as_f64().unwrap());
        }
    }
    let refused = load_description(&description).unwrap_err().to_string();
    assert!(refused.contains("images/0.png is a mirror image, as in left-handed axes"), "{refused}");
    assert!(!refused.contains("remove the photo"), "{refused}");
}

#[test]
fn one_angle_is_enough() {
    for (key, side) in [("camera_angle_x", 40.0), ("camera_angle_y", 30.0)] {
        let mut description = nerfstudio();
        _ = ["fl_x", "fl_y"].map(|key| description.as_object_mut().unwrap().remove(key));
        description[key] = json!(2.0 * f64::atan(0.5 * side / 50.0));
        let focal = load_description(&description).unwrap().train[0].camera.focal_px;
        assert!(focal.iter().all(|focal| (focal - 50.0).abs() < 1e-9), "{key}: {focal:?}");
    }
}

/// As Swift and numpy keep them.
#[test]
fn poses_by_columns_are_turned() {
    let mut description = nerfstudio();
    for frame in description["frames"].as_array_mut().unwrap() {
        let rows = frame["transform_matrix"].clone();
        let turned = (0..4).map(|row| (0..4).map(|column| rows[column][row].clone()).collect::<Vec<_>>());
        frame["transform_matrix"] = json!(turned.collect::<Vec<_>>());
    }
    let scene = load_description(&description).unwrap();
    assert_same_camera(&scene.train[0].camera, &camera(1));
    assert!(scene.notices[0].contains("column by column"), "{:?}", scene.notices);
    // One alone is a mistake.
    let mut one = nerfstudio();
    one["frames"][1] = description["frames"][1].clone();
    let refused = load_description(&one).unwrap_err().to_string();
    assert!(refused.contains("images/1.png has a last row that is not 0 0 0 1"), "{refused}");
}

#[test]
fn photos_are_found_in_the_folder_that_is_asked_for_or_that_all_use() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    for index in 0..3 {
        let photo = folder.path().join(format!("images_2/{index}.png"));
        photos::write_png(&photo, &tiny_photo(index, [80, 60])).unwrap();
    }
    let with = |images: &str| {
        load_scene(folder.path(), &LoadOptions { image_folder: images.into(), ..LoadOptions::default() }, &())
    };
    let larger = with("images_2").unwrap();
    assert_eq!((larger.train[0].camera.width, larger.train[0].camera.focal_px), (80, [88.0, 90.0]));
    assert_eq!(larger.train[0].name, "1.png");
    let none = with("images_4").unwrap_err().to_string();
    assert!(none.contains("none of the 3 photos") && none.contains("images_4"), "{none}");
    // The list may leave the folder out, or have it in another case.
    for (listed, is) in [("", "images"), ("Images/", "images"), ("images/", "IMAGES")] {
        let folder = tempfile::tempdir().unwrap();
        let mut description = nerfstudio();
        for index in 0..3 {
            description["frames"][index]["file_path"] = json!(format!("{listed}{index}.png"));
        }
        write(folder.path(), "transforms.json", &description);
        let [from, to] = ["images", is].map(|name| folder.path().join(name));
        fs::rename(from, to).unwrap();
        assert_eq!(load(folder.path()).unwrap().train.len(), 2, "{listed} {is}");
    }
}

#[test]
fn what_is_empty_names_nothing() {
    let mut description = nerfstudio();
    description["ply_file_path"] = json!("");
    description["frames"][1]["mask_path"] = json!("");
    let scene = load_description(&description).unwrap();
    assert!(scene.train[0].mask.is_none() && scene.starts_from_random());
    // A list of test photos that one program asks for.
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms_train.json", &nerfstudio());
    fs::write(folder.path().join("transforms_test.json"), r#"{"frames": []}"#).unwrap();
    assert_eq!(load(folder.path()).unwrap().train.len(), 2);
}

#[test]
fn an_interval_that_is_asked_for_stands_above_lists_that_contradict_each_other() {
    let mut description = nerfstudio();
    description["train_filenames"] = json!(["images/0.png", "images/1.png", "images/gone.png"]);
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &description);
    assert!(load(folder.path()).unwrap_err().to_string().contains("images/gone.png in its train_filenames"));
    let every = HoldOut::Every(NonZeroU32::new(3).unwrap());
    let scene = load_scene(folder.path(), &LoadOptions { hold_out: every, ..LoadOptions::default() }, &());
    assert_eq!(scene.unwrap().train.len(), 2);
}

#[test]
fn photos_without_a_camera_are_told_of() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    let put = |name: String| photos::write_png(&folder.path().join(name), &tiny_photo(0, [40, 30])).unwrap();
    // Those that macOS leaves on disks of others are none.
    (0..9).for_each(|index| put(format!("images/._{index}.png")));
    let scene = load(folder.path()).unwrap();
    assert!(scene.doubts.is_empty() && scene.notices.len() == 1, "{:?}", scene.notices);
    (3..9).for_each(|index| put(format!("images/{index}.png")));
    let doubts = load(folder.path()).unwrap().doubts;
    assert!(doubts[0].problem.contains("only 3 of the 9 photos have a camera"), "{}", doubts[0].problem);
}

#[test]
fn of_two_lists_of_cameras_the_one_that_is_read_is_told() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(3));
    fs::write(folder.path().join("transforms.json"), nerfstudio().to_string()).unwrap();
    let told = load(folder.path()).unwrap().notices.join("; ");
    assert!(told.contains("sparse/0, and transforms.json is not read"), "{told}");
}

#[test]
fn a_middle_outside_of_the_photo_is_told_of() {
    let mut description = nerfstudio();
    description["cx"] = json!(80.0);
    let told = load_description(&description).unwrap().notices.join("; ");
    assert!(told.contains("3 photos have their principal points outside of them, first"), "{told}");
    description = nerfstudio();
    (description["fl_x"], description["fl_y"]) = (json!(1.1), json!(1.5));
    let told = load_description(&description).unwrap().notices.join("; ");
    assert!(told.contains("3 photos are more than 170 degrees across, first"), "{told}");
}

/// The scene of this text.
fn load_text(text: &str) -> Result<genesplat_io::Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    fs::write(folder.path().join("transforms.json"), text).unwrap();
    load(folder.path()).map_err(|error| error.to_string())
}

/// Python writes `NaN`, which is none of JSON's words.
#[test]
fn what_is_not_finite_is_ignored_left_out_or_told() {
    let whole = nerfstudio().to_string();
    for word in ["NaN", "Infinity", "-Infinity"] {
        let unread =
            load_text(&whole.replace("\"sharpness\":3.5", &format!("\"sharpness\":{word}"))).unwrap();
        assert_eq!(unread.train.len() + unread.test.len(), 3, "{:?}", unread.notices);
        let mut lost = nerfstudio();
        lost["frames"][1]["transform_matrix"][0][3] = json!("PLACE");
        let lost = lost.to_string().replace("\"PLACE\"", word);
        let scene = load_text(&lost).unwrap();
        assert_eq!(scene.train.len() + scene.test.len(), 2);
        let told = "1 of the 3 photos that";
        assert!(
            scene
                .notices
                .iter()
                .any(|notice| notice.contains(told) && notice.contains("a pose that is not finite")),
            "{:?}",
            scene.notices
        );
        let focal = load_text(&whole.replace("\"fl_x\":44", &format!("\"fl_x\":{word}"))).unwrap_err();
        assert!(focal.contains("focal length that is not a positive number"), "{focal}");
    }
    let mut zero = nerfstudio();
    zero["frames"][1]["transform_matrix"] = json!([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]);
    let scene = load_text(&zero.to_string()).unwrap();
    assert_eq!(scene.train.len() + scene.test.len(), 2, "{:?}", scene.notices);
    let all = whole.replace("\"transform_matrix\":[[", "\"transform_matrix\":[[NaN,0,0,0],[");
    assert!(load_text(&all).unwrap_err().contains("is not finite"));
    // The place is that of the file.
    let refused = load_text("{\"aabb\": [NaN, Infinity, -Infinity], \"frames\": [}").unwrap_err();
    assert!(refused.contains("line 1 column 49"), "{refused}");
    let text = load_text(&whole.replace("\"fl_x\":44", "\"fl_x\":\"wide\"")).unwrap_err();
    assert!(text.contains("expected a number"), "{text}");
}

#[test]
fn masks_and_points_are_found_as_photos_are() {
    let points = super::ascii_points("", "uchar", "1 -2 0.5 9 8 7\n4 5 6 255 128 0\n");
    let grey = genesplat_core::Photo { width: 40, height: 30, rgb: vec![0; 3600] };
    for place in ["", "./", ".\\", "C:\\scan\\", "/home/me/scan/", "../scan/"] {
        let separator = if place.contains('\\') { "\\" } else { "/" };
        let mut description = nerfstudio();
        description["frames"][1]["mask_path"] = json!(format!("{place}masks{separator}1.png"));
        description["ply_file_path"] = json!(format!("{place}Cloud.ply"));
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "transforms.json", &description);
        photos::write_png(&folder.path().join("masks/1.png"), &grey).unwrap();
        let is_elsewhere = place.len() > 2;
        fs::write(folder.path().join(if is_elsewhere { "Cloud.ply" } else { "cloud.ply" }), &points).unwrap();
        let scene = load(folder.path()).unwrap_or_else(|error| panic!("{place}: {error}"));
        assert_eq!((scene.points.len(), scene.points[0].position), (4, [1.0, -2.0, 0.5]), "{place}");
        let told = |words: &str| scene.notices.iter().any(|notice| notice.contains(words));
        assert!(told("hidden entirely and left out, first 1.png"), "{place}: {:?}", scene.notices);
    }
}

/// As points3D.txt has it.
#[test]
fn clouds_without_colours_or_with_lost_points_are_read() {
    let with = |ply: String| {
        let folder = tempfile::tempdir().unwrap();
        let mut description = nerfstudio();
        description["ply_file_path"] = json!("points.ply");
        write(folder.path(), "transforms.json", &description);
        fs::write(folder.path().join("points.ply"), ply).unwrap();
        load(folder.path()).map_err(|error| error.to_string())
    };
    let rows = "1 -2 0.5 9 8 7\n4 5 6 255 128 0\nnan 0 0 1 2 3\n";
    let lost = with(super::ascii_points("", "uchar", rows).replace("vertex 4", "vertex 5")).unwrap();
    assert_eq!((lost.points.len(), lost.points[1].rgb), (4, [255, 128, 0]));
    let told = |notice: &String| notice.contains("1 of the 5 points of") && notice.contains("not finite");
    assert!(lost.notices.iter().any(told), "{:?}", lost.notices);
    let bare = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                end_header\n";
    let bare = with(format!("{bare}{}", "1 2 3\n".repeat(4))).unwrap();
    assert_eq!((bare.points.len(), bare.points[0].rgb), (4, [127; 3]));
    assert!(bare.notices.iter().any(|notice| notice.contains("have no colours")), "{:?}", bare.notices);
    let rows = rows.replace("nan", "1e25");
    let far = with(super::ascii_points("", "uchar", &rows).replace("vertex 4", "vertex 5")).unwrap();
    assert!(far.points.len() == 4 && far.notices.iter().any(told), "{:?}", far.notices);
}
