//! The CPU backend: every stage on all cores, with the widest vectors that the machine has.
//!
//! Work is cut into pieces of fixed size and every sum has a fixed order, so that results are the same bytes
//! for any number of threads. Threads are those of the ambient rayon pool.

mod backend;
mod bin;
mod blend;
mod differentiable;
mod loss;
mod memory;
mod roofline;
mod score;
mod share;
mod simd;
pub mod stages;
mod update;
mod view;

pub use backend::CpuBackend;
pub use differentiable::{DifferentiableView, ScreenGradient, ViewGradients};
pub use loss::{PhotoRows, Target};
pub use roofline::roofline_nanoseconds_per_intersection;
pub use update::PoseGradient;
pub use view::buffers::{StageSeconds, ViewBuffers};
pub use view::pinhole::Pinhole;

/// Memory that a vector has, used or not.
fn bytes_of<T>(values: &Vec<T>) -> usize {
    values.capacity() * size_of::<T>()
}

#[cfg(test)]
mod tests;
