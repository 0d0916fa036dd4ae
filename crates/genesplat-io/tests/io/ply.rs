//! Clouds survive the disk bit for bit, and no file makes the reader panic.

use std::fs;
use std::path::{Path, PathBuf};

use genesplat_core::{Gaussians, Rng, ScreenFilter, Stream};
use genesplat_io::ply::{self, Fault, PlyError};
use genesplat_io::{PlyOptions, read_ply, write_ply};
use proptest::prelude::*;

/// A cloud whose values are any bit pattern, NaN and denormals included.
fn any_bits(seed: u64, n: usize, filter: bool) -> Gaussians {
    let rng = Rng::new(seed);
    let value = |row: usize, column: u32| {
        f32::from_bits(rng.at(Stream::Test, row as u32, column / 4, 0).0[(column % 4) as usize])
    };
    let mut cloud = Gaussians::zeros(n);
    for row in 0..n {
        cloud.positions[row] = std::array::from_fn(|i| value(row, i as u32));
        cloud.log_scales[row] = std::array::from_fn(|i| value(row, 4 + i as u32));
        cloud.rotations[row] = std::array::from_fn(|i| value(row, 8 + i as u32));
        cloud.opacity_logits[row] = value(row, 12);
        cloud.sh[row] = std::array::from_fn(|i| value(row, 16 + i as u32));
    }
    cloud.filter_3d = filter.then(|| (0..n).map(|row| value(row, 13)).collect());
    cloud
}

fn bits(cloud: &Gaussians) -> Vec<u32> {
    (cloud.positions.iter().flatten())
        .chain(cloud.log_scales.iter().flatten())
        .chain(cloud.rotations.iter().flatten())
        .chain(&cloud.opacity_logits)
        .chain(cloud.sh.iter().flatten())
        .chain(cloud.filter_3d.iter().flatten())
        .map(|value| value.to_bits())
        .collect()
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn holding(bytes: &[u8]) -> (Self, PathBuf) {
        let folder = Self::new();
        let path = folder.file("cloud.ply");
        fs::write(&path, bytes).unwrap();
        (folder, path)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_is_written_is_read_bit_for_bit(seed: u64, n in 0usize..9000, filter: bool) {
        let (folder, cloud) = (Folder::new(), any_bits(seed, n.pow(2) / 9000, filter));
        let path = folder.file("cloud.ply");
        write_ply(&path, &cloud, &PlyOptions::default()).unwrap();
        let read = read_ply(&path).unwrap();
        prop_assert_eq!(bits(&read), bits(&cloud));
        prop_assert_eq!(read.filter_3d.is_some(), filter);
    }

    #[test]
    fn damaged_files_never_panic(seed: u64, at in 0usize..2000, byte: u8, cut in 0usize..3000) {
        let folder = Folder::new();
        let path = folder.file("cloud.ply");
        write_ply(&path, &any_bits(seed, 3, true), &PlyOptions::default()).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let last = bytes.len() - 1;
        bytes[at.min(last)] = byte;
        bytes.truncate(cut.max(1));
        fs::write(&path, &bytes).unwrap();
        // Either a cloud or a sentence; a panic fails the test.
        if let Err(error) = read_ply(&path) {
            prop_assert!(error.to_string().contains("cloud.ply"));
        }
    }
}

#[test]
fn the_layout_is_the_authors() {
    let (folder, mut cloud) = (Folder::new(), Gaussians::zeros(1));
    cloud.positions[0] = [1.0, 2.0, 3.0];
    cloud.sh[0] = std::array::from_fn(|i| i as f32);
    cloud.opacity_logits[0] = 100.0;
    cloud.log_scales[0] = [101.0, 102.0, 103.0];
    cloud.rotations[0] = [104.0, 105.0, 106.0, 107.0];
    let path = folder.file("cloud.ply");
    let options = PlyOptions { screen_filter: ScreenFilter::Mip, ..PlyOptions::default() };
    write_ply(&path, &cloud, &options).unwrap();
    let bytes = fs::read(&path).unwrap();
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
    let values: Vec<f32> =
        bytes[start..].chunks_exact(4).map(|v| f32::from_le_bytes(v.try_into().unwrap())).collect();
    // The file is channel-major after the base colours; memory holds the three channels of each coefficient
    // together.
    let mut expected = vec![1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0];
    expected.extend((0..3).flat_map(|channel| (1..16).map(move |k| (3 * k + channel) as f32)));
    expected.extend((100..108).map(|i| i as f32));
    assert_eq!(values, expected);
    let (header, _) = ply::read_ply_with_header(&path).unwrap();
    assert_eq!((header.gaussians, header.sh_degree, header.screen_filter), (1, 3, Some(ScreenFilter::Mip)));
}

#[test]
fn screen_filters_survive_the_file() {
    let (folder, cloud) = (Folder::new(), Gaussians::zeros(1));
    for filter in [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip] {
        let path = folder.file("cloud.ply");
        write_ply(&path, &cloud, &PlyOptions { screen_filter: filter, ..PlyOptions::default() }).unwrap();
        let (header, _) = ply::read_ply_with_header(&path).unwrap();
        assert_eq!(header.screen_filter, Some(filter));
        let known = if filter == ScreenFilter::Classic { "default" } else { "mip" };
        assert_eq!(header.comments[0], format!("SplatRenderMode: {known}"), "a word that viewers know");
    }
}

#[test]
fn other_orders_types_and_degrees_are_read() {
    let names = "rot_3 rot_2 rot_1 rot_0 scale_2 scale_1 scale_0 opacity f_dc_2 f_dc_1 f_dc_0 z y x";
    let mut text =
        String::from("ply\r\nformat binary_little_endian 1.0\r\nelement camera 2\r\nproperty short id\r\n");
    text += "element vertex 1\r\nproperty uchar label\r\n";
    names.split(' ').for_each(|name| text += &format!("property double {name}\r\n"));
    // Degree 1, three coefficients a channel.
    (0..9).for_each(|i| text += &format!("property float32 f_rest_{i}\r\n"));
    text += "element face 7\r\nproperty list uchar int vertex_indices\r\nend_header\r\n";
    let mut bytes = text.into_bytes();
    bytes.extend([9, 9, 9, 9, 77]);
    (0..14).for_each(|i| bytes.extend(f64::from(i).to_le_bytes()));
    (0..9).for_each(|i| bytes.extend((20.0 + i as f32).to_le_bytes()));
    let (_folder, path) = Folder::holding(&bytes);
    let cloud = read_ply(&path).unwrap();
    assert_eq!(cloud.positions, [[13.0, 12.0, 11.0]]);
    assert_eq!(cloud.rotations, [[3.0, 2.0, 1.0, 0.0]]);
    assert_eq!(cloud.log_scales, [[6.0, 5.0, 4.0]]);
    assert_eq!(cloud.opacity_logits, [7.0]);
    let sh = cloud.sh[0];
    assert_eq!(sh[..12], [10.0, 9.0, 8.0, 20.0, 23.0, 26.0, 21.0, 24.0, 27.0, 22.0, 25.0, 28.0]);
    assert!(sh[12..].iter().all(|v| *v == 0.0));
}

/// The binary file at `path` in words.
fn in_ascii(path: &Path) -> String {
    let bytes = fs::read(path).unwrap();
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
    let header = String::from_utf8(bytes[..start].to_vec()).unwrap();
    let columns = header.matches("property float").count();
    let values = bytes[start..].chunks_exact(4).map(|value| f32::from_le_bytes(value.try_into().unwrap()));
    let words: Vec<String> = values.map(|value| value.to_string()).collect();
    let rows: Vec<String> = words.chunks(columns).map(|row| row.join(" ")).collect();
    header.replace("binary_little_endian", "ascii") + &rows.join("\n") + "\n"
}

#[test]
fn an_ascii_file_holds_the_same_gaussians() {
    let (folder, mut cloud) = (Folder::new(), any_bits(5, 7, true));
    cloud.log_scales[2] = [1.5e-30, -0.0, f32::INFINITY];
    // Of the bits of NaN, words say nothing.
    let columns = [cloud.positions.as_flattened_mut(), cloud.log_scales.as_flattened_mut()];
    let more = [cloud.rotations.as_flattened_mut(), cloud.sh.as_flattened_mut(), &mut cloud.opacity_logits];
    let values = columns.into_iter().chain(more).flatten().chain(cloud.filter_3d.iter_mut().flatten());
    values.filter(|value| value.is_nan()).for_each(|value| *value = f32::NAN);
    let path = folder.file("cloud.ply");
    write_ply(&path, &cloud, &PlyOptions::default()).unwrap();
    let text = in_ascii(&path);
    fs::write(&path, &text).unwrap();
    assert_eq!(bits(&read_ply(&path).unwrap()), bits(&cloud));

    let (rest, last_word) = text.trim_end().rsplit_once(' ').unwrap();
    let cases = [
        (format!("{text}1 2 3\n"), "something follows its end"),
        (text.trim_end().rsplit_once('\n').unwrap().0.to_owned(), "in row 6; export the file again"),
        (rest.to_owned(), "in row 6"),
        (format!("{rest} {last_word},5"), "in row 6"),
    ];
    for (text, problem) in cases {
        fs::write(&path, text).unwrap();
        let error = read_ply(&path).unwrap_err().to_string();
        assert!(error.contains("cloud.ply") && error.contains(problem), "{error}");
    }
}

#[test]
fn bad_files_are_named_with_what_is_wrong() {
    let header = |lines: &str| format!("ply\n{lines}\nend_header\n").into_bytes();
    let little = "format binary_little_endian 1.0\nelement vertex";
    // As many bytes before the vertices as u64 holds: with those of the header they are more.
    let endless = "format binary_little_endian 1.0\nelement camera 18446744073709551615\nproperty uchar id\n\
                   element vertex 1";
    let cases: [(Vec<u8>, &str); 9] = [
        (header(&format!("{endless}\nproperty float x")), "promises 1 rows but holds bytes for 0"),
        (b"\x89PNG\r\n".to_vec(), "does not begin with"),
        (header("format ascii 1.0\nelement vertex 0\nproperty float x"), "lack y; give a splat"),
        (header("format binary_little_endian 1.0\nelement face 0"), "no vertices"),
        (header(&format!("{little} 0\nproperty float x\nproperty float y")), "lack z; give a splat"),
        (header(&format!("{little} 1152921504606846976\nproperty float x")), "promises 1152921504606846976"),
        (header(&format!("{little} -1\nproperty float x")), "impossible count"),
        (header(&format!("{little} 0\nproperty float f_rest_0")), "1 f_rest"),
        (b"ply\nformat binary_little_endian 1.0\n".to_vec(), "no end"),
    ];
    for (bytes, sentence) in cases {
        let (_folder, path) = Folder::holding(&bytes);
        let error = read_ply(&path).unwrap_err().to_string();
        assert!(error.contains(sentence) && error.contains("cloud.ply"), "{error}");
    }
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    let folder = Folder::new();
    let path = folder.file("cloud.ply");
    write_ply(&path, &any_bits(1, 2, false), &PlyOptions::default()).unwrap();
    let bytes = fs::read(&path).unwrap();
    for length in 0..bytes.len() {
        fs::write(&path, &bytes[..length]).unwrap();
        assert!(read_ply(&path).is_err(), "cut to {length} of {} bytes", bytes.len());
    }
}

#[test]
fn rows_beyond_the_count_are_an_error() {
    let folder = Folder::new();
    let path = folder.file("cloud.ply");
    write_ply(&path, &any_bits(1, 12, false), &PlyOptions::default()).unwrap();
    let bytes = fs::read(&path).unwrap();
    let text = String::from_utf8_lossy(&bytes[..200]).into_owned();
    let at = text.find("vertex 12").unwrap() + "vertex 1".len();
    for count in [b'1', b'0'] {
        let mut fewer = bytes.clone();
        fewer[at] = count;
        fs::write(&path, fewer).unwrap();
        let error = read_ply(&path).unwrap_err().to_string();
        let promised = format!("more than the 1{} rows", char::from(count));
        assert!(error.contains(&promised) && error.contains("something follows its end"), "{error}");
    }
}

#[test]
fn a_value_that_is_not_finite_is_named() {
    let mut cloud = Gaussians::zeros(3);
    let path = PathBuf::from("cloud.ply");
    assert!(ply::check_finite(&path, &cloud).is_ok());
    cloud.opacity_logits[1] = f32::NAN;
    let error = ply::check_finite(&path, &cloud).unwrap_err();
    let said = "cloud.ply: the opacity of Gaussian 1 is not finite; `genesplat convert cloud.ply OUT` leaves such Gaussians \
                out";
    assert_eq!(error.to_string(), said);
    for filter in [f32::NAN, f32::INFINITY, -0.5] {
        let cloud = Gaussians { filter_3d: Some(vec![0.0, 0.1, filter]), ..Gaussians::zeros(3) };
        let error = ply::check_finite(&path, &cloud).unwrap_err();
        let is_named =
            matches!(error, PlyError::Gaussian { fault: Fault { row: 2, parameter: "filter_3D", .. }, .. });
        assert!(is_named, "{error}");
    }
}

#[test]
fn a_position_that_no_scene_has_is_named() {
    let mut cloud = Gaussians::zeros(3);
    cloud.positions[2] = [1e9, -1e9, 0.0];
    assert!(ply::check_finite(Path::new("cloud.ply"), &cloud).is_ok());
    cloud.positions[2][1] = 1e25;
    let error = ply::check_finite(Path::new("cloud.ply"), &cloud).unwrap_err().to_string();
    assert!(error.contains("cloud.ply: the position of Gaussian 2 lies beyond 1e9 world units"), "{error}");
}

#[test]
fn gaussians_that_cannot_be_shown_are_left_out_and_named() {
    let opacity_logits = (0..7u8).map(f32::from).collect();
    let sound = Gaussians { filter_3d: Some(vec![0.1; 7]), opacity_logits, ..Gaussians::zeros(7) };
    assert_eq!(ply::leave_out_faults(sound.clone()), (sound.clone(), Vec::new()));
    let mut cloud = sound.clone();
    cloud.sh[1][47] = f32::INFINITY;
    (cloud.rotations[3][2], cloud.positions[3][0]) = (f32::NAN, f32::NAN);
    cloud.positions[4][1] = -1e25;
    cloud.filter_3d.as_mut().unwrap()[6] = f32::NAN;
    // No direction is no rotation, as for every renderer here.
    cloud.rotations[5] = [0.0; 4];
    let (left, faults) = ply::leave_out_faults(cloud.clone());
    assert_eq!(left, cloud.gather(&[0, 2, 5]));
    let said: Vec<String> = faults.iter().map(Fault::to_string).collect();
    assert_eq!(
        said,
        [
            "the colour of Gaussian 1 is not finite",
            "the position of Gaussian 3 is not finite",
            "the position of Gaussian 4 lies beyond 1e9 world units",
            "the filter_3D of Gaussian 6 is not finite"
        ]
    );
}

#[test]
fn flat_gaussians_get_a_thickness() {
    let folder = Folder::new();
    let path = folder.file("cloud.ply");
    let cloud = Gaussians { log_scales: vec![[-1.0, -2.0, -3.0]; 2], ..Gaussians::zeros(2) };
    write_ply(&path, &cloud, &PlyOptions { sh_degree: 0, ..PlyOptions::default() }).unwrap();
    assert!(!ply::read_ply_with_header(&path).unwrap().0.is_2dgs);
    let text = in_ascii(&path);
    // Words of the third scale go with its line.
    let (header, rows) = text.split_once("end_header\n").unwrap();
    let flat =
        header.replace("property float scale_2\n", "") + "end_header\n" + &rows.replace("-1 -2 -3", "-1 -2");
    fs::write(&path, &flat).unwrap();
    let (header, read) = ply::read_ply_with_header(&path).unwrap();
    assert!(header.is_2dgs);
    assert_eq!(read.log_scales, [[-1.0, -2.0, 1e-6f32.ln()]; 2]);
    assert_eq!(Gaussians { log_scales: cloud.log_scales.clone(), ..read }, cloud);
    fs::write(&path, flat.replace("property float scale_1", "property float size")).unwrap();
    assert!(read_ply(&path).unwrap_err().to_string().contains("lack scale_1"));
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error() {
    let (_folder, file) = Folder::holding(b"a file, not a folder");
    let error = write_ply(&file.join("cloud.ply"), &Gaussians::zeros(1), &PlyOptions::default()).unwrap_err();
    assert!(matches!(error, PlyError::Write { .. }), "{error}");
}
