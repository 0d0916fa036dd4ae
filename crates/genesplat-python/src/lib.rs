//! `genesplat._native`: what the Python package `genesplat` calls.
//!
//! Names, defaults, types and documentation are Python's (`python/genesplat/`); here arrays become clouds and
//! cameras, long work leaves the interpreter's lock and hears Ctrl-C, and errors become exceptions.

mod arrays;
mod card;
mod cloud;
mod density;
mod error;
mod listener;
mod measure;
mod photos;
mod plan;
mod rasterize;
mod scene;
mod search;
mod training;
mod waiting;

use pyo3::prelude::*;

/// Runs the command `words`, its own name first; returns its exit status.
#[pyfunction]
fn command(py: Python<'_>, words: Vec<std::ffi::OsString>) -> u8 {
    py.detach(|| genesplat::command::run(words))
}

/// The number of threads of all that follows.
#[pyfunction]
fn use_threads(threads: u16) -> PyResult<()> {
    genesplat::run::device::use_threads(Some(threads)).map_err(error::told)
}

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Error", module.py().get_type::<error::Error>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<cloud::Cloud>()?;
    module.add_class::<scene::LoadedScene>()?;
    module.add_class::<training::Training>()?;
    rasterize::register(module)?;
    density::register(module)?;
    module.add_function(wrap_pyfunction!(command, module)?)?;
    module.add_function(wrap_pyfunction!(use_threads, module)?)?;
    module.add_function(wrap_pyfunction!(measure::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(measure::evaluate_run, module)?)?;
    module.add_function(wrap_pyfunction!(photos::poses, module)?)?;
    module.add_function(wrap_pyfunction!(scene::write_gallery, module)?)?;
    module.add_function(wrap_pyfunction!(search::genetic_search, module)?)
}
