//! The terminal: what is said, how far things are, and what the user wants to stop.

pub(crate) mod interrupt;
pub(crate) mod limits;
pub(crate) mod numbers;
pub(crate) mod output;
pub(crate) mod progress;
pub(crate) mod reporter;
