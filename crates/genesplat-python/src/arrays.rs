//! NumPy arrays and what the library holds.

use genesplat::core::spherical_harmonics::{SH_STRIDE, coefficients};
use genesplat::core::{Camera, Gaussians, Image, Photo};
use glam::{DMat3, DQuat, DVec3};
use numpy::ndarray::{Array2, Array3, ArrayView2, ArrayView3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::wrong;

/// The columns of a cloud, as Python has checked their shapes.
#[derive(FromPyObject)]
pub(crate) struct Columns<'py> {
    means: PyReadonlyArray2<'py, f32>,
    quats: PyReadonlyArray2<'py, f32>,
    log_scales: PyReadonlyArray2<'py, f32>,
    logit_opacities: PyReadonlyArray1<'py, f32>,
    sh0: PyReadonlyArray3<'py, f32>,
    #[pyo3(attribute("shN"))]
    sh_n: PyReadonlyArray3<'py, f32>,
    filter_3d: Option<PyReadonlyArray1<'py, f32>>,
}

fn rows<const WIDTH: usize>(values: &PyReadonlyArray2<'_, f32>) -> Vec<[f32; WIDTH]> {
    values.as_array().outer_iter().map(|row| std::array::from_fn(|at| row[at])).collect()
}

impl Columns<'_> {
    /// The degree of the spherical harmonics.
    pub(crate) fn sh_degree(&self) -> PyResult<u8> {
        let count = 1 + self.sh_n.as_array().dim().1;
        let degree = (0..=3).find(|&degree| coefficients(degree) == count);
        degree.ok_or_else(|| wrong(format!("shN has {} coefficients; give 0, 3, 8 or 15", count - 1)))
    }

    pub(crate) fn cloud(&self) -> PyResult<Gaussians> {
        let (sh0, sh_n) = (self.sh0.as_array(), self.sh_n.as_array());
        let colours = sh0.outer_iter().zip(sh_n.outer_iter()).map(|(first, others)| {
            let mut row = [0.0; SH_STRIDE];
            row.iter_mut().zip(first.iter().chain(others)).for_each(|(to, from)| *to = *from);
            row
        });
        let cloud = Gaussians {
            positions: rows(&self.means),
            log_scales: rows(&self.log_scales),
            rotations: rows(&self.quats),
            opacity_logits: self.logit_opacities.as_array().to_vec(),
            sh: colours.collect(),
            filter_3d: self.filter_3d.as_ref().map(|filter| filter.as_array().to_vec()),
        };
        match cloud.first_non_finite() {
            Some((row, name)) => Err(wrong(format!("the {name} of Gaussian {row} is not finite"))),
            None if !cloud.is_consistent() => Err(wrong("arrays have different numbers of Gaussians")),
            None => Ok(cloud),
        }
    }
}

/// The arrays of a cloud, by the names that Python gives them.
pub(crate) fn to_dict<'py>(
    py: Python<'py>,
    cloud: &Gaussians,
    sh_degree: u8,
) -> PyResult<Bound<'py, PyDict>> {
    let (count, others) = (cloud.len(), coefficients(sh_degree) - 1);
    let dict = PyDict::new(py);
    dict.set_item("means", flat(py, &cloud.positions))?;
    dict.set_item("quats", flat(py, &cloud.rotations))?;
    dict.set_item("log_scales", flat(py, &cloud.log_scales))?;
    dict.set_item("logit_opacities", PyArray1::from_slice(py, &cloud.opacity_logits))?;
    let sh0 = cloud.sh.iter().flat_map(|row| row[..3].iter().copied()).collect();
    let sh_n = cloud.sh.iter().flat_map(|row| row[3..3 + 3 * others].iter().copied()).collect();
    dict.set_item("sh0", shaped(py, [count, 1, 3], sh0))?;
    dict.set_item("shN", shaped(py, [count, others, 3], sh_n))?;
    dict.set_item("filter_3d", cloud.filter_3d.as_ref().map(|filter| PyArray1::from_slice(py, filter)))?;
    Ok(dict)
}

fn flat<'py, const WIDTH: usize>(py: Python<'py>, values: &[[f32; WIDTH]]) -> Bound<'py, PyArray2<f32>> {
    let values = values.as_flattened().to_vec();
    let shape = (values.len() / WIDTH, WIDTH);
    Array2::from_shape_vec(shape, values).expect("so many values").into_pyarray(py)
}

fn shaped<'py>(
    py: Python<'py>,
    [count, rows, width]: [usize; 3],
    values: Vec<f32>,
) -> Bound<'py, PyArray3<f32>> {
    Array3::from_shape_vec((count, rows, width), values).expect("so many values").into_pyarray(py)
}

/// A photo as `[H, W, 3]`.
pub(crate) fn photo_array<'py>(py: Python<'py>, photo: &Photo) -> Bound<'py, PyArray3<u8>> {
    let shape = (photo.height as usize, photo.width as usize, 3);
    Array3::from_shape_vec(shape, photo.rgb.clone()).expect("so many pixels").into_pyarray(py)
}

/// The pixels of a picture `[H, W, 3]`, at the end of `to`.
pub(crate) fn append_pixels(to: &mut Vec<f32>, picture: &Image) {
    let pixels = picture.width as usize * picture.height as usize;
    to.extend((0..pixels).flat_map(|at| [0, 1, 2].map(|channel| picture.planes[channel * pixels + at])));
}

/// The cameras of `viewmats [C, 4, 4]` (camera from world) and `intrinsics [C, 3, 3]`.
pub(crate) fn cameras(
    viewmats: &ArrayView3<'_, f64>,
    intrinsics: &ArrayView3<'_, f64>,
    (width, height): (u32, u32),
    near: f64,
) -> PyResult<Vec<Camera>> {
    let each = viewmats.outer_iter().zip(intrinsics.outer_iter()).enumerate();
    each.map(|(at, (pose, lens))| camera(&pose, &lens, at, (width, height), near)).collect()
}

/// How far a rotation may be from one: single precision, multiplied a few times.
const ROTATION_ERROR: f64 = 1e-3;

pub(crate) fn camera(
    pose: &ArrayView2<'_, f64>,
    lens: &ArrayView2<'_, f64>,
    at: usize,
    (width, height): (u32, u32),
    near: f64,
) -> PyResult<Camera> {
    let column = |axis: usize| DVec3::new(pose[[0, axis]], pose[[1, axis]], pose[[2, axis]]);
    let rotation = DMat3::from_cols(column(0), column(1), column(2));
    let error = (rotation.transpose() * rotation - DMat3::IDENTITY).to_cols_array().map(f64::abs);
    let is_rotation = error.into_iter().all(|error| error < ROTATION_ERROR) && rotation.determinant() > 0.0;
    if !is_rotation || !column(3).is_finite() {
        return Err(wrong(format!(
            "viewmats[{at}] is no rigid motion; give camera_from_world, a rotation and a translation"
        )));
    }
    let (focal_px, principal_px) = ([lens[[0, 0]], lens[[1, 1]]], [lens[[0, 2]], lens[[1, 2]]]);
    let is_usable = focal_px.iter().all(|focal| focal.is_finite() && *focal > 0.0)
        && principal_px.iter().all(|place| place.is_finite())
        && [lens[[0, 1]], lens[[1, 0]], lens[[2, 0]], lens[[2, 1]]] == [0.0; 4];
    if !is_usable {
        return Err(wrong(format!(
            "Ks[{at}] is no pinhole camera; give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels"
        )));
    }
    Ok(Camera {
        width,
        height,
        focal_px,
        principal_px,
        camera_from_world_rotation: DQuat::from_mat3(&rotation).normalize(),
        camera_from_world_translation: column(3),
        near,
    })
}

/// `camera_from_world [4, 4]` and the intrinsics `[3, 3]`.
pub(crate) fn camera_arrays<'py>(
    py: Python<'py>,
    camera: &Camera,
) -> (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>) {
    let (rotation, translation) = (camera.rotation(), camera.camera_from_world_translation);
    let pose = Array2::from_shape_fn((4, 4), |(row, column)| match (row, column) {
        (3, 3) => 1.0,
        (3, _) => 0.0,
        (_, 3) => translation[row],
        _ => rotation.col(column)[row],
    });
    let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px);
    let lens = numpy::ndarray::arr2(&[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]);
    (pose.into_pyarray(py), lens.into_pyarray(py))
}
