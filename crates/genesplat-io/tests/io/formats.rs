//! Clouds survive every format within the steps that it has for each value.

use std::fs;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};

use genesplat_core::gaussians::{logit, sigmoid};
use genesplat_core::spherical_harmonics::C0;
use genesplat_core::{Gaussians, Rng, ScreenFilter, Stream, morton_order};
use genesplat_io::format::{self, Format, Options, SpzVersion};
use genesplat_io::ply;
use tempfile::TempDir;

/// Half the side of the cube that [`varied`] fills.
const EXTENT: f32 = 3.0;
/// Log-scales of [`varied`].
const LOG_SCALES: [f32; 2] = [-6.0, -1.0];
/// Largest coefficient of [`varied`].
const SH_MAX: f32 = 0.8;

/// A cloud along a Morton curve, so that no writer changes its order. Eight rows each share their harmonics,
/// so that a palette can hold them all.
pub(crate) fn varied(seed: u64, rows: usize, sh_degree: u8) -> Gaussians {
    let rng = Rng::new(seed);
    // Uniform in -1..1, a function of row and column.
    let uniform = |row: usize, column: u32| {
        let bits = rng.at(Stream::Test, row as u32, column / 4, 0).0[(column % 4) as usize];
        bits as f32 / 2.0f32.powi(31) - 1.0
    };
    let mut cloud = Gaussians::zeros(rows);
    let [low, high] = LOG_SCALES;
    let rest = 3 * (usize::from(sh_degree) + 1).pow(2);
    for row in 0..rows {
        cloud.positions[row] = std::array::from_fn(|i| EXTENT * uniform(row, i as u32));
        cloud.log_scales[row] =
            std::array::from_fn(|i| low + (high - low) * (0.5 + 0.5 * uniform(row, 4 + i as u32)));
        cloud.rotations[row] = std::array::from_fn(|i| uniform(row, 8 + i as u32));
        cloud.opacity_logits[row] = 6.0 * uniform(row, 12);
        cloud.sh[row][..3].copy_from_slice(&[16, 17, 18].map(|column| 1.5 * uniform(row, column)));
        for slot in 3..rest {
            cloud.sh[row][slot] = SH_MAX * uniform(row / 8, 20 + slot as u32);
        }
    }
    let order = morton_order(&cloud.positions);
    let sh = std::mem::take(&mut cloud.sh);
    cloud.sh = vec![[0.0; 48]; rows];
    let mut ordered = cloud.gather(&order);
    ordered.sh = sh;
    ordered
}

/// How far the values of a format may be from those that were written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steps {
    pub(crate) position: f32,
    pub(crate) log_scale: f32,
    /// Angle of the rotation between the two, radians.
    pub(crate) angle: f32,
    pub(crate) opacity: f32,
    pub(crate) base_colour: f32,
    pub(crate) harmonic: f32,
}

/// Half a step of a byte that spans `range`.
fn byte_step(range: f32) -> f32 {
    range / 255.0 / 2.0
}

/// The angle that an error of each of the three smallest components makes. The fourth, of at least 1/2,
/// follows them: its error is at most three times theirs, so the four have a norm of at most `√12` times it,
/// and an angle is twice that.
fn angle_of(component: f32) -> f32 {
    2.0 * 12f32.sqrt() * component
}

const ROUNDING: f32 = 2e-6;

pub(crate) fn steps(format: Format) -> Steps {
    let exact = Steps {
        position: 0.0,
        log_scale: 0.0,
        angle: 2.0 * 4.0 * f32::EPSILON.sqrt(),
        opacity: 0.0,
        base_colour: 0.0,
        harmonic: 0.0,
    };
    let three = std::f32::consts::SQRT_2;
    let log_extent = 2.0 * EXTENT.ln_1p();
    let scale_range = LOG_SCALES[1] - LOG_SCALES[0];
    match format {
        Format::Ply => exact,
        // Ranges of a chunk are at most those of all; the axis of fewest bits has 10.
        Format::CompressedPly => Steps {
            position: 2.0 * EXTENT / 1023.0 / 2.0 + ROUNDING,
            log_scale: scale_range / 1023.0 / 2.0 + ROUNDING,
            angle: angle_of(three / 1023.0 / 2.0) + exact.angle,
            opacity: byte_step(1.0) + ROUNDING,
            base_colour: byte_step(3.0) + ROUNDING,
            harmonic: 8.0 / 256.0 / 2.0 + ROUNDING,
        },
        // A component of 1 would be the byte 256, and is 255.
        Format::Splat => Steps {
            log_scale: ROUNDING,
            angle: 2.0 * 2.0 * (1.0 / 128.0),
            opacity: byte_step(1.0) + ROUNDING,
            base_colour: byte_step(1.0) / C0 as f32 + ROUNDING,
            harmonic: 0.0,
            ..exact
        },
        // 12 binary places; harmonics are rounded to 1/128.
        Format::Spz => Steps {
            position: 0.5 / 4096.0 + ROUNDING,
            log_scale: 0.5 / 16.0 + ROUNDING,
            angle: angle_of(three / 2.0 / 511.0 / 2.0) + exact.angle,
            opacity: byte_step(1.0) + ROUNDING,
            base_colour: byte_step(1.0) / 0.15 + ROUNDING,
            harmonic: 0.5 / 128.0 + ROUNDING,
        },
        // A step of the logarithmic scale is widest far away. Values of a codebook lie about evenly here, at
        // most three times as far from each other as on average.
        Format::Sog => Steps {
            position: log_extent / 65535.0 / 2.0 * (1.0 + EXTENT) + ROUNDING,
            log_scale: 3.0 * scale_range / 256.0 / 2.0,
            angle: angle_of(three / 255.0 / 2.0) + exact.angle,
            opacity: byte_step(1.0) + ROUNDING,
            base_colour: 3.0 * 3.0 / 256.0 / 2.0,
            harmonic: 3.0 * 2.0 * SH_MAX / 256.0 / 2.0,
        },
        Format::Glb => Steps { log_scale: ROUNDING, opacity: ROUNDING, ..exact },
    }
}

/// Why `read` is not `written` within `steps`, row by row.
pub(crate) fn difference(read: &Gaussians, written: &Gaussians, steps: &Steps) -> Result<(), String> {
    if read.len() != written.len() {
        return Err(format!("{} rows of {}", read.len(), written.len()));
    }
    let largest = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0f32, f32::max);
    for row in 0..read.len() {
        let found = [
            (largest(&read.positions[row], &written.positions[row]), steps.position, "position"),
            (largest(&read.log_scales[row], &written.log_scales[row]), steps.log_scale, "log-scale"),
            (angle(read.rotations[row], written.rotations[row]), steps.angle, "rotation"),
            (
                (sigmoid(read.opacity_logits[row]) - sigmoid(written.opacity_logits[row])).abs(),
                steps.opacity,
                "opacity",
            ),
            (largest(&read.sh[row][..3], &written.sh[row][..3]), steps.base_colour, "base colour"),
            (largest(&read.sh[row][3..], &written.sh[row][3..]), steps.harmonic, "harmonics"),
        ];
        if let Some((off, step, what)) = found.into_iter().find(|(off, step, _)| off.is_nan() || off > step) {
            return Err(format!("row {row}: {what} is off by {off}, more than {step}"));
        }
    }
    Ok(())
}

fn angle(a: [f32; 4], b: [f32; 4]) -> f32 {
    let dot =
        |a: [f32; 4], b: [f32; 4]| a.iter().zip(&b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    let cosine = dot(a, b).abs() / (dot(a, a) * dot(b, b)).sqrt();
    (2.0 * cosine.min(1.0).acos()) as f32
}

/// What `.splat` cannot hold is not expected of it.
fn expected(format: Format, cloud: &Gaussians) -> Gaussians {
    let mut cloud = cloud.clone();
    if format == Format::Splat {
        cloud.sh.iter_mut().for_each(|row| row[3..].fill(0.0));
    }
    cloud
}

fn file(folder: &TempDir, format: Format) -> PathBuf {
    folder.path().join(format!("cloud{}", format.ending()))
}

pub(crate) fn write(path: &Path, cloud: &Gaussians, options: &Options) -> u64 {
    format::write(path, Format::of(path).unwrap(), cloud, options).unwrap()
}

#[test]
fn clouds_survive_every_format_within_its_steps() {
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL {
        for (seed, rows, degree) in [(1, 1, 0), (2, 257, 1), (3, 1000, 2), (4, 600, 3)] {
            for spz_version in [SpzVersion::V3, SpzVersion::V4] {
                let (path, cloud) = (file(&folder, format), varied(seed, rows, degree));
                let bytes = write(&path, &cloud, &Options { spz_version, ..Options::default() });
                assert_eq!(bytes, fs::metadata(&path).unwrap().len());
                let loaded = format::read(&path).unwrap();
                assert_eq!(loaded.format, format);
                let held = match format {
                    Format::Ply => 3,
                    Format::Splat => 0,
                    _ => degree,
                };
                assert_eq!(loaded.sh_degree, held, "{format:?}");
                let difference = difference(&loaded.cloud, &expected(format, &cloud), &steps(format));
                assert_eq!(difference, Ok(()), "{format:?} of {rows} rows and degree {degree}");
            }
        }
    }
}

/// Three times a step away, each value is noticed.
#[test]
fn a_value_that_is_off_is_noticed() {
    let cloud = varied(5, 300, 3);
    let changes: [fn(&mut Gaussians, &Steps); 6] = [
        |cloud, steps| cloud.positions[200][1] += 3.0 * steps.position + 1e-5,
        |cloud, steps| cloud.log_scales[200][2] += 3.0 * steps.log_scale + 1e-5,
        |cloud, steps| {
            // Turned about x by the angle.
            let (sin, cos) = (1.5 * steps.angle + 1e-3).sin_cos();
            let [w, x, y, z] = cloud.rotations[200];
            cloud.rotations[200] =
                [w * cos - x * sin, w * sin + x * cos, y * cos - z * sin, y * sin + z * cos];
        },
        |cloud, steps| {
            let opacity = sigmoid(cloud.opacity_logits[200]);
            let away = 3.0 * steps.opacity + 1e-4;
            cloud.opacity_logits[200] = logit(if opacity > 0.5 { opacity - away } else { opacity + away });
        },
        |cloud, steps| cloud.sh[200][0] -= 3.0 * steps.base_colour + 1e-5,
        |cloud, steps| cloud.sh[200][47] += 3.0 * steps.harmonic + 1e-5,
    ];
    for format in Format::ALL {
        let steps = steps(format);
        assert_eq!(difference(&cloud, &cloud, &steps), Ok(()));
        for (index, change) in changes.iter().enumerate() {
            let mut changed = cloud.clone();
            change(&mut changed, &steps);
            let noticed = difference(&changed, &cloud, &steps).unwrap_err();
            assert!(noticed.starts_with("row 200"), "{format:?} {index}: {noticed}");
        }
        assert!(difference(&cloud.gather(&[0]), &cloud, &steps).is_err());
    }
}

/// Rows of one chunk, so that the ranges of a compressed PLY stay, too.
#[test]
fn what_is_read_and_written_again_stays() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = varied(6, 250, 2);
    let exact = Steps {
        position: 2e-6,
        log_scale: 2e-6,
        angle: steps(Format::Ply).angle,
        opacity: 2e-6,
        base_colour: 2e-6,
        harmonic: 2e-6,
    };
    for format in [Format::CompressedPly, Format::Spz, Format::Glb] {
        let path = file(&folder, format);
        write(&path, &cloud, &Options::default());
        let once = format::read(&path).unwrap().cloud;
        // Rounded positions have another order along the curve.
        let once = once.gather(&morton_order(&once.positions));
        write(&path, &once, &Options::default());
        assert_eq!(difference(&format::read(&path).unwrap().cloud, &once, &exact), Ok(()), "{format:?}");
    }
}

#[test]
fn a_gaussian_without_a_thickness_costs_its_neighbours_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut cloud = varied(6, 250, 2);
    cloud.log_scales[9][2] = f32::MIN_POSITIVE.ln();
    let path = file(&folder, Format::CompressedPly);
    write(&path, &cloud, &Options::default());
    let mut read: Vec<f32> =
        format::read(&path).unwrap().cloud.log_scales.iter().map(|scales| scales[2]).collect();
    let mut wanted: Vec<f32> = cloud.log_scales.iter().map(|scales| scales[2].max(-20.0)).collect();
    [&mut read, &mut wanted].into_iter().for_each(|values| values.sort_by(f32::total_cmp));
    // 10 bits between -20 and what is usual.
    assert!(read.iter().zip(&wanted).all(|(read, wanted)| (read - wanted).abs() < 0.012), "{read:?}");
}

/// Rows leave along the Morton curve; nothing but their order changes.
#[test]
fn rows_may_change_their_order_and_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = varied(7, 700, 1);
    let reversed = cloud.gather(&(0..700).rev().collect::<Vec<u32>>());
    for format in [Format::CompressedPly, Format::Spz] {
        let path = file(&folder, format);
        write(&path, &reversed, &Options::default());
        assert_eq!(
            difference(&format::read(&path).unwrap().cloud, &cloud, &steps(format)),
            Ok(()),
            "{format:?}"
        );
    }
}

#[test]
fn formats_that_can_say_how_to_filter_do() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = varied(8, 20, 0);
    for screen_filter in [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip] {
        for format in Format::ALL {
            let path = file(&folder, format);
            write(&path, &cloud, &Options { screen_filter, ..Options::default() });
            let said = match (format, screen_filter) {
                (Format::Splat | Format::Glb, _) => None,
                (Format::Spz | Format::Sog, ScreenFilter::Mip) => Some(ScreenFilter::Antialiased),
                _ => Some(screen_filter),
            };
            assert_eq!(format::read(&path).unwrap().screen_filter, said, "{format:?}");
        }
    }
}

/// The comment of a compressed PLY is the one that splat-transform and viewers know.
#[test]
fn a_compressed_ply_says_how_to_filter_in_known_words() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, Format::CompressedPly);
    write(&path, &varied(8, 20, 0), &Options { screen_filter: ScreenFilter::Mip, ..Options::default() });
    let bytes = fs::read(&path).unwrap();
    let comment = b"ply\nformat binary_little_endian 1.0\ncomment SplatRenderMode: mip\nelement chunk 1\n";
    assert!(bytes.starts_with(comment), "{}", String::from_utf8_lossy(&bytes[..100]));
    let silent = [&bytes[..36], &bytes[comment.len() - "element chunk 1\n".len()..]].concat();
    fs::write(&path, silent).unwrap();
    assert_eq!(format::read(&path).unwrap().screen_filter, None);
}

/// The file with another `meta.json`.
fn with_meta(sog: &[u8], change: impl Fn(&mut serde_json::Map<String, serde_json::Value>)) -> Vec<u8> {
    let mut from = zip::ZipArchive::new(Cursor::new(sog)).unwrap();
    let mut to = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for index in 0..from.len() {
        let mut bytes = Vec::new();
        let mut entry = from.by_index(index).unwrap();
        entry.read_to_end(&mut bytes).unwrap();
        let name = entry.name().unwrap().into_owned();
        if name == "meta.json" {
            let mut meta: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
            change(meta.as_object_mut().unwrap());
            bytes = serde_json::to_vec(&meta).unwrap();
        }
        to.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        to.write_all(&bytes).unwrap();
    }
    to.finish().unwrap().into_inner()
}

/// Programs of either time find the mark that they know, and we find either.
#[test]
fn a_sog_has_the_marks_of_older_and_newer_programs() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, Format::Sog);
    for (screen_filter, marks) in
        [(ScreenFilter::Classic, (false, None)), (ScreenFilter::Antialiased, (true, Some("antialiased")))]
    {
        write(&path, &varied(8, 20, 0), &Options { screen_filter, ..Options::default() });
        let sog = fs::read(&path).unwrap();
        with_meta(&sog, |meta| {
            let model = meta.get("model").map(|model| model.as_str().unwrap());
            assert_eq!((meta["antialias"].as_bool().unwrap(), model), marks);
        });
        let without = |mark: &str| {
            fs::write(&path, with_meta(&sog, |meta| drop(meta.remove(mark)))).unwrap();
            format::read(&path).unwrap().screen_filter.unwrap()
        };
        assert_eq!((without("antialias"), without("model")), (screen_filter, screen_filter));
    }
}

/// Their `null` is one even step before the second value.
#[test]
fn a_sog_of_older_programs_has_codebooks_that_begin_with_null() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, Format::Sog);
    write(&path, &varied(16, 300, 1), &Options::default());
    let (sog, expected) = (fs::read(&path).unwrap(), format::read(&path).unwrap().cloud);
    let with_null = |part: &str, at: usize| {
        with_meta(&sog, |meta| meta[part]["codebook"].as_array_mut().unwrap()[at] = serde_json::Value::Null)
    };
    for part in ["scales", "sh0", "shN"] {
        fs::write(&path, with_null(part, 0)).unwrap();
        let read = format::read(&path).unwrap().cloud;
        let column = |cloud: &Gaussians| match part {
            "scales" => cloud.log_scales.as_flattened().to_vec(),
            _ => cloud.sh.as_flattened().to_vec(),
        };
        let changed = column(&read).iter().zip(column(&expected)).filter(|&(&a, b)| a != b).count();
        assert!(
            (1..column(&read).len() / 4).contains(&changed) && read.first_non_finite().is_none(),
            "{part}: {changed}"
        );
        fs::write(&path, with_null(part, 7)).unwrap();
        assert!(format::read(&path).unwrap_err().to_string().contains("a codebook with null in it"));
    }
}

/// Only the PLY keeps the filter; elsewhere the Gaussians are as wide and as faint as it makes them.
#[test]
fn a_3d_filter_is_baked_in_where_there_is_no_place_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = Gaussians { filter_3d: Some(vec![0.05; 40]), ..varied(9, 40, 0) };
    for format in Format::ALL {
        let path = file(&folder, format);
        write(&path, &cloud, &Options::default());
        let read = format::read(&path).unwrap().cloud;
        let kept = if format == Format::Ply { cloud.clone() } else { cloud.fused() };
        assert_eq!(read.filter_3d, kept.filter_3d, "{format:?}");
        assert_eq!(difference(&read, &kept, &steps(format)), Ok(()), "{format:?}");
        assert!(format == Format::Ply || difference(&read, &cloud, &steps(format)).is_err(), "{format:?}");
    }
}

#[test]
fn harmonics_are_cut_at_the_degree_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = varied(10, 100, 3);
    for format in Format::ALL {
        let sizes = [0, 1, 2, 3].map(|sh_degree| {
            let path = file(&folder, format);
            let bytes = write(&path, &cloud, &Options { sh_degree, ..Options::default() });
            let loaded = format::read(&path).unwrap();
            let held = if format == Format::Splat { 0 } else { sh_degree };
            assert_eq!((loaded.sh_degree, loaded.cloud.sh_degree_in_use()), (held, held), "{format:?}");
            bytes
        });
        assert!(format == Format::Splat || sizes.is_sorted_by(|a, b| a < b), "{format:?} {sizes:?}");
    }
}

#[test]
fn the_same_cloud_is_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = varied(11, 400, 3);
    for format in Format::ALL {
        let path = file(&folder, format);
        let [once, again] = [(); 2].map(|()| {
            write(&path, &cloud, &Options::default());
            fs::read(&path).unwrap()
        });
        assert!(once == again, "{format:?}");
    }
}

/// What tells a file's format is what it begins with; only `.splat` has no mark.
#[test]
fn content_goes_before_the_name() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = varied(12, 10, 0);
    for format in Format::ALL {
        let path = file(&folder, format);
        write(&path, &cloud, &Options::default());
        let renamed = folder.path().join("other.ply");
        fs::rename(&path, &renamed).unwrap();
        match format {
            Format::Splat => assert!(format::read(&renamed).is_err()),
            _ => assert_eq!(format::read(&renamed).unwrap().format, format),
        }
    }
}

/// The first number of such a file begins as gzip does.
#[test]
fn a_splat_is_not_taken_for_gzip() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, Format::Splat);
    let mut cloud = varied(17, 3, 0);
    cloud.positions[0][0] = f32::from_bits(0x3f80_8b1f);
    write(&path, &cloud, &Options::default());
    assert_eq!(format::read(&path).unwrap().cloud.positions, cloud.positions);
}

#[test]
fn the_farthest_position_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL.into_iter().filter(|&format| format != Format::Spz) {
        let path = file(&folder, format);
        let mut cloud = varied(18, 2, 0);
        (cloud.positions[0], cloud.positions[1]) = ([1e9; 3], [-1e9; 3]);
        write(&path, &cloud, &Options::default());
        let read = format::read(&path).unwrap().cloud.positions;
        assert!(read.iter().flatten().all(|v| (0.9999e9..=1e9).contains(&v.abs())), "{format:?}: {read:?}");
    }
}

#[test]
fn converters_infinite_opacities_become_opaque_and_transparent() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    let mut cloud = varied(13, 3, 0);
    cloud.opacity_logits = vec![f32::INFINITY, f32::NEG_INFINITY, 0.5];
    write(&path, &cloud, &Options::default());
    let read = format::read(&path).unwrap().cloud;
    assert!(read.opacity_logits.iter().all(|logit| logit.is_finite()));
    let opacities: Vec<f32> = read.opacity_logits.iter().map(|&logit| sigmoid(logit)).collect();
    assert!(
        opacities[0] > 0.999_999 && opacities[1] < 1e-6 && read.opacity_logits[2] == 0.5,
        "{opacities:?}"
    );
    cloud.opacity_logits[1] = f32::NAN;
    write(&path, &cloud, &Options::default());
    let error = format::read(&path).unwrap_err().to_string();
    assert!(error.contains("cloud.ply") && error.contains("opacity of Gaussian 1 is not finite"), "{error}");
}

#[test]
fn a_log_scale_of_minus_infinity_is_a_scale_of_0() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    let mut cloud = varied(16, 3, 0);
    cloud.log_scales[1][2] = f32::NEG_INFINITY;
    write(&path, &cloud, &Options::default());
    let read = format::read(&path).unwrap().cloud;
    for format in Format::ALL {
        let path = file(&folder, format);
        write(&path, &read, &Options::default());
        let [x, y, z] = format::read(&path).unwrap().cloud.log_scales[1];
        assert!(z.exp() < 1e-4 && x.min(y) > LOG_SCALES[0] - 0.1, "{format:?}: {x} {y} {z}");
    }
    cloud.log_scales[1][2] = f32::INFINITY;
    write(&path, &cloud, &Options::default());
    let error = format::read(&path).unwrap_err().to_string();
    assert!(error.contains("log-scale of Gaussian 1 is not finite"), "{error}");
    let (sound, faults) = ply::leave_out_faults(format::read_unchecked(&path).unwrap().cloud);
    assert_eq!((sound, faults.len()), (cloud.gather(&[0, 2]), 1));
}

#[test]
fn what_is_not_finite_is_not_packed() {
    let folder = tempfile::tempdir().unwrap();
    let mut cloud = varied(14, 3, 1);
    cloud.sh[2][5] = f32::NAN;
    for format in Format::ALL.into_iter().filter(|&format| format != Format::Ply) {
        let error = format::write(&file(&folder, format), format, &cloud, &Options::default()).unwrap_err();
        assert!(error.to_string().contains("colour of Gaussian 2"), "{error}");
        assert!(!file(&folder, format).exists());
    }
}
