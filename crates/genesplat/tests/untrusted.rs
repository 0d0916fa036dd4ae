//! Doors for what comes from strangers: a file is opened by `genesplat_io::input` alone, a name is shown by
//! `genesplat_io::shown` alone, and a file is made, named or linked by `genesplat_io::own` (names of ours)
//! and `genesplat_io::atomic` (names that users give) alone. Whatever goes around them in the sources of the
//! products is found here.

use std::fs;
use std::path::{Path, PathBuf};

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

const INPUT: &str = "genesplat-io/src/input.rs";
const OWN: &str = "genesplat-io/src/own.rs";
const ATOMIC: &str = "genesplat-io/src/atomic.rs";

/// Each call with the files that may make it.
const DOORS: [(&str, &[&str]); 22] = [
    (".display()", &["genesplat-io/src/shown.rs"]),
    ("fs::read(", &[INPUT]),
    ("fs::read_to_string(", &[INPUT]),
    // A folder, whose disk is waited for.
    ("File::open(", &[INPUT, ATOMIC]),
    ("ImageReader::open(", &[INPUT]),
    ("OpenOptions", &[OWN, ATOMIC]),
    // `/dev/null`, for what graphics drivers say.
    ("File::options(", &["genesplat/src/terminal/output.rs"]),
    ("File::create(", &[]),
    ("File::create_new(", &[]),
    ("DirBuilder", &[]),
    // A file of the kernel's; the documents of this project.
    ("fs::write(", &["genesplat-run/src/memory.rs", "genesplat-lab/src/commands/tables.rs"]),
    ("fs::copy(", &[]),
    ("fs::hard_link(", &[OWN]),
    ("fs::soft_link(", &[]),
    ("fs::symlink(", &[]),
    // A folder of ours takes its place, and a frame its.
    ("fs::rename(", &[ATOMIC, "genesplat/src/poses/mod.rs", "genesplat/src/poses/video.rs"]),
    ("fs::create_dir(", &[OWN]),
    // The last makes the folder that the user has given for files without a name.
    ("fs::create_dir_all(", &[OWN, ATOMIC, "genesplat-io/src/photos/file.rs"]),
    ("fs::remove_file(", &[OWN, ATOMIC, "genesplat-run/src/files.rs", "genesplat/src/poses/photos.rs"]),
    ("fs::set_permissions(", &[]),
    // Without a name: photos, and what graphics drivers say.
    ("tempfile::", &["genesplat-io/src/photos/file.rs", "genesplat/src/terminal/output.rs"]),
    ("NamedTempFile", &[]),
];

/// What `source`, the text of `file`, does around the doors.
fn detours(file: &str, source: &str) -> Vec<String> {
    // Tests come last in a file, and may do what they like.
    let product = source.split("mod tests {").next().unwrap_or_default();
    let closed = DOORS.iter().filter(|(_, doors)| !doors.contains(&file));
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

/// `tests.rs`, or in a folder `tests`.
fn is_of_tests(name: &str) -> bool {
    name.split('/').any(|part| ["tests", "tests.rs"].contains(&part))
}

#[test]
fn files_and_names_of_strangers_come_through_the_doors() {
    let mut seen = 0;
    let crates_there = fs::read_dir(crates()).unwrap().map(|entry| entry.unwrap().path().join("src"));
    for file in crates_there.flat_map(|folder| sources(&folder)) {
        let name = file.strip_prefix(crates()).unwrap().to_str().unwrap().replace('\\', "/");
        if is_of_tests(&name) {
            continue;
        }
        assert_eq!(detours(&name, &fs::read_to_string(&file).unwrap()), [""; 0]);
        seen += 1;
    }
    assert!(seen > 100, "the search finds sources: {seen}");
}

#[test]
fn a_detour_is_found() {
    for planted in [
        "let file = File::open(path)?;",
        "bail!(\"{}\", path.display())",
        "fs::read(path)",
        "let file = File::create(&path)?;",
        "fs::copy(from, to)",
        "OpenOptions::new().append(true).open(path)",
        "fs::write(path, text)",
        "fs::hard_link(from, to)",
    ] {
        assert_eq!(detours("genesplat/src/x.rs", planted).len(), 1, "{planted}");
        assert!(
            detours("genesplat-gpu/src/x.rs", &format!("#[cfg(test)]\nmod tests {{ {planted} }}")).is_empty()
        );
    }
    assert_eq!(detours("genesplat-io/src/x.rs", "#[error(\"{path} {problem}\")]").len(), 1);
    assert!(detours("genesplat-io/src/input.rs", "fs::read(path)").is_empty());
}
