//! A splat: a cloud, and how it is meant to be shown.

use std::path::PathBuf;
use std::sync::Arc;

use genesplat::core::{Camera, Gaussians, RenderSettings, ScreenFilter};
use genesplat::io::format::{self, Options};
use genesplat::io::{Format, Offset, shown};
use genesplat::run::device::{self, Device, DeviceChoice};
use genesplat::run::output::WriteBar;
use genesplat::run::{files, splat, take_along};
use numpy::ndarray::Array4;
use numpy::{IntoPyArray, PyArray4, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{self, Columns};
use crate::error::{told, wrong};
use crate::waiting::wait_for;

/// Names of screen filters, as gsplat calls the two that it has.
const FILTERS: [(&str, ScreenFilter); 3] = [
    ("classic", ScreenFilter::Classic),
    ("antialiased", ScreenFilter::Antialiased),
    ("mip", ScreenFilter::Mip),
];

#[pyclass(frozen, module = "genesplat._native")]
pub(crate) struct Cloud {
    pub(crate) cloud: Arc<Gaussians>,
    pub(crate) settings: RenderSettings,
    pub(crate) offset: Option<Offset>,
}

fn filter_named(name: &str) -> PyResult<ScreenFilter> {
    let found = FILTERS.iter().find(|(known, _)| *known == name);
    found.map(|(_, filter)| *filter).ok_or_else(|| {
        wrong(format!("there is no rasterize_mode {name:?}; it is \"classic\", \"antialiased\" or \"mip\""))
    })
}

fn format_named(ending: &str) -> PyResult<Format> {
    let found = Format::ALL.into_iter().find(|format| format.ending() == ending);
    found.ok_or_else(|| wrong(format!("there is no format {ending:?}")))
}

/// The device called so.
pub(crate) fn device_named(name: &str) -> PyResult<DeviceChoice> {
    name.parse().map_err(|problem: String| wrong(problem))
}

/// A device of this choice that holds the cloud.
pub(crate) fn device_with(choice: DeviceChoice, cloud: &Gaussians) -> anyhow::Result<Device> {
    let mut device = device::open(choice)?;
    device.upload(cloud.clone().into())?;
    Ok(device)
}

#[pymethods]
impl Cloud {
    #[staticmethod]
    fn from_arrays(splats: Columns<'_>, rasterize_mode: &str, offset: Option<Offset>) -> PyResult<Self> {
        let (sh_degree, cloud) = (splats.sh_degree()?, splats.cloud()?);
        let settings =
            RenderSettings { sh_degree, filter: filter_named(rasterize_mode)?, ..RenderSettings::default() };
        Ok(Self { cloud: cloud.into(), settings, offset })
    }

    /// A file, or the folder of a run; `ending` is the format that it has to have, if any.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf, ending: Option<&str>) -> PyResult<Self> {
        let wanted = ending.map(format_named).transpose()?;
        let opened = wait_for(py, &Default::default(), || splat::open(&path))?.map_err(told)?;
        if let Some(wanted) = wanted.filter(|wanted| opened.format != Some(*wanted)) {
            let found = opened.format.map_or("the folder of a run", Format::ending);
            let (path, wanted) = (shown(&path), wanted.ending());
            return Err(told(format!("{path} is {found}, and not {wanted}; use Splats.load")));
        }
        Ok(Self { cloud: opened.cloud.into(), settings: opened.settings, offset: opened.offset })
    }

    /// Writes it as the format of this ending, or, without one, as the format that the name asks for.
    fn save(&self, py: Python<'_>, path: PathBuf, ending: Option<&str>) -> PyResult<()> {
        let format = match ending {
            Some(ending) => format_named(ending)?,
            None => files::format_of(&path).map_err(told)?,
        };
        let filter = self.settings.filter;
        let options =
            Options { screen_filter: filter, sh_degree: self.settings.sh_degree, ..Options::default() };
        let write = || -> anyhow::Result<()> {
            format::write_told(&path, format, &self.cloud, &options, &WriteBar::default())?;
            splat::write_offset(&path, self.offset)?;
            splat::tell_losses(format, &self.cloud, filter);
            Ok(())
        };
        wait_for(py, &Default::default(), write)?.map_err(told)
    }

    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = arrays::to_dict(py, &self.cloud, self.settings.sh_degree)?;
        let mode = FILTERS.iter().find(|(_, filter)| *filter == self.settings.filter);
        dict.set_item("rasterize_mode", mode.map(|(name, _)| *name))?;
        dict.set_item("offset", self.offset)?;
        Ok(dict)
    }

    /// `[C, H, W, 3]`.
    fn render<'py>(
        &self,
        py: Python<'py>,
        viewmats: PyReadonlyArray3<'py, f64>,
        intrinsics: PyReadonlyArray3<'py, f64>,
        size: (u32, u32),
        near: f64,
        background: [f32; 3],
        sh_degree: u8,
        device: &str,
    ) -> PyResult<Bound<'py, PyArray4<f32>>> {
        let cameras = arrays::cameras(&viewmats.as_array(), &intrinsics.as_array(), size, near)?;
        let settings = RenderSettings { background, sh_degree, ..self.settings };
        let choice = device_named(device)?;
        let draw = || self.pictures(&cameras, &settings, choice);
        let pixels = wait_for(py, &Default::default(), draw)?.map_err(told)?;
        let shape = (cameras.len(), size.1 as usize, size.0 as usize, 3);
        Ok(Array4::from_shape_vec(shape, pixels).expect("so many pixels").into_pyarray(py))
    }

    /// The page that `genesplat export` makes.
    fn page(&self, py: Python<'_>, title: &str) -> PyResult<String> {
        let make = || -> anyhow::Result<String> {
            let spz = take_along::spz(title.as_ref(), &self.cloud, &self.settings)?;
            Ok(take_along::page(&spz, title, &self.cloud, &self.settings, None, &[]))
        };
        wait_for(py, &Default::default(), make)?.map_err(told)
    }
}

impl Cloud {
    fn pictures(
        &self,
        cameras: &[Camera],
        settings: &RenderSettings,
        choice: DeviceChoice,
    ) -> anyhow::Result<Vec<f32>> {
        let mut device = device_with(choice, &self.cloud)?;
        let mut pixels = Vec::new();
        for camera in cameras {
            arrays::append_pixels(&mut pixels, &device.render(camera, settings)?);
        }
        Ok(pixels)
    }
}
