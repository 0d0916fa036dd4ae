//! What tells whether the processes of a run have loaded the same.

use genesplat_io::{Digest, PhotoDigests, Scene};

use crate::corrected::Corrected;
use crate::inputs::Inputs;
use crate::settings::Settings;

/// What digests are of, in their order.
pub(crate) const PARTS: [&str; 6] = [
    "another version of genesplat",
    "other settings",
    "other cameras or points",
    "other photos",
    "photos of another exposure, or cameras elsewhere",
    "another offset of coordinates",
];

/// A digest of each of [`PARTS`], of what a run keeps to know its inputs again.
pub(crate) fn digests(settings: &Settings, scene: &Scene, corrected: &Corrected) -> [Digest; PARTS.len()] {
    let Inputs { settings: of_result, scene, exposure, cameras, .. } = Inputs::of(settings, scene, corrected);
    let gains = exposure.into_iter().flat_map(|exposure| {
        let of_photos = exposure.photos.into_values().flatten().chain(exposure.contrasts.into_values());
        of_photos.chain([exposure.dark, exposure.fall_off, exposure.plain_corners.len() as f32])
    });
    let motions = cameras.into_iter().flat_map(|cameras| cameras.photos.into_values());
    let motions = motions.flat_map(|motion| motion.turn.into_iter().chain(motion.shift));
    let checkpoint_every = settings.schedule.config().checkpoint_every;
    let of_photos =
        |words: &dyn Fn(&PhotoDigests) -> Vec<u8>| scene.photos.iter().flat_map(words).collect::<Vec<u8>>();
    let camera = |photo: &PhotoDigests| [photo.pose.bytes(), photo.lens.bytes()].concat();
    let photo = |photo: &PhotoDigests| {
        let [mask, depth] =
            [photo.mask, photo.depth].map(|file| file.map_or([0; 32], |digest| digest.bytes()));
        let name = Digest::of(photo.name.as_bytes()).bytes();
        [&name[..], &[photo.held_out.into()], &photo.photo.bytes(), &mask, &depth].concat()
    };
    let offset = scene.offset.into_iter().flatten().flat_map(f64::to_le_bytes).collect();
    let points = scene.points.map_or(Vec::new(), |points| points.bytes().to_vec());
    [
        env!("CARGO_PKG_VERSION").as_bytes().to_vec(),
        format!("{of_result}\n{checkpoint_every}").into_bytes(),
        [of_photos(&camera), points].concat(),
        of_photos(&photo),
        gains.flat_map(f32::to_le_bytes).chain(motions.flat_map(f64::to_le_bytes)).collect(),
        offset,
    ]
    .map(|part| Digest::of(&part))
}

#[cfg(test)]
mod tests {
    use std::mem::swap;

    use genesplat_gallery::Gallery;
    use genesplat_io::HoldOut;

    use super::*;
    use crate::exposure::Exposure;
    use crate::settings::{ConfigFile, Machine};
    use crate::small_scene;

    /// The parts in which a change shows.
    fn changed(change: impl Fn(&mut ConfigFile, &mut Gallery)) -> Vec<usize> {
        let of = |is_changed: bool| {
            let mut gallery = small_scene::gallery();
            let mut config = ConfigFile::of_scene("scene".into(), Default::default());
            if is_changed {
                change(&mut config, &mut gallery);
            }
            let scene = gallery.into_scene(HoldOut::EveryEighth);
            digests(&config.resolve(Machine::default()).unwrap(), &scene, &Corrected::default())
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
        assert_eq!(changed(|_, gallery| gallery.views[0].camera.focal_px[1] += 1.0), [2]);
        assert_eq!(changed(|_, gallery| gallery.points[3].rgb[0] ^= 1), [2]);
        assert_eq!(changed(|_, gallery| gallery.views[1].name = "gallery_001x.png".into()), [3]);
        let exchange: fn(&mut Gallery) = |gallery| {
            let [one, other] = gallery.views.get_disjoint_mut([1, 2]).unwrap();
            swap(&mut one.photo, &mut other.photo);
        };
        assert_eq!(changed(|_, gallery| exchange(gallery)), [3]);
    }

    /// Cameras and points may be the same once they are moved.
    #[test]
    fn ranks_whose_scenes_lie_elsewhere_are_told_apart() {
        let settings = ConfigFile::of_scene("scene".into(), Default::default());
        let settings = settings.resolve(Machine::default()).unwrap();
        let of = |offset| {
            let mut scene = small_scene::gallery().into_scene(HoldOut::EveryEighth);
            scene.digests.offset = offset;
            digests(&settings, &scene, &Corrected::default())
        };
        let (near, far) = (of(None), of(Some([500_000.0, 0.0, 0.0])));
        assert!(near[..5] == far[..5] && near[5] != far[5] && far != of(Some([0.0, 500_000.0, 0.0])));
    }

    #[test]
    fn ranks_whose_photos_have_other_gains_are_told_apart() {
        let scene = small_scene::gallery().into_scene(HoldOut::EveryEighth);
        let settings = ConfigFile::of_scene("scene".into(), Default::default());
        let settings = settings.resolve(Machine::default()).unwrap();
        let of = |gain: f32| {
            let photos = [("gallery_001.png".to_owned(), [gain, 1.0, 1.0])].into();
            let exposure = Some(Exposure {
                stops: 0.5,
                explained: 0.3,
                photos,
                contrasts: [].into(),
                dark: 0.8,
                fall_off: 0.0,
                plain_corners: [].into(),
            });
            digests(&settings, &scene, &Corrected { exposure, cameras: None })
        };
        let (one, other) = (of(1.1), of(1.2));
        assert!(one[..4] == other[..4] && one[4] != other[4] && one == of(1.1));
    }
}
