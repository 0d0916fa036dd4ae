//! Every reader of strangers' bytes, and what must hold of what it reads.
//!
//! That nothing panics, overflows, hangs or fills memory holds of all. Errors are shown, since a sentence is
//! made only then. What was read is written and read again, where there is a writer.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use genesplat_core::Gaussians;
use genesplat_io::bytes;
use genesplat_io::colmap::Form;
use genesplat_io::format::{Format, Options};
use genesplat_io::ply::leave_out_faults;
use genesplat_metrics::weights::read_weights;
use genesplat_train::{Checkpoint, TrainConfig};
use genesplat_viewer::message::ClientMessage;
use genesplat_viewer::path::CameraPath;

use crate::{planted, wrap};

pub(crate) type Target = fn(&[u8]);

/// Each with the name of its folder in `corpus/`.
pub(crate) const ALL: [(&str, Target); 32] = [
    ("archive", archive),
    ("archive-names", |bytes| archive(&wrap::empty_entries(bytes.split(|byte| *byte == b'\n')))),
    ("cameras-bin", |bytes| drop(said(bytes::cameras(Form::Binary, bytes)))),
    ("cameras-txt", |bytes| drop(said(bytes::cameras(Form::Text, bytes)))),
    ("images-bin", |bytes| drop(said(bytes::images(Form::Binary, bytes)))),
    ("images-txt", |bytes| drop(said(bytes::images(Form::Text, bytes)))),
    ("frames-bin", |bytes| drop(said(bytes::frames(Form::Binary, bytes)))),
    ("frames-txt", |bytes| drop(said(bytes::frames(Form::Text, bytes)))),
    ("points-bin", |bytes| points(Form::Binary, bytes)),
    ("points-txt", |bytes| points(Form::Text, bytes)),
    ("lenses", lenses),
    ("transforms", |bytes| drop(said(bytes::transforms(bytes)))),
    ("photos", |bytes| drop(said(bytes::photo(bytes, PHOTO_PIXELS_MAX)))),
    ("depths", depths),
    ("points-ply", |bytes| drop(said(bytes::point_cloud(bytes)))),
    ("ply", |bytes| splat(Format::Ply, bytes)),
    ("compressed-ply", |bytes| splat(Format::CompressedPly, bytes)),
    ("splat", |bytes| splat(Format::Splat, bytes)),
    ("spz", |bytes| splat(Format::Spz, bytes)),
    ("spz-inside", |bytes| splat(Format::Spz, &wrap::gzip(bytes))),
    ("sog", |bytes| splat(Format::Sog, bytes)),
    ("sog-inside", |bytes| splat(Format::Sog, &wrap::zip(&SOG_PARTS, bytes))),
    ("glb", |bytes| splat(Format::Glb, bytes)),
    ("offset", offset),
    ("values", values),
    ("config", config),
    ("checkpoint", |bytes| checkpoint(&wrap::checkpoint(bytes))),
    ("weights", weights),
    ("weights-inside", |bytes| weights(&wrap::zip(&PTH_PARTS, bytes))),
    ("message", message),
    ("request", |bytes| drop(bytes_of_a_page(bytes))),
    ("camera-path", camera_path),
];

/// What an archive of the few kilobytes of an input may claim.
const UNPACKED_MAX: u64 = 1 << 27;
const PHOTO_PIXELS_MAX: u64 = 1 << 14;
/// A lens is undone point by point, which takes long for large photos.
const LENS_SIDE_MAX: u32 = 24;
/// Larger clouds are read, but not written again.
const CLOUD_MAX: usize = 64;
/// Everything that a Gaussian has, its 3D filter among it.
pub(crate) const VALUES_PER_ROW: usize = 60;

/// As genesplat names them.
pub(crate) const SOG_PARTS: [&str; 8] = [
    "meta.json",
    "means_l.webp",
    "means_u.webp",
    "scales.webp",
    "quats.webp",
    "sh0.webp",
    "shN_centroids.webp",
    "shN_labels.webp",
];
/// As `torch.save` names them.
pub(crate) const PTH_PARTS: [&str; 4] = ["a/data.pkl", "a/byteorder", "a/version", "a/data/0"];

pub(crate) const TOKEN: &str = "5e1f";

/// What was read, or nothing, once the reason is said.
fn said<T>(read: Result<T, impl std::fmt::Display>) -> Option<T> {
    read.map_err(|error| assert!(!error.to_string().trim().is_empty(), "an error says something")).ok()
}

/// Points, and tracks of as many.
fn points(form: Form, bytes: &[u8]) {
    let (points, tracks) = (said(bytes::points(form, bytes)), said(bytes::tracks(form, bytes)));
    if let (Some(points), Some(tracks)) = (points, tracks) {
        assert_eq!(points.len(), tracks.len());
    }
}

/// What is unpacked is no more than is likely, and every name is one file's.
fn archive(bytes: &[u8]) {
    let Some(files) = said(bytes::unpacked(bytes)) else { return };
    assert!(files.iter().map(|(_, bytes)| bytes).sum::<u64>() <= UNPACKED_MAX);
    let names: BTreeSet<String> =
        files.iter().map(|(file, _)| file.to_string_lossy().to_lowercase()).collect();
    assert_eq!(names.len(), files.len(), "a name that occurs twice is refused");
    let list = bytes.windows(4).filter(|mark| mark == b"PK\x01\x02").count();
    assert!(files.len() <= list, "no entry is made up");
}

/// A map is the same where COLMAP has it.
fn depths(bytes: &[u8]) {
    let Some(map) = said(bytes::depths(bytes)) else { return };
    let again = bytes::depths(&map).expect("what is written is read");
    assert_eq!(again, map);
}

fn lenses(bytes: &[u8]) {
    for camera in said(bytes::cameras(Form::Text, bytes)).unwrap_or_default().values().take(2) {
        bytes::undistorted(camera, LENS_SIDE_MAX);
    }
}

fn splat(format: Format, bytes: &[u8]) {
    let Some(read) = said(bytes::splat(format, bytes)) else { return };
    assert!(read.cloud.is_consistent() && read.sh_degree <= 3);
    if format == Format::Splat {
        planted::meet(bytes);
    }
    if read.cloud.len() > CLOUD_MAX {
        return;
    }
    let options = Options { sh_degree: read.sh_degree, ..Options::default() };
    let Some(file) = said(bytes::written(format, &read.cloud, &options)) else { return };
    let again = bytes::splat(format, &file).expect("what is written is read").cloud;
    assert_eq!(again.len(), read.cloud.len());
    let is_exact = format == Format::Ply;
    assert!(!is_exact || is_same(&again, &read.cloud), "every bit is kept");
    if is_exact {
        let far = Options { offset: Some([431_250.5, 5_412_345.25, -300.0]), ..options };
        let file = bytes::written(format, &read.cloud, &far).expect("it was written without an offset");
        let again = said(bytes::splat(format, &file));
        assert!(again.is_none_or(|again| again.cloud.len() == read.cloud.len()));
    }
}

/// What is believed is written so that it is read again.
fn offset(bytes: &[u8]) {
    let Some(offset) = said(bytes::offset(bytes)) else { return };
    assert_eq!(bytes::offset(genesplat_io::offset::to_json(offset).as_bytes()), Ok(offset));
}

/// Whatever numbers a cloud holds: without what cannot be shown, every format takes it or says why not, and
/// what is written is read again whole.
fn values(bytes: &[u8]) {
    let numbers: Vec<f32> = bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let (rows, _) = numbers.as_chunks::<VALUES_PER_ROW>();
    let mut cloud = Gaussians { filter_3d: Some(vec![0.0; rows.len()]), ..Gaussians::zeros(rows.len()) };
    for (row, [x, y, z, sx, sy, sz, a, b, c, d, opacity, filter, sh @ ..]) in rows.iter().enumerate() {
        cloud.positions[row] = [*x, *y, *z];
        cloud.log_scales[row] = [*sx, *sy, *sz];
        cloud.rotations[row] = [*a, *b, *c, *d];
        cloud.opacity_logits[row] = *opacity;
        cloud.sh[row] = *sh;
        cloud.filter_3d.iter_mut().for_each(|filters| filters[row] = *filter);
    }
    let (sound, faults) = leave_out_faults(cloud);
    assert!(
        sound.len() + faults.len() == rows.len() && faults.iter().all(|fault| !fault.to_string().is_empty())
    );
    if sound.is_empty() {
        return;
    }
    for format in Format::ALL {
        let Some(file) = said(bytes::written(format, &sound, &Options::default())) else { continue };
        let again = bytes::splat(format, &file).expect("what is written is read").cloud;
        assert_eq!(again.len(), sound.len(), "{format:?}");
    }
}

/// Zeros of either sign are equal, and nothing that was read is NaN.
fn is_same(a: &Gaussians, b: &Gaussians) -> bool {
    a == b
}

fn config(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else { return };
    let Some(config) = said(toml::from_str::<TrainConfig>(text)) else { return };
    let written = toml::to_string(&config).ok();
    let Some(schedule) = said(config.clone().resolve()) else { return };
    let again =
        toml::from_str::<TrainConfig>(&written.expect("what is valid is written")).expect("and read again");
    assert_eq!(again, config);
    let last = schedule.iterations;
    for i in [1, 500.min(last), last.div_ceil(2), last.saturating_sub(1).max(1), last] {
        let events = schedule.timeline().at(i).count();
        assert!(events > 0 && schedule.sh_degree(i) <= 3);
        schedule.rates(1.0, i);
        schedule.timeline().optimiser_step(i);
    }
}

fn checkpoint(bytes: &[u8]) {
    let Some(read) = said(Checkpoint::read(bytes)) else { return };
    let mut written = Vec::new();
    read.write(&mut written).expect("memory takes it");
    let again = Checkpoint::read(&written[..]).expect("what is written is read");
    let mut twice = Vec::new();
    again.write(&mut twice).expect("memory takes it");
    assert!(written == twice, "what was read and written again reads the same");
}

/// The reader of PyTorch's files takes a path.
fn weights(bytes: &[u8]) {
    static FILE: LazyLock<PathBuf> = LazyLock::new(|| {
        let memory = PathBuf::from("/dev/shm");
        let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
        folder.join(format!("genesplat-fuzz-{}", std::process::id()))
    });
    fs::write(&*FILE, bytes).expect("a small file can be written");
    let read = said(read_weights(&FILE, |_| true)).unwrap_or_default();
    fs::remove_file(&*FILE).expect("it is ours");
    for tensor in read.values() {
        assert_eq!(
            tensor.shape.iter().product::<usize>(),
            tensor.values.len(),
            "a shape holds for its values"
        );
    }
}

fn message(bytes: &[u8]) {
    let Some(ClientMessage::Look(look)) = said(ClientMessage::parse(bytes)) else { return };
    let camera = look.pose.camera(look.width, look.height);
    assert!(camera.focal_px[0].is_finite() && camera.centre_in_world().is_finite(), "{look:?}");
}

fn bytes_of_a_page(bytes: &[u8]) -> Option<String> {
    genesplat_viewer::bytes::request(TOKEN, bytes).ok().flatten()
}

fn camera_path(bytes: &[u8]) {
    let Some(path) = said(CameraPath::parse(bytes)) else { return };
    for camera in path.cameras(5, 64, 48) {
        assert!(camera.focal_px[0].is_finite() && camera.centre_in_world().is_finite());
    }
}
