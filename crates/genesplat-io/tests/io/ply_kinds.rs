//! PLY files of many programs: other colours, degrees, orders of bytes and comments.

use std::fs;
use std::path::Path;

use genesplat_io::format::{self, Loaded};

/// Names and values of one Gaussian in the authors' order, with harmonics of this degree.
fn row(degree: usize) -> Vec<(String, f32)> {
    let rest = 3 * (degree + 1).pow(2) - 3;
    let position = ["x", "y", "z"].map(str::to_owned).into_iter().zip([1.0, 2.0, 3.0]);
    let base = (0..3).map(|i| (format!("f_dc_{i}"), 0.25 * i as f32));
    let rest = (0..rest).map(|i| (format!("f_rest_{i}"), i as f32));
    let size = (0..3).map(|i| (format!("scale_{i}"), -1.0 - i as f32));
    let turn = (0..4).map(|i| (format!("rot_{i}"), 0.5 + i as f32));
    position.chain(base).chain(rest).chain([("opacity".to_owned(), 0.75)]).chain(size).chain(turn).collect()
}

/// A binary file of one row, `is_big` end first, with a comment of these bytes.
fn file(row: &[(String, f32)], is_big: bool, comment: &[u8]) -> Vec<u8> {
    let end = if is_big { "big" } else { "little" };
    let properties: String = row.iter().map(|(name, _)| format!("property float {name}\n")).collect();
    let header = format!("ply\nformat binary_{end}_endian 1.0\ncomment ");
    let rest = format!("\nelement vertex 1\n{properties}end_header\n");
    let bytes = |value: f32| if is_big { value.to_be_bytes() } else { value.to_le_bytes() };
    let values = row.iter().flat_map(|(_, value)| bytes(*value)).collect::<Vec<_>>();
    [header.as_bytes(), comment, rest.as_bytes(), &values].concat()
}

fn read(bytes: &[u8]) -> Loaded {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    fs::write(&path, bytes).unwrap();
    format::read(&path).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn either_end_may_come_first_and_comments_have_any_bytes() {
    let usual = read(&file(&row(3), false, b"x"));
    assert_eq!((usual.cloud.positions[0], usual.cloud.opacity_logits[0]), ([1.0, 2.0, 3.0], 0.75));
    for (is_big, comment) in [(true, b"x".as_slice()), (false, b"cr\xe9\xe9 par X"), (true, b"\xff\xfe")] {
        assert_eq!(read(&file(&row(3), is_big, comment)).cloud, usual.cloud);
    }
}

#[test]
fn higher_harmonics_are_left_out_and_counted() {
    for degree in [4, 5] {
        let loaded = read(&file(&row(degree), false, b"x"));
        assert_eq!((loaded.sh_degree, loaded.sh_degree_in_file), (3, degree as u8));
        let rest = (degree + 1).pow(2) - 1;
        let expected = |k: usize, channel: usize| (channel * rest + k - 1) as f32;
        for k in 1..16 {
            let channels: [f32; 3] = [0, 1, 2].map(|channel| expected(k, channel));
            assert_eq!(loaded.cloud.sh[0][3 * k..3 * k + 3], channels);
        }
    }
    assert_eq!(read(&file(&row(2), false, b"x")).sh_degree_in_file, 2);
}

/// nerfstudio exports `rgb`: bytes; others write fractions as floats.
#[test]
fn colours_stand_for_the_base_of_the_harmonics() {
    let base = 0.282_094_8;
    for (kind, colour, bytes) in [
        ("uchar", [0.2, 0.4, 1.0], vec![51, 102, 255]),
        ("float", [0.25, 0.5, 1.0], [0.25f32, 0.5, 1.0].map(f32::to_le_bytes).concat()),
        ("float", [0.2, 0.4, 1.0], [51f32, 102.0, 255.0].map(f32::to_le_bytes).concat()),
    ] {
        for names in [["red", "green", "blue"], ["r", "g", "b"]] {
            let plain: Vec<_> = row(0).into_iter().filter(|(name, _)| !name.starts_with("f_")).collect();
            let whole = file(&plain, false, b"x");
            let colours = names.map(|name| format!("property {kind} {name}\n")).concat();
            let at = whole.windows(10).position(|bytes| bytes == b"end_header").unwrap();
            let splat = [&whole[..at], colours.as_bytes(), &whole[at..], &bytes].concat();
            let cloud = read(&splat).cloud;
            for (value, level) in cloud.sh[0].iter().zip(colour) {
                assert!((0.5 + base * value - level).abs() < 1e-5, "{kind}: {value} for {level}");
            }
            assert_eq!((cloud.opacity_logits[0], cloud.rotations[0]), (0.75, [0.5, 1.5, 2.5, 3.5]));
        }
    }
}

/// "Export it again as binary little-endian PLY" helps nobody whose file is one.
#[test]
fn no_remedy_asks_for_what_the_file_is() {
    let bytes =
        b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nproperty float f_rest_0\nend_header\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    fs::write(&path, bytes).unwrap();
    let refused = format::read(Path::new(&path)).unwrap_err().to_string();
    assert!(refused.contains("1 f_rest") && !refused.contains("little-endian"), "{refused}");
}
