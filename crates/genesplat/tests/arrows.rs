//! The map is the territory: dependencies between crates point only where ARCHITECTURE.md says, and the files
//! that the documents name exist.

use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// What each crate may depend on.
const ARROWS: [(&str, &[&str]); 15] = [
    ("genesplat-core", &[]),
    ("genesplat-io", &["genesplat-core"]),
    ("genesplat-gallery", &["genesplat-core", "genesplat-io"]),
    ("genesplat-metrics", &["genesplat-core", "genesplat-io"]),
    ("genesplat-reference", &["genesplat-core"]),
    ("genesplat-kernels", &["genesplat-core"]),
    ("genesplat-cluster", &["genesplat-core", "genesplat-kernels"]),
    ("genesplat-gpu", &["genesplat-core"]),
    ("genesplat-evolve", &["genesplat-core"]),
    ("genesplat-viewer", &["genesplat-core"]),
    ("genesplat-train", &["genesplat-core", "genesplat-evolve"]),
    (
        "genesplat-run",
        &[
            "genesplat-cluster",
            "genesplat-core",
            "genesplat-gpu",
            "genesplat-io",
            "genesplat-kernels",
            "genesplat-metrics",
            "genesplat-train",
            "genesplat-viewer",
        ],
    ),
    ("genesplat-lab", &["genesplat"]),
    ("genesplat-python", &["genesplat"]),
    (
        "genesplat",
        &[
            "genesplat-cluster",
            "genesplat-core",
            "genesplat-evolve",
            "genesplat-gallery",
            "genesplat-gpu",
            "genesplat-io",
            "genesplat-kernels",
            "genesplat-metrics",
            "genesplat-run",
            "genesplat-train",
            "genesplat-viewer",
        ],
    ),
];

/// Walls within crates: what does not stand in the code below a path.
const WALLS: [(&str, &[&str]); 11] = [
    // A run has no arguments and no terminal, and does not end the process.
    ("genesplat-run/src", &["clap", "terminal_size", "process::exit", "io::stdout", "io::stderr"]),
    // Reports know results, and not runs.
    (
        "genesplat-run/src/report",
        &[
            "crate::cluster",
            "crate::device",
            "crate::lock",
            "crate::output",
            "crate::reporter",
            "crate::session",
            "crate::settings",
            "crate::training",
        ],
    ),
    // Nothing but commands knows the terminal.
    ("genesplat/src/args", &["terminal::"]),
    ("genesplat/src/blocks", &["terminal::"]),
    ("genesplat/src/flags.rs", &["terminal::"]),
    ("genesplat/src/inspect", &["terminal::"]),
    ("genesplat/src/poses", &["terminal::"]),
    ("genesplat/src/unpacked.rs", &["terminal::"]),
    ("genesplat-lab/src/args.rs", &["terminal::"]),
    ("genesplat-lab/src/experiment", &["terminal::"]),
    ("genesplat-lab/src/tables", &["terminal::"]),
];

/// Crates of this workspace that a manifest depends on, on any platform (tests may use more).
fn dependencies(manifest: &str) -> Vec<String> {
    let manifest: toml::Table = manifest.parse().expect("a manifest is TOML");
    let platforms = manifest.get("target").and_then(toml::Value::as_table);
    let of_platforms = platforms.into_iter().flat_map(toml::Table::values).filter_map(toml::Value::as_table);
    let parts = std::iter::once(&manifest).chain(of_platforms);
    let tables = parts.flat_map(|part| ["dependencies", "build-dependencies"].map(|kind| part.get(kind)));
    let names = tables.flatten().filter_map(toml::Value::as_table).flat_map(toml::Table::keys);
    names.filter(|name| name.starts_with("genesplat")).cloned().collect()
}

fn forbidden(name: &str, dependencies: &[String]) -> Option<String> {
    let allowed = ARROWS.iter().find(|(from, _)| *from == name).expect("every crate is in the table").1;
    dependencies.iter().find(|to| !allowed.contains(&to.as_str())).map(|to| format!("{name} -> {to}"))
}

#[test]
fn arrows_between_crates_point_one_way() {
    let folders = std::fs::read_dir(root().join("crates")).expect("crates");
    let mut seen = 0;
    for folder in folders {
        let folder = folder.expect("readable");
        let manifest = std::fs::read_to_string(folder.path().join("Cargo.toml")).expect("a manifest");
        let name = folder.file_name().into_string().expect("UTF-8");
        assert_eq!(forbidden(&name, &dependencies(&manifest)), None);
        seen += 1;
    }
    assert_eq!(seen, ARROWS.len(), "ARROWS lists every crate");
}

#[test]
fn a_forbidden_arrow_is_found() {
    for kind in ["dependencies", "build-dependencies", "target.'cfg(unix)'.dependencies"] {
        let planted =
            format!("[{kind}]\ngenesplat-core.workspace = true\ngenesplat-kernels.workspace = true\n");
        assert_eq!(
            forbidden("genesplat-train", &dependencies(&planted)).as_deref(),
            Some("genesplat-train -> genesplat-kernels"),
            "{kind}"
        );
    }
    assert_eq!(dependencies("[dev-dependencies]\ngenesplat-kernels.workspace = true\n"), [""; 0]);
}

/// Files of Rust below a path, or the path itself.
fn code_below(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_owned()];
    }
    let entries = std::fs::read_dir(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let files = entries.flat_map(|entry| {
        let path = entry.expect("readable").path();
        if path.is_dir() || path.extension().is_some_and(|end| end == "rs") {
            code_below(&path)
        } else {
            Vec::new()
        }
    });
    files.collect()
}

/// The first line of code, but for comments, in which one of `words` stands.
fn over_the_wall<'a>(code: &'a str, words: &[&str]) -> Option<&'a str> {
    let mut lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines.find(|line| words.iter().any(|word| line.contains(word)))
}

#[test]
fn walls_within_crates_hold() {
    for (path, words) in WALLS {
        let files = code_below(&root().join("crates").join(path));
        assert!(!files.is_empty(), "{path} has code");
        for file in files {
            let code = std::fs::read_to_string(&file).expect("code");
            assert_eq!(over_the_wall(&code, words), None, "{}", file.display());
        }
    }
}

#[test]
fn a_look_over_a_wall_is_found() {
    let code = "// terminal::x\nuse genesplat::io;\n    use genesplat::terminal::output;\n";
    assert_eq!(over_the_wall(code, &["clap", "terminal::"]), Some("    use genesplat::terminal::output;"));
    assert_eq!(over_the_wall(code, &["clap"]), None);
}

/// Files of WGSL, as `folder/name`, that a table does not list.
fn unlisted_shaders(table: &str) -> Vec<String> {
    let list = |folder: &Path| -> Vec<PathBuf> {
        std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("readable").path()).collect()
    };
    let folder = root().join("crates/genesplat-gpu/shader");
    let files: Vec<PathBuf> = list(&folder).iter().flat_map(|folder| list(folder)).collect();
    assert!(files.len() > 50, "{} files", files.len());
    let names = files.iter().map(|file| {
        file.strip_prefix(&folder).expect("below it").with_extension("").to_str().expect("UTF-8").to_owned()
    });
    names
        .filter(|name| {
            ![format!("\"{name}\""), format!("\"{name}.wgsl\"")].iter().any(|entry| table.contains(entry))
        })
        .collect()
}

#[test]
fn every_shader_is_in_the_table() {
    let table = root().join("crates/genesplat-gpu/src/device/shaders.rs");
    let table = std::fs::read_to_string(table).expect("the table");
    assert_eq!(unlisted_shaders(&table), [""; 0]);
    assert_eq!(unlisted_shaders(&table.replace("bin/project\"", "\"")), ["bin/project"]);
}

/// Paths in backquotes, with a folder and a known ending.
fn named_paths(text: &str) -> Vec<String> {
    text.split('`')
        .skip(1)
        .step_by(2)
        .filter(|word| [".rs", ".md", ".toml", ".wgsl"].iter().any(|ending| word.ends_with(ending)))
        .filter(|word| {
            word.contains('/') && !word.contains(' ') && !word.contains('*') && !word.starts_with("..")
        })
        .map(str::to_owned)
        .collect()
}

/// The documents at the root, and those below `docs` and `lab`.
fn documents() -> Vec<PathBuf> {
    let mut documents: Vec<PathBuf> = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"]
        .map(|name| root().join(name))
        .into();
    for folder in ["docs", "lab"] {
        let pages =
            std::fs::read_dir(root().join(folder)).expect(folder).map(|page| page.expect("readable").path());
        documents.extend(pages.filter(|page| page.extension().is_some_and(|ending| ending == "md")));
    }
    documents
}

/// Who uses genesplat or works on it is promised so many words to read, besides the laboratory's diary.
const WORDS_MAX: usize = 15_000;

#[test]
fn documents_for_readers_are_short() {
    let is_diary = |path: &PathBuf| path.parent().is_some_and(|folder| folder.ends_with("lab"));
    let others = ["fuzz/README.md", "crates/genesplat-python/README.md"].map(|name| root().join(name));
    let words = |path: PathBuf| std::fs::read_to_string(path).expect("a document").split_whitespace().count();
    let all: usize = documents().into_iter().filter(|path| !is_diary(path)).chain(others).map(words).sum();
    assert!(all > WORDS_MAX / 2, "{all} words: documents are found");
    assert!(all <= WORDS_MAX, "{all} words; what can go?");
}

#[test]
fn documents_name_files_that_exist() {
    let mut seen = 0;
    for document in documents() {
        let text = std::fs::read_to_string(&document).expect("a document");
        for path in named_paths(&text) {
            let exists = root().join(&path).exists();
            assert!(exists, "{} names {path}, which is not there", document.display());
            seen += 1;
        }
    }
    assert!(seen > 5, "the search finds paths: {seen}");
    assert_eq!(named_paths("see `a/b.rs` and `c d/e.rs` and `x`"), ["a/b.rs"]);
}

/// Where the links of a page lead, without the part behind `#`; addresses on the web are left out.
fn links(text: &str) -> Vec<&str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    targets.filter(|target| !target.contains("://")).filter_map(|target| target.split('#').next()).collect()
}

#[test]
fn links_of_documents_lead_to_files() {
    assert_eq!(links("[a](b.md#c), [d](https://e/f.md), ![g](h.png), [i](#j)"), ["b.md", "h.png", ""]);
    // What changed is told with the paths of its time.
    for document in documents().into_iter().filter(|document| !document.ends_with("CHANGELOG.md")) {
        let text = std::fs::read_to_string(&document).expect("a document");
        for link in links(&text).into_iter().filter(|link| !link.is_empty()) {
            let target = document.parent().expect("a folder").join(link);
            assert!(target.exists(), "{} links to {link}, which is not there", document.display());
        }
    }
}
