//! The readers, each as a function of bytes.

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use genesplat_io::bytes;
use genesplat_io::colmap::Form;
use genesplat_metrics::weights::{read_weights, to_safetensors};
use genesplat_train::{Checkpoint, TrainConfig};

use crate::args::{ExperimentArgs, SizeArgs};
use crate::experiment_file::ExperimentFile;

/// Larger photos are not decoded: there would be a few of them a second, and no more code would be reached.
const PIXELS_MAX: u64 = 1 << 16;

/// The reader called `name`.
pub(crate) fn named(name: &str) -> Option<fn(&[u8])> {
    let reader: fn(&[u8]) = match name {
        "colmap_binary" => |data| colmap(Form::Binary, data),
        "colmap_text" => |data| colmap(Form::Text, data),
        "ply" => ply,
        "transforms" => |data| drop(bytes::transforms(data)),
        "config" => config,
        "experiment" => experiment,
        "checkpoint" => checkpoint,
        "weights" => weights,
        "photo" => |data| drop(bytes::photo(data, PIXELS_MAX)),
        _ => return None,
    };
    Some(reader)
}

/// The first byte says which of the three files the others are.
fn colmap(form: Form, data: &[u8]) {
    let Some((kind, file)) = data.split_first() else { return };
    let read = match kind {
        b'c' => bytes::cameras(form, file),
        b'i' => bytes::images(form, file),
        _ => bytes::points(form, file),
    };
    #[cfg(feature = "planted")]
    if read.is_ok() {
        planted(file);
    }
    drop(read);
}

/// A bug three comparisons deep in a valid file: found by who is told which comparisons were passed, and by nobody else.
#[cfg(feature = "planted")]
fn planted(file: &[u8]) {
    use std::hint::black_box;

    for (place, wanted) in (16..).zip(b"bug") {
        if black_box(file.get(place)) != Some(wanted) {
            return;
        }
    }
    panic!("the planted bug");
}

/// As a splat, and as a cloud of points.
fn ply(data: &[u8]) {
    drop(bytes::splat(data));
    drop(bytes::cloud(data));
}

/// The settings of training: all of a run's `config.toml` but its scene and machine.
fn config(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(config) = toml::from_str::<TrainConfig>(text) else { return };
    if let Ok(resolved) = config.resolve() {
        let written = toml::to_string(resolved.config()).expect("what was read can be written");
        let again: TrainConfig = toml::from_str(&written).expect("what was written can be read");
        assert_eq!(toml::to_string(&again).expect("what was read can be written"), written);
    }
}

fn experiment(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(mut file) = toml::from_str::<ExperimentFile>(text) else { return };
    let size = SizeArgs { max_side: Some(64), downscale: None };
    file.override_by(&ExperimentArgs { size, iterations: Some(7), steps_scale: Some(0.5) });
    drop(file.gallery.options());
    let written = toml::to_string(&file).expect("what was read can be written");
    let again: ExperimentFile = toml::from_str(&written).expect("what was written can be read");
    assert_eq!(toml::to_string(&again).expect("what was read can be written"), written);
}

/// The file without its checksum, which would keep every changed byte from the reader behind it.
fn checkpoint(data: &[u8]) {
    let sum = data.iter().fold(FNV_OFFSET, |sum, &byte| (sum ^ u64::from(byte)).wrapping_mul(FNV_PRIME));
    let file = [data, &sum.to_le_bytes()].concat();
    if let Ok(checkpoint) = Checkpoint::read(&file[..]) {
        let mut written = Vec::new();
        checkpoint.write(&mut written).expect("memory takes it");
        Checkpoint::read(&written[..]).expect("what was written can be read");
    }
}

/// FNV-1a, 64 bits: the checksum of checkpoints.
const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0000_0100_0000_01b3;

/// Through a file, since tensors of PyTorch's formats are read when they are asked for.
fn weights(data: &[u8]) {
    static FILE: LazyLock<PathBuf> = LazyLock::new(|| {
        let folder = if fs::metadata("/dev/shm").is_ok() { "/dev/shm".into() } else { std::env::temp_dir() };
        folder.join(format!("genesplat-fuzz-{}", std::process::id()))
    });
    fs::write(&*FILE, data).expect("the folder takes files");
    if let Ok(tensors) = read_weights(&FILE, |_| true) {
        if tensors.values().all(|tensor| tensor.shape.iter().product::<usize>() == tensor.values.len()) {
            drop(to_safetensors(&tensors));
        }
    }
}
