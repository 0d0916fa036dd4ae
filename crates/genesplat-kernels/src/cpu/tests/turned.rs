//! A splat that is turned, scaled and moved, seen by a camera that is moved likewise, is the same picture.

use genesplat_core::{Camera, Device, Gaussians, Image, RenderSettings, Renderer, ScreenFilter, Similarity};
use glam::{DQuat, DVec3};

use super::super::CpuBackend;
use crate::fixtures::{camera, filtered_cloud};

fn by() -> Similarity {
    let rotation = DQuat::from_xyzw(0.3, -0.5, 0.7, 0.4).normalize();
    Similarity { rotation, scale: 2.5, translation: DVec3::new(1.0, -2.0, 3.0) }
}

fn moved(camera: &Camera, by: &Similarity) -> Camera {
    let rotation = camera.camera_from_world_rotation * by.rotation.inverse();
    let translation = -(rotation * by.point(camera.centre_in_world()));
    Camera {
        camera_from_world_rotation: rotation,
        camera_from_world_translation: translation,
        near: camera.near * by.scale,
        ..*camera
    }
}

fn picture(cloud: &Gaussians, camera: &Camera, settings: &RenderSettings) -> Image {
    let mut backend = CpuBackend::default();
    backend.upload(cloud.clone().into()).unwrap();
    backend.render(camera, settings).unwrap()
}

/// Mean difference of two pictures.
fn difference(a: &Image, b: &Image) -> f32 {
    let sum: f32 = a.planes.iter().zip(&b.planes).map(|(a, b)| (a - b).abs()).sum();
    sum / a.planes.len() as f32
}

#[test]
fn a_moved_splat_is_the_same_picture_to_a_moved_camera() {
    let (by, here) = (by(), camera());
    let there = moved(&here, &by);
    for filter in [ScreenFilter::Classic, ScreenFilter::Mip] {
        for sh_degree in 0..=3 {
            let settings = RenderSettings { sh_degree, filter, ..RenderSettings::default() };
            let before = filtered_cloud(400, filter);
            let mut after = before.clone();
            by.apply(&mut after);
            let expected = picture(&before, &here, &settings);
            let off = difference(&picture(&after, &there, &settings), &expected);
            assert!(off < 1e-4, "{filter:?}, degree {sh_degree}: {off}");
            // Without the turn of its harmonics, it is another.
            after.sh = before.sh;
            let off = difference(&picture(&after, &there, &settings), &expected);
            assert_eq!(off > 3e-3, sh_degree > 0, "{filter:?}, degree {sh_degree}: {off}");
        }
    }
}
