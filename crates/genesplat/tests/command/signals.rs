//! One Ctrl-C or SIGTERM ends whatever prepares, at once and with status 130; nothing that is half written
//! stays.

#![cfg(target_os = "linux")]

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

use genesplat::core::Gaussians;
use genesplat::io::{PlyOptions, write_ply};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::support::{command, text, train};

/// Sends `signal` once `is_time`, and returns how the command ended; it must not have ended before.
pub(crate) fn signalled<S: AsRef<std::ffi::OsStr>>(
    arguments: impl IntoIterator<Item = S>,
    signal: &str,
    is_time: impl Fn(&Child) -> bool,
) -> Output {
    let mut child = command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    while !is_time(&child) {
        assert!(child.try_wait().unwrap().is_none(), "it still works");
        sleep(Duration::from_millis(1));
    }
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    child.wait_with_output().unwrap()
}

/// Whether a process hears signals: its thread for them is there.
pub(crate) fn listens(child: &Child) -> bool {
    let threads = fs::read_dir(format!("/proc/{}/task", child.id())).into_iter().flatten().flatten();
    let mut names = threads.map(|thread| fs::read_to_string(thread.path().join("comm")));
    names.any(|name| name.is_ok_and(|name| name.trim() == "signals"))
}

/// All files in a folder and below it.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

fn assert_stopped(output: &Output, place: &Path) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("no file is left half written"), "{said}");
    let left = files(place).into_iter().find(|file| file.extension().is_some_and(|end| end == "tmp"));
    assert_eq!(left, None);
}

#[test]
fn a_command_that_converts_leaves_nothing() {
    let place = tempfile::tempdir().unwrap();
    let [from, to] = ["from.ply", "to.sog"].map(|name| place.path().join(name));
    let mut cloud = Gaussians::zeros(300_000);
    let values = cloud.sh.as_flattened_mut().iter_mut().zip(1u32..);
    values.for_each(|(value, number)| *value = (number.wrapping_mul(2_654_435_761) as f32) / 2f32.powi(32));
    write_ply(&from, &cloud, &PlyOptions::default()).unwrap();
    for signal in ["-INT", "-TERM"] {
        assert_stopped(&signalled(["convert", text(&from), text(&to)], signal, listens), place.path());
        assert!(!to.exists());
    }
}

#[test]
fn an_archive_that_is_unpacked_goes_on_from_where_it_was_stopped() {
    const PHOTOS: usize = 20_000;
    let place = tempfile::tempdir().unwrap();
    let [archive, out] = ["photos.zip", "run"].map(|name| place.path().join(name));
    let mut zip = ZipWriter::new(BufWriter::new(File::create(&archive).unwrap()));
    for photo in 0..PHOTOS {
        zip.start_file(format!("images/{photo:05}.jpg"), SimpleFileOptions::default()).unwrap();
    }
    zip.finish().unwrap().flush().unwrap();
    let arguments = train(&archive, &out, &[]);
    let has_begun = |child: &Child| listens(child) && out.join("scene/images").is_dir();
    for signal in ["-TERM", "-INT"] {
        assert_stopped(&signalled(&arguments, signal, has_begun), place.path());
        let there = photos(place.path()).len();
        assert!(there < PHOTOS, "{there} of them");
    }
    let output = command(&arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains(&format!("{PHOTOS} files of")), "{said}");
    assert_eq!(photos(place.path()).len(), PHOTOS);
}

fn photos(place: &Path) -> Vec<PathBuf> {
    files(place).into_iter().filter(|file| file.extension().is_some_and(|end| end == "jpg")).collect()
}
