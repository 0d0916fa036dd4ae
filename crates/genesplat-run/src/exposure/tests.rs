use std::sync::{Arc, LazyLock};

use genesplat_core::{Camera, Image, Photo, PhotoStore, StoredPhoto};
use genesplat_gallery::{Gallery, GalleryOptions};
use genesplat_io::HoldOut;

use super::*;

fn photo(values: &[u8]) -> Photo {
    Photo {
        width: values.len() as u32,
        height: 1,
        rgb: values.iter().flat_map(|value| [*value; 3]).collect(),
    }
}

/// Gains alone.
fn of_photos(photos: BTreeMap<String, [f32; 3]>) -> Exposure {
    Exposure {
        stops: 1.0,
        explained: 1.0,
        photos,
        contrasts: BTreeMap::new(),
        dark: 1.0,
        fall_off: 0.0,
        plain_corners: [].into(),
    }
}

const BLACK: [f32; 3] = [0.0; 3];
static CAMERA: LazyLock<Camera> = LazyLock::new(|| Camera::at_origin(1, 1, 1.0));

#[test]
fn photos_are_brought_so_that_no_white_is_cut_off_and_go_back() {
    let values = [0, 50, 100, 200, 245, 250, 255];
    let gains = [("bright", [2.0, 1.0, 0.8]), ("dark", [0.5, 1.0, 1.25])];
    let photos = gains.map(|(name, gain)| (name.to_owned(), gain)).into();
    let exposure = Exposure { dark: 0.5, ..of_photos(photos) };
    let mut scene = gallery(|_| [1.0; 3]).0;
    scene.train = gains.map(|(name, _)| view(name, photo(&values))).into();
    let points = scene.points.clone();
    exposure.bring(&mut scene, None).unwrap();
    let channel = |view: &View, channel: usize| -> Vec<u8> {
        view.photo.read().unwrap().rgb.iter().skip(channel).step_by(3).copied().collect()
    };
    assert_eq!(channel(&scene.train[0], 0), [0, 13, 25, 50, 61, 63, 64]);
    assert_eq!(channel(&scene.train[0], 1), [0, 25, 50, 100, 123, 125, 128]);
    assert_eq!(channel(&scene.train[1], 0), values);
    assert_eq!(scene.points[3].rgb[1], (f32::from(points[3].rgb[1]) / 2.0).round() as u8);
    for at in &scene.train {
        let taken = Light::in_training(&exposure).brought().as_taken(at).unwrap();
        for (back, value) in channel(&taken, 1).iter().zip(values) {
            assert!(back.abs_diff(value) <= 1, "{back} {value}");
        }
        assert_eq!(
            Light::finished(&exposure).as_taken(at).unwrap().photo.read().unwrap(),
            at.photo.read().unwrap()
        );
    }
}

#[test]
fn photos_of_another_contrast_are_brought_and_go_back() {
    let values = [20, 50, 100, 200, 255];
    let photos = [("a".to_owned(), [1.2, 1.0, 0.6])].into();
    let contrasts = [("a".to_owned(), 1.25)].into();
    let mut exposure = Exposure { contrasts, ..of_photos(photos) };
    let mut scene = gallery(|_| [1.0; 3]).0;
    scene.train = vec![view("a", photo(&values))];
    exposure.dark = exposure.darkness(&scene.train);
    assert!(exposure.dark < 0.95, "{}", exposure.dark);
    exposure.bring(&mut scene, None).unwrap();
    // What is as bright as the pivot differs by the gain alone.
    let middle = f32::from(exposure.bringing("a", 1.0).of_photo(&photo(&[89]), &CAMERA).rgb[1]);
    assert!((middle - 89.0).abs() <= 1.0, "{middle}");
    let taken = Light::in_training(&exposure).brought().as_taken(&scene.train[0]).unwrap();
    for (back, value) in taken.photo.read().unwrap().rgb.iter().zip(photo(&values).rgb) {
        assert!(back.abs_diff(value) <= 2, "{back} {value}");
    }
    let mut image = Image { width: 1, height: 1, planes: vec![0.35; 3] };
    Light::finished(&exposure).of_photo("a").put_on(&mut image, &CAMERA);
    assert!(image.planes.iter().zip([0.42, 0.35, 0.21]).all(|(value, right)| (value - right).abs() < 1e-5));
}

#[test]
fn contrasts_that_cameras_chose_are_found() {
    let (plain, _) = gallery(put);
    assert!(estimate(&plain).unwrap().unwrap().contrasts.is_empty(), "where there are none, none are");
    let (mut scene, _) = gallery(put);
    let power = |index: usize| 1.0 + 0.2 * (2.3 * index as f32).sin();
    for (index, view) in scene.train.iter_mut().enumerate() {
        let contrast = power(index);
        let shade = Shade { factors: [0.35f32.powf(1.0 - contrast); 3], contrast, fall_off: 0.0 };
        view.photo = shade.of_photo(&view.photo.read().unwrap(), &view.camera).into();
    }
    let exposure = estimate(&scene).unwrap().unwrap();
    let usual = ((0..21).map(|index| power(index).ln()).sum::<f32>() / 21.0).exp();
    for (index, view) in scene.train.iter().enumerate() {
        let ratio = exposure.contrast(&view.name) / (power(index) / usual);
        assert!((ratio - 1.0).abs() < 0.08, "{}: {ratio}", view.name);
    }
}

#[test]
fn a_render_at_the_exposure_of_a_photo_is_what_the_photo_shows() {
    let photos = [("a".to_owned(), [2.0, 1.0, 0.5])].into();
    let exposure = Exposure { dark: 0.5, ..of_photos(photos) };
    let [training, finished] = [Light::in_training(&exposure), Light::finished(&exposure)];
    assert_eq!((training.of_photo("a").factors, training.mean().factors), ([4.0, 2.0, 1.0], [2.0; 3]));
    assert_eq!((finished.of_photo("a").factors, finished.of_photo("b").factors), ([2.0, 1.0, 0.5], [1.0; 3]));
    let mut image = Image { width: 2, height: 1, planes: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6] };
    finished.of_photo("a").put_on(&mut image, &Camera::at_origin(2, 1, 1.0));
    assert_eq!(image.planes, [0.2, 0.4, 0.3, 0.4, 0.25, 0.3]);
}

#[test]
fn a_page_shows_all_photos_at_the_mean_exposure() {
    let (mut scene, plain) = gallery(put);
    let exposure = estimate(&scene).unwrap().unwrap();
    exposure.bring(&mut scene, None).unwrap();
    let light = Light::in_training(&exposure);
    for (view, plain, light) in
        [(&scene.train[4], &plain.train[4], light.brought()), (&scene.test[1], &plain.test[1], light)]
    {
        let [shown, plain] =
            [light.at_mean(view), plain.clone()].map(|view| view.photo.read().unwrap().rgb.clone());
        let middle = 3 * (30 * 60 + 30);
        for (shown, plain) in shown.iter().zip(&plain).skip(middle).take(30) {
            let ratio = f32::from(*shown) / f32::from(*plain).max(1.0);
            assert!((0.85..1.15).contains(&ratio) || *plain < 20, "{}: {shown} {plain}", view.name);
        }
    }
}

fn view(name: &str, photo: Photo) -> View {
    let camera = Camera::at_origin(photo.width, photo.height, 1.0);
    View { name: name.into(), camera, photo: photo.into(), mask: None, depth: None }
}

#[test]
fn the_sentence_says_what_was_found_and_what_is_done() {
    let view = |name: &str| view(name, photo(&[9]));
    let options = GalleryOptions { width: 16, height: 16, views: 9, points: 20, seed: 1 };
    let mut scene = genesplat_gallery::generate(&options).into_scene(HoldOut::EveryEighth);
    (scene.train, scene.test) = (vec![view("a"), view("b")], vec![view("c")]);
    let photos = [("a".to_owned(), [1.0; 3]), ("c".to_owned(), [1.0; 3])].into();
    let exposure = Exposure { stops: 0.534, explained: 0.351, dark: 0.7, ..of_photos(photos) };
    assert_eq!(
        exposure.sentence(&scene),
        "photos differ by 0.53 stops, and are brought to one exposure, which explains 35 % of what shared points differ by; \
         1 shares too few points, and stay as they are"
    );
    assert_eq!(exposure.only(|name| name == "c").photos.len(), 1);
    assert_eq!((exposure.gain("a"), exposure.gain("zzz")), ([1.0; 3], [1.0; 3]));
}

static PLAIN: LazyLock<Gallery> = LazyLock::new(|| {
    genesplat_gallery::generate(&GalleryOptions { width: 60, height: 60, views: 24, points: 600, seed: 3 })
});

/// Photos of the gallery that were taken with these gains, and what they would be with none.
fn gallery(gain: impl Fn(usize) -> [f32; 3]) -> (Scene, Scene) {
    let plain = PLAIN.clone();
    let mut damaged = plain.clone();
    for (index, view) in damaged.views.iter_mut().enumerate() {
        let (photo, gain) = (view.photo.read().unwrap(), gain(index));
        let scaled = |(value, gain): (&u8, &f32)| (f32::from(*value) * gain).round().min(255.0) as u8;
        let rgb = photo.rgb.iter().zip(gain.iter().cycle()).map(scaled).collect();
        view.photo = Photo { rgb, ..*photo }.into();
    }
    (damaged.into_scene(HoldOut::EveryEighth), plain.into_scene(HoldOut::EveryEighth))
}

/// Up to 30 % brighter or darker, and of another white.
fn put(index: usize) -> [f32; 3] {
    [0, 1, 2].map(|channel| 1.0 + 0.25 * (1.7 * index as f32).sin() + 0.05 * ((index + channel) as f32).cos())
}

/// How far training photos are from the mean of what they share: the mean of logarithms' absolute
/// differences.
fn difference(scene: &Scene) -> f64 {
    let samples = samples::of_photos(scene, &scene.train).unwrap();
    let mut of_points: BTreeMap<u32, Vec<f32>> = BTreeMap::new();
    samples
        .iter()
        .flatten()
        .for_each(|sample| of_points.entry(sample.point).or_default().push(sample.logs[1]));
    let shared = of_points.values().filter(|logs| logs.len() > 1);
    let differences = shared.flat_map(|logs| {
        let mean = logs.iter().sum::<f32>() / logs.len() as f32;
        logs.iter().map(move |log| f64::from((log - mean).abs()))
    });
    let differences: Vec<f64> = differences.collect();
    differences.iter().sum::<f64>() / differences.len() as f64
}

#[test]
fn known_gains_are_found_and_nine_tenths_of_the_damage_come_back() {
    let (mut damaged, plain) = gallery(put);
    let exposure = decide(&damaged, Corrections::On, BLACK).unwrap().expect("points are shared");
    let means = [0, 1, 2].map(|channel: usize| {
        let of_train = (0..24).filter(|index| index % 8 != 0);
        (of_train.map(|index| put(index)[channel].ln()).sum::<f32>() / 21.0).exp()
    });
    for (index, name) in (0..24).map(|index| (index, format!("gallery_{index:03}.png"))) {
        for channel in 0..3 {
            let ratio = exposure.photos[&name][channel] / (put(index)[channel] / means[channel]);
            assert!((ratio - 1.0).abs() < 0.02, "{name}, channel {channel}: {ratio}");
        }
    }
    let with_damage = difference(&damaged);
    exposure.bring(&mut damaged, None).unwrap();
    let (without, back) = (difference(&plain), difference(&damaged));
    assert!(with_damage - back > 0.9 * (with_damage - without), "{with_damage} {back} {without}");
    let test = |scene: &Scene| scene.test[1].photo.read().unwrap();
    let (again, _) = gallery(put);
    assert_eq!(test(&damaged), test(&again), "test photos stay as they were taken");
}

#[test]
fn photos_of_one_exposure_hardly_change_and_nobody_is_forced() {
    let (scene, _) = gallery(|_| [1.0; 3]);
    assert!(decide(&scene, Corrections::On, BLACK).unwrap().is_some_and(|exposure| exposure.stops < 0.05));
    assert_eq!(decide(&scene, Corrections::Off, BLACK).unwrap(), None);
    assert_eq!(decide(&scene, Corrections::Auto, BLACK).unwrap(), None, "nothing is worth bringing");
    assert_eq!(decide(&scene, Corrections::Auto, [1.0; 3]).unwrap(), None);
    let (damaged, _) = gallery(put);
    assert!(decide(&damaged, Corrections::Auto, BLACK).unwrap().is_some());
}

#[test]
fn a_white_background_has_no_exposure() {
    let (scene, _) = gallery(put);
    let error = decide(&scene, Corrections::On, [1.0; 3]).unwrap_err().to_string();
    assert!(error.contains("white background") && error.contains("--corrections on"), "{error}");
}

#[test]
fn corners_that_a_lens_shows_darker_come_back() {
    let (mut scene, _) = gallery(put);
    for view in &mut scene.train {
        let shade = Shade { fall_off: -0.25, ..Shade::NONE };
        view.photo = shade.of_photo(&view.photo.read().unwrap(), &view.camera).into();
    }
    let exposure = estimate(&scene).unwrap().unwrap();
    assert_eq!(exposure.plain_corners.len(), 3, "test photos have another lens");
    // The gallery's light makes corners darker, too.
    let plain = estimate(&gallery(put).0).unwrap().unwrap();
    let added = exposure.fall_off - plain.fall_off;
    assert!((added + 0.25).abs() < 0.03, "{added}, {}", plain.fall_off);
    assert!(exposure.told().contains(" % darker; renders show the mean"), "{}", exposure.told());
}

#[test]
fn whites_that_are_clipped_do_not_mislead() {
    let gain = |index: usize| [if index.is_multiple_of(2) { 1.7 } else { 0.9 }; 3];
    let exposure = estimate(&gallery(gain).0).unwrap().unwrap();
    let of = |index: usize| exposure.photos[&format!("gallery_{index:03}.png")][0];
    for pair in [1, 9, 17] {
        let ratio = of(pair + 1) / of(pair) / (1.7 / 0.9);
        assert!((ratio - 1.0).abs() < 0.03, "{pair}: {ratio}");
    }
}

#[test]
fn a_scene_without_tracks_is_a_sentence() {
    let (mut scene, _) = gallery(put);
    scene.seen.clear();
    let error = decide(&scene, Corrections::On, BLACK).unwrap_err().to_string();
    assert!(error.contains("which photos share which points") && error.contains("leave out"), "{error}");
}

#[test]
fn photos_in_a_file_are_brought_as_those_in_memory() {
    let (mut scene, _) = gallery(put);
    let exposure = estimate(&scene).unwrap().unwrap();
    let mut in_file = scene.clone();
    let folder = tempfile::tempdir().unwrap();
    let spill = Spill { folder: folder.path().to_owned(), memory_bytes: 0 };
    // Into a file first.
    in_file.train[0].photo = stored(&in_file.train[0]);
    exposure.bring(&mut scene, None).unwrap();
    exposure.bring(&mut in_file, Some(&spill)).unwrap();
    for (a, b) in scene.train.iter().zip(&in_file.train) {
        assert_eq!(a.photo.read().unwrap(), b.photo.read().unwrap());
        assert_eq!(b.photo.held_bytes(), 0);
    }
}

/// The photo of a view in a store that is not memory.
fn stored(view: &View) -> StoredPhoto {
    #[derive(Debug)]
    struct Shelf(Vec<u8>);
    impl PhotoStore for Shelf {
        fn read(&self, at: u64, out: &mut [u8]) -> std::io::Result<()> {
            out.copy_from_slice(&self.0[at as usize..at as usize + out.len()]);
            Ok(())
        }
    }
    let photo = view.photo.read().unwrap();
    StoredPhoto::in_store(Arc::new(Shelf(photo.rgb.clone())), 0, photo.width, photo.height)
}
