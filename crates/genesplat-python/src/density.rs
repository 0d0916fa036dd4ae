//! What `genesplat.strategy` stands on: plans of density control, and how much Gaussians stand for edges.

use genesplat::core::gaussians::Moments;
use genesplat::core::{Device, Gaussians, Origin, Photo, RenderSettings, Statistics, View};
use genesplat::kernels::cpu::CpuBackend;
use genesplat::train::{DensityControl, MethodName, edge_scores};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::arrays::camera;
use crate::error::{told, wrong};
use crate::rasterize::rows_of;

/// When a run densifies, and how.
#[pyclass(name = "DensityControl", module = "genesplat._native", frozen)]
pub(crate) struct PyDensityControl(DensityControl);

/// Of each new row: the old one, and whether it is the same; mean, log-scales, opacity logit. How many rows
/// were split, pruned, and refused for want of room.
type Decision<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    (usize, usize, usize),
);

#[pymethods]
impl PyDensityControl {
    #[new]
    fn new(
        method: &str,
        iterations: u32,
        every: u32,
        photos: usize,
        cap: usize,
        seed: u64,
    ) -> PyResult<Self> {
        let name = MethodName::from_name(method)
            .filter(|name| matches!(name, MethodName::Genesplat | MethodName::ImprovedGs))
            .ok_or_else(|| {
                wrong(format!("method is {method:?}, but must be \"genesplat\" or \"improved-gs\""))
            })?;
        let control = DensityControl::new(name, iterations, every, photos, cap, seed);
        control.map(Self).map_err(wrong)
    }

    /// Density control ends before this iteration.
    fn until(&self) -> u32 {
        self.0.until()
    }

    fn densifies(&self, iteration: u32) -> bool {
        self.0.densifies(iteration)
    }

    /// To what opacities are limited in an iteration, if they are.
    fn reset(&self, iteration: u32) -> Option<f32> {
        self.0.reset(iteration)
    }

    fn budget(&self, iteration: u32) -> usize {
        self.0.budget(iteration)
    }

    /// Which of so many views have a say.
    fn score_views(&self, iteration: u32, views: usize) -> Vec<usize> {
        self.0.score_views(iteration, views)
    }

    /// What an iteration does to these rows; `scores` say how much each is worth splitting.
    fn decide<'py>(
        &self,
        py: Python<'py>,
        iteration: u32,
        gradient_sum: PyReadonlyArray1<'py, f32>,
        weight_sum: PyReadonlyArray1<'py, f32>,
        cloud: PyRef<'py, Rows>,
        scores: Option<PyReadonlyArray1<'py, f32>>,
    ) -> PyResult<Decision<'py>> {
        let rows = cloud.0.len();
        let statistics = Statistics {
            gradient_sum: column("gradient_sum", &gradient_sum, rows)?,
            weight_sum: column("weight_sum", &weight_sum, rows)?,
            ..Statistics::default()
        };
        let scores = scores.map(|scores| column("scores", &scores, rows)).transpose()?;
        let mut edited = cloud.0.clone();
        let decided = py.detach(|| {
            let genes = edited.all_genes();
            let decided = self.0.decide(iteration, &statistics, &genes, scores.as_deref());
            decided.edit.apply(&mut edited, &mut Moments::default());
            decided
        });
        let kept: Vec<bool> = decided.edit.origins.iter().map(|origin| *origin == Origin::Kept).collect();
        let count = kept.len();
        Ok((
            decided.edit.sources.iter().map(|&row| i64::from(row)).collect::<Vec<_>>().into_pyarray(py),
            kept.into_pyarray(py),
            edited.positions.into_flattened().into_pyarray(py).reshape([count, 3])?,
            edited.log_scales.into_flattened().into_pyarray(py).reshape([count, 3])?,
            edited.opacity_logits.into_pyarray(py),
            (decided.split, decided.pruned, decided.refused),
        ))
    }
}

/// Means, log-scales, quaternions and opacity logits: all that density control reads of a cloud.
#[pyclass(name = "Rows", module = "genesplat._native", frozen)]
pub(crate) struct Rows(Gaussians);

#[pymethods]
impl Rows {
    #[new]
    fn new(
        means: PyReadonlyArray2<'_, f32>,
        scales: PyReadonlyArray2<'_, f32>,
        quats: PyReadonlyArray2<'_, f32>,
        opacities: PyReadonlyArray1<'_, f32>,
    ) -> PyResult<Self> {
        let rows = means.shape()[0];
        let cloud = Gaussians {
            positions: rows_of("means", &means, rows)?,
            log_scales: rows_of("scales", &scales, rows)?,
            rotations: rows_of("quats", &quats, rows)?,
            opacity_logits: column("opacities", &opacities, rows)?,
            ..Gaussians::zeros(rows)
        };
        match cloud.first_non_finite() {
            Some((row, parameter)) => Err(wrong(format!(
                "the {parameter} of Gaussian {row} is not finite; lower the learning rates"
            ))),
            None => Ok(Self(cloud)),
        }
    }

    /// How much each row stands for the edges of photos [H, W, 3], taken by these cameras.
    fn edge_scores<'py>(
        &self,
        py: Python<'py>,
        photos: Vec<PyReadonlyArray3<'py, u8>>,
        viewmats: PyReadonlyArray3<'py, f64>,
        intrinsics: PyReadonlyArray3<'py, f64>,
        near: f64,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let (poses, lenses) = (viewmats.as_array(), intrinsics.as_array());
        let cameras = poses.outer_iter().zip(lenses.outer_iter()).enumerate();
        let view = |(photo, (at, (pose, lens)))| -> PyResult<View> {
            let photo = photo_of(photo)?;
            let camera = camera(&pose, &lens, at, (photo.width, photo.height), near)?;
            Ok(View { name: String::new(), camera, photo: photo.into(), mask: None, depth: None })
        };
        let views: Vec<View> = photos.iter().zip(cameras).map(view).collect::<PyResult<_>>()?;
        let cloud = self.0.clone();
        let scores = py.detach(|| {
            let mut backend = CpuBackend::new();
            backend.set_views(&views)?;
            backend.upload(cloud.into())?;
            let shown: Vec<usize> = (0..views.len()).collect();
            edge_scores(&mut backend, &views, &shown, &RenderSettings::default())
        });
        Ok(scores.map_err(told)?.into_pyarray(py))
    }
}

/// Adds what is here to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyDensityControl>()?;
    module.add_class::<Rows>()
}

fn column(name: &str, values: &PyReadonlyArray1<'_, f32>, rows: usize) -> PyResult<Vec<f32>> {
    let values = values.as_slice()?;
    if values.len() != rows {
        return Err(wrong(format!("{name} has {} rows, not {rows}", values.len())));
    }
    Ok(values.to_vec())
}

fn photo_of(photo: &PyReadonlyArray3<'_, u8>) -> PyResult<Photo> {
    let &[height, width, 3] = photo.shape() else {
        return Err(wrong(format!("a photo has the shape {:?}, not [H, W, 3]", photo.shape())));
    };
    Ok(Photo { width: width as u32, height: height as u32, rgb: photo.as_slice()?.to_vec() })
}
