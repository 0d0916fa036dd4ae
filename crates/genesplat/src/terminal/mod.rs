//! The terminal: what is said, how far things are, and what the user wants to stop.

pub mod interrupt;
pub mod limits;
pub mod output;
pub mod program;
mod progress;
