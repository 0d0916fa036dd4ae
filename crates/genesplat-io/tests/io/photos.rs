//! Photos: sizes, resampling as published figures were made, transparency, and pictures that survive the
//! disk.

use std::fs;

use genesplat_core::Photo;
use genesplat_io::colmap::Form;
use genesplat_io::photos::{self, PhotoError};
use genesplat_io::{LoadOptions, PhotoSize, Scene, Spill, load_scene};

use crate::common::{CLAIM, SIZE, claiming, tiny_model, write_scene};

#[test]
fn sizes_follow_the_reference() {
    let cases = [
        (PhotoSize::Auto, (1600, 1200), (1600, 1200)),
        (PhotoSize::Auto, (2000, 1333), (1600, 1066)),
        (PhotoSize::Auto, (2000, 1332), (1600, 1065)),
        // 1601 / (1601 / 1600) is a hair below 1600, in Python as here.
        (PhotoSize::Auto, (1601, 1000), (1599, 999)),
        (PhotoSize::Auto, (900, 4000), (900, 4000)),
        // Halves go to the even neighbour: 2.5 to 2, 3.5 to 4.
        (PhotoSize::Downscale(2), (5, 7), (2, 4)),
        (PhotoSize::Downscale(4), (539, 960), (135, 240)),
        (PhotoSize::Downscale(1), (539, 960), (539, 960)),
        (PhotoSize::Downscale(0), (539, 960), (539, 960)),
        (PhotoSize::MaxSide(320), (539, 960), (180, 320)),
        (PhotoSize::MaxSide(960), (539, 960), (539, 960)),
        (PhotoSize::MaxSide(2000), (539, 960), (539, 960)),
        (PhotoSize::MaxSide(0), (539, 960), (1, 1)),
    ];
    for (size, (width, height), expected) in cases {
        assert_eq!(size.of(width, height), expected, "{size:?} of {width}x{height}");
    }
}

/// The expected values are Pillow 10.4's, of the same pattern with its default filter.
#[test]
fn resampling_is_pillows_to_the_bit() {
    let value = |x: usize, y: usize, c: usize| (((x * 37 + y * 91 + c * 53) * (x * y + 7)) % 256) as u8;
    let rgb = (0..9 * 13 * 3).map(|i| value(i / 3 % 13, i / 39, i % 3)).collect();
    let photo = Photo { width: 13, height: 9, rgb };
    let reduced = [
        72, 152, 156, 102, 152, 169, 106, 132, 213, 86, 146, 134, 83, 147, 84, 127, 124, 117, 93, 114, 85,
        135, 170, 162, 138, 156, 160, 142, 132, 135, 105, 151, 140, 83, 110, 151, 109, 136, 129, 126, 145,
        145, 156, 146, 113, 158, 177, 124, 117, 125, 131, 101, 146, 155, 105, 157, 113, 119, 177, 130,
    ];
    assert_eq!(photos::resize(&photo, 5, 4), Photo { width: 5, height: 4, rgb: reduced.into() });
    let third_row = [
        188, 169, 156, 75, 126, 129, 67, 131, 117, 136, 148, 121, 67, 49, 105, 49, 97, 119, 87, 149, 79, 159,
        154, 62, 205, 107, 156, 68, 165, 172, 118, 155, 162, 151, 158, 169, 42, 218, 190, 185, 145, 67, 177,
        90, 128, 130, 106, 140, 119, 162, 52,
    ];
    assert_eq!(photos::resize(&photo, 17, 5).rgb[2 * 51..3 * 51], third_row);
    assert_eq!(photos::resize(&photo, 13, 9), photo);
}

#[test]
fn a_png_is_read_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/picture.png");
    let photo = Photo { width: 3, height: 2, rgb: (0..18).collect() };
    photos::write_png(&path, &photo).unwrap();
    assert_eq!(photos::read_photo(&path).unwrap(), photo);
    assert_eq!(photos::photo_size(&path).unwrap(), (3, 2));
}

#[test]
fn transparency_shows_the_background_truncated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.png");
    let pixels = vec![200, 100, 50, 255, 200, 100, 50, 0, 200, 100, 51, 128];
    image::RgbaImage::from_raw(3, 1, pixels).unwrap().save(&path).unwrap();
    // 200 * 128 / 255 = 100.39, 50.19 and 25.6.
    assert_eq!(photos::read_photo(&path).unwrap().rgb, [200, 100, 50, 0, 0, 0, 100, 50, 25]);
}

#[test]
fn grey_and_deep_pictures_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let (grey, deep) = (folder.path().join("grey.png"), folder.path().join("deep.png"));
    image::GrayImage::from_raw(2, 1, vec![7, 250]).unwrap().save(&grey).unwrap();
    image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(1, 1, vec![257u16 * 9, 0, 65535])
        .unwrap()
        .save(&deep)
        .unwrap();
    assert_eq!(photos::read_photo(&grey).unwrap().rgb, [7, 7, 7, 250, 250, 250]);
    assert_eq!(photos::read_photo(&deep).unwrap().rgb, [9, 0, 255]);
}

#[test]
fn what_of_a_picture_is_discarded_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.png");
    let discarded = |picture: image::DynamicImage| {
        picture.save(&path).unwrap();
        let (photo, discarded) = photos::read_photo_and_discarded(&path).unwrap();
        assert_eq!(photo, photos::read_photo(&path).unwrap());
        (discarded.depth, discarded.transparency)
    };
    let glass = |alpha| image::RgbaImage::from_pixel(2, 1, image::Rgba([9, 9, 9, alpha]));
    assert_eq!(discarded(image::RgbImage::new(2, 1).into()), (false, false));
    assert_eq!(discarded(glass(255).into()), (false, false), "an opaque picture keeps all");
    assert_eq!(discarded(glass(254).into()), (false, true));
    assert_eq!(discarded(image::DynamicImage::new_luma16(2, 1)), (true, false));
    assert_eq!(discarded(image::DynamicImage::new_rgba16(2, 1)), (true, true));
}

/// A sparse file: it takes no room on the disk, and would take 10 GB of memory.
#[test]
fn a_file_far_larger_than_its_picture_is_refused_unread() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.png");
    photos::write_png(&path, &Photo { width: 3, height: 2, rgb: vec![9; 18] }).unwrap();
    fs::File::options().append(true).open(&path).unwrap().set_len(10_000_000_000).unwrap();
    let refused = photos::read_photo(&path).unwrap_err().to_string();
    assert!(
        refused.contains("its 10000000000 bytes are more than 3x2 pixels take; export it again"),
        "{refused}"
    );
}

/// A header may claim 65,535 x 65,535 pixels: 12 GB. Less is believed as far as the bytes reach.
#[test]
fn a_photo_that_claims_to_be_huge_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.jpg");
    let claims = [([65_535, 65_535], "65535x65535 pixels, and at most"), (CLAIM, "pixels, which its")];
    for (size, words) in claims {
        fs::write(&path, claiming(size)).unwrap();
        let error = photos::read_photo(&path).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains(&format!("{}x{}", size[0], size[1])), "{error}");
    }
    // Nothing takes fewer bytes than a picture of one colour.
    let blank = Photo { width: 3_000, height: 2_000, rgb: vec![0; 3 * 3_000 * 2_000] };
    photos::write_png(&path, &blank).unwrap();
    assert!(photos::read_photo(&path).unwrap() == blank);
    fs::write(&path, photos::encode_jpeg(&blank, 1)).unwrap();
    assert_eq!(photos::read_photo(&path).unwrap().width, 3_000);
}

/// Decoders fill the lost half of a truncated JPEG with grey and report success; we must not.
#[test]
fn a_jpeg_cut_anywhere_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.jpg");
    let pattern =
        image::RgbImage::from_fn(48, 32, |x, y| image::Rgb([(x * y) as u8, (7 * x) as u8, y as u8]));
    pattern.save(&path).unwrap();
    let whole = fs::read(&path).unwrap();
    assert_eq!(photos::read_photo(&path).unwrap().width, 48);
    for length in 0..whole.len() - 1 {
        fs::write(&path, &whole[..length]).unwrap();
        let error = photos::read_photo(&path).expect_err("a truncated photo must not load");
        assert!(matches!(error, PhotoError::Decode { .. }), "{error}");
    }
}

#[test]
fn a_png_cut_anywhere_is_an_error_or_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.png");
    let photo = Photo { width: 16, height: 16, rgb: (0..768).map(|i| (i * i) as u8).collect() };
    photos::write_png(&path, &photo).unwrap();
    let whole = fs::read(&path).unwrap();
    for length in 0..whole.len() {
        fs::write(&path, &whole[..length]).unwrap();
        // Only the end chunk, which holds no pixels, may be missing.
        if let Ok(read) = photos::read_photo(&path) {
            assert_eq!(read, photo, "cut to {length} of {} bytes", whole.len());
        }
    }
}

#[test]
fn photos_that_memory_should_not_hold_are_read_from_a_file_without_a_name() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(4));
    let run = folder.path().join("run");
    let load = |memory_bytes: u64| {
        let spill = Some(Spill { folder: run.clone(), memory_bytes });
        load_scene(folder.path(), &LoadOptions { spill, ..LoadOptions::default() }, &()).unwrap()
    };
    let bytes = 4 * 3 * u64::from(SIZE[0] * SIZE[1]);
    let (held, kept) = (load(bytes), load(bytes - 1));
    let views = |scene: &Scene| scene.test.iter().chain(&scene.train).cloned().collect::<Vec<_>>();
    for (held, kept) in views(&held).iter().zip(views(&kept)) {
        assert!(held.photo.held_bytes() as u64 == bytes / 4 && kept.photo.held_bytes() == 0);
        assert_eq!(held.photo.read().unwrap(), kept.photo.read().unwrap());
    }
    assert_eq!(fs::read_dir(&run).unwrap().count(), 0);

    let spill = Some(Spill { folder: folder.path().join("images/a b/000.png"), memory_bytes: 0 });
    let error = load_scene(folder.path(), &LoadOptions { spill, ..LoadOptions::default() }, &()).unwrap_err();
    assert!(error.to_string().contains("cannot keep the photos in a file in"), "{error}");
}
