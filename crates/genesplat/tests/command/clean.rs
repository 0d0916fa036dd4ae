//! Gaussians that no photo supports go, and the others stay.

use genesplat::core::Gaussians;
use genesplat::io::colmap::{find_model, read_model};
use genesplat::io::{PlyOptions, format, write_ply};
use glam::{DQuat, DVec3};

use crate::support::{fail, run, scene, succeed, text, train};

const PLANTED: usize = 12;

/// Opaque specks: before one camera each, far outside, and behind all cameras.
fn plant(cloud: &Gaussians) -> Gaussians {
    let model = read_model(&find_model(scene()).unwrap()).unwrap();
    let mut specks = cloud.gather(&[0; PLANTED]);
    for row in 0..PLANTED {
        let image = &model.images[row % model.images.len()];
        let [w, x, y, z] = image.rotation;
        let world_from_camera = DQuat::from_xyzw(x, y, z, w).normalize().inverse();
        let seen = match row % 3 {
            0 => DVec3::new(0.01, 0.0, 0.25),
            1 => DVec3::new(0.0, 0.0, -30.0),
            _ => DVec3::new(400.0, 0.0, -90.0),
        };
        let place = world_from_camera * (seen - DVec3::from(image.translation));
        specks.positions[row] = place.as_vec3().to_array();
        specks.log_scales[row] = [-5.5; 3];
        specks.opacity_logits[row] = 4.0;
    }
    let mut planted = cloud.clone();
    planted.append(specks);
    planted
}

#[test]
fn floaters_go_and_held_out_photos_lose_nothing() {
    let place = tempfile::tempdir().unwrap();
    let [trained, file, out] = ["run", "planted.ply", "clean.ply"].map(|name| place.path().join(name));
    succeed(train(scene(), &trained, &["--iterations", "200", "--no-lpips"]));
    let cloud = format::read(&trained.join("point_cloud.ply")).unwrap().cloud;
    write_ply(&file, &plant(&cloud), &PlyOptions::default()).unwrap();
    let said = succeed(["clean", text(&file), "--data", text(scene()), "--out", text(&out)]);
    let left = format::read(&out).unwrap().cloud;
    let specks = left.log_scales.iter().filter(|log_scale| **log_scale == [-5.5; 3]).count();
    assert!(specks <= PLANTED / 4, "{specks} specks are left: {said}");
    assert!(left.len() * 10 > cloud.len() * 7, "{} of {} are left: {said}", left.len(), cloud.len());
    let line = said.lines().find(|line| line.starts_with("test PSNR")).unwrap();
    let number = |at: usize| line.split_whitespace().nth(at).unwrap().parse::<f64>().unwrap();
    assert!(number(5) >= number(2) - 0.011, "{line}");
    let removed = plant(&cloud).len() - left.len();
    assert!(said.starts_with(&format!("{removed} of ")), "{said}");
    assert!(place.path().join("clean.ply.png").metadata().unwrap().len() > 100);
    fail(["clean", text(&file), "--out", text(&out)], &["does not say which scene", "--data SCENE"]);
    let output = run(["clean", text(&trained), "--out", text(&out)]);
    assert!(output.status.success(), "the run knows its scene");
}
