//! The tables of the documents, made of the figures in `docs/results`, so that none is typed by hand, and docs/settings.md,
//! made of the comments of the settings.
//!
//! ```sh
//! cargo run --release -p genesplat-lab -- tables            # rewrites the tables in README.md and docs/*.md
//! cargo run --release -p genesplat-lab -- tables --check    # changes nothing; fails where a document disagrees
//! cargo run --release -p genesplat-lab -- tables --add DIR study-evolution COMMIT MACHINE
//! ```

pub(crate) mod add;
pub(crate) mod settings;
#[expect(clippy::module_inception, reason = "the tables themselves, which a test reads alone, too")]
pub(crate) mod tables;
