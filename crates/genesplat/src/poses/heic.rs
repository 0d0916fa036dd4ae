//! HEIC photos, as iPhones take them: the Python that runs pycolmap writes them as JPEG, if it has
//! pillow-heif.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;

use anyhow::{Result, bail, ensure};
use genesplat::io::{plural, shown};
use genesplat::run::files::write_own_json;
use genesplat::run::output;
use genesplat::run::output::Bar;
use serde::Deserialize;

use super::engine::Engine;
use super::process;

/// In small letters.
pub(super) const ENDINGS: [&str; 3] = ["heic", "heif", "hif"];
/// What the script is told, below the folder of the stages.
const LIST: &str = "heic.json";
const SCRIPT: &str = include_str!("heic.py");

/// Writes each first file as the second, a JPEG; false where `stop` has ended it.
pub(super) fn convert(
    pairs: &[(PathBuf, PathBuf)],
    engine: &Engine,
    work: &Path,
    stop: &AtomicBool,
) -> Result<bool> {
    let Some((first, _)) = pairs.first() else { return Ok(true) };
    let Some(mut command) = converter(engine) else {
        bail!(
            "{} {} HEIC, first {}, and {} cannot read them; install pillow-heif (`pip install pillow-heif`) beside pycolmap, or \
             convert them to JPEG",
            pairs.len(),
            plural(pairs.len(), "photo is", "photos are"),
            shown(first),
            engine.name()
        )
    };
    write_own_json(work, LIST, &pairs)?;
    let mut bar = Bar::new("photos", pairs.len() as u64);
    command.arg(work.join(LIST));
    let mut damaged: Vec<Damaged> = Vec::new();
    let is_done = process::run(&mut command, &work.join("heic.log"), stop, |line| {
        damaged.extend(serde_json::from_str::<Damaged>(line).ok());
        line.trim().parse().into_iter().for_each(|done| bar.set(done, String::new));
    })?;
    drop(bar);
    tell_of(&damaged, pairs.len())?;
    Ok(is_done)
}

/// A photo that no decoder takes for one.
#[derive(Deserialize)]
struct Damaged {
    damaged: PathBuf,
    why: String,
}

/// Fails where all are.
fn tell_of(damaged: &[Damaged], all: usize) -> Result<()> {
    let Some(Damaged { damaged: first, why }) = damaged.first() else { return Ok(()) };
    let count = damaged.len();
    let which = format!("cannot decode the photo {}: {}", shown(first), shown(why));
    ensure!(
        count < all,
        "{count} of {all} HEIC photos are damaged; the first: {which}; copy them again, or leave them out"
    );
    output::tell(&format!(
        "notice: {count} of {all} HEIC photos {} damaged and left out; the first: {which}",
        plural(count, "is", "are")
    ));
    Ok(())
}

/// The Python that can do it, with the script.
fn converter(engine: &Engine) -> Option<Command> {
    let ran = engine.python("import pillow_heif, PIL")?.output();
    ran.is_ok_and(|ran| ran.status.success()).then(|| engine.python(SCRIPT))?
}
