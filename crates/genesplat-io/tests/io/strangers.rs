//! Scenes as strangers lay them out, and names as their systems write them.

use std::fs;
use std::path::Path;

use crate::common::{CLAIM, claiming, tiny_model, write_form, write_scene};
use genesplat_io::colmap::Form;
use genesplat_io::{HoldOut, LoadOptions, MaskUse, Scene, load_scene};

fn load(path: &Path, options: &LoadOptions) -> Result<Scene, String> {
    load_scene(path, options, &()).map_err(|error| error.to_string())
}

/// A model in `model`, and the three photos that it lists in `photos`.
fn lay_out(place: &Path, model: &str, photos: &str) {
    let scene = tempfile::tempdir().unwrap();
    write_scene(scene.path(), Form::Text, &tiny_model(3));
    write_form(&place.join(model), Form::Text, &tiny_model(3));
    let to = place.join(photos).join("a b");
    fs::create_dir_all(&to).unwrap();
    for photo in fs::read_dir(scene.path().join("images/a b")).unwrap().flatten() {
        fs::copy(photo.path(), to.join(photo.file_name())).unwrap();
    }
}

#[test]
fn models_and_photos_are_found_wherever_they_lie() {
    for (model, photos, notice) in [
        ("", "", "the photos are those in"),
        ("sparse/0", "", "the photos are those in"),
        ("sparse/0", "sparse/0", "the photos are those in"),
        ("model", "images", "the COLMAP model in"),
        ("model", "model", "the photos are those in"),
        ("0", "images", "the COLMAP model in"),
        ("colmap/0", "images", "the COLMAP model in"),
        ("export/undistorted/sparse/0", "", "the COLMAP model in"),
        ("distorted/sparse/0", "images", "the COLMAP model in"),
        ("distorted/sparse/0", "images", "distorted/sparse/0"),
    ] {
        let place = tempfile::tempdir().unwrap();
        lay_out(place.path(), model, photos);
        let scene =
            load(place.path(), &LoadOptions::default()).unwrap_or_else(|error| panic!("{model}: {error}"));
        assert_eq!(scene.train.len() + scene.test.len(), 3, "{model}, {photos}");
        let is_told = scene.notices.iter().any(|said| said.contains(notice));
        assert!(is_told, "{model}, {photos}: {:?}", scene.notices);
    }
}

#[test]
fn what_is_found_and_not_taken_is_named() {
    for (model, photos, says) in [
        ("model", "photos", "photos has photos of these names, so give --images photos"),
        ("distorted/sparse/0", "input", "distorted/sparse/0/images.txt lists is in"),
        ("distorted/sparse/0", "input", "so give --images input"),
    ] {
        let place = tempfile::tempdir().unwrap();
        lay_out(place.path(), model, photos);
        let refused = load(place.path(), &LoadOptions::default()).unwrap_err();
        assert!(refused.contains(says) && !refused.contains("no cameras"), "{refused}");
        let asked = LoadOptions { image_folder: photos.into(), ..LoadOptions::default() };
        assert_eq!(load(place.path(), &asked).unwrap().train.len(), 2, "the remedy works");
    }
    // Who asks for a folder is given no other.
    let place = tempfile::tempdir().unwrap();
    lay_out(place.path(), "sparse/0", "");
    let asked = LoadOptions { image_folder: "images_2".into(), ..LoadOptions::default() };
    assert!(load(place.path(), &asked).unwrap_err().contains("none of the 3 photos"));
    // Two could be meant.
    let place = tempfile::tempdir().unwrap();
    lay_out(place.path(), "one", "images");
    lay_out(place.path(), "two", "images");
    let refused = load(place.path(), &LoadOptions::default()).unwrap_err();
    assert!(refused.contains("one and in") && refused.contains("two; give the folder"), "{refused}");
    // A part of a model is not said to be none.
    let place = tempfile::tempdir().unwrap();
    lay_out(place.path(), "sparse/0", "images");
    fs::remove_file(place.path().join("sparse/0/cameras.txt")).unwrap();
    let refused = load(place.path(), &LoadOptions::default()).unwrap_err();
    assert!(refused.contains("has no cameras.txt beside images.txt; copy all files"), "{refused}");
}

/// As macOS packs archives, and lists have it the other way.
#[test]
fn names_are_compared_in_one_normal_form() {
    let [composed, decomposed] = ["\u{e9}t\u{e9}", "e\u{301}te\u{301}"];
    for (listed, there) in [(composed, decomposed), (decomposed, composed)] {
        let place = tempfile::tempdir().unwrap();
        let mut model = tiny_model(9);
        model.images.iter_mut().enumerate().for_each(|(at, image)| image.name = format!("{there}{at}.png"));
        write_scene(place.path(), Form::Binary, &model);
        model.images.iter_mut().enumerate().for_each(|(at, image)| image.name = format!("{listed}{at}.png"));
        write_form(&place.path().join("sparse/0"), Form::Binary, &model);
        fs::create_dir(place.path().join("masks")).unwrap();
        let photo = |name: &str| place.path().join(name);
        fs::copy(photo(&format!("images/{there}3.png")), photo(&format!("masks/{there}3.PNG"))).unwrap();
        for name in [listed, there] {
            let hold_out = HoldOut::Photos(vec![format!("{name}4.png"), format!("{name}5")]);
            let scene = load(place.path(), &LoadOptions { hold_out, ..LoadOptions::default() }).unwrap();
            assert_eq!((scene.train.len(), scene.test.len()), (7, 2));
            let told = "9 photos have names in other characters than";
            let [said, ..] = &scene.notices[..] else { panic!("nothing is said") };
            assert!(said.contains(told) && said.contains("they look alike, and differ in Unicode"), "{said}");
            assert!(scene.notices.iter().any(|said| said.contains("1 of 9 photos have a mask")));
        }
        // A sentence that shows two names that look the same says how they differ.
        let hold_out = HoldOut::Photos(vec![format!("{listed}0.png").replace('t', "\u{442}")]);
        let refused = load(place.path(), &LoadOptions { hold_out, ..LoadOptions::default() }).unwrap_err();
        assert!(refused.contains("no photo called") && refused.contains("U+0442 in the first"), "{refused}");
    }
}

#[test]
fn most_photos_without_cameras_are_a_doubt() {
    let place = tempfile::tempdir().unwrap();
    write_scene(place.path(), Form::Binary, &tiny_model(4));
    let photo = |name: &str| place.path().join("images/a b").join(name);
    let more = |range: std::ops::Range<usize>| {
        range.for_each(|at| _ = fs::copy(photo("000.png"), photo(&format!("more_{at}.png"))).unwrap());
        load(place.path(), &LoadOptions { mask: MaskUse::Off, ..LoadOptions::default() }).unwrap()
    };
    let half = more(0..4);
    assert!(half.doubts.is_empty() && half.notices[0].starts_with("4 of the 8 photos have no camera"));
    let [doubt] = &more(4..5).doubts[..] else { panic!("no doubt") };
    assert!(doubt.problem.starts_with("only 4 of the 9 photos have a camera in"), "{doubt}");
    assert!(doubt.remedy.contains("--anyway"), "{doubt}");
    // Whoever names a model means the photos that it has.
    assert!(load(&place.path().join("sparse/0"), &LoadOptions::default()).unwrap().doubts.is_empty());
}

#[test]
fn lists_of_cameras_may_be_utf_16() {
    let place = tempfile::tempdir().unwrap();
    lay_out(place.path(), "sparse/0", "images");
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        let file = place.path().join("sparse/0").join(name);
        let text = fs::read_to_string(&file).unwrap().replace('\n', "\r\n");
        let units = [0xFEFF].into_iter().chain(text.encode_utf16());
        fs::write(&file, units.flat_map(u16::to_le_bytes).collect::<Vec<_>>()).unwrap();
    }
    let scene = load(place.path(), &LoadOptions::default()).unwrap();
    assert_eq!((scene.train.len(), scene.points.len()), (2, 9));
}

/// As one that is absent is; where none is left to train on, the first says why.
/// As programs write them that list photos where they were taken from.
#[test]
fn names_that_lead_out_of_a_folder_are_looked_for_in_it() {
    for before in ["/home/me/scene/images/", "../photos/", "C:\\Users\\me\\"] {
        let folder = tempfile::tempdir().unwrap();
        let (mut listed, mut there) = (tiny_model(3), tiny_model(3));
        let last = |name: &str| name.replace("a b/", "");
        there.images.iter_mut().for_each(|image| image.name = last(&image.name));
        listed.images.iter_mut().for_each(|image| image.name = format!("{before}{}", last(&image.name)));
        write_scene(folder.path(), Form::Text, &there);
        write_form(&folder.path().join("sparse/0"), Form::Text, &listed);
        let scene = load(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!(scene.train.len() + scene.test.len(), 3, "{before}");
        // What is not in the folder is not looked for elsewhere.
        fs::remove_dir_all(folder.path().join("images")).unwrap();
        assert!(load(folder.path(), &LoadOptions::default()).is_err(), "{before}");
    }
}

#[cfg(unix)]
#[test]
fn a_link_to_a_photo_that_is_gone_counts_as_an_absent_photo() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(3));
    let photo = folder.path().join("images/a b/001.png");
    fs::remove_file(&photo).unwrap();
    std::os::unix::fs::symlink("gone.png", &photo).unwrap();
    let scene = load(folder.path(), &LoadOptions::default()).unwrap();
    assert_eq!(scene.train.len() + scene.test.len(), 2);
    let [notice] = &scene.notices[..] else { panic!("{:?}", scene.notices) };
    assert!(notice.starts_with("1 of the 3 photos that") && notice.contains("do not exist"), "{notice}");
}

/// As programs write where they have found nothing.
#[test]
fn a_pose_of_zeros_is_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(3);
    write_scene(folder.path(), Form::Text, &model);
    model.images[1].rotation = [0.0; 4];
    write_form(&folder.path().join("sparse/0"), Form::Text, &model);
    let scene = load(folder.path(), &LoadOptions::default()).unwrap();
    assert_eq!(scene.train.len() + scene.test.len(), 2);
    let notice = &scene.notices[0];
    assert!(notice.contains("not finite, or of zeros, and is left out, first a b/001.png"), "{notice}");
}

#[test]
fn what_a_model_lacks_is_named() {
    for (gone, there) in [("images", "cameras"), ("cameras", "images")] {
        for form in [Form::Text, Form::Binary] {
            let folder = tempfile::tempdir().unwrap();
            write_scene(folder.path(), form, &tiny_model(3));
            let ending = if form == Form::Text { "txt" } else { "bin" };
            fs::remove_file(folder.path().join(format!("sparse/0/{gone}.{ending}"))).unwrap();
            let refused = load(folder.path(), &LoadOptions::default()).unwrap_err();
            assert!(
                refused.contains(&format!("has no {gone}.{ending} beside {there}.{ending}")),
                "{refused}"
            );
        }
    }
}

#[test]
fn a_damaged_photo_is_left_out_and_counted() {
    let torn: &[u8] = b"\xFF\xD8\xFF\xE0\x00\x10JFIF\0\x01\x01\0\0\x01\0\x01\0\0\xFF\xDA\x00\x02torn";
    for (bytes, problem) in [
        (b"not a picture".to_vec(), "neither a PNG nor a JPEG nor a WebP"),
        (torn.to_vec(), "cut off"),
        (claiming(CLAIM), "13344x18742 pixels"),
    ] {
        for (damaged, left) in [(0, [2, 0]), (1, [1, 1])] {
            let folder = tempfile::tempdir().unwrap();
            write_scene(folder.path(), Form::Binary, &tiny_model(3));
            let photo = |index: usize| folder.path().join(format!("images/a b/{index:03}.png"));
            fs::write(photo(damaged), &bytes).unwrap();
            let load = || load_scene(folder.path(), &LoadOptions::default(), &());
            let scene = load().unwrap();
            assert_eq!([scene.train.len(), scene.test.len()], left);
            let [notice] = &scene.notices[..] else { panic!("{:?}", scene.notices) };
            assert!(
                notice.starts_with("1 of the 3 photos cannot be used and is left out, first: "),
                "{notice}"
            );
            assert!(notice.contains(problem) && notice.contains(&format!("00{damaged}.png")), "{notice}");
            let digests = genesplat_io::scene_digests(folder.path(), &LoadOptions::default()).unwrap();
            assert_eq!(digests.photos, scene.digests.photos, "a photo that is repaired is another");
            (1..3).for_each(|index| fs::write(photo(index), &bytes).unwrap());
            let sentence = load().unwrap_err().to_string();
            assert!(sentence.contains(problem) && sentence.contains("export it again"), "{sentence}");
        }
    }
}
