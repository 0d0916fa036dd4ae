//! A scene, loaded once and used by many.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use genesplat::core::View;
use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::{Offset, SIDE_MIN_PX, Scene};
use genesplat::run::settings::{ConfigFile, Dataset, DepthUse};
use genesplat::run::{inputs, scene};
use genesplat::train::{Background, TrainConfig};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::arrays;
use crate::error::{told, wrong};
use crate::plan::spill;
use crate::waiting::wait_for;

#[pyclass(frozen, name = "Scene", module = "genesplat._native")]
pub(crate) struct LoadedScene {
    pub(crate) scene: Arc<Scene>,
    pub(crate) dataset: Dataset,
    /// What it was loaded with, which a training on it must have, too.
    pub(crate) background: [f32; 3],
}

/// A photo's name, size, and the matrices of its camera.
type ViewParts<'py> = (String, (u32, u32), Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// The settings in a text of JSON.
pub(crate) fn settings_of(json: &str) -> PyResult<ConfigFile> {
    let table = serde_json::from_str(json).map_err(wrong)?;
    ConfigFile::from_table(table).map_err(|error| wrong(error.message()))
}

#[pymethods]
impl LoadedScene {
    /// The scene that the `dataset` of these settings says.
    #[staticmethod]
    fn load(py: Python<'_>, settings: &str) -> PyResult<Self> {
        let file = settings_of(settings)?;
        file.check().map_err(wrong)?;
        Self::of(py, file, None)
    }

    /// That of the run in `out`, as it was loaded for it.
    #[staticmethod]
    fn of_run(py: Python<'_>, out: PathBuf) -> PyResult<Self> {
        Self::of(py, ConfigFile::of_run(&out).map_err(told)?, inputs::offset(&out))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.scene.name
    }

    #[getter]
    fn path(&self) -> &std::path::Path {
        &self.dataset.path
    }

    #[getter]
    fn background(&self) -> &str {
        if self.background == Background::White.fixed_colour() { "white" } else { "black" }
    }

    fn count(&self, split: &str) -> usize {
        self.views(split).len()
    }

    fn view<'py>(&self, py: Python<'py>, split: &str, index: usize) -> ViewParts<'py> {
        let View { name, camera, .. } = &self.views(split)[index];
        let (pose, lens) = arrays::camera_arrays(py, camera);
        (name.clone(), (camera.width, camera.height), pose, lens)
    }

    fn photo<'py>(&self, py: Python<'py>, split: &str, index: usize) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let photo = self.views(split)[index].photo.read().map_err(told)?;
        Ok(arrays::photo_array(py, &photo))
    }

    /// Positions and colours.
    fn points<'py>(&self, py: Python<'py>) -> (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u8>>) {
        let points = &self.scene.points;
        let position = |(row, axis): (usize, usize)| f64::from(points[row].position[axis]);
        let positions = Array2::from_shape_fn((points.len(), 3), position);
        let colours = Array2::from_shape_fn((points.len(), 3), |(row, channel)| points[row].rgb[channel]);
        (positions.into_pyarray(py), colours.into_pyarray(py))
    }
}

impl LoadedScene {
    fn of(py: Python<'_>, mut file: ConfigFile, offset: Option<Offset>) -> PyResult<Self> {
        // Runs on it can be looked at from any folder.
        file.dataset.path = std::path::absolute(&file.dataset.path)?;
        let ConfigFile { dataset, train: TrainConfig { background, seed, .. }, .. } = file;
        let background = background.fixed_colour();
        // Which method is trained on it is not known yet.
        let with_depth = dataset.depth != DepthUse::Off;
        let load = || scene::load(&dataset, with_depth, background, seed, Some(spill()), offset);
        let scene = wait_for(py, &AtomicBool::new(false), load)?.map_err(told)?;
        Ok(Self { scene: scene.into(), dataset, background })
    }

    pub(crate) fn views(&self, split: &str) -> &[View] {
        if split == "test" { &self.scene.test } else { &self.scene.train }
    }
}

/// Writes the bundled scene into `folder`, with so many photos of this size.
#[pyfunction]
pub(crate) fn write_gallery(
    py: Python<'_>,
    folder: PathBuf,
    views: u32,
    size: (u32, u32),
    points: u32,
    seed: u64,
) -> PyResult<()> {
    let (width, height) = size;
    if views < 2 || width.min(height) < SIDE_MIN_PX {
        return Err(wrong(format!("give at least 2 views of at least {SIDE_MIN_PX} x {SIDE_MIN_PX} pixels")));
    }
    let options = GalleryOptions { width, height, views, points, seed };
    let write = || gallery::generate(&options).write_colmap(&folder);
    wait_for(py, &AtomicBool::new(false), write)?.map_err(told)
}
