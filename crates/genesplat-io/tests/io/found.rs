//! Scenes that are not quite where or what was said: each is found, with a notice, or refused in a sentence.

use std::fs;
use std::path::Path;

use crate::common::{SIZE, tiny_model, tiny_photo, write_form, write_scene};
use genesplat_core::Photo;
use genesplat_io::colmap::{Form, Model};
use genesplat_io::{LoadOptions, Scene, load_scene, photos};
use tempfile::TempDir;

fn tiny_scene(photos: usize) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Text, &tiny_model(photos));
    folder
}

fn load(path: &Path) -> Result<Scene, String> {
    load_scene(path, &LoadOptions::default(), &()).map_err(|error| error.to_string())
}

/// The number of photos, and the only notice.
fn found(path: &Path) -> (usize, String) {
    let mut scene = load(path).unwrap();
    assert_eq!(scene.notices.len(), 1, "{:?}", scene.notices);
    (scene.train.len() + scene.test.len(), scene.notices.remove(0))
}

#[test]
fn photos_of_another_case_or_ending_are_found() {
    let folder = tiny_scene(3);
    let photo = |name: &str| folder.path().join("images/a b").join(name);
    fs::rename(photo("001.png"), photo("001.PNG")).unwrap();
    fs::rename(photo("002.png"), photo("002.Jpeg")).unwrap();
    let (photos, notice) = found(folder.path());
    assert!(photos == 3 && notice.starts_with("2 photos have other cases or endings than"), "{notice}");
    assert!(notice.ends_with("first 001.PNG for 001.png"), "{notice}");
    // Two that could be meant are none.
    fs::copy(photo("002.Jpeg"), photo("002.JPG")).unwrap();
    assert_eq!(load(folder.path()).unwrap().notices.len(), 3);
    fs::rename(folder.path().join("images"), folder.path().join("Images")).unwrap();
    assert_eq!(load(folder.path()).unwrap().notices.len(), 3);
}

#[test]
fn photos_that_are_absent_are_counted_and_others_named() {
    let folder = tiny_scene(4);
    let photo = |name: &str| folder.path().join("images/a b").join(name);
    fs::remove_file(photo("001.png")).unwrap();
    fs::remove_file(photo("003.png")).unwrap();
    let (photos, notice) = found(folder.path());
    assert!(
        photos == 2 && notice.contains("2 of the 4 photos that") && notice.contains("a b/001.png"),
        "{notice}"
    );
    fs::rename(photo("000.png"), photo("IMG_7.png")).unwrap();
    fs::rename(photo("002.png"), photo("IMG_8.png")).unwrap();
    let sentence = load(folder.path()).unwrap_err();
    assert!(
        sentence.contains("none of the 4 photos") && sentence.contains("IMG_7.png where 000.png is wanted"),
        "{sentence}"
    );
}

#[test]
fn photos_without_a_camera_are_counted_where_they_are_many() {
    let folder = tiny_scene(18);
    let photo = |name: &str| folder.path().join("images/a b").join(name);
    // Made of a photo that has a camera, or no photo.
    fs::write(photo("notes.txt"), "").unwrap();
    fs::copy(photo("000.png"), photo("000.webp")).unwrap();
    fs::copy(photo("000.png"), photo("900.png")).unwrap();
    assert_eq!(load(folder.path()).unwrap().notices, [""; 0], "one of twenty");
    fs::copy(photo("000.png"), photo("901.png")).unwrap();
    fs::copy(photo("000.png"), photo("902.jpg")).unwrap();
    let (photos, notice) = found(folder.path());
    assert!(photos == 18 && notice.starts_with("3 of the 22 photos have no camera in"), "{notice}");
}

#[test]
fn one_photo_for_two_records_is_refused() {
    let mut model = tiny_model(2);
    (model.images[0].name, model.images[1].name) = ("x/1.png".into(), "y/1.png".into());
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &model);
    assert!(load(folder.path()).is_ok());
    let image = |name: &str| folder.path().join("images").join(name);
    fs::rename(image("x/1.png"), image("1.png")).unwrap();
    fs::remove_file(image("y/1.png")).unwrap();
    let sentence = load(folder.path()).unwrap_err();
    assert!(
        sentence.contains("lists x/1.png and y/1.png") && sentence.contains("the only photo for both"),
        "{sentence}"
    );
}

#[test]
fn points_that_are_absent_are_drawn() {
    let folder = tiny_scene(3);
    fs::write(folder.path().join("sparse/0/points3D.txt"), "# none\n").unwrap();
    let (_, notice) = found(folder.path());
    assert!(notice.contains("no points") && notice.contains("100000 random ones"), "{notice}");
    fs::remove_file(folder.path().join("sparse/0/points3D.txt")).unwrap();
    assert_eq!(found(folder.path()).1, notice);
    let of_seed = |seed| {
        load_scene(folder.path(), &LoadOptions { seed, ..LoadOptions::default() }, &()).unwrap().points
    };
    assert!(of_seed(1) == of_seed(1) && of_seed(1) != of_seed(2));
    fs::write(folder.path().join("sparse/0/points3D.txt"), "1 0 0 0 1 2 3 0.1\n").unwrap();
    assert!(found(folder.path()).1.contains("has only 1 point, so training starts from 100000 random ones"));
}

#[test]
fn names_and_marks_of_windows_are_understood() {
    let folder = tiny_scene(3);
    let sparse = |name: &str| folder.path().join("sparse/0").join(name);
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        let text = fs::read_to_string(sparse(name)).unwrap().replace("a b/", "a b\\").replace('\n', "\r\n");
        fs::write(sparse(name), format!("\u{feff}{text}")).unwrap();
    }
    let scene = load(folder.path()).unwrap();
    assert_eq!((scene.train.len(), scene.train[0].name.as_str(), scene.notices.len()), (2, "001.png", 0));
}

#[test]
fn of_several_models_the_one_with_the_most_photos_is_used() {
    for form in [Form::Binary, Form::Text] {
        let folder = tempfile::tempdir().unwrap();
        write_scene(folder.path(), form, &tiny_model(5));
        let sparse = |name: &str| folder.path().join("sparse").join(name);
        write_form(&sparse("0"), form, &tiny_model(2));
        write_form(&sparse("1"), form, &tiny_model(5));
        write_form(&sparse("10"), form, &tiny_model(3));
        let (photos, notice) = found(folder.path());
        assert!(
            photos == 5
                && notice.contains("into 3 models")
                && notice.contains("sparse/1 is used, the largest"),
            "{notice}"
        );
        // Of equal ones the first, and the only one whatever it is called.
        write_form(&sparse("1"), form, &tiny_model(2));
        fs::remove_dir_all(sparse("10")).unwrap();
        assert!(found(folder.path()).1.contains("sparse/0 is used, the largest"));
        fs::remove_dir_all(sparse("0")).unwrap();
        assert_eq!(load(folder.path()).unwrap().train.len(), 1);
    }
}

#[test]
fn points_may_be_in_another_form_than_cameras() {
    let model = tiny_model(3);
    let forms = [(Form::Binary, "points3D.bin"), (Form::Text, "points3D.txt")];
    for (form, other) in [(Form::Binary, forms[1]), (Form::Text, forms[0])] {
        let [folder, donor] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        write_scene(folder.path(), form, &model);
        write_form(donor.path(), other.0, &model);
        let sparse = folder.path().join("sparse/0");
        forms.iter().for_each(|(_, points)| _ = fs::remove_file(sparse.join(points)));
        fs::rename(donor.path().join(other.1), sparse.join(other.1)).unwrap();
        assert_eq!(load(folder.path()).unwrap().points, model.points);
    }
    let folder = tiny_scene(3);
    let sparse = folder.path().join("sparse/0");
    fs::remove_file(sparse.join("points3D.txt")).unwrap();
    let properties = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"];
    let properties = properties.map(|name| format!("property {name}\n")).concat();
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex 4\n{properties}end_header\n{}",
        "1 2 3 4 5 6\n".repeat(4)
    );
    fs::write(sparse.join("points3D.ply"), ply).unwrap();
    let points = load(folder.path()).unwrap().points;
    assert_eq!((points.len(), points[3].position, points[3].rgb), (4, [1.0, 2.0, 3.0], [4, 5, 6]));
}

#[test]
fn a_part_of_a_scene_stands_for_the_whole() {
    let folder = tiny_scene(3);
    for part in ["sparse/0", "sparse", "images", "images/a b", "sparse/0/images.txt", "sparse/0/cameras.txt"]
    {
        let (photos, notice) = found(&folder.path().join(part));
        assert!(photos == 3 && notice.contains("of which a part was given"), "{part}: {notice}");
    }
    // As nerfstudio keeps COLMAP's files, and as archives are unpacked.
    fs::create_dir(folder.path().join("colmap")).unwrap();
    fs::rename(folder.path().join("sparse"), folder.path().join("colmap/sparse")).unwrap();
    assert_eq!(load(folder.path()).unwrap().train.len(), 2);
    assert_eq!(found(&folder.path().join("colmap/sparse/0")).0, 3);
    let outer = tempfile::tempdir().unwrap();
    fs::rename(folder.path(), outer.path().join("scene")).unwrap();
    assert_eq!(found(outer.path()).0, 3);
    let outermost = tempfile::tempdir().unwrap();
    fs::create_dir_all(outermost.path().join("export/mine")).unwrap();
    fs::rename(outer.path().join("scene"), outermost.path().join("export/mine/scene")).unwrap();
    assert_eq!(found(outermost.path()).0, 3);
    write_scene(&outermost.path().join("export/other/scene"), Form::Text, &tiny_model(3));
    assert!(load(outermost.path()).is_err(), "two could be meant");
    fs::create_dir(folder.path()).unwrap();
}

/// COLMAP's dense workspace holds the photos without distortion, and their model; the model beside is of
/// others.
#[test]
fn the_scene_in_a_workspace_is_found() {
    let folder = tempfile::tempdir().unwrap();
    write_form(&folder.path().join("sparse/0"), Form::Binary, &tiny_model(3));
    write_scene(&folder.path().join("dense/0"), Form::Text, &tiny_model(3));
    let (photos, notice) = found(folder.path());
    assert!(photos == 3 && notice.contains("dense"), "{notice}");
}

#[test]
fn one_of_several_models_is_used_as_it_was_given() {
    let folder = tiny_scene(5);
    let other = Model { images: tiny_model(5).images[..2].to_vec(), ..tiny_model(5) };
    write_form(&folder.path().join("sparse/1"), Form::Text, &other);
    let photos = |part: &str| {
        let scene = load(&folder.path().join(part)).unwrap();
        assert!(scene.notices.iter().any(|notice| notice.contains("split the photos into 2 models")));
        scene.train.len() + scene.test.len()
    };
    assert_eq!(["", "sparse/0", "sparse/1"].map(photos), [5, 5, 2]);
}

#[test]
fn photos_of_another_folder_are_taken_where_it_is_named() {
    let folder = tiny_scene(3);
    fs::rename(folder.path().join("images"), folder.path().join("images_4")).unwrap();
    let sentence = load(folder.path()).unwrap_err();
    assert!(sentence.contains("images_4 has photos of these names, so give --images images_4"), "{sentence}");
    let options = LoadOptions { image_folder: "images_4".into(), ..LoadOptions::default() };
    assert_eq!(load_scene(folder.path(), &options, &()).unwrap().train.len(), 2);
}

#[test]
fn a_camera_far_from_all_others_is_told() {
    let told = |at: f64| {
        let mut model = tiny_model(5);
        model.images[3].translation[0] = at;
        let folder = tempfile::tempdir().unwrap();
        write_scene(folder.path(), Form::Text, &model);
        load(folder.path()).unwrap().notices
    };
    assert_eq!(told(20.0), Vec::<String>::new());
    let notices = told(-3000.0);
    assert!(
        notices.len() == 1 && notices[0].starts_with("1 camera stands far from the others, 003.png"),
        "{notices:?}"
    );
}

#[test]
fn files_that_are_no_scene_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    for (name, says) in [
        ("scene.zip", "`genesplat train` takes a zip"),
        ("scene.tar.gz", "is an archive; unpack it"),
        ("a.jpg", "is one photo; give the folder"),
        ("notes.txt", "is a file; give the folder of a scene"),
        ("film.MP4", "is a video, and training needs to know"),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, "x").unwrap();
        let sentence = load(&path).unwrap_err();
        assert!(sentence.contains(name) && sentence.contains(says), "{sentence}");
    }
}

#[test]
fn cameras_of_other_programs_are_told_apart() {
    for (name, says) in [
        ("cameras.xml", "Metashape"),
        ("reconstruction.json", "opensfm export_colmap"),
        ("poses_bounds.npy", "LLFF"),
        ("sfm_data.json", "openMVG2Colmap"),
        ("cameras.json", "rename it to transforms.json"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        photos::write_png(&folder.path().join("images/0.png"), &tiny_photo(0, SIZE)).unwrap();
        fs::write(folder.path().join(name), "x").unwrap();
        let sentence = load(folder.path()).unwrap_err();
        assert!(
            sentence.contains(name) && sentence.contains(says) && sentence.contains("poses"),
            "{sentence}"
        );
    }
}

#[test]
fn webp_photos_are_read_whole_or_not_at_all() {
    let folder = tiny_scene(1);
    let photo = tiny_photo(5, SIZE);
    let path = folder.path().join("a.webp");
    image::RgbImage::from_raw(SIZE[0], SIZE[1], photo.rgb.clone()).unwrap().save(&path).unwrap();
    assert_eq!(photos::read_photo(&path).unwrap(), photo);
    let whole = fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(7) {
        fs::write(&path, &whole[..length]).unwrap();
        // The last byte fills a chunk up.
        let read = photos::read_photo(&path);
        assert!(read.is_err() || read.unwrap() == photo, "{length} of {} bytes", whole.len());
    }
}

/// COLMAP looks past orientation tags; some programs turn photos before they calibrate.
#[test]
fn a_photo_on_its_side_is_turned_where_its_camera_says_so() {
    let folder = tiny_scene(2);
    let photo = |name: &str| folder.path().join("images/a b").join(name);
    let [raw, sideways] = [SIZE, [SIZE[1], SIZE[0]]].map(|size| photos::encode_jpeg(&gradient(size), 95));
    fs::remove_file(photo("000.png")).unwrap();
    let top_left = |bytes: &[u8], orientation: u8| {
        fs::write(photo("000.jpg"), tagged(bytes, orientation)).unwrap();
        let scene = load(folder.path()).unwrap();
        scene.test[0].photo.read().unwrap().pixel(1, 1)
    };
    // Dark is where rows and columns begin.
    assert!(top_left(&raw, 6)[0] < 60, "raw pixels, whatever the tag says");
    // What is upright has the lower left corner of the file's pixels at its top left with tag 6, and the
    // upper right one with 8.
    let ([red, green, _], [other_red, other_green, _]) = (top_left(&sideways, 6), top_left(&sideways, 8));
    assert!(red < 60 && green > 200, "turned clockwise: {red} {green}");
    assert!(other_red > 200 && other_green < 60, "turned counter-clockwise: {other_red} {other_green}");
    fs::write(photo("000.jpg"), &sideways).unwrap();
    assert!(load(folder.path()).unwrap_err().contains("which is another shape"), "no tag, no turn");
}

/// Red grows to the right, green downwards.
fn gradient([width, height]: [u32; 2]) -> Photo {
    let pixel =
        |at: u32| [(255 * (at % width) / (width - 1)) as u8, (255 * (at / width) / (height - 1)) as u8, 0];
    Photo { width, height, rgb: (0..width * height).flat_map(pixel).collect() }
}

/// A JPEG with an orientation in its EXIF data.
fn tagged(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let tiff =
        [b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".as_slice(), &[orientation, 0, 0, 0, 0, 0, 0, 0]]
            .concat();
    let length = (2 + 6 + tiff.len() as u16).to_be_bytes();
    [&jpeg[..2], b"\xFF\xE1", &length, b"Exif\0\0", &tiff, &jpeg[2..]].concat()
}
