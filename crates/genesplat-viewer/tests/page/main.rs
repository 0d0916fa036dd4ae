//! The page's server, from outside: what it serves, and what strangers cannot do to it.

mod abuse;
mod edits;
mod files;
mod memory;
mod pictures;
mod scripts;
mod snapshots;
mod support;
