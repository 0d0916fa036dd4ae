//! Cameras of photos.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use genesplat::poses::{Request, find};
use pyo3::prelude::*;

use crate::error::told;
use crate::waiting::wait_for;

/// Makes the scene of photos without cameras; what was found, as JSON.
#[pyfunction]
pub(crate) fn poses(
    py: Python<'_>,
    photos: PathBuf,
    out: PathBuf,
    frames: Option<u32>,
    all_pairs: bool,
) -> PyResult<String> {
    let stop = AtomicBool::new(false);
    let request = Request { photos: &photos, out: &out, frames, all_pairs, threads: None };
    let work = || find(&request, &stop);
    let found = wait_for(py, &stop, work)?.map_err(told)?;
    serde_json::to_string(&found).map_err(told)
}
