//! Cameras that do not stand where their photos show it, as the command is given them.

use std::fs;
use std::path::Path;

use genesplat::core::Camera;
use genesplat::gallery::{self, Gallery, GalleryOptions};
use genesplat::io::colmap::{find_model, read_model};
use glam::{DQuat, DVec3, Vec3};

#[cfg(unix)]
use crate::resume::signal;
#[cfg(unix)]
use crate::support::command;
use crate::support::{cloud, json, number, run, succeed, text, train};

fn photographed() -> Gallery {
    gallery::generate(&GalleryOptions { width: 64, height: 48, views: 16, points: 400, seed: 5 })
}

/// A few degrees, others for each photo.
fn disturbed(at: usize, camera: &Camera) -> Camera {
    let wave = |phase: f64| 0.06 * (5.1 * at as f64 + phase).sin();
    let turn = DQuat::from_scaled_axis(DVec3::new(wave(0.0), wave(2.0), wave(4.0)));
    let camera_from_world_rotation = camera.camera_from_world_rotation * turn;
    let camera_from_world_translation = -(camera_from_world_rotation * camera.centre_in_world());
    Camera { camera_from_world_rotation, camera_from_world_translation, ..*camera }
}

/// A COLMAP scene with features of the photos as they were taken, and these cameras.
fn write_scene(folder: &Path, gallery: &Gallery, camera: impl Fn(usize, &Camera) -> Camera) {
    gallery.write_colmap(folder).unwrap();
    let features = |at: usize| gallery.seen[at].iter().map(move |point| feature(gallery, at, *point));
    let mut images = (gallery.views.len() as u64).to_le_bytes().to_vec();
    for (at, view) in gallery.views.iter().enumerate() {
        let Camera { camera_from_world_rotation: q, camera_from_world_translation: t, .. } =
            camera(at, &view.camera);
        images.extend((at as u32 + 1).to_le_bytes());
        images.extend([q.w, q.x, q.y, q.z, t.x, t.y, t.z].map(f64::to_le_bytes).concat());
        images.extend(1u32.to_le_bytes());
        images.extend([view.name.as_bytes(), &[0]].concat());
        images.extend((gallery.seen[at].len() as u64).to_le_bytes());
        images.extend(
            features(at)
                .flat_map(|[x, y]| [x.to_le_bytes(), y.to_le_bytes(), (-1i64).to_le_bytes()].concat()),
        );
    }
    fs::write(folder.join("sparse/0/images.bin"), images).unwrap();
    let mut points = (gallery.points.len() as u64).to_le_bytes().to_vec();
    for (index, point) in (0u32..).zip(&gallery.points) {
        let place = |seen: &Vec<u32>| seen.iter().position(|point| *point == index);
        let track = (1u32..).zip(&gallery.seen).filter_map(|(id, seen)| Some([id, place(seen)? as u32]));
        let track: Vec<u32> = track.flatten().collect();
        points.extend(u64::from(index).to_le_bytes());
        points.extend(point.position.map(|value| f64::from(value).to_le_bytes()).concat());
        points.extend(point.rgb);
        points.extend(0.5f64.to_le_bytes());
        points.extend((track.len() as u64 / 2).to_le_bytes());
        points.extend(track.iter().flat_map(|number| number.to_le_bytes()));
    }
    fs::write(folder.join("sparse/0/points3D.bin"), points).unwrap();
}

/// Px from the corner, as COLMAP counts.
fn feature(gallery: &Gallery, view: usize, point: u32) -> [f64; 2] {
    let camera = &gallery.views[view].camera;
    let position = Vec3::from(gallery.points[point as usize].position).as_dvec3();
    camera.pixel_from_camera(camera.camera_from_world(position)).map(|pixel| pixel + 0.5)
}

#[test]
fn cameras_go_back_to_where_they_stood_and_every_command_has_them_there() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, right, first, of_right] =
        ["scene", "right", "first", "of-right"].map(|name| folder.path().join(name));
    let gallery = photographed();
    write_scene(&scene, &gallery, disturbed);
    write_scene(&right, &gallery, |_, camera| *camera);
    let output = run(train(&scene, &first, &["--iterations", "60"]));
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && told.contains("16 cameras are moved, by "), "{told}");
    // Right ones keep every bit.
    let said = run(train(&right, &of_right, &["--iterations", "60"]));
    assert!(!String::from_utf8(said.stderr).unwrap().contains("are moved"));
    assert!(
        !of_right.join("cameras").exists() && json(&of_right.join("inputs.json")).get("cameras").is_none()
    );
    let psnr = |run: &Path| number(&json(&run.join("metrics.json"))["test"]["psnr"]);
    assert!((psnr(&first) - psnr(&of_right)).abs() < 0.2, "{} {}", psnr(&first), psnr(&of_right));
    // What other programs read.
    let model = read_model(&find_model(&first.join("cameras")).unwrap()).unwrap();
    assert_eq!(model.images.len(), 16);
    for image in &model.images {
        let view = gallery.views.iter().find(|view| view.name == image.name).unwrap();
        let [w, x, y, z] = image.rotation;
        let turned = DQuat::from_xyzw(x, y, z, w).angle_between(view.camera.camera_from_world_rotation);
        assert!(turned < 1e-3, "{}: {turned}", image.name);
    }
    // What looks at the run later.
    let scores = folder.path().join("scores.json");
    succeed(["evaluate", text(&first), "--device", "cpu", "--json", text(&scores)]);
    assert!((number(&json(&scores)["psnr"]) - psnr(&first)).abs() < 0.05);
    assert_eq!(json(&first.join("inputs.json"))["cameras"]["photos"].as_object().unwrap().len(), 16);
    // Nobody asked for it.
    let off = folder.path().join("off");
    succeed(train(&scene, &off, &["--iterations", "60", "--corrections", "off"]));
    assert!(psnr(&off) < psnr(&first) - 0.5, "{} {}", psnr(&off), psnr(&first));
}

#[cfg(unix)]
#[test]
fn a_run_that_was_stopped_goes_on_with_its_cameras_where_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, whole, broken] = ["scene", "whole", "broken"].map(|name| folder.path().join(name));
    write_scene(&scene, &photographed(), disturbed);
    let steps = ["--iterations", "900", "--max-gaussians", "600"];
    succeed(train(&scene, &whole, &steps));
    let mut stopped = command(train(&scene, &broken, &steps));
    let output = signal(&mut stopped, &broken, r#""event":"step""#, "-INT");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    let resumed = run(train(&scene, &broken, &["--resume"]));
    let told = String::from_utf8(resumed.stderr).unwrap();
    assert!(resumed.status.success() && !told.contains("are moved"), "{told}");
    assert!(cloud(&whole) == cloud(&broken), "as if it had never been stopped");
}
