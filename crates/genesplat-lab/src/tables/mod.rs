//! The tables of the documents, made of the figures in `lab/results`, so that none is typed by hand, and
//! docs/settings.md, made of the comments of the settings.
//!
//! ```sh
//! cargo run --release -p genesplat-lab -- tables            # rewrites the tables in README.md, docs/*.md and lab/*.md
//! cargo run --release -p genesplat-lab -- tables --check    # changes nothing; fails where a document disagrees
//! cargo run --release -p genesplat-lab -- tables --add DIR study-evolution COMMIT MACHINE
//! ```

pub(crate) mod add;
pub(crate) mod settings;
#[expect(clippy::module_inception, reason = "the tables themselves, which a test reads alone, too")]
pub(crate) mod tables;
