//! Fifty natural mistakes: each works all the same, or gets one sentence that says what, where, and what to
//! do.

mod table;

use std::fs::{self, File};
use std::io::Write;
use std::path::PathBuf;

use genesplat::core::Photo;

use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::support::{copy, fail, run, scene, text, train};

/// What comes of a mistake.
enum Outcome {
    /// It works, and this is said.
    Works(&'static [&'static str]),
    /// One sentence with these words.
    Says(&'static [&'static str]),
}

use Outcome::{Says, Works};

/// A place with a copy of the bundled scene.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        copy(&scene().join("images"), &place.at("scene/images"));
        copy(&scene().join("sparse/0"), &place.at("scene/sparse/0"));
        place
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn photo(&self) -> PathBuf {
        self.at("scene/images/gallery_003.png")
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::create_dir_all(self.at(name).parent().unwrap()).unwrap();
        fs::write(self.at(name), content).unwrap();
    }

    fn rename(&self, from: &str, to: &str) {
        fs::create_dir_all(self.at(to).parent().unwrap()).unwrap();
        fs::rename(self.at(from), self.at(to)).unwrap();
    }

    /// What is in a folder, as an archive.
    fn zip(&self, folder: &str, archive: &str) {
        let folder = self.at(folder);
        let mut zip = ZipWriter::new(File::create(self.at(archive)).unwrap());
        let mut inner = vec![folder.clone()];
        while let Some(path) = inner.pop() {
            if path.is_dir() {
                inner.extend(fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()));
                continue;
            }
            zip.start_file(text(path.strip_prefix(&folder).unwrap()), SimpleFileOptions::default()).unwrap();
            zip.write_all(&fs::read(&path).unwrap()).unwrap();
        }
        zip.finish().unwrap();
    }

    /// `train` on what is called so.
    fn trains(&self, name: &str, more: &[&str]) -> Vec<String> {
        train(&self.at(name), &self.at("run"), &[&["--iterations", "2"], more].concat())
    }

    fn evaluates(&self, splat: &str) -> Vec<String> {
        ["evaluate", text(&self.at(splat)), "--data", text(scene()), "--device", "cpu"]
            .map(str::to_owned)
            .into()
    }
}

fn grey(width: u32, height: u32) -> Photo {
    Photo { width, height, rgb: vec![90; (3 * width * height) as usize] }
}

/// A mistake: its arguments, made in a place of its own, and what comes of it.
type Mistake = (fn(&Place) -> Vec<String>, Outcome);

fn judge(mistakes: &[Mistake]) {
    for (number, (arguments, outcome)) in mistakes.iter().enumerate() {
        let place = Place::new();
        let arguments = arguments(&place);
        eprintln!("{number}: {arguments:?}");
        match outcome {
            Says(words) => fail(&arguments, words),
            Works(words) => {
                let output = run(&arguments);
                let said = String::from_utf8(output.stderr).unwrap();
                assert!(output.status.success() && words.iter().all(|word| said.contains(word)), "{said}");
            }
        }
    }
}

#[test]
fn what_was_given_is_not_quite_a_scene() {
    judge(table::SCENES);
}

#[test]
fn photos_are_not_quite_where_and_what_the_list_says() {
    judge(table::PHOTOS);
}

#[test]
fn a_model_or_a_splat_is_not_quite_one() {
    judge(table::MODELS);
}
