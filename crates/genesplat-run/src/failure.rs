//! What is left of a run that failed midway, and how to go on.

use std::path::Path;

use genesplat_core::BackendError;
use genesplat_io::shown;
use genesplat_train::TrainError;

use super::session::{Caller, TakenOver, has_checkpoint, no_rows, read_checkpoint};
use super::{CHECKPOINT, METRICS};

/// `error`, and after its sentence what is left of the run in `folder`, and how to go on.
pub(crate) fn explain(error: anyhow::Error, folder: &Path, caller: Caller) -> anyhow::Error {
    let sentence = format!("{error}{}", what_is_left(&error, folder, caller));
    error.context(sentence)
}

/// What is left of a run in `folder` whose processes are gone, and how to go on. Looks and does not read:
/// there is no time.
pub(crate) fn left_by_ranks(folder: &Path) -> String {
    if has_checkpoint(folder) {
        format!(
            "{} is left, and the same command with --resume goes on from there",
            shown(folder.join(CHECKPOINT))
        )
    } else if folder.join(METRICS).exists() {
        format!("the run in {} is whole", shown(folder))
    } else {
        "no checkpoint had been saved, so the run has to begin anew".into()
    }
}

#[derive(Clone, Copy)]
enum DeviceFailure {
    OutOfMemory,
    /// It was main memory that there was too little of.
    HostOutOfMemory,
    Lost,
}

impl DeviceFailure {
    fn behind(error: &anyhow::Error) -> Option<Self> {
        let of_training = error.downcast_ref().and_then(|error| match error {
            TrainError::Backend(error) => Some(error),
            _ => None,
        });
        match of_training.or_else(|| error.downcast_ref())? {
            BackendError::OutOfMemory { .. } => Some(Self::OutOfMemory),
            BackendError::HostOutOfMemory { .. } => Some(Self::HostOutOfMemory),
            BackendError::DeviceLost { .. } => Some(Self::Lost),
            _ => None,
        }
    }
}

fn what_is_left(error: &anyhow::Error, folder: &Path, caller: Caller) -> String {
    if error.is::<TakenOver>() {
        return String::new();
    }
    let failed = DeviceFailure::behind(error);
    let anew = match caller {
        Caller::Train => "the run has to begin anew",
        Caller::Experiment => "the same command begins this run anew",
        Caller::Demo => return String::new(),
    };
    if !has_checkpoint(folder) {
        return failed.map_or(String::new(), |_| format!(" (no checkpoint had been saved, so {anew})"));
    }
    let checkpoint = match read_checkpoint(folder, &no_rows) {
        Ok(checkpoint) => checkpoint,
        Err(unread) => return format!(" ({unread})"),
    };
    let how = match (caller, failed) {
        (Caller::Experiment, Some(DeviceFailure::OutOfMemory)) => {
            "the same command goes on from there where the device has more memory to spare, while other limits or another device \
             need another --out"
        }
        (Caller::Experiment, Some(DeviceFailure::HostOutOfMemory)) => {
            "the same command goes on from there where there is more memory, while other limits need another --out"
        }
        (Caller::Experiment, _) => "the same command goes on from there",
        (_, None) => "--resume goes on from there",
        (_, Some(DeviceFailure::Lost)) => {
            "the same command with --resume goes on from there, also with --device cpu"
        }
        (_, Some(DeviceFailure::HostOutOfMemory)) => {
            "the same command with --resume goes on from there where there is more memory, while other limits need a new run"
        }
        (_, Some(DeviceFailure::OutOfMemory)) => {
            "the same command with --resume --device cpu goes on from there, while other limits need a new run"
        }
    };
    format!(
        " ({} holds the run at iteration {}; {how})",
        shown(folder.join(CHECKPOINT)),
        checkpoint.cursor.iteration
    )
}

#[cfg(test)]
mod tests {
    use std::fs;

    use anyhow::anyhow;
    use genesplat_core::{Alone, DeviceState};
    use genesplat_train::Checkpoint;
    use genesplat_train::checkpoint::{Cursor, Progress};

    use super::*;
    use crate::session::RunSession;

    fn out_of_memory() -> BackendError {
        BackendError::OutOfMemory { device: "toy".into(), wanted: 7, purpose: "a test".into() }
    }

    fn lost() -> BackendError {
        BackendError::DeviceLost { device: "toy".into(), reason: "it was unplugged".into() }
    }

    fn checkpoint(iteration: u32) -> Checkpoint {
        Checkpoint {
            origin: String::new(),
            cursor: Cursor::start_of(iteration),
            progress: Progress::default(),
            state: DeviceState::default(),
            virtual_pictures: Vec::new(),
        }
    }

    #[test]
    fn a_failed_device_is_followed_by_what_is_left() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("run");
        let mut session = RunSession::claim(&folder, Caller::Train, false).unwrap();
        session.begin("").unwrap();
        let says_by = |caller, error| explain(error, &folder, caller).to_string();
        let says = |error| says_by(Caller::Train, error);
        let other = || anyhow!("the moon is full");

        assert_eq!(says(other()), "the moon is full");
        assert!(says(TrainError::Backend(lost()).into()).ends_with("the run has to begin anew)"));

        session.write_checkpoint(checkpoint(4213), &Alone).unwrap();
        let file = folder.join(CHECKPOINT).display().to_string();
        let errors = [TrainError::Backend(out_of_memory()).into(), out_of_memory().into()];
        for sentence in errors.map(says) {
            let parts =
                ["out of memory on toy", &file, "iteration 4213", "--resume --device cpu", "--max-side"];
            assert!(parts.iter().all(|part| sentence.contains(part)), "{sentence}");
        }
        let sentence = says(TrainError::Backend(lost()).into());
        let parts = ["unplugged", &file, "iteration 4213", "--resume"];
        assert!(parts.iter().all(|part| sentence.contains(part)), "{sentence}");
        assert!(says(other()).ends_with("--resume goes on from there)"));
        // A demo never goes on, and `experiment` knows no --resume.
        let errors: [fn() -> anyhow::Error; 3] =
            [|| anyhow!("full"), || out_of_memory().into(), || lost().into()];
        for error in errors {
            assert_eq!(says_by(Caller::Demo, error()), error().to_string());
            let sentence = says_by(Caller::Experiment, error());
            assert!(
                sentence.contains("the same command goes on") && !sentence.contains("--resume"),
                "{sentence}"
            );
        }

        fs::write(&file, "no checkpoint").unwrap();
        assert!(says(other()).contains("not a checkpoint of this version"));

        let left = || left_by_ranks(&folder);
        assert!(left().contains(&file) && left().contains("--resume"), "{}", left());
        fs::remove_file(&file).unwrap();
        assert!(left().contains("begin anew"), "{}", left());
        fs::write(folder.join(METRICS), "{}").unwrap();
        assert!(left().ends_with("is whole"), "{}", left());
    }
}
