//! Files that are cut off, altered or made up end in a sentence, and take no more memory than they are worth.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::write::GzEncoder;
use genesplat_core::Gaussians;
use genesplat_core::gaussians::sigmoid;
use genesplat_io::format::{self, Format, Options, SpzVersion};
use proptest::prelude::*;
use tempfile::TempDir;

use crate::formats::{varied, write};

/// A small file of each format, and of both versions of `.spz`, with its ending.
static SAMPLES: LazyLock<Vec<(String, Vec<u8>)>> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let cloud = varied(1, 40, 2);
    let mut samples = Vec::new();
    for format in Format::ALL {
        for spz_version in [SpzVersion::V3, SpzVersion::V4] {
            let path = folder.path().join(format!("cloud{}", format.ending()));
            write(&path, &cloud, &Options { spz_version, ..Options::default() });
            samples.push((format.ending().to_owned(), fs::read(&path).unwrap()));
        }
    }
    samples
});

struct Place(TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, ending: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(format!("cloud{ending}"));
        fs::write(&path, bytes).unwrap();
        path
    }

    /// The sentence about a file that is not read.
    fn refused(&self, ending: &str, bytes: &[u8]) -> String {
        // A test that fails says how many Gaussians were read, and not all of them.
        let read = format::read(&self.file(ending, bytes)).map(|loaded| loaded.cloud.len());
        let error = read.unwrap_err().to_string();
        assert!(error.contains("cloud"), "{error}");
        error
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// A cloud or a sentence; a panic fails the test.
    #[test]
    fn altered_files_never_panic(changes in prop::collection::vec((any::<u32>(), any::<u8>()), 1..6), cut in 0u32..200) {
        let place = Place::new();
        for (ending, mut bytes) in SAMPLES.clone() {
            for &(at, byte) in &changes {
                let at = at as usize % bytes.len();
                bytes[at] = byte;
            }
            bytes.truncate(bytes.len() - (cut as usize).saturating_sub(100).min(bytes.len() - 1));
            match format::read(&place.file(&ending, &bytes)) {
                Ok(loaded) => prop_assert!(loaded.cloud.is_consistent() && loaded.cloud.first_non_finite().is_none()),
                Err(error) => prop_assert!(error.to_string().contains("cloud"), "{error}"),
            }
        }
    }

    /// Within the compression, where a checksum hides most changes from the test above.
    #[test]
    fn altered_spz_never_panics(header in prop::array::uniform16(any::<u8>()), keep in any::<u16>(), rest in 0usize..900) {
        let mut bytes = legacy_spz(3, 2, &vec![7; rest]);
        for (i, &byte) in header.iter().enumerate().filter(|(i, _)| keep >> i & 1 == 1) {
            bytes[i] = byte;
        }
        let loaded = format::read(&Place::new().file(".spz", &gzip(&bytes)));
        prop_assert!(loaded.is_ok() || loaded.unwrap_err().to_string().contains("cloud.spz"));
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// A header of degree 0 with 8 binary places, and what follows it.
fn legacy_spz(version: u32, gaussians: u32, rest: &[u8]) -> Vec<u8> {
    let mut bytes = b"NGSP".to_vec();
    bytes.extend([version, gaussians].iter().flat_map(|word| word.to_le_bytes()));
    bytes.extend([0, 8, 0, 0]);
    bytes.extend(rest);
    bytes
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    let place = Place::new();
    for (ending, bytes) in SAMPLES.clone() {
        for length in (0..bytes.len()).step_by(7).chain([bytes.len() - 1]) {
            // Whole rows of a .splat are a shorter .splat.
            let is_whole = ending == ".splat" && length % 32 == 0;
            let read = format::read(&place.file(&ending, &bytes[..length]));
            assert_eq!(read.is_ok(), is_whole, "{ending} cut to {length} of {} bytes", bytes.len());
        }
    }
}

#[test]
fn bytes_after_the_end_are_an_error() {
    let place = Place::new();
    for (ending, mut bytes) in SAMPLES.clone() {
        // A ZIP file is found from its end, and a gzip stream may be followed by others.
        if ending == ".sog" || bytes.starts_with(&[0x1f, 0x8b]) {
            continue;
        }
        bytes.push(0);
        let error = place.refused(&ending, &bytes);
        assert!(error.contains("again"), "{error}");
    }
}

#[test]
fn older_spz_is_read() {
    let place = Place::new();
    // Half floats 1, -2 and 0.5; opacity 128; colours; log-scales -10, -9 and -8; a rotation of a half turn
    // about z.
    let halves = [0x3c00u16, 0xc000, 0x3800].map(u16::to_le_bytes).concat();
    let fixed = [[0, 1, 0], [0, 0xfe, 0xff], [0x80, 0, 0]].concat();
    let others: [u8; 10] = [128, 127, 255, 0, 0, 16, 32, 128, 128, 255];
    for (version, positions) in [(1, halves), (2, fixed)] {
        let bytes = gzip(&legacy_spz(version, 1, &[positions, others.to_vec()].concat()));
        let loaded = format::read(&place.file(".spz", &bytes)).unwrap();
        // y and z point the other way.
        assert_eq!(loaded.cloud.positions, [[1.0, 2.0, -0.5]], "version {version}");
        assert_eq!(loaded.cloud.log_scales, [[-10.0, -9.0, -8.0]]);
        assert!((sigmoid(loaded.cloud.opacity_logits[0]) - 128.0 / 255.0).abs() < 1e-6);
        let [w, x, y, z] = loaded.cloud.rotations[0];
        assert!(
            w.abs() < 0.1 && x.abs() < 0.01 && y.abs() < 0.01 && z.abs() > 0.99,
            "{:?}",
            loaded.cloud.rotations
        );
        let base = &loaded.cloud.sh[0][..3];
        assert!((base[1] - 0.5 / 0.15).abs() < 1e-5 && (base[2] + 0.5 / 0.15).abs() < 1e-5, "{base:?}");
    }
}

#[test]
fn spz_that_cannot_be_is_refused() {
    let place = Place::new();
    let row = [0u8; 9 + 1 + 3 + 3 + 4];
    let sentence = |bytes: Vec<u8>| place.refused(".spz", &gzip(&bytes));
    let with = |at: usize, byte: u8| {
        let mut bytes = legacy_spz(3, 1, &row);
        bytes[at] = byte;
        bytes
    };
    for (bytes, words) in [
        (with(4, 9), "version 9"),
        (with(0, b'X'), "is no .spz"),
        (with(12, 5), "degree 5"),
        (with(13, 99), "99 binary places"),
        (legacy_spz(3, u32::MAX, &row), "claims 4294967295 Gaussians"),
        (legacy_spz(3, 2, &row), "cannot be decompressed"),
        (legacy_spz(3, 1, &[&row[..], &[1]].concat()), "goes on after"),
        (legacy_spz(4, 1, &row), "within gzip"),
    ] {
        let error = sentence(bytes);
        assert!(error.contains(words), "{error}");
    }
}

/// Extensions between the header and the table, which the whole file is shifted by.
fn with_extension(file: &[u8], kind: u32, payload: &[u8]) -> Vec<u8> {
    let mut bytes = file[..32].to_vec();
    bytes[14] |= 2;
    bytes[16..20].copy_from_slice(&(32 + 8 + payload.len() as u32).to_le_bytes());
    bytes.extend(kind.to_le_bytes());
    bytes.extend((payload.len() as u32).to_le_bytes());
    bytes.extend(payload);
    bytes.extend(&file[32..]);
    bytes
}

#[test]
fn extensions_of_spz_are_passed_over_or_heeded() {
    let place = Place::new();
    let path = place.file(".spz", b"");
    let cloud = varied(2, 30, 1);
    write(&path, &cloud, &Options::default());
    let file = fs::read(&path).unwrap();
    let plain = format::read(&path).unwrap().cloud;
    let read =
        |kind, payload: &[u8]| format::read(&place.file(".spz", &with_extension(&file, kind, payload)));
    assert_eq!(read(0x1234_0001, &[9; 24]).unwrap().cloud, plain, "unknown");
    assert_eq!(read(0xADBE_0003, &[4, 0, 0, 0]).unwrap().cloud, plain, "right, up, back");
    let down = read(0xADBE_0003, &[6, 0, 0, 0]).unwrap().cloud;
    assert_eq!(down.positions[3].map(|v| -v)[1..], plain.positions[3][1..], "right, down, forward");
    for (kind, payload, words) in [
        (0xADBE_0003u32, vec![1, 0, 0, 0], "axes"),
        (0xADBE_0003, vec![], "axes"),
        (0xADBE_0001, vec![0; 16], "spherical harmonics"),
    ] {
        let error = read(kind, &payload).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("export it"), "{error}");
    }
    let mut endless = with_extension(&file, 1, &[0; 4]);
    endless[36] = 200;
    assert!(place.refused(".spz", &endless).contains("ends within an extension"));
}

/// Within gzip they follow the attributes.
#[test]
fn extensions_of_older_spz_are_heeded_too() {
    let place = Place::new();
    let row = [[1, 2, 3].repeat(3), vec![7; 11]].concat();
    let read = |rest: &[u8]| {
        let mut bytes = legacy_spz(3, 1, &[&row[..], rest].concat());
        bytes[14] = 2;
        format::read(&place.file(".spz", &gzip(&bytes)))
    };
    let extension = |kind: u32, payload: &[u8]| {
        [&kind.to_le_bytes()[..], &(payload.len() as u32).to_le_bytes(), payload].concat()
    };
    let plain = read(&[]).unwrap().cloud;
    let down = read(&[extension(0x1234_0001, &[9; 5]), extension(0xADBE_0003, &[6, 0, 0, 0])].concat())
        .unwrap()
        .cloud;
    assert_eq!(down.positions[0].map(|v| -v)[1..], plain.positions[0][1..], "right, down, forward");
    for (kind, payload, words) in
        [(0xADBE_0003, &[1, 0, 0, 0][..], "axes"), (0xADBE_0001, &[0; 16], "spherical harmonics")]
    {
        let error = read(&extension(kind, payload)).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("export it"), "{error}");
    }
    assert_eq!(
        read(&[1; 20]).unwrap().cloud,
        plain,
        "a record without a size, as the first programs wrote it"
    );
    assert!(read(&vec![0; (1 << 20) + 1]).unwrap_err().to_string().contains("goes on after"));
}

/// An `.spz` of so many Gaussians, all of whose bytes are 0.
fn spz_of_zeros(gaussians: usize) -> Vec<u8> {
    let streams = [9, 1, 3, 3, 4].map(|bytes| vec![0; bytes * gaussians]);
    let compressed = streams.each_ref().map(|stream| zstd::bulk::compress(stream, 1).unwrap());
    let mut file = legacy_spz(4, gaussians as u32, &32u32.to_le_bytes());
    file[15] = 5;
    file.resize(32, 0);
    for (stream, compressed) in streams.iter().zip(&compressed) {
        file.extend([compressed.len(), stream.len()].map(|size| (size as u64).to_le_bytes()).concat());
    }
    [file, compressed.concat()].concat()
}

/// A file of repetitions is worth 64 bytes of memory a byte, beyond a quarter of a gigabyte.
#[test]
fn a_short_file_of_many_gaussians_is_refused() {
    let place = Place::new();
    let read = |gaussians| format::read(&place.file(".spz", &spz_of_zeros(gaussians)));
    assert_eq!(read(1_000_000).unwrap().cloud.len(), 1_000_000);
    // A megabyte of ballast, which an extension makes, is worth 284,000 more.
    let bomb = with_extension(&spz_of_zeros(1_500_000), 0x1234_0001, &[7; 1 << 20]);
    let error = place.refused(".spz", &bomb);
    assert!(error.contains("claims 1500000 Gaussians, far more than"), "{error}");
}

#[test]
fn compressed_ply_that_contradicts_itself_is_refused() {
    let place = Place::new();
    let path = place.file(".compressed.ply", b"");
    write(&path, &varied(3, 300, 1), &Options::default());
    let file = fs::read(&path).unwrap();
    let header_end = file.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
    let text = String::from_utf8(file[..header_end].to_vec()).unwrap();
    let with = |from: &str, to: &str| [text.replace(from, to).as_bytes(), &file[header_end..]].concat();
    for (from, to, words) in [
        ("element chunk 2", "element chunk 1", "again"),
        (
            "element vertex 300",
            "element vertex 18446744073709551615",
            "ends before the 18446744073709551615 rows",
        ),
        ("element sh 300", "element sh 3", "again"),
        ("min_y", "min_w", "no float property min_y"),
        ("float min_y", "uint min_y", "no float property min_y"),
        ("packed_scale", "packed_size", "no uint property packed_scale"),
        ("f_rest_8", "f_rest_9", "no uchar property f_rest_8"),
        ("element chunk 2", "element block 2", "no element chunk"),
        ("binary_little_endian", "ascii", "words or lists"),
    ] {
        let error = place.refused(".compressed.ply", &with(from, to));
        assert!(error.contains(words), "{from}: {error}");
    }
    // Rows without properties have no bytes, so any number of them fits.
    let empty =
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nelement chunk 3906250000\n\
        element vertex 0\nproperty uint packed_position\nend_header\n";
    assert!(place.refused(".compressed.ply", empty).contains("no uint property packed_position"));
}

fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    let length = 12 + 8 + json.len() + 8 + binary.len();
    [2, length as u32, json.len() as u32].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((binary.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(binary);
    bytes
}

#[test]
fn glb_that_holds_no_splat_or_lies_about_it_is_refused() {
    let place = Place::new();
    let primitive = |attributes: &str, accessors: &str| {
        format!(
            r#"{{"meshes":[{{"primitives":[{{"attributes":{{{attributes}}},"extensions":{{"KHR_gaussian_splatting":{{}}}}}}]}}],
            "accessors":[{accessors}],"bufferViews":[{{"byteLength":48}}]}}"#
        )
    };
    let all = r#""POSITION":0,"KHR_gaussian_splatting:ROTATION":0,"KHR_gaussian_splatting:SCALE":0,"KHR_gaussian_splatting:OPACITY":0"#;
    let floats =
        |count: u64| format!(r#"{{"bufferView":0,"componentType":5126,"type":"VEC3","count":{count}}}"#);
    for (json, words) in [
        ("{}".to_owned(), "holds no splat"),
        ("{".to_owned(), "description"),
        (primitive("", ""), "without POSITION"),
        (primitive(all, ""), "an accessor 0"),
        (primitive(all, &floats(5)), "ends before the 5 rows"),
        (primitive(all, &floats(u64::MAX)), "ends before the 18446744073709551615 rows"),
        (primitive(all, &floats(4)), "a VEC3 in accessor 0, where a VEC4 belongs"),
        (primitive(all, r#"{"componentType":1,"type":"VEC3","count":1}"#), "type 1"),
    ] {
        let error = place.refused(".glb", &glb(&json, &[0; 48]));
        assert!(error.contains(words), "{error}");
    }
    let mut short = glb("{}", &[]);
    short[8] += 1;
    assert!(place.refused(".glb", &short).contains("says that it has"));
}

/// A splat of one Gaussian in each of `primitives` primitives of mesh 0, placed by these nodes.
fn glb_of_nodes(nodes: &str, primitives: usize) -> Vec<u8> {
    let name = |name: &str, index: usize| format!(r#""KHR_gaussian_splatting:{name}":{index}"#);
    let attributes =
        [name("ROTATION", 1), name("SCALE", 0), name("OPACITY", 2), name("SH_DEGREE_0_COEF_0", 0)].join(",");
    let primitive = format!(
        r#"{{"attributes":{{"POSITION":0,{attributes}}},"extensions":{{"KHR_gaussian_splatting":{{}}}}}}"#
    );
    let accessors = ["VEC3", "VEC4", "SCALAR"]
        .map(|kind| format!(r#"{{"bufferView":0,"componentType":5126,"type":"{kind}","count":1}}"#));
    let json = format!(
        r#"{{"nodes":[{nodes}],"meshes":[{{"primitives":[{}]}}],"accessors":[{}],"bufferViews":[{{"byteLength":16}}]}}"#,
        vec![primitive; primitives].join(","),
        accessors.join(",")
    );
    glb(&json, &[0.5f32; 4].map(f32::to_le_bytes).concat())
}

#[test]
fn glb_that_moves_its_splat_is_refused() {
    let place = Place::new();
    assert_eq!(format::read(&place.file(".glb", &glb_of_nodes(r#"{"mesh":0}"#, 5))).unwrap().cloud.len(), 5);
    for (nodes, words) in [
        (r#"{"mesh":0},{"mesh":0,"translation":[100,0,0]}"#, "shows its splat twice"),
        (r#"{"mesh":0},{"children":[0],"translation":[100,0,0]}"#, "moves its splat by node 1"),
        (r#"{"mesh":0,"children":[1]},{"children":[0]}"#, "below themselves"),
    ] {
        let error = place.refused(".glb", &glb_of_nodes(nodes, 1));
        assert!(error.contains(words), "{error}");
    }
}

/// Each node is looked at once, however deep the splat lies: step by step for each primitive, this took 44
/// seconds.
#[test]
fn a_chain_of_many_nodes_takes_no_time() {
    let link =
        |at: usize| if at == 0 { r#"{"mesh":0}"#.into() } else { format!(r#"{{"children":[{}]}}"#, at - 1) };
    let nodes: Vec<String> = (0..40_000).map(link).collect();
    let place = Place::new();
    let path = place.file(".glb", &glb_of_nodes(&nodes.join(","), 5));
    let start = Instant::now();
    assert_eq!(format::read(&path).unwrap().cloud.len(), 5);
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
}

/// Normalised bytes and shorts, as the extension allows them.
#[test]
fn quantised_glb_is_read() {
    let accessor = |view: usize, kind: &str, component: u32, normalised: bool| {
        format!(
            r#"{{"bufferView":{view},"componentType":{component},"type":"{kind}","count":1,"normalized":{normalised}}}"#
        )
    };
    let accessors = [
        accessor(0, "VEC3", 5126, false),
        accessor(1, "VEC4", 5120, true),
        accessor(0, "VEC3", 5126, false),
        accessor(2, "SCALAR", 5121, true),
        accessor(0, "VEC3", 5126, false),
    ];
    let name = |name: &str, index: usize| format!(r#""KHR_gaussian_splatting:{name}":{index}"#);
    let attributes =
        [name("ROTATION", 1), name("SCALE", 2), name("OPACITY", 3), name("SH_DEGREE_0_COEF_0", 4)];
    let json = format!(
        r#"{{"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,{}}},"extensions":{{"KHR_gaussian_splatting":{{}}}}}}]}}],
        "accessors":[{}],"bufferViews":[{{"byteLength":12}},{{"byteOffset":12,"byteLength":4}},{{"byteOffset":16,"byteLength":1}}]}}"#,
        attributes.join(","),
        accessors.join(",")
    );
    let mut binary: Vec<u8> = [1.0f32, 2.0, 3.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    binary.extend([0, 0, 0, 127, 51, 0, 0, 0]);
    let loaded = format::read(&Place::new().file(".glb", &glb(&json, &binary))).unwrap();
    let Gaussians { positions, log_scales, rotations, opacity_logits, .. } = loaded.cloud;
    assert_eq!((positions[0], rotations[0]), ([1.0, -2.0, -3.0], [1.0, 0.0, 0.0, 0.0]));
    assert!((log_scales[0][2] - 3f32.ln()).abs() < 1e-6 && (sigmoid(opacity_logits[0]) - 0.2).abs() < 1e-6);
}

fn sog_meta(version: u32, count: u64) -> String {
    format!(
        r#"{{"version":{version},"count":{count},"means":{{"mins":[0,0,0],"maxs":[1,1,1],"files":["a","b"]}},
        "scales":{{"codebook":[],"files":["c"]}},"quats":{{"files":["d"]}},"sh0":{{"codebook":[],"files":["e"]}}}}"#
    )
}

/// A picture that unpacks to far more than its pixels take is not unpacked: 1.5 MB took 1.5 GB.
#[test]
fn a_sog_whose_picture_unpacks_to_too_much_is_refused() {
    let place = Place::new();
    let sentence = |bytes: usize| {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for (name, content) in [("meta.json", sog_meta(2, 1).into_bytes()), ("a", vec![0; bytes])] {
            zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
            zip.write_all(&content).unwrap();
        }
        place.refused(".sog", &zip.finish().unwrap().into_inner())
    };
    // 8 bytes for each of 2^20 + 2 pixels, and 64 KiB.
    let most = 8 * ((1 << 20) + 2) + (1 << 16);
    assert!(sentence(most).contains("no readable picture in a"), "{}", sentence(most));
    let error = sentence(most + 1);
    assert!(error.contains(&format!("more than {most} bytes in a")), "{error}");
}

#[test]
fn a_sog_without_its_pictures_is_refused() {
    let place = Place::new();
    for (json, words) in [
        (sog_meta(2, 1), "no readable a"),
        (sog_meta(1, 1), "version 1"),
        (sog_meta(2, u64::MAX), "claims 18446744073709551615 Gaussians"),
        ("{}".into(), "meta.json that is not valid"),
    ] {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        zip.start_file("meta.json", zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(json.as_bytes()).unwrap();
        let error = place.refused(".sog", &zip.finish().unwrap().into_inner());
        assert!(error.contains(words), "{error}");
    }
}
