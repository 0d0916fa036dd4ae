//! COLMAP's tracks: which photos see which points, in both forms, whole or not.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use genesplat_io::bytes;
use genesplat_io::colmap::{Form, ImageRecord, Model};
use genesplat_io::{LoadOptions, Scene, Sight, load_scene};

use crate::common::{tiny_model, write_scene};

/// The photos (by the model's ids, which count from 1) that see each of nine points. Photo 99 is in no list.
const TRACKS: [&[u32]; 9] = [&[1, 2], &[], &[2, 3, 2], &[4], &[99, 1], &[5, 4, 3], &[], &[1], &[3, 5]];

/// The file of nine points with these tracks; of the one in `lost`, a coordinate is this.
fn points_file(form: Form, lost: Option<(usize, f64)>) -> Vec<u8> {
    let points = TRACKS.iter().enumerate().map(|(index, track)| {
        let x = lost.filter(|lost| lost.0 == index).map_or(index as f64 / 7.0, |lost| lost.1);
        if form == Form::Text {
            let track: String = track.iter().map(|photo| format!(" {photo} 17")).collect();
            return format!("{index} {x} -0.25 1 {index} 255 3 0.5{track}\n").into_bytes();
        }
        let mut bytes = (index as u64).to_le_bytes().to_vec();
        bytes.extend([x, -0.25, 1.0].map(f64::to_le_bytes).concat());
        bytes.extend([index as u8, 255, 3]);
        bytes.extend(0.5f64.to_le_bytes());
        bytes.extend((track.len() as u64).to_le_bytes());
        bytes.extend(track.iter().flat_map(|photo| [photo.to_le_bytes(), 17u32.to_le_bytes()].concat()));
        bytes
    });
    let count = if form == Form::Text { Vec::new() } else { 9u64.to_le_bytes().to_vec() };
    [count, points.collect::<Vec<_>>().concat()].concat()
}

fn scene(folder: &Path, form: Form, lost: Option<(usize, f64)>) -> std::path::PathBuf {
    write_scene(folder, form, &tiny_model(5));
    let name = if form == Form::Binary { "points3D.bin" } else { "points3D.txt" };
    let file = folder.join("sparse/0").join(name);
    fs::write(&file, points_file(form, lost)).unwrap();
    file
}

fn load(folder: &Path, with_tracks: bool) -> Scene {
    load_scene(folder, &LoadOptions { with_tracks, ..LoadOptions::default() }, &()).unwrap()
}

fn points_of(scene: &Scene) -> BTreeMap<String, Vec<u32>> {
    let points = |sights: &Vec<Sight>| sights.iter().map(|sight| sight.point).collect();
    scene.seen.iter().map(|(photo, sights)| (photo.clone(), points(sights))).collect()
}

#[test]
fn photos_know_their_points_in_both_forms_where_that_is_asked_for() {
    let of = |points: &[(&str, &[u32])]| -> BTreeMap<String, Vec<u32>> {
        points.iter().map(|(name, points)| ((*name).to_owned(), points.to_vec())).collect()
    };
    for form in [Form::Binary, Form::Text] {
        let folder = tempfile::tempdir().unwrap();
        scene(folder.path(), form, None);
        let seen = points_of(&load(folder.path(), true));
        let expected = of(&[
            ("000.png", &[0, 4, 7]),
            ("001.png", &[0, 2]),
            ("002.png", &[2, 5, 8]),
            ("003.png", &[3, 5]),
            ("004.png", &[5, 8]),
        ]);
        assert_eq!(seen, expected, "{form:?}");
        assert!(load(folder.path(), false).seen.is_empty(), "{form:?}");
        // Places are those among the points that are kept.
        for lost in [f64::NAN, 1e25] {
            scene(folder.path(), form, Some((2, lost)));
            let loaded = load(folder.path(), true);
            assert_eq!(loaded.points.len(), 8);
            assert_eq!(points_of(&loaded)["002.png"], [4, 7], "{form:?} {lost}");
            assert_eq!(loaded.points[4].rgb[0], 5, "{form:?} {lost}");
        }
    }
}

#[test]
fn a_scene_without_tracks_has_none() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(5));
    assert!(load(folder.path(), true).seen.is_empty());
}

#[test]
fn tracks_that_are_cut_off_are_errors() {
    let whole = points_file(Form::Binary, None);
    assert_eq!(bytes::tracks(Form::Binary, &whole).unwrap(), TRACKS);
    for end in 0..whole.len() {
        assert!(bytes::tracks(Form::Binary, &whole[..end]).is_err(), "{end}");
    }
    assert!(bytes::tracks(Form::Binary, &[&whole[..], &[0]].concat()).is_err());
    let text = String::from_utf8(points_file(Form::Text, None)).unwrap();
    assert_eq!(bytes::tracks(Form::Text, text.as_bytes()).unwrap(), TRACKS);
    let cut = text.trim_end().rsplit_once(' ').unwrap().0;
    let error = bytes::tracks(Form::Text, cut.as_bytes()).unwrap_err().to_string();
    assert!(error.contains("line 9") && error.contains("POINT2D_IDX pairs"), "{error}");
    let not_an_id = text.replacen(" 99 ", " -99 ", 1);
    assert!(bytes::tracks(Form::Text, not_an_id.as_bytes()).is_err());
}

/// `images.txt` or `images.bin` of a tiny model whose photos have these features.
fn with_features(model: &Model, form: Form, features: &[[f64; 2]]) -> Vec<u8> {
    let image = |(id, image): (u32, &ImageRecord)| {
        let pose = || image.rotation.iter().chain(&image.translation);
        if form == Form::Text {
            let pose: String = pose().map(|value| format!(" {value}")).collect();
            let features: String = features.iter().map(|[x, y]| format!("{x} {y} -1 ")).collect();
            return format!("{id}{pose} {} {}\n{features}\n", image.camera, image.name).into_bytes();
        }
        let mut bytes = id.to_le_bytes().to_vec();
        bytes.extend(pose().flat_map(|value| value.to_le_bytes()));
        bytes.extend(image.camera.to_le_bytes());
        bytes.extend(image.name.as_bytes());
        bytes.push(0);
        bytes.extend((features.len() as u64).to_le_bytes());
        let feature = |[x, y]: &[f64; 2]| [x.to_le_bytes(), y.to_le_bytes(), (-1i64).to_le_bytes()].concat();
        bytes.extend(features.iter().flat_map(feature));
        bytes
    };
    let images = (1..).zip(&model.images).map(image).collect::<Vec<_>>().concat();
    let count = (model.images.len() as u64).to_le_bytes();
    if form == Form::Text { images } else { [&count[..], &images].concat() }
}

/// Tracks name the 17th feature, counted from 0.
#[test]
fn photos_know_where_they_show_points() {
    let folder = tempfile::tempdir().unwrap();
    let mut features: Vec<[f64; 2]> = (0..18).map(|at| [f64::from(at), 0.5]).collect();
    features[17] = [27.75, 11.125];
    for form in [Form::Binary, Form::Text] {
        let model = tiny_model(5);
        let scene = folder.path().join(format!("{form:?}"));
        self::scene(&scene, form, None);
        let list = if form == Form::Binary { "images.bin" } else { "images.txt" };
        let write = |features: &[[f64; 2]]| {
            fs::write(scene.join("sparse/0").join(list), with_features(&model, form, features)).unwrap();
        };
        write(&features);
        let [x, y] = load(&scene, true).seen["002.png"][1].ray.unwrap();
        assert!((x - (27.75 - 20.5) / 35.5).abs() < 1e-6 && (y - (11.125 - 14.75) / 36.25).abs() < 1e-6);
        write(&features[..17]);
        assert_eq!(load(&scene, true).seen["002.png"][1], Sight { point: 5, ray: None });
    }
}
