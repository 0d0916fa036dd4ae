//! A backend that was chosen when the program ran. Everything else is generic over [`Backend`].

use std::borrow::Cow;

use genesplat::core::backend::{MomentPolicy, StepReport};
use genesplat::core::lineage::PARENTS;
use genesplat::core::{
    Backend, BackendError, Blend, Camera, Credits, Gaussians, Genes, Image, Judgement, Lineage, Merit,
    Moments, RenderSettings, RowEdit, SparseDelta, Statistics, TrainStep, View,
};
use genesplat::gpu::GpuBackend;
use genesplat::kernels::cpu::CpuBackend;

/// The processor or a graphics device.
pub(crate) enum AnyBackend {
    /// All cores.
    Cpu(Box<CpuBackend>),
    /// A graphics device.
    Gpu(Box<GpuBackend>),
}

/// The same verb of whichever backend it is.
macro_rules! delegate {
    ($self:ident.$verb:ident($($argument:expr),*)) => {
        match $self {
            Self::Cpu(backend) => backend.$verb($($argument),*),
            Self::Gpu(backend) => backend.$verb($($argument),*),
        }
    };
}

impl Backend for AnyBackend {
    fn describe(&self) -> String {
        delegate!(self.describe())
    }

    fn len(&self) -> usize {
        delegate!(self.len())
    }

    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        delegate!(self.set_views(views))
    }

    fn upload(&mut self, cloud: Gaussians, moments: Option<Moments>) -> Result<(), BackendError> {
        delegate!(self.upload(cloud, moments))
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        delegate!(self.download())
    }

    fn genes(&mut self) -> Result<Vec<Genes>, BackendError> {
        delegate!(self.genes())
    }

    fn download_moments(&mut self) -> Result<Cow<'_, Moments>, BackendError> {
        delegate!(self.download_moments())
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        delegate!(self.render(camera, settings))
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        delegate!(self.train_step(step))
    }

    fn abandon(&mut self) -> Result<usize, BackendError> {
        delegate!(self.abandon())
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        delegate!(self.report())
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        delegate!(self.statistics())
    }

    fn restore_statistics(&mut self, statistics: Statistics) -> Result<(), BackendError> {
        delegate!(self.restore_statistics(statistics))
    }

    fn reset_statistics(&mut self, genes: bool) {
        delegate!(self.reset_statistics(genes));
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        delegate!(self.edit_rows(edit))
    }

    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError> {
        delegate!(self.reset_opacity(ceiling))
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError> {
        delegate!(self.set_filter_3d(filter))
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError> {
        delegate!(self.apply(delta, moments))
    }

    fn remember(&mut self, parent: usize) -> Result<(), BackendError> {
        delegate!(self.remember(parent))
    }

    fn weigh(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Merit>, BackendError> {
        delegate!(self.weigh(views, settings))
    }

    fn credit(
        &mut self,
        mutants: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Credits, BackendError> {
        delegate!(self.credit(mutants, views, settings))
    }

    fn remembered(&self) -> [u32; PARENTS] {
        delegate!(self.remembered())
    }

    fn forget(&mut self) {
        delegate!(self.forget());
    }

    fn lineage(&mut self) -> Result<Cow<'_, Lineage>, BackendError> {
        delegate!(self.lineage())
    }

    fn restore_lineage(&mut self, lineage: Lineage) -> Result<(), BackendError> {
        delegate!(self.restore_lineage(lineage))
    }

    fn judge(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<Judgement>, BackendError> {
        delegate!(self.judge(blends, views, settings))
    }

    fn breed(&mut self, blend: &Blend) -> Result<(), BackendError> {
        delegate!(self.breed(blend))
    }

    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        delegate!(self.score(population, views, settings))
    }
}
