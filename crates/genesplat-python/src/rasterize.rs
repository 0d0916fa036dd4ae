//! What `genesplat.torch` stands on: a cloud as one camera sees it, forward and backward.
//!
//! Names, shapes and conventions are gsplat's: parameters are activated, and the centre of the first pixel is
//! at (0.5, 0.5).

use std::sync::{Mutex, MutexGuard, PoisonError};

use genesplat::core::constants::JACOBIAN_LIMIT;
use genesplat::core::spherical_harmonics::{SH_STRIDE, coefficients};
use genesplat::core::{BackendError, Gaussians, RenderSettings, ScreenFilter, Splat};
use genesplat::kernels::cpu::{DifferentiableView, Pinhole, PoseGradient, ViewGradients};
use genesplat::run::device::DeviceChoice;
use glam::{DMat3, DVec3, Mat3, Vec3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::card::on_card;
use crate::cloud::device_named;
use crate::error::{told, wrong};

/// Where the logit of an opacity ends: in `f32` the sigmoid of more is 1.
const LOGIT_MAX: f64 = 20.0;
/// What a scale is taken to be at least, so that it has a logarithm; its square is 0 in `f32`.
const SCALE_MIN: f32 = 1e-30;
/// From the centre of a pixel to its corner, px.
const HALF: f32 = 0.5;

/// A cloud as one camera sees it.
#[pyclass(name = "RasterizedView", module = "genesplat._native", frozen)]
pub(crate) struct RasterizedView {
    view: Mutex<DifferentiableView>,
    /// As given: their logarithms are what the kernels know `[N, 3]`.
    scales: Vec<[f32; 3]>,
    camera: Pinhole,
    /// What blends, where that is not the CPU.
    card: Option<DeviceChoice>,
}

/// Of each splat: row, mean and half extent, px; depth; inverse covariance; opacity.
type SplatArrays<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<i32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
);

/// Picture and transmittance.
type DrawnArrays<'py> = (Bound<'py, PyArray3<f32>>, Bound<'py, PyArray2<f32>>);

/// By means, quaternions, scales, opacities, harmonics, colours, means on the screen, these with absolute
/// values, and the view matrix.
type GradientArrays<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray3<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray2<f32>>,
);

#[pymethods]
impl RasterizedView {
    /// Projects the cloud. `colors` are harmonics `[N, K, 3]` of degree `sh_degree`, or as they are `[N, 3]`.
    #[new]
    #[pyo3(signature = (means, quats, scales, opacities, sh, rgb, sh_degree, viewmat, k, size, near, far, radius_clip, antialiased, device))]
    fn new(
        py: Python<'_>,
        means: PyReadonlyArray2<'_, f32>,
        quats: PyReadonlyArray2<'_, f32>,
        scales: PyReadonlyArray2<'_, f32>,
        opacities: PyReadonlyArray1<'_, f32>,
        sh: Option<PyReadonlyArray3<'_, f32>>,
        rgb: Option<PyReadonlyArray2<'_, f32>>,
        sh_degree: u8,
        viewmat: PyReadonlyArray2<'_, f32>,
        k: PyReadonlyArray2<'_, f32>,
        size: (u32, u32),
        near: f32,
        far: f32,
        radius_clip: f32,
        antialiased: bool,
        device: &str,
    ) -> PyResult<Self> {
        let rows = means.shape()[0];
        let scales = rows_of::<3>("scales", &scales, rows)?;
        let cloud = Gaussians {
            positions: rows_of("means", &means, rows)?,
            log_scales: scales
                .iter()
                .map(|scale| scale.map(|value| value.abs().max(SCALE_MIN).ln()))
                .collect(),
            rotations: rows_of("quats", &quats, rows)?,
            opacity_logits: opacity_logits(opacities.as_slice()?, rows)?,
            sh: harmonics(sh.as_ref(), sh_degree, rows)?,
            filter_3d: None,
        };
        let rgb = rgb.as_ref().map(|rgb| rows_of::<3>("colors", rgb, rows)).transpose()?;
        let camera = pinhole(viewmat.as_slice()?, k.as_slice()?, size, near)?;
        let card = device_named(device)?.resolve().map_err(told)?;
        let filter = if antialiased { ScreenFilter::Antialiased } else { ScreenFilter::Classic };
        let settings =
            RenderSettings { sh_degree, background: [0.0; 3], filter, ..RenderSettings::default() };
        let view = py.detach(|| {
            let mut view = DifferentiableView::project(cloud, rgb.as_deref(), camera, settings)?;
            view.retain(|splat| {
                let [x, y] = splat.half_extent_px;
                splat.depth < far && x.max(y).ceil() > radius_clip
            });
            Ok::<_, BackendError>(view)
        });
        let view = Mutex::new(view.map_err(told)?);
        Ok(Self { view, scales, camera, card: Some(card).filter(|card| card.is_graphics()) })
    }

    /// What is drawn, in the order of the rows.
    fn splats<'py>(&self, py: Python<'py>) -> PyResult<SplatArrays<'py>> {
        let view = self.view();
        let count = view.splats().len();
        let mut rows = Vec::with_capacity(count);
        let [mut means, mut conics] = [Vec::with_capacity(2 * count), Vec::with_capacity(3 * count)];
        let mut radii = Vec::with_capacity(2 * count);
        let [mut depths, mut opacities] = [Vec::with_capacity(count), Vec::with_capacity(count)];
        for (_, splat) in view.splats().iter() {
            rows.push(i64::from(splat.row));
            means.extend(splat.mean_px.map(|value| value + HALF));
            radii.extend(splat.half_extent_px.map(|value| value.ceil().max(1.0) as i32));
            let [a, b, c] = splat.conic_log2.map(|value| value * -std::f32::consts::LN_2);
            conics.extend([2.0 * a, b, 2.0 * c]);
            depths.push(splat.depth);
            opacities.push(splat.log2_opacity.exp2());
        }
        Ok((
            rows.into_pyarray(py),
            means.into_pyarray(py).reshape([count, 2])?,
            radii.into_pyarray(py).reshape([count, 2])?,
            depths.into_pyarray(py),
            conics.into_pyarray(py).reshape([count, 3])?,
            opacities.into_pyarray(py),
        ))
    }

    /// The picture on black `[3, H, W]`, and the transmittance that is left `[H, W]`.
    fn draw<'py>(&self, py: Python<'py>) -> PyResult<DrawnArrays<'py>> {
        let [width, height] = self.camera.size_px.map(|pixels| pixels as usize);
        let (image, left) = py.detach(|| self.drawn()).map_err(told)?;
        let image = image.into_pyarray(py).reshape([3, height, width])?;
        Ok((image, left.into_pyarray(py).reshape([height, width])?))
    }

    /// From gradients by the picture `[3, H, W]` and the transmittance `[H, W]` that were drawn last.
    fn backward<'py>(
        &self,
        py: Python<'py>,
        by_image: PyReadonlyArray3<'py, f32>,
        by_transmittance: PyReadonlyArray2<'py, f32>,
    ) -> PyResult<GradientArrays<'py>> {
        let (by_image, by_left) = (by_image.as_slice()?, by_transmittance.as_slice()?);
        let pixels: usize = self.camera.size_px.map(|pixels| pixels as usize).iter().product();
        if by_image.len() != 3 * pixels || by_left.len() != pixels {
            return Err(wrong("the gradients are not of the picture that was drawn"));
        }
        let gradients = py.detach(|| self.differentiated(by_image, by_left)).map_err(told)?;
        self.arrays(py, gradients)
    }
}

impl RasterizedView {
    fn view(&self) -> MutexGuard<'_, DifferentiableView> {
        self.view.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn drawn(&self) -> anyhow::Result<(Vec<f32>, Vec<f32>)> {
        let mut view = self.view();
        let Some(card) = self.card else {
            let (image, left) = view.draw();
            return Ok((image.to_vec(), left.to_vec()));
        };
        on_card(card, |gpu| gpu.draw_splats(&splats_of(&view), self.camera.size_px))
    }

    fn differentiated(&self, by_image: &[f32], by_left: &[f32]) -> anyhow::Result<ViewGradients> {
        let mut view = self.view();
        let Some(card) = self.card else { return Ok(view.backward(by_image, by_left)?) };
        let size = self.camera.size_px;
        let sums = on_card(card, |gpu| gpu.splats_backward(&splats_of(&view), size, by_image, by_left))?;
        Ok(view.backward_from(&sums)?)
    }

    fn arrays<'py>(&self, py: Python<'py>, gradients: ViewGradients) -> PyResult<GradientArrays<'py>> {
        let ViewGradients { cloud, screen, pose } = gradients;
        let of_row = |(by_log, scales): (&[f32; 3], &[f32; 3])| -> [f32; 3] {
            std::array::from_fn(|axis| {
                by_log[axis] / scales[axis].abs().max(SCALE_MIN).copysign(scales[axis])
            })
        };
        let by_scales = cloud.log_scales.iter().zip(&self.scales).map(of_row).collect();
        let rows = screen.len();
        Ok((
            array(py, cloud.positions)?,
            array(py, cloud.rotations)?,
            array(py, by_scales)?,
            screen.iter().map(|of| of.opacity).collect::<Vec<_>>().into_pyarray(py),
            cloud.sh.into_flattened().into_pyarray(py).reshape([rows, SH_STRIDE / 3, 3])?,
            array(py, screen.iter().map(|of| of.rgb).collect())?,
            array(py, screen.iter().map(|of| of.mean_px).collect())?,
            array(py, screen.iter().map(|of| of.absolute_mean_px).collect())?,
            array(py, by_viewmat(&pose, &self.camera))?,
        ))
    }
}

/// Adds what is here to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<RasterizedView>()
}

/// What is drawn, in the order of the rows.
fn splats_of(view: &DifferentiableView) -> Vec<Splat> {
    view.splats().iter().map(|(_, splat)| *splat).collect()
}

/// By the view matrix `[R T; 0 1]`: the centre `c = −R⁻¹ T` moves by `−R⁻¹ (dR c + dT)`.
fn by_viewmat(pose: &PoseGradient, camera: &Pinhole) -> Vec<[f32; 4]> {
    let [x, y, z] = camera.rotation.map(|row| Vec3::from(row).as_dvec3());
    // Of columns that are its rows: the transpose.
    let transposed = DMat3::from_cols(x, y, z);
    let through_centre = -(transposed.inverse() * DVec3::from(pose.centre_in_world));
    let centre = Vec3::from(camera.centre_in_world).as_dvec3();
    let rows = (0..3).map(|row| {
        let by_rotation = DVec3::from(pose.rotation[row]) + through_centre[row] * centre;
        by_rotation.extend(pose.translation[row] + through_centre[row]).as_vec4().to_array()
    });
    rows.chain([[0.0; 4]]).collect()
}

fn array<const K: usize>(py: Python<'_>, rows: Vec<[f32; K]>) -> PyResult<Bound<'_, PyArray2<f32>>> {
    let count = rows.len();
    rows.into_flattened().into_pyarray(py).reshape([count, K])
}

/// The rows of an array `[N, K]`.
pub(crate) fn rows_of<const K: usize>(
    name: &str,
    array: &PyReadonlyArray2<'_, f32>,
    rows: usize,
) -> PyResult<Vec<[f32; K]>> {
    match array.as_slice()?.as_chunks() {
        (chunks, []) if array.shape() == [rows, K] => Ok(chunks.to_vec()),
        _ => Err(wrong(format!("{name} has the shape {:?}, not [{rows}, {K}]", array.shape()))),
    }
}

fn opacity_logits(opacities: &[f32], rows: usize) -> PyResult<Vec<f32>> {
    if opacities.len() != rows {
        return Err(wrong(format!("opacities has {} rows, not {rows}", opacities.len())));
    }
    let logit = |(row, &opacity): (usize, &f32)| {
        if !(0.0..=1.0).contains(&opacity) {
            let reason = "opacities are between 0 and 1, after the sigmoid";
            return Err(wrong(format!("opacities[{row}] is {opacity}; {reason}")));
        }
        let opacity = f64::from(opacity);
        Ok((opacity / (1.0 - opacity)).ln().clamp(-LOGIT_MAX, LOGIT_MAX) as f32)
    };
    opacities.iter().enumerate().map(logit).collect()
}

/// The coefficients of a degree `[N, 16, 3]`; zeros where colours are given.
fn harmonics(
    sh: Option<&PyReadonlyArray3<'_, f32>>,
    degree: u8,
    rows: usize,
) -> PyResult<Vec<[f32; SH_STRIDE]>> {
    let mut out = vec![[0.0; SH_STRIDE]; rows];
    let Some(sh) = sh else { return Ok(out) };
    let &[count, bands, channels] = sh.shape() else { return Ok(out) };
    let used = coefficients(degree);
    if (count, channels) != (rows, 3) || bands < used {
        let shape = sh.shape();
        let reason = format!("not [{rows}, K, 3] with K of at least {used}, which sh_degree={degree} needs");
        return Err(wrong(format!("colors has the shape {shape:?}, {reason}")));
    }
    for (out, of_row) in out.iter_mut().zip(sh.as_slice()?.chunks_exact(3 * bands)) {
        out[..3 * used].copy_from_slice(&of_row[..3 * used]);
    }
    Ok(out)
}

/// A camera by gsplat's matrices, which need not be rigid.
fn pinhole(viewmat: &[f32], k: &[f32], (width, height): (u32, u32), near: f32) -> PyResult<Pinhole> {
    let &[a, b, c, x, d, e, f, y, g, h, i, z, ..] = viewmat else {
        return Err(wrong("a view matrix has 4 rows and columns"));
    };
    let &[fx, skew, cx, fy_x, fy, cy, 0.0, 0.0, 1.0] = k else {
        return Err(wrong("the last row of K is not 0, 0, 1"));
    };
    if [skew, fy_x] != [0.0; 2] || !(fx > 0.0 && fy > 0.0) {
        return Err(wrong("K has skew, or focal lengths that are not above 0"));
    }
    let rotation = Mat3::from_cols_array(&[a, d, g, b, e, h, c, f, i]);
    let translation = Vec3::new(x, y, z);
    let tangents = [width as f32 / (2.0 * fx), height as f32 / (2.0 * fy)];
    Ok(Pinhole {
        rotation: [[a, b, c], [d, e, f], [g, h, i]],
        translation: [x, y, z],
        centre_in_world: (rotation.inverse() * -translation).to_array(),
        focal_px: [fx, fy],
        axis_px: [cx - HALF, cy - HALF],
        slope_limit: tangents.map(|tangent| JACOBIAN_LIMIT * tangent),
        size_px: [width, height],
        near,
    })
}
