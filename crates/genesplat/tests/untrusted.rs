//! Two doors for what comes from strangers: a file is opened by `genesplat_io::input` alone, and a name is shown by
//! `genesplat_io::shown` alone. Whatever goes around them in the sources of the products is found here.

use std::fs;
use std::path::{Path, PathBuf};

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Folders of code that reads what users give it. (Tables are made of the project's own documents.)
const READERS: [&str; 6] = [
    "genesplat-io/src",
    "genesplat-metrics/src",
    "genesplat-run/src",
    "genesplat/src",
    "genesplat-lab/src/commands",
    "genesplat-lab/src/experiment",
];

/// Each call with the one file that may make it.
const DOORS: [(&str, &str); 6] = [
    (".display()", "genesplat-io/src/shown.rs"),
    ("fs::read(", "genesplat-io/src/input.rs"),
    ("fs::read_to_string(", "genesplat-io/src/input.rs"),
    ("File::open(", "genesplat-io/src/input.rs"),
    ("OpenOptions::new().read(", "genesplat-io/src/input.rs"),
    ("ImageReader::open(", "genesplat-io/src/input.rs"),
];

/// What `source`, the text of `file`, does around the doors.
fn detours(file: &str, source: &str) -> Vec<String> {
    let product = source.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let closed = DOORS.iter().filter(|(_, door)| file != *door);
    let calls = closed.filter(|(call, _)| product.contains(call)).map(|(call, _)| format!("{file}: {call}"));
    // `thiserror` shows a path by its name as `Path::display` does.
    let errors = product.split("#[error(").skip(1).filter_map(|rest| rest.split(")]").next());
    let raw = ["{path}", "{file}", "{photo}", "{list}", "{folder}", "{scene}"];
    let shown = errors.filter(|error| raw.iter().any(|name| error.contains(name)));
    calls.chain(shown.map(|error| format!("{file}: {error}"))).collect()
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let below = folders.iter().flat_map(|folder| sources(folder));
    files.into_iter().filter(|file| file.extension().is_some_and(|end| end == "rs")).chain(below).collect()
}

#[test]
fn files_and_names_of_strangers_come_through_the_doors() {
    let mut seen = 0;
    for file in READERS.iter().flat_map(|name| sources(&crates().join(name))) {
        let name = file.strip_prefix(crates()).unwrap().to_str().unwrap().replace('\\', "/");
        assert_eq!(detours(&name, &fs::read_to_string(&file).unwrap()), [""; 0]);
        seen += 1;
    }
    assert!(seen > 100, "the search finds sources: {seen}");
}

#[test]
fn a_detour_is_found() {
    for planted in ["let file = File::open(path)?;", "bail!(\"{}\", path.display())", "fs::read(path)"] {
        assert_eq!(detours("genesplat/src/x.rs", planted).len(), 1, "{planted}");
        assert!(detours("genesplat/src/x.rs", &format!("#[cfg(test)]\nmod tests {{ {planted} }}")).is_empty());
    }
    assert_eq!(detours("genesplat-io/src/x.rs", "#[error(\"{path} {problem}\")]").len(), 1);
    assert!(detours("genesplat-io/src/input.rs", "fs::read(path)").is_empty());
}
