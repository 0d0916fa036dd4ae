use std::io::Write;

use genesplat::core::Photo;
use genesplat::io::photos::{encode_jpeg, read_photo, write_png};

use super::*;

fn file(folder: &Path, name: &str) {
    fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
    fs::write(folder.join(name), name).unwrap();
}

#[cfg(unix)]
#[test]
fn folders_that_links_lead_to_are_looked_into_once_by_their_own_names() {
    use std::os::unix::fs::symlink;

    let place = tempfile::tempdir().unwrap();
    let [photos, elsewhere] = ["photos", "elsewhere"].map(|name| place.path().join(name));
    ["b/2.jpg", "1.jpg"].iter().for_each(|name| file(&photos, name));
    file(&elsewhere, "3.jpg");
    let links = [
        ("a", "b"),
        ("round", "."),
        ("again", "."),
        ("b/up", ".."),
        ("x", "../elsewhere"),
        ("w", "../elsewhere"),
    ];
    links.iter().for_each(|(name, to)| symlink(to, photos.join(name)).unwrap());
    assert_eq!(list(&photos).unwrap().photos, ["1.jpg", "b/2.jpg", "w/3.jpg"]);
}

#[test]
fn photos_are_found_in_subfolders_and_masks_are_none() {
    let place = tempfile::tempdir().unwrap();
    for name in ["b/2.JPG", "a.png", ".hidden.jpg", "masks/a.png", "notes.txt", "x.HEIC"] {
        file(place.path(), name);
    }
    let Found { photos, others, masks, .. } = list(place.path()).unwrap();
    assert_eq!((photos, others), (vec!["a.png".to_owned(), "b/2.JPG".into()], vec!["x.HEIC".to_owned()]));
    assert_eq!(masks, [place.path().join("masks")]);
}

#[cfg(unix)]
#[test]
fn a_name_that_leads_out_elsewhere_is_refused() {
    let photos = tempfile::tempdir().unwrap();
    for name in ["a\\..\\..\\x.jpg", "a\\2.heic", "\\x.webp"] {
        file(photos.path(), name);
        let refusal = Source::open(photos.path(), None).err().unwrap().to_string();
        assert!(refusal.contains("backslash") && refusal.contains("rename it"), "{refusal}");
        fs::remove_file(photos.path().join(name)).unwrap();
    }
}

#[test]
fn masks_come_along_under_the_names_of_their_photos() {
    let place = tempfile::tempdir().unwrap();
    for name in
        ["a/images/1.jpg", "a/images/2.jpg", "a/masks/1.png", "b/1.jpg", "b/masks/1.jpg.png", "b/masks/9.png"]
    {
        file(place.path(), name);
    }
    for (given, scene) in [("a", "of-a"), ("a/images", "of-images"), ("b", "of-b")] {
        let source = Source::open(&place.path().join(given), None).unwrap();
        let scene = place.path().join(scene);
        assert!(source.fill(&scene.join(IMAGES), &scene.join("work"), &AtomicBool::new(false)).unwrap());
        let masks: Vec<PathBuf> =
            fs::read_dir(scene.join("masks")).unwrap().map(|mask| mask.unwrap().path()).collect();
        assert_eq!(masks, [scene.join("masks/1.jpg.png")]);
    }
    file(place.path(), "b/masks/1.jpg.png.bak");
    let (b, work) = (place.path().join("b"), place.path().join("work"));
    fs::create_dir(&work).unwrap();
    Source::open(&b, None).unwrap().check_same(&work).unwrap();
    fs::write(b.join("masks/1.jpg.png"), "another mask").unwrap();
    assert!(Source::open(&b, None).unwrap().check_same(&work).is_err(), "features were looked for elsewhere");
}

/// WebP, lossless.
const ONE_PIXEL: &[u8] = b"RIFF\x1a\0\0\0WEBPVP8L\x0d\0\0\0\x2f\0\0\0\x10\x07\x10\x11\x11\x88\x88\xfe\x07\0";

#[test]
fn webp_photos_become_png_and_others_stay_as_they_are() {
    let place = tempfile::tempdir().unwrap();
    let [photos, images] = ["photos", "images"].map(|name| place.path().join(name));
    file(&photos, "b/1.jpg");
    fs::write(photos.join("2.WebP"), ONE_PIXEL).unwrap();
    let source = Source::open(&photos, None).unwrap();
    let never = AtomicBool::new(false);
    assert!(
        source.fill(&images, place.path(), &never).unwrap()
            && source.fill(&images, place.path(), &never).unwrap()
    );
    assert_eq!(names_in(&images).unwrap(), ["2.WebP.png", "b/1.jpg"]);
    let [png, webp] =
        [images.join("2.WebP.png"), photos.join("2.WebP")].map(|path| read_photo(&path).unwrap());
    assert_eq!(png, webp);
    assert_eq!(names_in(&photos).unwrap(), ["b/1.jpg"], "photos that lie in the scene already");
}

/// A JPEG whose EXIF data say that it is to be turned by a quarter.
fn lying() -> Vec<u8> {
    let jpeg = encode_jpeg(&Photo { width: 32, height: 16, rgb: vec![90; 3 * 32 * 16] }, 90);
    let tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    [&[0xFF, 0xD8, 0xFF, 0xE1, 0, 8 + tiff.len() as u8][..], b"Exif\0\0", tiff, &jpeg[2..]].concat()
}

#[test]
fn photos_that_lie_on_their_side_are_turned_with_their_masks() {
    let place = tempfile::tempdir().unwrap();
    let [photos, scene] = ["photos", "scene"].map(|name| place.path().join(name));
    file(&photos, "b/1.jpg");
    fs::write(photos.join("2.jpg"), lying()).unwrap();
    write_png(&photos.join("masks/2.png"), &Photo { width: 32, height: 16, rgb: vec![255; 3 * 32 * 16] })
        .unwrap();
    let (source, images) = (Source::open(&photos, None).unwrap(), scene.join(IMAGES));
    assert!(source.fill(&images, place.path(), &AtomicBool::new(false)).unwrap());
    for file in ["images/2.jpg", "masks/2.jpg.png"] {
        assert_eq!(photo_size(&scene.join(file)).unwrap(), (16, 32), "{file}");
    }
    assert_eq!(fs::read(images.join("b/1.jpg")).unwrap(), b"b/1.jpg");
}

#[test]
fn webp_photos_in_the_scene_stay_the_same_photos_beside_their_png() {
    let place = tempfile::tempdir().unwrap();
    let [images, work] = [IMAGES, "poses"].map(|name| place.path().join(name));
    fs::create_dir(&images).unwrap();
    fs::write(images.join("1.webp"), ONE_PIXEL).unwrap();
    for _ in 0..2 {
        let source = Source::open(place.path(), None).unwrap();
        source.check_same(&work).unwrap();
        assert!(source.fill(&images, &work, &AtomicBool::new(false)).unwrap());
        assert_eq!(names_in(&images).unwrap(), ["1.webp.png"]);
    }
}

#[test]
fn photos_of_an_archive_are_unpacked_once() {
    let place = tempfile::tempdir().unwrap();
    let [archive, images, work] = ["trip.zip", "images", "work"].map(|name| place.path().join(name));
    let mut zip = zip::ZipWriter::new(fs::File::create(&archive).unwrap());
    let photo = Photo { width: 8, height: 4, rgb: vec![90; 3 * 8 * 4] };
    write_png(&place.path().join("2.PNG"), &photo).unwrap();
    let (jpeg, png) = (encode_jpeg(&photo, 90), fs::read(place.path().join("2.PNG")).unwrap());
    // The third photo is damaged, and left out.
    let files: [(&str, &[u8]); 4] =
        [("trip/1.jpg", &jpeg), ("trip/b/2.PNG", &png), ("trip/3.jpg", b""), ("trip/notes.txt", b"")];
    for (name, bytes) in files {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap();
    let (source, never) = (Source::open(&archive, None).unwrap(), AtomicBool::new(false));
    source.check_same(&work).unwrap();
    assert!(!source.is_video() && source.fill(&images, &work, &never).unwrap());
    assert_eq!(names_in(&images).unwrap(), ["trip/1.jpg", "trip/b/2.PNG"]);
    // Whatever has been unpacked stays.
    fs::remove_file(work.join("unpacked/trip/1.jpg")).unwrap();
    assert!(source.fill(&images, &work, &never).unwrap() && names_in(&images).unwrap().len() == 2);
    assert!(!work.join("unpacked/trip/1.jpg").exists());
}

#[test]
fn stages_of_other_photos_are_refused() {
    let place = tempfile::tempdir().unwrap();
    let (photos, work) = (place.path().join("photos"), place.path().join("work"));
    file(&photos, "a.jpg");
    let check = || Source::open(&photos, None).unwrap().check_same(&work);
    check().unwrap();
    check().unwrap();
    file(&photos, "b.jpg");
    let refused = check().unwrap_err().to_string();
    assert!(refused.contains("other photos") && refused.contains("--out"), "{refused}");
    assert!(!refused.contains("remove"), "the scene holds photos, whose it is not known: {refused}");
}

#[test]
fn of_photos_in_the_scene_none_is_said_to_be_removable() {
    let place = tempfile::tempdir().unwrap();
    let work = place.path().join("poses");
    file(place.path(), "images/a.jpg");
    let check = || Source::open(place.path(), None).unwrap().check_same(&work);
    check().unwrap();
    file(place.path(), "images/b.jpg");
    let refused = check().unwrap_err().to_string();
    let [work, sparse] = [&work, &place.path().join("sparse")].map(shown);
    assert!(refused.ends_with(&format!("or remove {work} and {sparse} to start anew")), "{refused}");
}

#[test]
fn heic_photos_are_converted_with_their_masks_or_what_it_takes_is_said() {
    let place = tempfile::tempdir().unwrap();
    let (photos, images) = (place.path().join("photos"), place.path().join("scene/images"));
    file(&photos, "b/1.HEIC");
    file(&photos, "masks/1.png");
    let source = Source::open(&photos, None).unwrap();
    let (pairs, never) = (source.heic(&images), AtomicBool::new(false));
    assert_eq!(pairs, [(photos.join("b/1.HEIC"), images.join("b/1.HEIC.jpg"))]);
    assert!(source.fill(&images, place.path(), &never).unwrap());
    assert!(place.path().join("scene/masks/b/1.HEIC.jpg.png").exists());
    let engine = super::super::engine::Engine::of_python("no-such-python");
    let refused = heic::convert(&pairs, &engine, place.path(), &never).unwrap_err().to_string();
    assert!(refused.contains("1 photo is HEIC") && refused.contains("pip install pillow-heif"), "{refused}");
}

#[test]
fn what_is_neither_photos_nor_a_video_is_said() {
    let place = tempfile::tempdir().unwrap();
    let refusal =
        |name: &str, frames| Source::open(&place.path().join(name), frames).err().unwrap().to_string();
    for name in ["empty/notes.txt", "phone/1.dng", "photos/1.jpg", "scene.zip", "scene.rar"] {
        file(place.path(), name);
    }
    // Masks among photos are none of them.
    for name in
        ["among/1.jpg", "among/1.jpg.mask.png", "among/b/2.png", "among/b/2_mask.png", "among/x_mask.png"]
    {
        file(place.path(), name);
    }
    let among = list(&place.path().join("among")).unwrap();
    assert_eq!(among.photos, ["1.jpg", "b/2.png", "x_mask.png"]);
    assert_eq!(among.beside.iter().map(|(name, _)| &**name).collect::<Vec<_>>(), ["1.jpg", "b/2.png"]);
    // Cameras would be found on what they hide.
    ["masked/1.jpg", "masked/masks/IMG_7.png"].iter().for_each(|name| file(place.path(), name));
    let unfit = refusal("masked", None);
    assert!(unfit.contains("no mask of any photo") && unfit.contains("like IMG_7.png"), "{unfit}");
    assert!(refusal("absent", None).contains("does not exist"));
    assert!(refusal("empty", None).contains("holds no photos"));
    assert!(refusal("phone", None).contains("1.dng is one of 1"));
    assert!(refusal("photos", Some(9)).contains("--frames is for a video"));
    assert!(refusal("scene.zip", Some(9)).contains("--frames is for a video"));
    assert!(refusal("scene.rar", None).contains("neither a folder or a zip of photos nor a video"));
}
