//! The lists of file names by which a `transforms.json` splits its photos (nerfstudio).
//!
//! - `test_filenames` are tested on, or `val_filenames` where there are none.
//! - `train_filenames`, where there are any, are trained on, and nothing else is.
//! - A photo in no list is left out where there are lists of both kinds; beside a list of one kind, it is of
//!   the other.
//! - An empty list says nothing.

use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

use super::schema::Transforms;
use super::{ENDS, with_end};
use crate::error::SceneError;
use crate::listing::Purpose;
use crate::shown;

type Names = HashSet<PathBuf>;

/// The three lists, without `./` and the like in their names.
pub(super) struct Splits {
    train: Names,
    validation: Names,
    test: Names,
}

impl Splits {
    pub(super) fn of(file: &Transforms, list: &Path) -> Result<Self, SceneError> {
        let frames: Names = file.frames.iter().flat_map(|entry| names_of(&entry.file_path)).collect();
        let names = |names: &Option<Vec<String>>, key| known(names, &frames, key, list);
        Ok(Self {
            train: names(&file.train_filenames, "train_filenames")?,
            validation: names(&file.val_filenames, "val_filenames")?,
            test: names(&file.test_filenames, "test_filenames")?,
        })
    }

    pub(super) fn purpose(&self, frame: &str, list: &Path) -> Result<Purpose, SceneError> {
        let is_in = |names: &Names| names_of(frame).any(|name| names.contains(&name));
        let [train, validation, test] = [&self.train, &self.validation, &self.test].map(is_in);
        if train && (validation || test) {
            let problem = format!(
                "has {} both in its train_filenames and in its val_filenames or test_filenames; remove it from \
                 one of them, or its figures would be those of a photo that training saw",
                shown(frame)
            );
            return Err(SceneError::invalid(list, problem));
        }
        let is_tested = test || (self.test.is_empty() && validation);
        Ok(match (train, is_tested) {
            (true, _) => Purpose::Train,
            (_, true) => Purpose::Test,
            _ if validation => Purpose::Unused,
            _ => self.purpose_of_unlisted(),
        })
    }

    fn purpose_of_unlisted(&self) -> Purpose {
        let holds_out = !(self.validation.is_empty() && self.test.is_empty());
        match (self.train.is_empty(), holds_out) {
            (true, _) => Purpose::Unsaid,
            (false, true) => Purpose::Unused,
            (false, false) => Purpose::Test,
        }
    }
}

/// The names of a list, each of which must be a photo's: because of a typo, a photo that was to be held out
/// would be trained on.
fn known(
    names: &Option<Vec<String>>,
    frames: &Names,
    key: &'static str,
    list: &Path,
) -> Result<Names, SceneError> {
    let name = |name: &String| {
        let remedy = "but none of its frames has that file_path; correct one of them";
        let unknown = || SceneError::invalid(list, format!("has {} in its {key}, {remedy}", shown(name)));
        Some(plain(name)).filter(|name| frames.contains(name)).ok_or_else(unknown)
    };
    names.iter().flatten().map(name).collect()
}

fn plain(name: &str) -> PathBuf {
    Path::new(name).components().filter(|part| *part != Component::CurDir).collect()
}

/// What a frame's photo may be called: as the frame says, or with the extension that it leaves out.
fn names_of(frame: &str) -> impl Iterator<Item = PathBuf> {
    let frame = plain(frame);
    ENDS.into_iter().map(move |end| with_end(&frame, end))
}
