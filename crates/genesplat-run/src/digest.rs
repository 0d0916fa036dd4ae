//! What tells whether the processes of a run have loaded the same.

use std::hash::{DefaultHasher, Hash, Hasher};

use anyhow::Result;
use genesplat_core::{Camera, View};
use genesplat_io::{Point, Scene};
use rayon::prelude::*;

use crate::settings::Settings;

/// What digests are of, in their order.
pub(crate) const PARTS: [&str; 4] =
    ["another version of genesplat", "other settings", "other cameras or points", "other photos"];

/// A digest of each of [`PARTS`]; equal ones are of equal things, in processes of one build.
pub(crate) fn digests(settings: &Settings, scene: &Scene) -> Result<[u64; PARTS.len()]> {
    let views: Vec<&View> = scene.train.iter().chain(&scene.test).collect();
    let photos = views.par_iter().map(|view| photo_digest(view)).collect::<Result<Vec<u64>>>()?;
    Ok([
        digest(|to| env!("CARGO_PKG_VERSION").hash(to)),
        digest(|to| settings.of_result().hash(to)),
        digest(|to| {
            views.iter().for_each(|view| hash_camera(&view.camera, to));
            scene.points.iter().for_each(|point| hash_point(point, to));
        }),
        digest(|to| photos.hash(to)),
    ])
}

fn digest(fill: impl FnOnce(&mut DefaultHasher)) -> u64 {
    let mut hasher = DefaultHasher::new();
    fill(&mut hasher);
    hasher.finish()
}

fn photo_digest(view: &View) -> Result<u64> {
    let photo = view.photo.read()?;
    Ok(digest(|to| {
        view.name.hash(to);
        photo.rgb.hash(to);
        view.mask.as_ref().map(|mask| &mask.counts).hash(to);
    }))
}

fn hash_camera(camera: &Camera, to: &mut impl Hasher) {
    let Camera { width, height, focal_px, principal_px, .. } = *camera;
    (width, height).hash(to);
    let pose = camera.camera_from_world_rotation.to_array().into_iter();
    let lengths = focal_px.into_iter().chain(principal_px).chain(camera.camera_from_world_translation.to_array());
    pose.chain(lengths).chain([camera.near]).for_each(|value| value.to_bits().hash(to));
}

fn hash_point(point: &Point, to: &mut impl Hasher) {
    point.position.map(f32::to_bits).hash(to);
    point.rgb.hash(to);
}

#[cfg(test)]
mod tests {
    use genesplat_gallery::{self as gallery, GalleryOptions};
    use genesplat_io::HoldOut;

    use super::*;
    use crate::settings::{ConfigFile, Machine};

    /// The parts in which a change shows.
    fn changed(change: impl Fn(&mut ConfigFile, &mut Scene)) -> Vec<usize> {
        let of = |is_changed: bool| {
            let options = GalleryOptions { width: 16, height: 16, views: 9, points: 20, seed: 1 };
            let mut scene = gallery::generate(&options).into_scene(HoldOut::EveryEighth);
            let mut config = ConfigFile::of_scene("scene".into(), Default::default());
            if is_changed {
                change(&mut config, &mut scene);
            }
            digests(&config.resolve(Machine::default()).unwrap(), &scene).unwrap()
        };
        let [before, after] = [false, true].map(of);
        (0..PARTS.len()).filter(|&part| before[part] != after[part]).collect()
    }

    #[test]
    fn what_differs_is_told_apart() {
        assert_eq!(changed(|_, _| ()), [0; 0]);
        assert_eq!(changed(|config, _| config.dataset.path = "elsewhere".into()), [0; 0]);
        assert_eq!(changed(|config, _| config.train.seed = 7), [1]);
        assert_eq!(changed(|config, _| config.train.checkpoint_every = 7), [1]);
        assert_eq!(changed(|_, scene| scene.test[0].camera.focal_px[1] += 1.0), [2]);
        assert_eq!(changed(|_, scene| scene.points[3].rgb[0] ^= 1), [2]);
        assert_eq!(changed(|_, scene| scene.train.swap(0, 1)), [2, 3]);
    }
}
