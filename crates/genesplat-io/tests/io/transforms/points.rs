//! The points of `transforms.json` scenes: a named file, a COLMAP model beside, or random ones.

use std::fs;

use genesplat_io::colmap::{Form, ImageRecord, Intrinsics, Model};
use genesplat_io::{LoadOptions, Point, Scene, load_scene};
use glam::{DQuat, DVec3};
use serde_json::json;

use super::{camera, load, load_description, nerfstudio, write};
use crate::common::write_form;

#[test]
fn named_points_are_read_in_both_encodings() {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             property uint8 red\nproperty uint8 green\nproperty uint8 blue\nend_header\n"
        )
    };
    let mut binary = header("binary_little_endian").into_bytes();
    let last = ([0.0, 4.0, 8.0], [255, 128, 0]);
    for (position, rgb) in [([1.0f32, -2.0, 0.5], [1u8, 2, 3]), last, last, last] {
        position.iter().for_each(|v| binary.extend(v.to_le_bytes()));
        binary.extend(rgb);
    }
    let ascii = (header("ascii") + "1 -2 0.5 1 2 3" + &"\n0 4 8 255 128 0".repeat(3)).into_bytes();
    for bytes in [binary, ascii] {
        let folder = tempfile::tempdir().unwrap();
        let mut description = nerfstudio();
        description["ply_file_path"] = json!("points.ply");
        write(folder.path(), "transforms.json", &description);
        fs::write(folder.path().join("points.ply"), &bytes).unwrap();
        let points = load(folder.path()).unwrap().points;
        assert_eq!((points.len(), points[0].position, points[1].rgb), (4, [1.0, -2.0, 0.5], [255, 128, 0]));
        fs::write(folder.path().join("points.ply"), &bytes[..bytes.len() - 10]).unwrap();
        assert!(load(folder.path()).unwrap_err().to_string().contains("points.ply"));
        fs::write(folder.path().join("points.ply"), [&bytes, &b"\n0 4 8 255 128 0"[..]].concat()).unwrap();
        assert!(load(folder.path()).unwrap_err().to_string().contains("something follows its end"));
    }
}

/// The model that nerfstudio made the cameras of, in a world of another place, direction and size.
fn nested_model(shift: f64) -> Model {
    let (turn, scale) = (DQuat::from_euler(glam::EulerRot::XYZ, 0.9, 0.4, -1.1), 0.5);
    let image = |index: usize| {
        let camera = camera(index);
        let rotation = camera.camera_from_world_rotation * turn;
        let centre = scale * (turn.inverse() * camera.centre_in_world()) + DVec3::splat(shift * index as f64);
        let translation = rotation * -centre;
        ImageRecord {
            name: format!("{index}.png"),
            camera: 1,
            rotation: [rotation.w, rotation.x, rotation.y, rotation.z],
            translation: translation.into(),
        }
    };
    let intrinsics =
        Intrinsics { width: 40, height: 30, focal_px: [44.0; 2], principal_px: [20.0, 15.0], lens: None };
    let point = |z: f64| (scale * (turn.inverse() * DVec3::new(1.0, 2.0, z))).as_vec3().into();
    let points = [3.0, 4.0, 5.0, 6.0].map(|z| Point { position: point(z), rgb: [z as u8; 3] });
    let images = (0..3).map(image).collect();
    Model { cameras: [(1, intrinsics)].into(), images, points: points.into(), notices: Vec::new() }
}

#[test]
fn points_of_the_model_beside_are_moved_to_the_cameras() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    write_form(&folder.path().join("colmap/sparse/0"), Form::Binary, &nested_model(0.0));
    let points = load(folder.path()).unwrap().points;
    assert_eq!((points.len(), points[3].rgb), (4, [6; 3]));
    for (point, z) in points.iter().zip([3.0, 4.0, 5.0, 6.0]) {
        let off = DVec3::from(point.position.map(f64::from)).distance(DVec3::new(1.0, 2.0, z));
        assert!(off < 1e-5, "{point:?}");
    }
    // Of other cameras.
    write_form(&folder.path().join("colmap/sparse/0"), Form::Binary, &nested_model(0.3));
    assert_eq!(load(folder.path()).unwrap().points.len(), 100_000);
}

#[test]
fn points_that_lie_beside_the_list_are_taken_and_told() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "transforms.json", &nerfstudio());
    fs::write(
        folder.path().join("sparse_pc.ply"),
        ascii_points("", "uchar", "1 -2 0.5 9 8 7\n4 5 6 255 128 0\n"),
    )
    .unwrap();
    let scene = load(folder.path()).unwrap();
    assert_eq!((scene.points.len(), scene.points[0].position), (4, [1.0, -2.0, 0.5]));
    let told = |notice: &String| notice.contains("sparse_pc.ply, which the scene does not name");
    assert!(scene.notices.iter().any(told), "{:?}", scene.notices);
}

/// A point cloud of two points and two black ones, as training needs four; `before` stands between the
/// header's first lines and the vertices' own.
pub(super) fn ascii_points(before: &str, colour: &str, rows: &str) -> String {
    let colours = ["red", "green", "blue"].map(|name| format!("property {colour} {name}\n")).concat();
    format!(
        "ply\nformat ascii 1.0\n{before}element vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         {colours}end_header\n{}\n9 9 9 0 0 0\n9 9 8 0 0 0\n",
        rows.trim_end()
    )
}

/// The points of a nerfstudio scene that names this file.
fn load_points_of(ply: &str) -> Result<Vec<Point>, genesplat_io::SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let mut description = nerfstudio();
    description["ply_file_path"] = json!("points.ply");
    write(folder.path(), "transforms.json", &description);
    fs::write(folder.path().join("points.ply"), ply).unwrap();
    load(folder.path()).map(|scene| scene.points)
}

#[test]
fn colours_as_fractions_are_brought_to_bytes() {
    let colours =
        |ply: &str| load_points_of(ply).unwrap()[..2].iter().map(|point| point.rgb).collect::<Vec<_>>();
    let fractions = "0 0 0 0.5 1 0\n1 1 1 0.2 0.004 0.998\n";
    for kind in ["float", "double"] {
        assert_eq!(colours(&ascii_points("", kind, fractions)), [[128, 255, 0], [51, 1, 254]]);
    }
    // Levels written as floats, and a picture so dark that its bytes are 0 and 1.
    assert_eq!(
        colours(&ascii_points("", "float", "0 0 0 1 2 3\n1 1 1 0.4 0.6 254.7")),
        [[1, 2, 3], [0, 1, 255]]
    );
    let of_scanner = "0 0 0 65535 32896 0\n1 1 1 257 514 0";
    assert_eq!(colours(&ascii_points("", "ushort", of_scanner)), [[255, 128, 0], [1, 2, 0]]);
    assert_eq!(colours(&ascii_points("", "uchar", "0 0 0 1 0 1\n1 1 1 0 0 1")), [[1, 0, 1], [0, 0, 1]]);
}

/// What comes before the vertices of an ASCII file takes lines, whatever its types.
#[test]
fn elements_before_the_vertices_are_passed_over() {
    let before = "element camera 2\nproperty double f\nproperty list uchar int views\n";
    let rows = "500.25 3 1 2 3\n7 0\n1 -2 0.5 9 8 7\n4 5 6 255 128 0\n";
    let points = load_points_of(&ascii_points(before, "uchar", rows)).unwrap();
    assert_eq!((points.len(), points[0].position, points[1].rgb), (4, [1.0, -2.0, 0.5], [255, 128, 0]));
    let with_faces = ascii_points("", "uchar", rows.split_once("7 0\n").unwrap().1);
    let face = "element face 1\nproperty list uchar int vertex_indices\nend_header";
    assert_eq!(load_points_of(&(with_faces.replace("end_header", face) + "3 0 1 2\n")).unwrap(), points);
    let cut = load_points_of(&ascii_points(before, "uchar", "500.25 3 1 2 3\n7 0\n1 -2"));
    assert!(cut.unwrap_err().to_string().contains("points.ply"));
    let endless = "element camera 18446744073709551615\nproperty double f\n";
    let refused = load_points_of(&ascii_points(endless, "uchar", rows)).unwrap_err().to_string();
    assert!(refused.contains("cut off"), "{refused}");
}

#[test]
fn points_that_are_too_few_are_as_none() {
    let three = ascii_points("", "uchar", "1 2 3 4 5 6").replace("vertex 4", "vertex 3");
    assert_eq!(load_points_of(&three).unwrap().len(), 100_000);
}

/// Cameras that look at one another's focus are written with random points around it, not around the origin.
#[test]
fn random_points_lie_before_the_cameras() {
    let scene = load_description(&nerfstudio()).unwrap();
    let camera = &scene.train[0].camera;
    let ahead = |p: &&Point| camera.camera_from_world(p.position.map(f64::from).into()).z > 0.0;
    let fraction = scene.points.iter().filter(ahead).count() as f64 / scene.points.len() as f64;
    assert!(fraction > 0.5, "{fraction} of the points are before the camera");
    let again = load_description(&nerfstudio()).unwrap();
    assert_eq!(scene.points, again.points);
}

/// Nobody says whether a scene without points is in metres or in centimetres: it starts the same in both.
#[test]
fn random_points_and_the_near_plane_follow_the_unit_of_the_scene() {
    let scene_in = |unit: f64, with_points: bool| {
        let folder = tempfile::tempdir().unwrap();
        let mut description = nerfstudio();
        for frame in description["frames"].as_array_mut().unwrap() {
            for row in 0..3 {
                let moved = unit * frame["transform_matrix"][row][3].as_f64().unwrap();
                frame["transform_matrix"][row][3] = json!(moved);
            }
        }
        write(folder.path(), "transforms.json", &description);
        load_scene(folder.path(), &LoadOptions { with_points, ..LoadOptions::default() }, &()).unwrap()
    };
    let usual = scene_in(1.0, true);
    for unit in [0.01, 100.0] {
        let other = scene_in(unit, true);
        let near = |scene: &Scene| scene.train[0].camera.near;
        assert!((near(&other) / unit - near(&usual)).abs() < 1e-9, "{} at {unit}", near(&other));
        assert_eq!(near(&scene_in(unit, false)), near(&other), "whoever only looks has the same plane");
        for (a, b) in other.points.iter().zip(&usual.points) {
            let is_close = |axis: usize| (a.position[axis] / unit as f32 - b.position[axis]).abs() < 1e-3;
            assert!((0..3).all(is_close), "{a:?} and {b:?} at {unit}");
        }
    }
}
