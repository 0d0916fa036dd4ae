//! COLMAP scenes: both forms, every truncation, and a sentence for every mistake.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::{SIZE, tiny_model, tiny_photo, write_form, write_scene};
use genesplat_io::colmap::{Form, Intrinsics, Model, ModelFolder, find_model, read_model, write_model};
use genesplat_io::{HoldOut, LoadOptions, LoadProgress, PhotoSize, SceneError, load_scene, photos};

const FORMS: [Form; 2] = [Form::Binary, Form::Text];
const FILES: [&str; 3] = ["cameras", "images", "points3D"];

fn file_of(scene: &Path, form: Form, stem: &str) -> std::path::PathBuf {
    let extension = if form == Form::Binary { "bin" } else { "txt" };
    scene.join(format!("sparse/0/{stem}.{extension}"))
}

/// The sentence with which the scene of `model`, changed on disk by `spoil`, is refused.
fn refusal(form: Form, model: &Model, spoil: impl FnOnce(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), form, model);
    spoil(folder.path());
    let error = load_scene(folder.path(), &LoadOptions::default(), &()).unwrap_err().to_string();
    assert!(!error.contains('\n'), "one sentence: {error}");
    error
}

#[test]
fn both_forms_keep_every_bit() {
    let model = tiny_model(3);
    for form in FORMS {
        let folder = tempfile::tempdir().unwrap();
        write_form(folder.path(), form, &model);
        let found = find_model(folder.path()).unwrap();
        assert_eq!(found.form, form);
        assert_eq!(read_model(&found).unwrap(), model);
    }
}

#[test]
fn binary_is_preferred_to_text() {
    let folder = tempfile::tempdir().unwrap();
    write_form(folder.path(), Form::Text, &tiny_model(1));
    write_model(folder.path(), &tiny_model(2)).unwrap();
    assert_eq!(read_model(&find_model(folder.path()).unwrap()).unwrap().images.len(), 2);
}

#[test]
fn text_as_colmap_writes_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("cameras.txt", "# a comment\n\n1 SIMPLE_PINHOLE 640 480 500.5 320 240\n2 PINHOLE 64 48 5 6 3 2\n");
    write(
        "images.txt",
        "# a\n1 1 0 0 0 0 0 1.5 1 with space.jpg\n10.5 3 -1 7 8 2\n2 0 1 0 0 1 2 3 2 b.jpg\n\n",
    );
    write("points3D.txt", "63 1.5 -2 3e-1 255 0 7 0.8 1 2 2 4\n5 0 0 0 1 2 3 0.1\n");
    let model = read_model(&ModelFolder { path: folder.path().into(), form: Form::Text }).unwrap();
    assert_eq!(model.cameras[&1].focal_px, [500.5, 500.5]);
    assert_eq!(model.cameras[&2].principal_px, [3.0, 2.0]);
    assert_eq!(model.images[0].name, "with space.jpg");
    assert_eq!((model.images[1].rotation, model.images[1].camera), ([0.0, 1.0, 0.0, 0.0], 2));
    assert_eq!((model.points[0].position, model.points[0].rgb), ([1.5, -2.0, 0.3], [255, 0, 7]));
}

/// Somebody's script has removed the empty lines: a photo that stands where features should is not passed
/// over.
#[test]
fn a_photo_in_the_place_of_features_is_named_by_its_line() {
    let poses = ["1 1 0 0 0 0 0 3 7 a b/000.png", "2 1 0 0 0 0 0 4 7 a b/001.png"];
    for (text, line) in [
        (poses.join("\n"), 2),
        (format!("# a\n{}\n\n{}\n1 2 -1 4 5\n", poses[0], poses[1]), 5),
        (format!("{}\n10.5 3 x\n{}\n\n", poses[0], poses[1]), 2),
    ] {
        let sentence = refusal(Form::Text, &tiny_model(2), |scene| {
            fs::write(file_of(scene, Form::Text, "images"), text).unwrap();
        });
        let expected = format!("images.txt, line {line}: expected the features of the photo above");
        assert!(sentence.contains(&expected) && sentence.contains("or an empty line"), "{sentence}");
    }
}

#[test]
fn features_and_tracks_are_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let model = tiny_model(1);
    write_model(folder.path(), &model).unwrap();
    // One feature for the only photo, and a track of two for the last point.
    for (name, entries, bytes) in [("images.bin", 1u64, 24), ("points3D.bin", 2, 16)] {
        let path = folder.path().join(name);
        let mut file = fs::read(&path).unwrap();
        file.truncate(file.len() - 8);
        file.extend(entries.to_le_bytes());
        file.extend(vec![0xAB; bytes]);
        fs::write(&path, file).unwrap();
    }
    assert_eq!(read_model(&find_model(folder.path()).unwrap()).unwrap(), model);
}

#[test]
fn a_binary_model_cut_anywhere_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    write_model(folder.path(), &tiny_model(2)).unwrap();
    let found = find_model(folder.path()).unwrap();
    for stem in FILES {
        let path = folder.path().join(format!("{stem}.bin"));
        let whole = fs::read(&path).unwrap();
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            let error = read_model(&found).expect_err("a cut file must not load").to_string();
            assert!(error.contains(stem), "{error}");
        }
        fs::write(&path, &whole).unwrap();
    }
    assert!(read_model(&found).is_ok());
}

#[test]
fn any_changed_byte_is_read_or_refused() {
    for form in FORMS {
        let folder = tempfile::tempdir().unwrap();
        write_scene(folder.path(), form, &tiny_model(2));
        let found = find_model(folder.path()).unwrap();
        for stem in FILES {
            let path = file_of(folder.path(), form, stem);
            let whole = fs::read(&path).unwrap();
            for (at, byte) in (0..whole.len()).flat_map(|at| [0x7F, 0xFF].map(|byte| (at, byte))) {
                let mut bytes = whole.clone();
                bytes[at] = byte;
                fs::write(&path, &bytes).unwrap();
                // A panic or an endless allocation fails the test; either outcome of the call is fine.
                let _ = read_model(&found);
            }
            fs::write(&path, &whole).unwrap();
        }
    }
}

#[test]
fn counts_beyond_the_file_are_refused() {
    for stem in FILES {
        let sentence = refusal(Form::Binary, &tiny_model(2), |scene| {
            let path = file_of(scene, Form::Binary, stem);
            let mut bytes = fs::read(&path).unwrap();
            bytes[..8].copy_from_slice(&(1u64 << 60).to_le_bytes());
            fs::write(&path, bytes).unwrap();
        });
        assert!(sentence.contains("claims 1152921504606846976") && sentence.contains(stem), "{sentence}");
    }
}

/// A count that was damaged downwards loses records as surely as a truncated file does.
#[test]
fn records_beyond_the_count_are_refused() {
    for stem in FILES {
        let sentence = refusal(Form::Binary, &tiny_model(2), |scene| {
            let path = file_of(scene, Form::Binary, stem);
            let mut bytes = fs::read(&path).unwrap();
            bytes[0] -= 1;
            fs::write(&path, bytes).unwrap();
        });
        assert!(sentence.contains(stem) && sentence.contains("something follows its end"), "{sentence}");
    }
}

#[test]
fn two_cameras_of_one_id_are_refused_in_both_forms() {
    let spoil = |form, change: fn(&mut Vec<u8>)| {
        refusal(form, &tiny_model(2), |scene| {
            let path = file_of(scene, form, "cameras");
            let mut bytes = fs::read(&path).unwrap();
            change(&mut bytes);
            fs::write(&path, bytes).unwrap();
        })
    };
    let text = spoil(Form::Text, |bytes| bytes.extend(b"7 PINHOLE 40 30 1 2 20 15\n"));
    let binary = spoil(Form::Binary, |bytes| {
        bytes.extend_from_within(8..);
        bytes[0] = 2;
    });
    for sentence in [text, binary] {
        assert!(
            sentence.contains("cameras.") && sentence.contains("two cameras with the ID 7"),
            "{sentence}"
        );
    }
}

/// RealityScan writes `-nan(ind)` where it has found nothing.
#[test]
fn what_is_not_finite_is_left_out_and_counted_in_both_forms() {
    let mut model = tiny_model(4);
    model.images[1].translation[2] = f64::NAN;
    model.images[3].rotation[0] = f64::INFINITY;
    model.points[4].position[0] = f32::NAN;
    // No photo has it.
    let unused = Intrinsics { focal_px: [f64::NAN; 2], ..model.cameras[&7] };
    model.cameras.insert(9, unused);
    for form in FORMS {
        let folder = tempfile::tempdir().unwrap();
        write_scene(folder.path(), Form::Text, &tiny_model(4));
        fs::remove_dir_all(folder.path().join("sparse/0")).unwrap();
        write_form(&folder.path().join("sparse/0"), form, &model);
        if form == Form::Text {
            for stem in FILES {
                let path = file_of(folder.path(), form, stem);
                let text = fs::read_to_string(&path).unwrap();
                fs::write(&path, text.replace("NaN", "-nan(ind)").replace("inf", "1.#INF")).unwrap();
            }
        }
        let scene = load_scene(folder.path(), &LoadOptions::default(), &()).unwrap();
        assert_eq!((scene.train.len() + scene.test.len(), scene.points.len()), (2, 8));
        let told = scene.notices.join("; ");
        assert!(told.contains("2 of the 4 photos that") && told.contains("first a b/001.png"), "{told}");
        assert!(told.contains("1 of the 9 points of") && told.contains("points3D"), "{told}");
    }
    let none = |model: &mut Model| model.images.iter_mut().for_each(|image| image.translation[0] = f64::NAN);
    let sentence = refusal(Form::Text, &tiny_model(2), |scene| {
        let mut model = tiny_model(2);
        none(&mut model);
        write_form(&scene.join("sparse/0"), Form::Text, &model);
    });
    assert!(sentence.contains("pose of photo a b/000.png is not finite"), "{sentence}");
}

#[test]
fn bad_numbers_are_named_in_both_forms() {
    type Spoil = fn(&mut Model);
    let cases: [(Spoil, &str); 7] = [
        (|m| m.images[1].rotation = [1e-99; 4], "pose of photo a b/001.png has a rotation that is zero"),
        (|m| m.images[1].translation[2] = 1e25, "pose of photo a b/001.png lies beyond 1e9 world units"),
        (
            |m| m.cameras.get_mut(&7).unwrap().focal_px[1] = 1e25,
            "camera 7 has a focal length or a principal point beyond",
        ),
        (|m| m.cameras.get_mut(&7).unwrap().focal_px[0] = 0.0, "camera 7 has a focal length"),
        (|m| m.cameras.get_mut(&7).unwrap().principal_px[1] = f64::NAN, "camera 7 has a principal point"),
        (|m| m.cameras.get_mut(&7).unwrap().width = 0, "camera 7 has an impossible image size"),
        (|m| m.images[1].camera = 8, "refers to camera 8"),
    ];
    for form in FORMS {
        for (spoil, expected) in &cases {
            let sentence = refusal(form, &tiny_model(3), |scene| {
                let mut model = tiny_model(3);
                spoil(&mut model);
                write_form(&scene.join("sparse/0"), form, &model);
            });
            assert!(sentence.contains(expected) && sentence.contains("sparse/0"), "{sentence}");
        }
    }
}

/// Half of the size of training, in one reduction from the photo as it is, and the camera with it.
#[test]
fn a_fraction_of_a_size_is_loaded_with_its_cameras() {
    let (folder, model) = (tempfile::tempdir().unwrap(), tiny_model(9));
    write_scene(folder.path(), Form::Binary, &model);
    // Photos of twice the size that the model was calibrated at.
    for (index, image) in model.images.iter().enumerate() {
        let path = folder.path().join("images").join(&image.name);
        photos::write_png(&path, &tiny_photo(index, SIZE.map(|side| 2 * side))).unwrap();
    }
    let load = |size, divisor| {
        let options = LoadOptions { size, divisor, ..LoadOptions::default() };
        load_scene(folder.path(), &options, &()).unwrap().test.remove(0)
    };
    let (whole, half) = (load(PhotoSize::Auto, 1), load(PhotoSize::MaxSide(70), 2));
    // 80x60 to 70x53 (52.5 rounds up), and half of that is 35x26 (26.5 goes to the even neighbour).
    assert_eq!((half.camera.width, half.camera.height), (35, 26));
    assert_eq!(
        *half.photo.read().unwrap(),
        photos::resize(&whole.photo.read().unwrap(), 35, 26),
        "not resampled twice"
    );
    let scale = [35.0 / 40.0, 26.0 / 30.0];
    for axis in 0..2 {
        assert!((half.camera.focal_px[axis] - scale[axis] * [35.5, 36.25][axis]).abs() < 1e-12);
        assert!((half.camera.principal_px[axis] - scale[axis] * [20.5, 14.75][axis]).abs() < 1e-12);
    }
    assert_eq!(half.camera.camera_from_world_translation, whole.camera.camera_from_world_translation);
}

#[test]
fn an_unknown_camera_names_its_model_and_the_remedy() {
    let text = refusal(Form::Text, &tiny_model(2), |scene| {
        fs::write(file_of(scene, Form::Text, "cameras"), "7 CYLINDER 40 30 40 30\n").unwrap();
    });
    let binary = refusal(Form::Binary, &tiny_model(2), |scene| {
        let path = file_of(scene, Form::Binary, "cameras");
        let mut bytes = fs::read(&path).unwrap();
        bytes[12] = 99;
        fs::write(&path, bytes).unwrap();
    });
    for (sentence, model) in [(text, "model CYLINDER"), (binary, "model with the number 99")] {
        assert!(sentence.contains(model) && sentence.contains("image_undistorter"), "{sentence}");
    }
}

/// Number, name and parameters of one model with a lens, in both forms.
#[test]
fn a_lens_is_read_and_undone_in_both_forms() {
    let [text, binary] = FORMS.map(|form| {
        let folder = tempfile::tempdir().unwrap();
        write_scene(folder.path(), form, &tiny_model(2));
        let file = file_of(folder.path(), form, "cameras");
        let parameters = [35.5f64, 36.25, 20.5, 14.75, -0.1, 0.02, 0.003, -0.002];
        if form == Form::Text {
            let values = parameters.map(|value| value.to_string()).join(" ");
            fs::write(&file, format!("7 OPENCV 40 30 {values}\n")).unwrap();
        } else {
            let mut bytes = fs::read(&file).unwrap();
            bytes[12] = 4;
            bytes.extend(parameters[4..].iter().flat_map(|value| value.to_le_bytes()));
            fs::write(&file, bytes).unwrap();
        }
        load_scene(folder.path(), &LoadOptions::default(), &()).unwrap().train.remove(0)
    });
    assert_eq!((text.camera, &text.photo.read().unwrap()), (binary.camera, &binary.photo.read().unwrap()));
    assert_eq!(text.camera.focal_px, [35.5, 36.25]);
    assert!(
        *text.photo.read().unwrap() != tiny_photo(1, SIZE) && [text.camera.width, text.camera.height] != SIZE,
        "{:?}",
        text.camera
    );
}

#[test]
fn photos_that_cannot_be_used_are_named() {
    let first = |scene: &Path| scene.join("images/a b/000.png");
    type Spoil<'a> = Box<dyn Fn(&Path) + 'a>;
    let half = |path: &Path| {
        photos::write_png(path, &tiny_photo(0, [40, 40])).unwrap();
        let bytes = fs::read(path).unwrap();
        fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
    };
    let cases: [(Spoil, &str); 4] = [
        (Box::new(|s| fs::remove_dir_all(s.join("images")).unwrap()), "none of the 2 photos"),
        (Box::new(|s| photos::write_png(&first(s), &tiny_photo(0, [40, 40])).unwrap()), "is 40x40 pixels"),
        // Its size is looked at before a pixel is decoded.
        (Box::new(|s| half(&first(s))), "is 40x40 pixels"),
        (Box::new(|s| photos::write_png(&first(s), &tiny_photo(0, [20, 15])).unwrap()), "at 20x15 pixels"),
    ];
    for (spoil, expected) in cases {
        let sentence = refusal(Form::Binary, &tiny_model(2), spoil);
        assert!(sentence.contains(expected) && sentence.contains("images"), "{sentence}");
    }
}

#[test]
fn names_that_leave_the_image_folder_are_refused() {
    for name in ["../secret.png", "/etc/hostname", "a/../../b.png", "", "a\\..\\..\\b.png", "a/..", ".", "./"]
    {
        let sentence = refusal(Form::Binary, &tiny_model(2), |scene| {
            let mut model = tiny_model(2);
            model.images[0].name = name.into();
            write_model(&scene.join("sparse/0"), &model).unwrap();
        });
        assert!(sentence.contains("not a path inside"), "{sentence}");
    }
}

#[test]
fn two_names_of_one_photo_are_one() {
    let sentence = refusal(Form::Binary, &tiny_model(2), |scene| {
        let mut model = tiny_model(2);
        model.images[1].name = format!(".//{}", model.images[0].name.replace('/', "//"));
        write_model(&scene.join("sparse/0"), &model).unwrap();
    });
    assert!(sentence.contains("twice"), "{sentence}");
}

#[test]
fn a_photo_listed_twice_is_named() {
    let sentence = refusal(Form::Binary, &tiny_model(2), |scene| {
        let mut model = tiny_model(2);
        model.images[1].name = model.images[0].name.clone();
        write_model(&scene.join("sparse/0"), &model).unwrap();
    });
    assert!(sentence.contains("a b/000.png twice"), "{sentence}");
}

/// `model`, moved by a vector: its cameras keep their rotations.
#[test]
fn one_photo_is_not_enough_unless_none_is_held_out() {
    let sentence = refusal(Form::Binary, &tiny_model(1), |_| {});
    assert!(sentence.contains("not enough photos") && sentence.ends_with("add photos"), "{sentence}");
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(1));
    let options = LoadOptions { hold_out: HoldOut::None, ..LoadOptions::default() };
    let scene = load_scene(folder.path(), &options, &()).unwrap();
    assert_eq!((scene.train.len(), scene.test.len()), (1, 0));
}

#[test]
fn folders_that_are_no_scene_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let load = |path: &Path| load_scene(path, &LoadOptions::default(), &()).unwrap_err();
    assert!(matches!(load(folder.path()), SceneError::Unrecognised { .. }));
    assert!(matches!(load(&folder.path().join("nowhere")), SceneError::Missing { .. }));
}

#[test]
fn points_are_not_read_where_none_are_wanted() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(2));
    fs::write(file_of(folder.path(), Form::Binary, "points3D"), b"torn").unwrap();
    let load =
        |with_points| load_scene(folder.path(), &LoadOptions { with_points, ..LoadOptions::default() }, &());
    let scene = load(false).unwrap();
    assert_eq!((scene.train.len(), scene.points.len()), (1, 0));
    assert!(load(true).is_err());
}

/// Counts what it hears.
#[derive(Default)]
struct Counter {
    announced: AtomicUsize,
    done: AtomicUsize,
}

impl LoadProgress for Counter {
    fn start(&self, photos: usize) {
        self.announced.store(photos, Ordering::Relaxed);
    }

    fn photo_done(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn every_eighth_photo_by_name_is_held_out() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(17);
    model.images.reverse();
    write_scene(folder.path(), Form::Binary, &model);
    let counter = Counter::default();
    let scene = load_scene(folder.path(), &LoadOptions::default(), &counter).unwrap();
    let names: Vec<&str> = scene.test.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["000.png", "008.png", "016.png"]);
    assert_eq!((scene.train.len(), scene.points.len()), (14, 9));
    assert_eq!((counter.announced.into_inner(), counter.done.into_inner()), (17, 17));
    assert_eq!(
        *scene.test[0].photo.read().unwrap(),
        tiny_photo(16, SIZE),
        "the photo of the record that was written last"
    );
}

#[test]
fn photos_of_one_name_in_several_folders_stay_apart() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(2);
    model.images[0].name = "left/1.png".into();
    model.images[1].name = "right/1.png".into();
    write_scene(folder.path(), Form::Binary, &model);
    let scene = load_scene(folder.path(), &LoadOptions::default(), &()).unwrap();
    assert_eq!((scene.test[0].name.as_str(), scene.train[0].name.as_str()), ("left_1.png", "right_1.png"));
}

#[test]
fn cameras_follow_smaller_photos_and_requested_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(2);
    let camera = model.cameras.get_mut(&7).unwrap();
    (camera.width, camera.height, camera.focal_px) = (79, 61, [70.0, 70.0]);
    write_scene(folder.path(), Form::Binary, &model);
    let options = LoadOptions { size: PhotoSize::MaxSide(30), ..LoadOptions::default() };
    let loaded = load_scene(folder.path(), &options, &()).unwrap().train[0].camera;
    // 30 x 22.5 px rounds to 23 rows; each axis keeps its own field of view.
    assert_eq!((loaded.width, loaded.height), (30, 23));
    assert!((loaded.focal_px[0] - 70.0 * 30.0 / 79.0).abs() < 1e-12);
    assert!((loaded.focal_px[1] - 70.0 * 23.0 / 61.0).abs() < 1e-12);
}

#[test]
fn photos_and_videos_without_cameras_name_the_command_that_finds_them() {
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("my photos");
    photos::write_png(&photos.join("a.PNG"), &tiny_photo(0, SIZE)).unwrap();
    photos::write_png(&photos.join("more/b.png"), &tiny_photo(1, SIZE)).unwrap();
    let video = folder.path().join("film.MOV");
    fs::write(&video, "a film").unwrap();
    let quoted = format!("'{}'", photos.display());
    let cases = [
        (&photos, quoted, "holds 2 photos and no cameras"),
        (&video, video.display().to_string(), "is a video"),
    ];
    for (path, word, what) in cases {
        let sentence = load_scene(path, &LoadOptions::default(), &()).unwrap_err().to_string();
        let command = format!("`genesplat poses {word} --out SCENE`");
        assert!(
            sentence.contains(what) && sentence.contains(&command) && sentence.contains("--poses"),
            "{sentence}"
        );
    }
}
