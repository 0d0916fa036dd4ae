//! Experiments: many runs that differ in one thing each, and the tables that compare them.
//!
//! An experiment is a matrix. Its scenes, variants and seeds are lists; its *arms* are what is compared (without
//! evolution, with it, with another crossover). One run of one arm is a *cell*, an ordinary run folder, and cells of
//! the same scene, variant and seed are *paired*: they share all random streams but those that their difference
//! touches.
//!
//! ```text
//! TOML -> Experiment -> [Cell] -> run folders -> Results -> [Table] -> Markdown, LaTeX, CSV, HTML
//! ```
//!
//! | module | what it does |
//! |---|---|
//! | [`preset`], [`file`], [`arms`], [`plan`] | from a TOML file to the list of cells and their settings |
//! | [`runner`], [`cells`], [`board`] | runs what is unfinished; what is there already; the rows so far |
//! | [`results`] | what the cells have measured, and their paired differences |
//! | [`statistics`] | means, spreads, and two exact tests |
//! | [`summary`], [`table`], [`record`] | the paper's tables, how they are written, and everything as CSV |
//! | [`qualitative`] | pictures in which the program itself marks what got better and worse |
//! | [`page`] | `report.html` |

pub(crate) mod arms;
pub(crate) mod board;
pub(crate) mod cells;
pub(crate) mod file;
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
