//! [`Backend`] for the CPU.

use std::borrow::Cow;

use fearless_simd::Level;
use genesplat_core::gaussians::limited_opacity;
use genesplat_core::lineage::PARENTS;
use genesplat_core::{
    Backend, BackendError, Blend, Camera, Credits, DensitySignal, Gaussians, Image, Judgement, Lineage,
    Merit, Moments, RenderSettings, Rng, RowEdit, SparseDelta, Statistics, StatisticsRequest, TrainStep,
    View, backend::MomentPolicy, backend::StepReport,
};

use super::credit::{Mutants, credit};
use super::frame::{Frame, StageSeconds, timed};
use super::loss::{Target, loss};
use super::project::Pinhole;
use super::rasterise_backward::Extra;
use super::score::Scorer;
use super::update::{Inputs, update};
use super::weigh::weigh;

struct TrainView {
    camera: Pinhole,
    target: Target,
}

/// A cloud in main memory, trained by all threads of the ambient rayon pool.
pub struct CpuBackend {
    level: Level,
    rng: Rng,
    cloud: Gaussians,
    moments: Moments,
    statistics: Statistics,
    views: Vec<TrainView>,
    frame: Frame,
    report: StepReport,
    steps: u32,
    scorer: Scorer,
    lineage: Lineage,
    /// Room for a child of the lineage.
    child: Gaussians,
}

impl CpuBackend {
    /// An empty backend; `seed` is that of the run (split children and exploration are drawn from it).
    pub fn new(seed: u64) -> Self {
        Self {
            level: Level::new(),
            rng: Rng::new(seed),
            cloud: Gaussians::default(),
            moments: Moments::default(),
            statistics: Statistics::default(),
            views: Vec::new(),
            frame: Frame::default(),
            report: StepReport::default(),
            steps: 0,
            scorer: Scorer::default(),
            lineage: Lineage::default(),
            child: Gaussians::default(),
        }
    }

    /// Time spent in each stage since the last call.
    pub fn take_stage_seconds(&mut self) -> StageSeconds {
        std::mem::take(&mut self.frame.seconds)
    }

    /// Eq. 5 of the cloud on one training view, rendered in full: the plain way, which scoring is measured against.
    pub fn loss_of_view(&mut self, view: usize, settings: &RenderSettings) -> f32 {
        let TrainView { camera, target } = &self.views[view];
        self.frame.render(self.level, &self.cloud, camera, settings);
        loss(self.level, &self.frame.image, target, None)
    }

    /// Bytes of memory that scoring has taken at most since the views were set or the last step was made, beside the cloud, the photos and the individuals.
    pub fn scoring_bytes(&self) -> usize {
        self.scorer.bytes()
    }

    fn reset_density(&mut self) {
        let n = self.cloud.len();
        for column in [&mut self.statistics.gradient_sum, &mut self.statistics.weight_sum] {
            column.clear();
            column.resize(n, 0.0);
        }
        self.statistics.absolute_sum.clear();
    }

    /// Genes columns and the absolute one exist from the first step that asks for them.
    fn grow_statistics(&mut self, request: StatisticsRequest) {
        let n = self.cloud.len();
        self.statistics.gradient_sum.resize(n, 0.0);
        self.statistics.weight_sum.resize(n, 0.0);
        if request.density == Some(DensitySignal::SignedAndAbsolute) {
            self.statistics.absolute_sum.resize(n, 0.0);
        }
        if request.genes {
            self.statistics.gene_gradient_sum.resize(n, [0.0; 7]);
            self.statistics.gene_views.resize(n, 0);
        }
    }

    fn non_finite(&self) -> BackendError {
        BackendError::diverged(&self.cloud, self.steps)
    }
}

/// In plain words, `AVX2` say: the name of the variant, without what it holds.
fn instruction_set(level: Level) -> String {
    let variant = format!("{level:?}");
    variant.split('(').next().unwrap_or_default().replace('_', ".").to_uppercase()
}

/// Mean of `(I − P)²` over all values, summed row by row of a channel: the order does not depend on the machine.
fn squared_error(image: &Image, target: &Target) -> f32 {
    let rows = image.planes.chunks(target.width).zip(target.planes.chunks(target.width));
    let of_row = |(image, photo): (&[f32], &[u8])| {
        let square = |(&value, &level): (&f32, &u8)| (value - f32::from(level) * (1.0 / 255.0)).powi(2);
        f64::from(image.iter().zip(photo).map(square).sum::<f32>())
    };
    (rows.map(of_row).sum::<f64>() / target.planes.len() as f64) as f32
}

fn extra(signal: Option<DensitySignal>) -> Extra {
    match signal {
        Some(DensitySignal::Absolute | DensitySignal::SignedAndAbsolute) => Extra::Absolute,
        Some(DensitySignal::PixelWeighted { .. }) => Extra::Pixels,
        Some(DensitySignal::Signed) | None => Extra::None,
    }
}

impl Backend for CpuBackend {
    fn describe(&self) -> String {
        format!("CPU, {} threads, {}", rayon::current_num_threads(), instruction_set(self.level))
    }

    fn len(&self) -> usize {
        self.cloud.len()
    }

    fn set_views(&mut self, views: &[View]) -> Result<(), BackendError> {
        self.scorer = Scorer::default();
        self.views = views
            .iter()
            .map(|view| TrainView {
                camera: Pinhole::from(&view.camera),
                target: Target::from(view.photo.as_ref()),
            })
            .collect();
        Ok(())
    }

    fn upload(&mut self, cloud: Gaussians, moments: Option<Moments>) -> Result<(), BackendError> {
        self.moments = moments.unwrap_or_else(|| Moments::zeros(cloud.len()));
        self.cloud = cloud;
        self.forget();
        self.statistics = Statistics::default();
        self.reset_density();
        Ok(())
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        Ok(Cow::Borrowed(&self.cloud))
    }

    fn download_moments(&mut self) -> Result<Cow<'_, Moments>, BackendError> {
        Ok(Cow::Borrowed(&self.moments))
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        self.frame.render(self.level, &self.cloud, &Pinhole::from(camera), settings);
        Ok(self.frame.image.clone())
    }

    fn train_step(&mut self, step: &TrainStep) -> Result<(), BackendError> {
        // Training has no use for the room that scoring and breeding take.
        (self.scorer, self.child) = (Scorer::default(), Gaussians::default());
        self.grow_statistics(step.statistics);
        let view = &self.views[step.view];
        let (camera, settings) = (view.camera, step.settings);
        self.frame.render(self.level, &self.cloud, &camera, &settings);
        let loss = self.frame.backward(self.level, &camera, &view.target, extra(step.statistics.density));
        if !loss.is_finite() {
            return Err(self.non_finite());
        }
        let Frame { splats, bins, rows, seconds, .. } = &mut self.frame;
        let inputs = Inputs { splats, bins, rows, camera: &camera, settings: &settings };
        timed(&mut seconds.update, || {
            let (cloud, moments) = (&mut self.cloud, &mut self.moments);
            update(
                self.level,
                &inputs,
                cloud,
                moments,
                &mut self.statistics,
                step.statistics,
                step.update.as_ref(),
                &self.rng,
            );
        });
        self.steps = step.update.as_ref().map_or(self.steps, |update| update.step);
        self.report = StepReport { loss, visible: splats.len(), tile_splats: bins.entries.len() };
        Ok(())
    }

    /// A step is done when it returns.
    fn abandon(&mut self) -> Result<usize, BackendError> {
        Ok(0)
    }

    fn report(&mut self) -> Result<StepReport, BackendError> {
        Ok(self.report)
    }

    fn statistics(&mut self) -> Result<Statistics, BackendError> {
        Ok(self.statistics.clone())
    }

    fn restore_statistics(&mut self, statistics: Statistics) -> Result<(), BackendError> {
        self.statistics = statistics;
        Ok(())
    }

    fn reset_statistics(&mut self, genes: bool) {
        self.reset_density();
        if genes {
            self.statistics.gene_gradient_sum.clear();
            self.statistics.gene_views.clear();
        }
    }

    fn edit_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        self.forget();
        edit.apply(&mut self.cloud, &mut self.moments, &self.rng);
        if !self.statistics.gene_views.is_empty() {
            self.statistics.gene_gradient_sum = edit.gather(&self.statistics.gene_gradient_sum);
            self.statistics.gene_views = edit.gather(&self.statistics.gene_views);
        }
        self.reset_density();
        Ok(())
    }

    fn reset_opacity(&mut self, ceiling: f32) -> Result<(), BackendError> {
        self.forget();
        for row in 0..self.cloud.len() {
            let dimming = self.cloud.filter_dimming(row);
            let logit = &mut self.cloud.opacity_logits[row];
            *logit = limited_opacity(*logit, dimming, ceiling);
        }
        self.moments.first.opacity_logits.fill(0.0);
        self.moments.second.opacity_logits.fill(0.0);
        Ok(())
    }

    fn set_filter_3d(&mut self, filter: Vec<f32>) -> Result<(), BackendError> {
        self.cloud.filter_3d = Some(filter);
        Ok(())
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError> {
        self.cloud.apply(delta);
        if moments == MomentPolicy::Zero {
            for moment in [&mut self.moments.first, &mut self.moments.second] {
                for &row in &delta.rows {
                    moment.set_genes(row as usize, &[0.0; 7]);
                }
            }
        }
        Ok(())
    }

    fn remember(&mut self, parent: usize) -> Result<(), BackendError> {
        self.lineage.add(parent, &self.cloud);
        Ok(())
    }

    fn weigh(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Merit>, BackendError> {
        let mut merits = vec![Merit::default(); self.cloud.len()];
        for &view in views {
            let TrainView { camera, target } = &self.views[view];
            weigh(self.level, &mut self.frame, &self.cloud, (camera, target), settings, &mut merits);
        }
        Ok(merits)
    }

    fn credit(
        &mut self,
        mutants: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Credits, BackendError> {
        let mut credits = Credits::zeros(mutants.len(), self.cloud.len());
        let mut mutants = Mutants::new(&self.cloud, mutants);
        for &view in views {
            let TrainView { camera, target } = &self.views[view];
            credit(self.level, &mut self.frame, &mut mutants, (camera, target), settings, &mut credits);
        }
        Ok(credits)
    }

    fn remembered(&self) -> [u32; PARENTS] {
        self.lineage.states()
    }

    fn forget(&mut self) {
        self.lineage = Lineage::default();
    }

    fn lineage(&mut self) -> Result<Cow<'_, Lineage>, BackendError> {
        Ok(Cow::Borrowed(&self.lineage))
    }

    fn restore_lineage(&mut self, lineage: Lineage) -> Result<(), BackendError> {
        self.lineage = lineage;
        Ok(())
    }

    fn judge(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<Judgement>, BackendError> {
        let mut judgements = Vec::with_capacity(blends.len() * views.len());
        for blend in blends {
            // The cloud itself needs no copy.
            let judged = if *blend == Blend::default() {
                &self.cloud
            } else {
                self.lineage.breed(&self.cloud, blend, &mut self.child);
                &self.child
            };
            for &view in views {
                let TrainView { camera, target } = &self.views[view];
                self.frame.render(self.level, judged, camera, settings);
                let loss = loss(self.level, &self.frame.image, target, None);
                judgements.push(Judgement { loss, squared_error: squared_error(&self.frame.image, target) });
            }
        }
        Ok(judgements)
    }

    fn breed(&mut self, blend: &Blend) -> Result<(), BackendError> {
        self.lineage.breed(&self.cloud, blend, &mut self.child);
        std::mem::swap(&mut self.cloud, &mut self.child);
        self.forget();
        Ok(())
    }

    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        let of_view = |view: usize| (self.views[view].camera, &self.views[view].target);
        Ok(self.scorer.score(self.level, &self.cloud, population, views, of_view, settings))
    }
}
