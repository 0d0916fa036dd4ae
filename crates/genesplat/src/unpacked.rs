//! Archives that are given in place of folders: unpacked once, into the folder of the results.

use std::fs;
use std::path::Path;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::archive::{self, Unpacked};
use genesplat::io::{atomic, convert, input, shown};
use genesplat::run::files::{remove_leftovers_below, write_own_json};
use genesplat::run::lock::Lock;
use genesplat::run::output;
use serde::{Deserialize, Serialize};

/// In the folder: what was unpacked there, and whether all of it was.
const RECORD: &str = "unpacked.json";

#[derive(PartialEq, Serialize, Deserialize)]
struct Record {
    archive: String,
    bytes: u64,
    whole: bool,
}

/// Unpacks `archive` into `folder`, if that is not done already. Fails where the folder holds anything else.
pub(crate) fn unpack(archive: &Path, folder: &Path) -> Result<()> {
    let there = fs::metadata(archive).map_err(|error| anyhow!("cannot read {}: {error}", shown(archive)))?;
    let name = archive.file_name().unwrap_or_default().to_string_lossy();
    let record = |whole| Record { archive: name.clone().into_owned(), bytes: there.len(), whole };
    let file = folder.join(RECORD);
    match input::read(&file).ok().map(|bytes| serde_json::from_slice::<Record>(&bytes)) {
        Some(Ok(there)) if there == record(true) => return Ok(()),
        Some(Ok(there)) if there == record(false) => {}
        Some(_) => bail!(
            "{} was unpacked from another archive than {}; choose another --out, or remove that folder",
            shown(folder),
            shown(archive)
        ),
        None => ensure!(
            is_empty(folder),
            "{} is there already, and {} would be unpacked into it; choose another --out",
            shown(folder),
            shown(archive)
        ),
    }
    write_own_json(folder, RECORD, &record(false))?;
    let _lock = Lock::take(folder)?;
    remove_leftovers_below(folder);
    let Unpacked { files, unread } = archive::unpack(archive, folder)?;
    output::tell(&format!("{files} files of {} are unpacked into {}", shown(archive), shown(folder)));
    if let Some(first) = unread.first() {
        tell_of_unread(unread.len(), &shown(first).to_string());
    }
    write_own_json(folder, RECORD, &record(true))
}

/// Whether nothing is in a folder but what a process has left that was killed while it wrote.
fn is_empty(folder: &Path) -> bool {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name()).all(|name| atomic::is_temporary(&name.to_string_lossy()))
}

/// Pictures of formats that are not read are left out, and that is said.
pub(crate) fn tell_of_unread(count: usize, first: &str) {
    output::tell(&format!(
        "notice: {count} pictures are neither JPEG nor PNG nor WebP and are left out, first {first}; {}",
        convert(first)
    ));
}
