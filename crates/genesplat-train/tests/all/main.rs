//! The training algorithm against a backend that computes next to nothing and records every call.

mod config;
mod evaluate;
mod mosaic;
mod order;
mod recombine;
mod reconstruct;
mod renew;
mod resume;
mod stage;
mod support;
mod three_splats;
