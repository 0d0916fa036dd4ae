//! A picture with its derivatives: what trainers of others differentiate through.
//!
//! [`CpuBackend`](super::CpuBackend) knows one loss and steps by itself. Here the caller has both: it gets
//! picture and transmittance, and hands back what its loss makes of each pixel.

use fearless_simd::Level;
use genesplat_core::gaussians::sigmoid;
use genesplat_core::memory::ensure_memory;
use genesplat_core::{BackendError, DensitySignal, Gaussians, RenderSettings, Splat, SplatSums};
use rayon::prelude::*;

use super::blend::gradient_row::{GradientRow, column};
use super::blend::rasterise::transmittance;
use super::update::{BySplat, ByTile, PoseGradient, Share, SplatGradients, UpdateInputs, gradients};
use super::view::project::project;
use super::view::{Band, CHUNK, Pinhole, Splats, ViewBuffers};

/// What of the sums strategies of others ask for.
const SIGNAL: Option<DensitySignal> = Some(DensitySignal::Absolute);

/// A cloud as one camera sees it.
pub struct DifferentiableView {
    level: Level,
    cloud: Gaussians,
    camera: Pinhole,
    settings: RenderSettings,
    buffers: ViewBuffers,
    transmittance: Vec<f32>,
}

/// Gradients of a loss; rows without a splat have none.
pub struct ViewGradients {
    /// By raw parameters `[N]`.
    pub cloud: Gaussians,
    /// By what is between them and the picture `[N]`.
    pub screen: Vec<ScreenGradient>,
    /// By the camera.
    pub pose: PoseGradient,
}

/// Gradients of a loss by what a splat is on the screen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScreenGradient {
    /// By its mean, px.
    pub mean_px: [f32; 2],
    /// The same with absolute values at each pixel (gsplat's "absgrad").
    pub absolute_mean_px: [f32; 2],
    /// By its colour.
    pub rgb: [f32; 3],
    /// By the opacity of its Gaussian, after the sigmoid.
    pub opacity: f32,
}

impl DifferentiableView {
    /// Projects a cloud. Colours are `rgb` `[N, 3]`, as they are, or those of the cloud, which are not to be
    /// read, nor their gradients, where there are others. The background is black: the caller has the
    /// transmittance, and puts behind it what it wants.
    pub fn project(
        cloud: Gaussians,
        rgb: Option<&[[f32; 3]]>,
        camera: Pinhole,
        settings: RenderSettings,
    ) -> Result<Self, BackendError> {
        // A colour that is given depends on no direction.
        let sh_degree = if rgb.is_some() { 0 } else { settings.sh_degree };
        let settings = RenderSettings { background: [0.0; 3], sh_degree, ..settings };
        let (level, mut buffers) = (Level::new(), ViewBuffers::default());
        buffers.ensure(cloud.len(), camera.grid().iter().product())?;
        project(level, &cloud, &camera, &settings, &mut buffers.splats);
        if let Some(rgb) = rgb {
            buffers.splats.recolour(rgb);
        }
        Ok(Self { level, cloud, camera, settings, buffers, transmittance: Vec::new() })
    }

    /// Drops splats that are not to be drawn.
    pub fn retain(&mut self, keep: impl Fn(&Splat) -> bool) {
        self.buffers.splats.retain(keep);
    }

    /// What is drawn.
    pub fn splats(&self) -> &Splats {
        &self.buffers.splats
    }

    /// The picture `[3, H, W]`, and how much of the light behind all splats reaches each pixel `[H, W]`.
    pub fn draw(&mut self) -> (&[f32], &[f32]) {
        let band = Band::whole(&self.camera);
        self.buffers.draw(self.level, (&self.camera, &band), &self.settings);
        self.transmittance = transmittance(&self.buffers.tiles, &band);
        (&self.buffers.image.planes, &self.transmittance)
    }

    /// From a loss's gradients by the picture `[3, H, W]` and by the transmittance `[H, W]`, both as
    /// [`Self::draw`] returned them, to those by all else.
    pub fn backward(
        &mut self,
        by_image: &[f32],
        by_transmittance: &[f32],
    ) -> Result<ViewGradients, BackendError> {
        let Self { level, camera, buffers, transmittance, .. } = self;
        buffers.ensure_gradient_rows()?;
        buffers.image_gradient.clear();
        buffers.image_gradient.extend_from_slice(by_image);
        let terms = transmittance.iter().zip(by_transmittance).map(|(left, gradient)| left * gradient);
        buffers.transmittance_term.clear();
        buffers.transmittance_term.extend(terms);
        buffers.draw_backward(*level, (camera, &Band::whole(camera)), SIGNAL);
        self.gradients(|buffers| ByTile { bins: &buffers.bins, rows: &buffers.gradient_rows })
    }

    /// The same from what another device, which has drawn [`Self::splats`], has summed of each of them.
    pub fn backward_from(&mut self, sums: &[SplatSums]) -> Result<ViewGradients, BackendError> {
        ensure_memory(self.splats().capacity() * size_of::<GradientRow>(), "gradients of splats")?;
        self.gradients(|buffers| BySplat::new(&buffers.splats, sums))
    }

    fn gradients<'a, G: SplatGradients>(
        &'a mut self,
        sums_of: impl FnOnce(&'a ViewBuffers) -> G,
    ) -> Result<ViewGradients, BackendError> {
        let Self { level, cloud, camera, settings, buffers, .. } = self;
        ensure_memory(cloud.len() * (Gaussians::BYTES_PER_ROW + size_of::<ScreenGradient>()), "gradients")?;
        let (splats, sums) = (&buffers.splats, sums_of(buffers));
        let screen = screen_gradients(splats, &sums, &cloud.opacity_logits);
        let share = Share::whole(cloud.len());
        let inputs = UpdateInputs { splats, gradients: sums, camera, settings, is_masked: false, share };
        let (cloud, _, pose) = gradients(*level, &inputs, cloud, SIGNAL);
        Ok(ViewGradients { cloud, screen, pose })
    }
}

/// By row; zeros for rows without a splat.
fn screen_gradients(splats: &Splats, sums: &impl SplatGradients, logits: &[f32]) -> Vec<ScreenGradient> {
    let mut out = vec![ScreenGradient::default(); logits.len()];
    out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
        let first = chunk * CHUNK;
        for (index, splat) in (first..).zip(splats.chunk(chunk)) {
            let row = splat.row as usize;
            out[row - first] = screen_gradient(splat, &sums.sum(index).0, sigmoid(logits[row]));
        }
    });
    out
}

fn screen_gradient(splat: &Splat, sums: &[f32; 16], opacity: f32) -> ScreenGradient {
    let [a, b, c] = splat.conic_log2.map(|value| value * -std::f32::consts::LN_2);
    let (x, y) = (sums[column::X], sums[column::Y]);
    ScreenGradient {
        mean_px: [2.0 * a * x + b * y, b * x + 2.0 * c * y],
        absolute_mean_px: [sums[column::ABS_X], sums[column::ABS_Y]],
        rgb: [sums[column::RED], sums[column::GREEN], sums[column::BLUE]],
        // What is blended is a multiple of it, by the filters.
        opacity: sums[column::ONE] / opacity,
    }
}
