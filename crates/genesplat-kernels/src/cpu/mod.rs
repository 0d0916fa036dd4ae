//! The CPU backend: every stage on all cores, with the widest vectors that the machine has.
//!
//! Work is cut into pieces of fixed size and every sum has a fixed order, so that results are the same bytes for any
//! number of threads. Threads are those of the ambient rayon pool.

mod adam;
mod bin;
mod colour;
mod contribution;
mod loss;
mod noise;
mod order;
mod project;
mod project_backward;
mod rasterise;
mod rasterise_backward;
mod roofline;
mod score;
mod simd;
mod update;

mod backend;
mod evolution_backend;
mod frame;

pub use backend::CpuBackend;
pub use frame::{Frame, StageSeconds};
pub use loss::Target;
pub use project::Pinhole;
pub use rasterise_backward::Extra;
pub use roofline::roofline_nanoseconds_per_intersection;

/// Memory that a vector has, used or not.
fn bytes_of<T>(values: &Vec<T>) -> usize {
    values.capacity() * size_of::<T>()
}

#[cfg(test)]
mod tests;
