//! The training algorithm against a backend that computes next to nothing and records every call.

mod averaging;
mod coarse;
mod config;
mod evaluate;
mod growth;
mod improved;
mod order;
mod reconstruct;
mod resume;
mod stage;
mod support;
mod three_splats;
mod virtual_views;
