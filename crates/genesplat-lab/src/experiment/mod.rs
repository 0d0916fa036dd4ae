//! Experiments: many runs that differ in one thing each, and the tables that compare them.
//!
//! An experiment is a matrix. Its scenes, methods and seeds are lists; its *arms* are what is compared (a
//! method alone, with the search, with another setting, another method). One run of one arm is a *cell*, an
//! ordinary run folder, and cells of the same scene, method and seed are *paired*: they share all random
//! streams but those that their difference touches.
//!
//! ```text
//! TOML -> Experiment -> [Cell] -> run folders -> Results -> [Table] -> Markdown, CSV, HTML
//! ```

pub(crate) mod arms;
pub(crate) mod board;
pub(crate) mod cells;
pub(crate) mod file;
#[cfg(test)]
mod mutations;
pub(crate) mod page;
pub(crate) mod plan;
pub(crate) mod preset;
pub(crate) mod qualitative;
pub(crate) mod record;
pub(crate) mod results;
pub(crate) mod runner;
pub(crate) mod statistics;
pub(crate) mod summary;
pub(crate) mod table;
