//! Scenes, clouds of points and splats far from their origin, as maps and surveys have them.

use std::collections::HashSet;
use std::fs;
use std::path::Path;

use genesplat_core::Gaussians;
use genesplat_io::colmap::{Form, Model};
use genesplat_io::format::{self, Format, Options};
use genesplat_io::offset::to_json;
use genesplat_io::{HoldOut, LoadOptions, Offset, SceneError, load_scene};
use glam::{DQuat, DVec3};

use crate::common::{tiny_model, write_scene};
use crate::formats::{varied, write};

fn moved(mut model: Model, by: DVec3) -> Model {
    for image in &mut model.images {
        let [w, x, y, z] = image.rotation;
        let turned = DQuat::from_xyzw(x, y, z, w).normalize() * by;
        image.translation = (DVec3::from(image.translation) - turned).to_array();
    }
    for point in &mut model.points {
        point.position = (DVec3::from(point.position.map(f64::from)) + by).as_vec3().to_array();
    }
    model
}

/// In metres of a map, single precision has steps of half a metre: such scenes are moved, points from their
/// file's own digits, and what they were moved by is kept.
#[test]
fn a_scene_far_from_its_origin_is_moved_near_it() {
    let load = |model: &Model, asked: LoadOptions| {
        let folder = tempfile::tempdir().unwrap();
        write_scene(folder.path(), Form::Binary, model);
        load_scene(folder.path(), &asked, &())
    };
    let free = || LoadOptions::default();
    let fixed = || LoadOptions { offset: Some([0.0; 3]), ..free() };
    let is_told = |notices: &[String]| notices.iter().any(|notice| notice.contains("far from its origin"));
    let near = load(&tiny_model(9), free()).unwrap();
    assert!(!is_told(&near.notices) && near.digests.offset.is_none(), "{:?}", near.notices);
    let utm = DVec3::new(5e5, 5.4e6, 300.0);
    for by in [DVec3::new(0.0, 1500.0, 0.0), utm] {
        let off = load(&moved(tiny_model(9), by), free()).unwrap();
        let offset = DVec3::from(off.digests.offset.unwrap());
        assert!(offset.distance(by) < 20.0 && is_told(&off.notices), "{offset}: {:?}", off.notices);
        for (here, there) in off.train.iter().zip(&near.train) {
            let [here, there] = [here, there].map(|view| view.camera.centre_in_world());
            assert!((here + offset - by).distance(there) < 1e-8, "{here} {there}");
        }
    }
    // What a run began with is kept, whatever would be found now.
    let off = load(&moved(tiny_model(9), DVec3::new(0.0, 1500.0, 0.0)), fixed()).unwrap();
    assert!(off.digests.offset.is_none());
    assert!(off.notices.iter().any(|notice| notice.contains("model_transformer")), "{:?}", off.notices);
    let error = load(&moved(tiny_model(9), utm), fixed()).unwrap_err();
    assert!(matches!(error, SceneError::FarFromOrigin { .. }), "{error}");
    // One camera has no radius.
    let alone = LoadOptions { hold_out: HoldOut::None, ..free() };
    assert!(!is_told(&load(&moved(tiny_model(1), utm), alone).unwrap().notices));
}

/// UTM, metres.
const BY: [f64; 3] = [431_250.5, 5_412_345.25, 300.0];

/// Points a millimetre apart, as a line of text each.
fn exact(k: usize) -> [f64; 3] {
    [0.001 * k as f64, 0.25, -0.003 * k as f64]
}

fn far_points(line: impl Fn(usize, [f64; 3]) -> String) -> String {
    (1..9).map(|k| line(k, std::array::from_fn(|axis| exact(k)[axis] + BY[axis]))).collect()
}

fn check_points(scene: &Path) {
    let scene = load_scene(scene, &LoadOptions::default(), &()).unwrap();
    let offset = scene.digests.offset.unwrap();
    assert_eq!(scene.points.len(), 8);
    for (k, point) in (1..9).zip(&scene.points) {
        for axis in 0..3 {
            let expected = exact(k)[axis] + BY[axis] - offset[axis];
            assert!((f64::from(point.position[axis]) - expected).abs() < 1e-5, "{point:?} {expected}");
        }
    }
}

#[test]
fn points_of_a_far_scene_keep_their_digits() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Text, &moved(tiny_model(9), DVec3::from(BY)));
    let file = folder.path().join("sparse/0/points3D.txt");
    fs::write(&file, far_points(|k, [x, y, z]| format!("{k} {x} {y} {z} 1 2 3 0.5\n"))).unwrap();
    check_points(folder.path());
    // A cloud of points, too, as text and in double precision.
    fs::remove_file(file).unwrap();
    let cloud = folder.path().join("sparse/0/points3D.ply");
    let properties = "property double x\nproperty double y\nproperty double z\n";
    let header = |form: &str| format!("ply\nformat {form} 1.0\nelement vertex 8\n{properties}end_header\n");
    fs::write(&cloud, header("ascii") + &far_points(|_, [x, y, z]| format!("{x} {y} {z}\n"))).unwrap();
    check_points(folder.path());
    let mut bytes = header("binary_little_endian").into_bytes();
    let rows = (1..9).flat_map(|k| (0..3).flat_map(move |axis| (exact(k)[axis] + BY[axis]).to_le_bytes()));
    bytes.extend(rows);
    fs::write(&cloud, bytes).unwrap();
    check_points(folder.path());
}

#[test]
fn a_part_of_a_scene_lies_where_it_says() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(9));
    let load = |offset: Option<Offset>| {
        load_scene(folder.path(), &LoadOptions { offset, ..LoadOptions::default() }, &())
    };
    let centre = |offset| load(offset).unwrap().train[0].camera.centre_in_world();
    let near = centre(None);
    fs::write(folder.path().join("offset.json"), to_json(BY)).unwrap();
    let told = load(None).unwrap();
    assert_eq!(told.digests.offset, Some(BY));
    assert!(!told.notices.iter().any(|notice| notice.contains("far from its origin")), "{:?}", told.notices);
    assert_eq!(centre(None), near, "it is there already");
    let other = BY.map(|value| value + 7.0);
    assert!((centre(Some(other)) + DVec3::splat(7.0)).distance(near) < 1e-9);
    fs::write(folder.path().join("offset.json"), "7").unwrap();
    let sentence = load(None).unwrap_err().to_string();
    assert!(sentence.contains("offset.json") && sentence.contains("remove it"), "{sentence}");
}

/// 5,000 km from the origin, in metres, and Gaussians of centimetres.
const FAR: [f64; 3] = [431_250.5, 5_412_345.25, -300.0];

#[test]
fn a_far_ply_in_double_precision_keeps_its_digits() {
    let folder = tempfile::tempdir().unwrap();
    let (path, cloud) = (folder.path().join("far.ply"), varied(11, 500, 1));
    write(&path, &cloud, &Options { offset: Some(FAR), ..Options::default() });
    let text = String::from_utf8_lossy(&fs::read(&path).unwrap()[..200]).into_owned();
    assert!(
        text.contains("property double x\nproperty double y\nproperty double z\nproperty float nx"),
        "{text}"
    );
    let read = format::read(&path).unwrap();
    let by = read.offset.unwrap();
    assert!((0..3).all(|axis| (by[axis] - FAR[axis]).abs() < 10.0 && by[axis].fract() == 0.0), "{by:?}");
    assert_eq!(read.step, 0.0);
    for (here, there) in read.cloud.positions.iter().zip(&cloud.positions) {
        for axis in 0..3 {
            let expected = f64::from(there[axis]) + FAR[axis] - by[axis];
            assert!((f64::from(here[axis]) - expected).abs() < 1e-6, "{here:?} {there:?}");
        }
    }
    let rest = Gaussians { positions: cloud.positions.clone(), ..read.cloud };
    assert_eq!(rest, cloud, "all else has the same bits");
}

/// What single precision has left is kept by every format, and how coarse it is is known.
#[test]
fn a_far_splat_is_moved_near_its_origin_before_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let (path, mut cloud) = (folder.path().join("far.ply"), varied(12, 500, 0));
    cloud.positions.iter_mut().for_each(|position| position[0] += 1e6);
    write(&path, &cloud, &Options::default());
    let mut read = format::read(&path).unwrap();
    assert_eq!(read.offset, None, "it is as it is");
    read.move_near();
    let by = read.offset.unwrap();
    assert!((by[0] - 1e6).abs() < 10.0 && (read.step - 0.119).abs() < 0.01, "{by:?} {}", read.step);
    for (here, there) in read.cloud.positions.iter().zip(&cloud.positions) {
        assert_eq!(f64::from(here[0]) + by[0], f64::from(there[0]), "nothing is rounded");
    }
    let distinct = |cloud: &Gaussians| {
        cloud.positions.iter().map(|position| position[0].to_bits()).collect::<HashSet<_>>().len()
    };
    let out = folder.path().join("far.spz");
    write(&out, &read.cloud, &Options::default());
    let again = format::read(&out).unwrap();
    assert_eq!((distinct(&again.cloud), again.offset), (distinct(&read.cloud), None));
    let steps = [Format::Ply, Format::Spz, Format::Sog].map(|format| format::step(format, &cloud));
    assert!(steps.iter().all(|step| (0.1..100.0).contains(step)), "{steps:?}");
    let steps = [Format::Ply, Format::Spz, Format::Sog].map(|format| format::step(format, &read.cloud));
    assert!(steps.iter().all(|step| *step < 1e-3), "{steps:?}");
}
