//! Depth maps: where they are found, how they are taken to views, and what is left out.

use std::fs;
use std::path::Path;

use genesplat_core::{DepthMap, View};
use genesplat_io::colmap::Form;
use genesplat_io::{LoadOptions, PhotoSize, Point, Scene, Spill, list_scene, load_scene, photos};
use serde_json::{Value, json};

use crate::common::{SIZE, matrix, tiny_model, tiny_photo, write_scene};

const WIDTH: usize = SIZE[0] as usize;

fn options() -> LoadOptions {
    LoadOptions { with_depth: true, with_tracks: true, ..LoadOptions::default() }
}

fn load(scene: &Path) -> Scene {
    load_scene(scene, &options(), &()).unwrap()
}

/// All views by name.
fn views(scene: &Scene) -> Vec<&View> {
    let mut views: Vec<&View> = scene.train.iter().chain(&scene.test).collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    views
}

/// Depths of a view, world units; 0 where they are not known.
fn depths(view: &View) -> Vec<f32> {
    let map: &DepthMap = view.depth.as_ref().expect("a depth map");
    let depth = |inverse: f32| if inverse > 0.0 { map.nearest / inverse } else { 0.0 };
    map.inverse().unwrap().into_iter().map(depth).collect()
}

fn are_close(found: &[f32], wanted: &[f32]) -> bool {
    found.len() == wanted.len() && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= 2e-4 * b.max(1.0))
}

/// As COLMAP writes a map.
fn write_dense(
    scene: &Path,
    photo: &str,
    kind: &str,
    [width, height]: [usize; 2],
    depth: impl Fn(usize, usize) -> f32,
) {
    let mut bytes = format!("{width}&{height}&1&").into_bytes();
    (0..height).for_each(|y| (0..width).for_each(|x| bytes.extend(depth(x, y).to_le_bytes())));
    let path = scene.join("stereo/depth_maps").join(format!("{photo}.{kind}.bin"));
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// Rises to the right, and knows nothing of the first row.
fn slope(x: usize, y: usize) -> f32 {
    if y == 0 { 0.0 } else { 2.0 + x as f32 / 10.0 }
}

fn all_of_slope() -> Vec<f32> {
    (0..SIZE[1] as usize).flat_map(|y| (0..WIDTH).map(move |x| slope(x, y))).collect()
}

#[test]
fn maps_of_dense_reconstructions_are_found_when_they_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(3));
    write_dense(folder.path(), "a b/000.png", "geometric", [WIDTH, 30], slope);
    write_dense(folder.path(), "a b/000.png", "photometric", [WIDTH, 30], |_, _| 9.0);
    write_dense(folder.path(), "a b/001.png", "photometric", [WIDTH / 2, 15], |_, _| 7.0);
    let scene = load(folder.path());
    let views = views(&scene);
    assert!(are_close(&depths(views[0]), &all_of_slope()));
    assert!(are_close(&depths(views[1]), &[7.0; 1200]), "a smaller map serves, too");
    assert!(views[2].depth.is_none());
    assert!(scene.notices.iter().any(|notice| notice.starts_with("2 of 3 photos have a depth map")));
    assert_eq!(scene.photos.len(), 5, "maps are not to be written over, either");
    let known = |name: &str| scene.digests.photo(name).unwrap().depth.is_some();
    assert_eq!([0, 1, 2].map(|index| known(&views[index].name)), [true, true, false]);

    let without = load_scene(folder.path(), &LoadOptions::default(), &()).unwrap();
    assert!(without.train.iter().chain(&without.test).all(|view| view.depth.is_none()));
    assert!(without.digests.photos.iter().all(|photo| photo.depth.is_none()));
    assert!(without.notices.iter().all(|notice| !notice.contains("depth")));
    assert_eq!(without.photos.len(), 3);
}

/// A nerfstudio scene with a map for each photo, whose entry has what `entry` adds.
fn nerfstudio(folder: &Path, entry: impl Fn(usize) -> Value, whole: &Value) {
    let model = tiny_model(3);
    let plain = LoadOptions { with_points: false, ..LoadOptions::default() };
    write_scene(folder, Form::Binary, &model);
    let scene = load_scene(folder, &plain, &()).unwrap();
    let frames: Vec<Value> = (views(&scene).iter().enumerate())
        .map(|(index, view)| {
            photos::write_png(&folder.join(format!("{index}.png")), &tiny_photo(index, SIZE)).unwrap();
            let mut frame =
                json!({"file_path": format!("{index}.png"), "transform_matrix": matrix(&view.camera)});
            frame.as_object_mut().unwrap().extend(entry(index).as_object().unwrap().clone());
            frame
        })
        .collect();
    fs::remove_dir_all(folder.join("sparse")).unwrap();
    let mut list =
        json!({"w": 40, "h": 30, "fl_x": 35.5, "fl_y": 36.25, "cx": 20.5, "cy": 14.75, "frames": frames});
    list.as_object_mut().unwrap().extend(whole.as_object().unwrap().clone());
    fs::write(folder.join("transforms.json"), list.to_string()).unwrap();
}

/// As NumPy saves an array.
fn write_npy(path: &Path, kind: &str, values: &[u8]) {
    let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': (30, 40), }}\n");
    let bytes = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), values];
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes.concat()).unwrap();
}

#[test]
fn maps_that_a_list_names_are_in_its_unit() {
    let folder = tempfile::tempdir().unwrap();
    // The second one as another machine calls it.
    let name = |index: usize| ["depths/0.npy", "C:\\capture\\1.npy", "depths/2.npy"][index];
    nerfstudio(folder.path(), |index| json!({"depth_file_path": name(index)}), &json!({}));
    let millimetres: Vec<u8> =
        all_of_slope().iter().flat_map(|depth| ((depth * 1000.0).round() as u16).to_le_bytes()).collect();
    (0..3).for_each(|index| {
        write_npy(&folder.path().join(format!("depths/{index}.npy")), "<u2", &millimetres);
    });
    let scene = load(folder.path());
    assert!(views(&scene).into_iter().all(|view| are_close(&depths(view), &all_of_slope())));

    let list = fs::read_to_string(folder.path().join("transforms.json")).unwrap();
    let halved = list.replacen('{', "{\"depth_unit_scale_factor\": 0.0005, ", 1);
    fs::write(folder.path().join("transforms.json"), halved).unwrap();
    let half: Vec<f32> = all_of_slope().iter().map(|depth| 0.5 * depth).collect();
    assert!(are_close(&depths(views(&load(folder.path()))[0]), &half));
    // In the words of instant-ngp.
    let ngp =
        list.replacen('{', "{\"integer_depth_scale\": 0.0005, ", 1).replace("depth_file_path", "depth_path");
    fs::write(folder.path().join("transforms.json"), ngp).unwrap();
    assert!(are_close(&depths(views(&load(folder.path()))[0]), &half));

    // A block of the scene has it as COLMAP would.
    let list = list_scene(folder.path(), &options()).unwrap();
    let map = list.photos[0].depth.as_ref().unwrap();
    let bytes = map.to_dense().unwrap();
    let values = bytes.strip_prefix(b"40&30&1&").unwrap().as_chunks::<4>().0;
    let values: Vec<f32> = values.iter().map(|value| f32::from_le_bytes(*value)).collect();
    assert!(!map.is_dense() && are_close(&values, &half));
}

#[test]
fn photos_smaller_and_through_a_lens_have_the_depths_of_their_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let metres: Vec<u8> = all_of_slope().iter().flat_map(|depth| depth.to_le_bytes()).collect();
    let entry = |index| json!({"depth_file_path": format!("depths/{index}.npy")});
    nerfstudio(folder.path(), entry, &json!({"k1": 0.08, "depth_unit_scale_factor": 1}));
    (0..3).for_each(|index| write_npy(&folder.path().join(format!("depths/{index}.npy")), "<f4", &metres));
    let size = PhotoSize::MaxSide(30);
    let scene = load_scene(folder.path(), &LoadOptions { size, ..options() }, &()).unwrap();
    let view = views(&scene)[0];
    let (camera, found) = (&view.camera, depths(view));
    let mut known = 0;
    for y in 0..camera.height as usize {
        for x in 0..camera.width as usize {
            // Straight there, bent here.
            let [u, v] = [
                (x as f64 + 0.5 - camera.principal_px[0]) / camera.focal_px[0],
                (y as f64 + 0.5 - camera.principal_px[1]) / camera.focal_px[1],
            ];
            let bent = 1.0 + 0.08 * (u * u + v * v);
            let at = [35.5 * u * bent + 20.5, 36.25 * v * bent + 14.75].map(|at| at.floor() as usize);
            let wanted = slope(at[0], at[1]);
            let depth = found[y * camera.width as usize + x];
            assert!((depth - wanted).abs() < 2e-3, "{x} {y}: {depth}, not {wanted}");
            known += usize::from(depth > 0.0);
        }
    }
    assert!(known > 200, "{known}");
}

#[test]
fn what_cannot_be_used_is_left_out_and_said() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(4));
    write_dense(folder.path(), "a b/000.png", "geometric", [WIDTH, 30], slope);
    write_dense(folder.path(), "a b/001.png", "geometric", [30, WIDTH], slope);
    write_dense(folder.path(), "a b/002.png", "geometric", [WIDTH, 30], |_, _| -1.0);
    fs::write(folder.path().join("stereo/depth_maps/a b/003.png.geometric.bin"), "40&30&1&short").unwrap();
    let scene = load(folder.path());
    let has: Vec<bool> = views(&scene).iter().map(|view| view.depth.is_some()).collect();
    assert_eq!(has, [true, false, false, false]);
    let notice = scene.notices.iter().find(|notice| notice.contains("cannot be used")).unwrap();
    assert!(
        notice.starts_with("3 depth maps cannot be used, first ") && notice.contains("it is 30x40"),
        "{notice}"
    );
}

#[test]
fn what_a_mask_hides_has_no_depth_and_a_file_keeps_maps_as_photos() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(3));
    for index in 0..3 {
        let name = format!("a b/{index:03}.png");
        write_dense(folder.path(), &name, "geometric", [WIDTH, 30], slope);
        let mut mask = tiny_photo(index, SIZE);
        mask.rgb = (0..1200).flat_map(|at| [if at % WIDTH < 10 { 0 } else { 255 }; 3]).collect();
        photos::write_png(&folder.path().join("masks").join(name + ".png"), &mask).unwrap();
    }
    let wanted: Vec<f32> = all_of_slope()
        .into_iter()
        .enumerate()
        .map(|(at, depth)| if at % WIDTH < 10 { 0.0 } else { depth })
        .collect();
    // Photos alone would fit.
    let spill = Some(Spill { folder: folder.path().to_owned(), memory_bytes: 4 * 3 * 1200 });
    for spill in [None, spill] {
        let in_memory = spill.is_none();
        let scene = load_scene(folder.path(), &LoadOptions { spill, ..options() }, &()).unwrap();
        for view in views(&scene) {
            assert!(are_close(&depths(view), &wanted));
            assert_eq!(view.depth.as_ref().unwrap().codes.held_bytes() > 0, in_memory);
        }
    }
}

/// Maps of networks and phones have a unit of their own; the points of the scene tell it.
#[test]
fn maps_are_brought_to_the_unit_of_the_points() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(3);
    // A wall before all cameras, seen from several depths, and what hides behind it.
    for image in &mut model.images {
        image.rotation = [1.0, 0.0, 0.0, 0.0];
        image.translation[2] = 0.0;
    }
    let depth = |x: usize| 4.0 + x as f32 / 20.0;
    model.points = (0..400usize)
        .map(|index| {
            let (x, y) = (index % WIDTH, index * 7 % 30);
            let z = depth(x);
            let at = [(x as f32 + 0.5 - 20.5) / 35.5 * z, (y as f32 + 0.5 - 14.75) / 36.25 * z, z];
            // In the axes of the world, whose cameras stand aside.
            Point { position: [at[0] - 0.5, at[1] - 1.0 / 3.0, at[2]], rgb: [9; 3] }
        })
        .collect();
    // Most points of a large scene lie elsewhere.
    model.points.extend((0..100_000).map(|index| Point { position: [index as f32, 0.0, -5.0], rgb: [9; 3] }));
    write_scene(folder.path(), Form::Binary, &model);
    // Nothing is known of what is infinitely far.
    let in_feet = |x: usize, y: usize| if y == 5 { f32::INFINITY } else { 3.28 * depth(x) };
    for index in 0..2 {
        write_dense(folder.path(), &format!("a b/{index:03}.png"), "geometric", [WIDTH, 30], in_feet);
    }
    let elsewhere = |x: usize, y: usize| 1.0 + ((x * 31 + y * 17) % 40) as f32;
    write_dense(folder.path(), "a b/002.png", "geometric", [WIDTH, 30], elsewhere);
    let scene = load(folder.path());
    let wanted: Vec<f32> = (0..1200).map(|at| depth(at % WIDTH)).collect();
    let views = views(&scene);
    let off = |view: &View| {
        let found = depths(view);
        assert!(found[5 * WIDTH..6 * WIDTH].iter().all(|&depth| depth == 0.0));
        let known = found.iter().zip(&wanted).filter(|(depth, _)| **depth > 0.0);
        known.map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f32::max)
    };
    assert!(off(views[0]) < 0.01 && off(views[1]) < 0.01, "{} {}", off(views[0]), off(views[1]));
    assert!(views[2].depth.is_none());
    let told = scene.notices.join("\n");
    assert!(told.contains("2 depth maps are brought to the scene's unit by its points"), "{told}");
    assert!(told.contains("1 depth map is left out: the scene's points are elsewhere"), "{told}");
}

#[test]
fn a_list_that_names_maps_elsewhere_is_read_without_them() {
    for name in ["../maps/0.npy", "/maps/0.npy", "..", "depths/gone.npy"] {
        let folder = tempfile::tempdir().unwrap();
        nerfstudio(folder.path(), |_| json!({"depth_file_path": name}), &json!({}));
        fs::create_dir_all(folder.path().join("depths")).unwrap();
        let scene = load(folder.path());
        assert!(views(&scene).iter().all(|view| view.depth.is_none()), "{name}");
        assert!(
            scene.notices.iter().any(|notice| notice.starts_with("3 depth maps cannot be used")),
            "{name}"
        );
    }
}
