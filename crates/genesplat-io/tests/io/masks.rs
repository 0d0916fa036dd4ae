//! Masks beside photos, transparency, and what is made of them.

use std::fs;
use std::path::Path;

use crate::common::{SIZE, tiny_model, tiny_photo, write_scene};
use genesplat_core::{Photo, View};
use genesplat_io::colmap::Form;
use genesplat_io::{HoldOut, LoadOptions, MaskUse, PhotoSize, Scene, SceneError, load_scene, photos};

const WIDTH: u32 = SIZE[0];
const HEIGHT: u32 = SIZE[1];

/// Twelve columns of every forty are hidden.
fn is_hidden(x: u32) -> bool {
    (14..26).contains(&(x % 40))
}

fn mask() -> Photo {
    let value = |i: u32| if is_hidden(i / 3 % WIDTH) { 0 } else { 255 };
    Photo { width: WIDTH, height: HEIGHT, rgb: (0..3 * WIDTH * HEIGHT).map(value).collect() }
}

fn load(scene: &Path, mask: MaskUse) -> Result<Scene, SceneError> {
    load_scene(scene, &LoadOptions { mask, background: [9, 8, 7], ..LoadOptions::default() }, &())
}

fn views(scene: &Scene) -> impl Iterator<Item = &View> {
    scene.test.iter().chain(&scene.train)
}

#[test]
fn masks_are_found_under_the_names_of_both_conventions() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(4));
    for name in ["a b/000.png.png", "a b/001.png", "002.png.png"] {
        photos::write_png(&folder.path().join("masks").join(name), &mask()).unwrap();
    }
    let scene = load(folder.path(), MaskUse::Usual).unwrap();
    assert_eq!(views(&scene).map(View::counted_pixels).collect::<Vec<_>>(), [840, 840, 840, 1200]);
    assert_eq!(
        scene.notices,
        ["3 of 4 photos have a mask: what it hides counts for nothing (--mask ignore)"]
    );
    assert_eq!(scene.photos.len(), 7, "masks are not to be written over, either");

    let scene = load(folder.path(), MaskUse::Transparent).unwrap();
    assert!(scene.notices[0].contains("3 of 4 photos") && scene.notices[0].contains("must be background"));
    let view = &scene.test[0];
    assert_eq!((view.mask.is_none(), view.photo.read().unwrap().pixel(20, 3)), (true, [9, 8, 7]));
    assert_eq!(view.photo.read().unwrap().pixel(3, 3), tiny_photo(0, SIZE).pixel(3, 3));
}

#[test]
fn masks_of_other_programs_are_found() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(2));
    photos::write_png(&folder.path().join("mask/a b/000.mask.png"), &mask()).unwrap();
    let scene = load(folder.path(), MaskUse::Usual).unwrap();
    assert_eq!(views(&scene).map(View::counted_pixels).collect::<Vec<_>>(), [840, 1200]);
}

/// As RealityScan writes them; they are no photos without cameras.
#[test]
fn masks_among_the_photos_are_found() {
    for name in ["000.png.mask.png", "000.mask.png", "000_mask.png"] {
        let place = tempfile::tempdir().unwrap();
        write_scene(place.path(), Form::Binary, &tiny_model(2));
        photos::write_png(&place.path().join("images/a b").join(name), &mask()).unwrap();
        let scene = load(place.path(), MaskUse::Usual).unwrap();
        assert_eq!(views(&scene).map(View::counted_pixels).collect::<Vec<_>>(), [840, 1200], "{name}");
        assert_eq!(scene.notices.len(), 1, "{:?}", scene.notices);
        let without = load(place.path(), MaskUse::Off).unwrap();
        assert!(views(&without).all(|view| view.mask.is_none()) && without.notices.is_empty());
    }
}

/// RealityScan's, Metashape's, and those of people; photos are found in as many ways.
#[test]
fn masks_are_found_whatever_their_case_and_ending() {
    for (folder, name) in [
        ("masks", "000.png.mask.png"),
        ("masks", "a b/000_mask.png"),
        ("masks", "000_mask.PNG"),
        ("masks", "000.PNG"),
        ("masks", "000.PNG.Mask.Png"),
        ("Masks", "000.png.png"),
        ("mask", "000-mask.png"),
        ("masks", "000.jpg.png"),
    ] {
        let place = tempfile::tempdir().unwrap();
        write_scene(place.path(), Form::Binary, &tiny_model(2));
        let file = place.path().join(folder).join(name);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        photos::write_png(&place.path().join("mask_0.png"), &mask()).unwrap();
        fs::rename(place.path().join("mask_0.png"), &file).unwrap();
        let scene = load(place.path(), MaskUse::Usual).unwrap();
        let counted: Vec<_> = views(&scene).map(View::counted_pixels).collect();
        assert_eq!((counted, scene.doubts.len()), (vec![840, 1200], 0), "{folder}/{name}");
        let without = load(place.path(), MaskUse::Off).unwrap();
        assert!(views(&without).all(|view| view.mask.is_none()) && without.notices.is_empty());
        // Two that could be meant are none, and none that fits is doubted.
        fs::copy(&file, file.with_file_name("000 mask.jpg")).unwrap();
        fs::rename(&file, file.with_file_name("000-MASK.jpeg")).unwrap();
        assert_eq!(load(place.path(), MaskUse::Usual).unwrap().doubts.len(), 1);
    }
}

/// Black is not quite black in a JPEG.
#[test]
fn a_mask_that_is_a_jpeg_hides_what_is_dark() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(1);
    model.images[0].name = "0.jpg".into();
    write_scene(folder.path(), Form::Binary, &model);
    fs::create_dir(folder.path().join("masks")).unwrap();
    fs::write(folder.path().join("masks/0.jpg"), photos::encode_jpeg(&mask(), 75)).unwrap();
    let options = LoadOptions { hold_out: HoldOut::None, ..LoadOptions::default() };
    let scene = load_scene(folder.path(), &options, &()).unwrap();
    let counts = &scene.train[0].mask.as_ref().unwrap().counts;
    let wrong =
        (0..WIDTH * HEIGHT).filter(|index| counts[*index as usize] == is_hidden(index % WIDTH)).count();
    assert_eq!(wrong, 0);
}

#[test]
fn transparency_is_background_or_hidden() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(2));
    let glass = |x: u32, _| image::Rgba([100, 50, 20, if is_hidden(x) { 0 } else { 255 }]);
    image::RgbaImage::from_fn(WIDTH, HEIGHT, glass).save(folder.path().join("images/a b/000.png")).unwrap();
    for mask in [MaskUse::Usual, MaskUse::Transparent] {
        let scene = load(folder.path(), mask).unwrap();
        assert!(
            scene.test[0].mask.is_none() && scene.test[0].photo.read().unwrap().pixel(20, 3) == [9, 8, 7]
        );
        assert!(
            scene.notices[0].starts_with("1 of 2 photos are transparent in parts, which must be background")
        );
    }
    let scene = load(folder.path(), MaskUse::Ignore).unwrap();
    assert_eq!(views(&scene).map(View::counted_pixels).collect::<Vec<_>>(), [840, 1200]);
    assert!(scene.notices[0].contains("what is not opaque counts for nothing"), "{:?}", scene.notices);
    // Both together.
    let half = Photo { rgb: (0..3600).map(|i| if i / 3 / WIDTH < 15 { 0 } else { 255 }).collect(), ..mask() };
    photos::write_png(&folder.path().join("masks/a b/000.png"), &half).unwrap();
    let scene = load(folder.path(), MaskUse::Ignore).unwrap();
    assert_eq!(scene.test[0].counted_pixels(), 420);
}

#[test]
fn masks_that_cannot_be_meant_are_told() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(3));
    let masks = folder.path().join("masks");
    photos::write_png(&masks.join("IMG_1.png"), &mask()).unwrap();
    let scene = load(folder.path(), MaskUse::Usual).unwrap();
    let doubt = scene.doubts[0].to_string();
    for words in [
        "has no mask of any photo: that of 000.png would be called 000.png.png, and it has names like IMG_1.png",
        "go on without masks by --mask off",
    ] {
        assert!(doubt.contains(words), "{doubt}");
    }
    assert!(load(folder.path(), MaskUse::Off).unwrap().doubts.is_empty());
    for (size, advice) in [([20, 20], "make it as large as its photo"), ([30, 40], "turn it as its photo")] {
        photos::write_png(&masks.join("001.png"), &tiny_photo(0, size)).unwrap();
        let sentence = load(folder.path(), MaskUse::Usual).unwrap_err().to_string();
        let expected =
            format!("001.png is a mask of {}x{} pixels, and its photo has 40x30; {advice}", size[0], size[1]);
        assert!(sentence.contains(&expected), "{sentence}");
    }
    // A mask of the original size of reduced photos.
    let left = |x: u32| if x < 40 { 0 } else { 255 };
    let rgb = (0..80 * 60).flat_map(|pixel| [left(pixel % 80); 3]).collect();
    photos::write_png(&masks.join("001.png"), &Photo { width: 80, height: 60, rgb }).unwrap();
    let scene = load(folder.path(), MaskUse::Usual).unwrap();
    let counted = scene.train.iter().find(|view| view.name == "001.png").unwrap().counted_pixels();
    assert!((17 * 30..=20 * 30).contains(&counted), "about a half: {counted}");
    photos::write_png(&masks.join("001.png"), &Photo { rgb: vec![0; 3600], ..mask() }).unwrap();
    let scene = load(folder.path(), MaskUse::Usual).unwrap();
    assert_eq!((scene.train.len(), scene.test.len()), (1, 1));
    assert_eq!(scene.notices[1], "1 photo is hidden entirely and left out, first 001.png");
    photos::write_png(&masks.join("002.png"), &Photo { rgb: vec![0; 3600], ..mask() }).unwrap();
    let sentence = load(folder.path(), MaskUse::Usual).unwrap_err().to_string();
    assert!(sentence.contains("hide all of its training photos"), "{sentence}");
    fs::write(masks.join("002.png"), "none").unwrap();
    let sentence = load(folder.path(), MaskUse::Usual).unwrap_err().to_string();
    assert!(sentence.contains("002.png") && sentence.contains("neither a PNG nor"), "{sentence}");
}

/// Photos of 400x300 pixels through a lens, loaded at a third of their size.
#[test]
fn a_mask_that_cannot_be_read_is_called_a_mask_and_none_that_is_asked_for_is_told() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(4));
    for asked in [MaskUse::Ignore, MaskUse::Transparent] {
        let told = load(folder.path(), asked).unwrap().notices.join("; ");
        assert!(told.contains("no photo has a mask or is transparent"), "{told}");
    }
    fs::create_dir(folder.path().join("masks")).unwrap();
    fs::write(folder.path().join("masks/002.png"), "").unwrap();
    let told = load(folder.path(), MaskUse::Usual).unwrap_err().to_string();
    assert!(
        told.contains("masks/002.png is a mask that cannot be read") && told.contains("--mask off"),
        "{told}"
    );
}

#[test]
fn what_is_hidden_reaches_no_pixel_that_counts() {
    let [one, other] = [0, 200].map(|behind| {
        let folder = tempfile::tempdir().unwrap();
        let model = tiny_model(2);
        write_scene(folder.path(), Form::Text, &model);
        let lens = "7 OPENCV 400 300 355 362 205 147 -0.2 0.05 0.003 -0.002\n";
        fs::write(folder.path().join("sparse/0/cameras.txt"), lens).unwrap();
        for image in &model.images {
            let [photo, mask] = noise_and_mask(behind);
            photos::write_png(&folder.path().join("images").join(&image.name), &photo).unwrap();
            photos::write_png(&folder.path().join("masks").join(&image.name), &mask).unwrap();
        }
        let options = LoadOptions { size: PhotoSize::MaxSide(130), ..LoadOptions::default() };
        load_scene(folder.path(), &options, &()).unwrap().test.remove(0)
    });
    let mask = one.mask.clone().unwrap();
    assert!(one.mask == other.mask && (3000..8500).contains(&mask.counted()), "{}", mask.counted());
    assert!(
        one.photo.read().unwrap() != other.photo.read().unwrap()
            && mask.hide_in(&one.photo.read().unwrap()) == mask.hide_in(&other.photo.read().unwrap())
    );
}

/// Noise, with a grey in oblique stripes that the mask hides.
fn noise_and_mask(behind: u8) -> [Photo; 2] {
    let (width, height) = (400, 300);
    let is_hidden = |pixel: u32| is_hidden((pixel % width + 2 * (pixel / width)) % 160 / 4);
    let photo = |i: u32| if is_hidden(i / 3) { behind } else { (i.wrapping_mul(2_654_435_761) >> 24) as u8 };
    let mask = |i: u32| if is_hidden(i / 3) { 0 } else { 255 };
    let values = 0..3 * width * height;
    [values.clone().map(photo).collect(), values.map(mask).collect()].map(|rgb| Photo { width, height, rgb })
}
