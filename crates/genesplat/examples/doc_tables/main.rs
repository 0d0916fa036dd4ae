//! Writes the tables of the documents from the figures in `docs/results`, so that none is typed by hand.
//!
//! ```sh
//! cargo run --release --example doc_tables               # rewrites the tables in README.md and docs/*.md
//! cargo run --release --example doc_tables -- --check    # changes nothing; fails where a document disagrees
//! ```

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

mod tables;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let check = match &arguments[..] {
        [] => false,
        [argument] if argument == "--check" => true,
        _ => bail!("usage: doc_tables [--check]"),
    };
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    let results = root.join("docs/results");
    for path in tables::documents(root)? {
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let with_tables = tables::update(&text, &results).with_context(|| path.display().to_string())?;
        if text == with_tables {
            continue;
        }
        if check {
            bail!("tables of {} are not those of docs/results; run this without --check", path.display());
        }
        fs::write(&path, with_tables).with_context(|| format!("cannot write {}", path.display()))?;
        eprintln!("rewrote {}", path.display());
    }
    Ok(())
}
