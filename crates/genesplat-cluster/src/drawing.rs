//! A picture that all ranks draw together, forward and backward. All here is done by one rank; what it
//! returns as parts is to be exchanged, and what it takes as parts was.

use std::ops::Range;

use genesplat_core::{BackendError, DensitySignal, Image, RenderSettings, TrainStep};
use genesplat_kernels::cpu::stages::{
    Band, LOSS_REACH, Level, SplatGradients, Splats, Wanted, columns_of, loss_of_rows, squared_errors,
};
use genesplat_kernels::cpu::{Pinhole, Target, ViewBuffers};

use crate::bands::Bands;
use crate::gradients::Gradients;
use crate::group::Group;
use crate::picture::{PictureRows, part};
use crate::splats::{Dealt, Received};
use crate::wire::{Reader, Writer};

/// What each rank has sent here, or is to be sent.
pub(crate) type Parts = Vec<Vec<u32>>;

/// A picture, and who draws which band of it.
pub(crate) struct Canvas {
    pub(crate) camera: Pinhole,
    bands: Bands,
    /// The own one.
    band: Band,
    drawers: Range<usize>,
    rank: usize,
    ranks: usize,
}

impl Canvas {
    /// Drawn by some of the ranks; `intersections` are those of each row of tiles, where they are known.
    pub(crate) fn new(camera: Pinhole, intersections: &[u32], drawers: Range<usize>, group: &Group) -> Self {
        let bands = Bands::new(camera.grid(), intersections, &drawers, group.count());
        let (rank, ranks) = (group.rank(), group.count());
        Self { band: Band::new(&camera, bands.of(rank)), camera, bands, drawers, rank, ranks }
    }

    /// Drawn by all.
    pub(crate) fn of_all(camera: Pinhole, intersections: &[u32], group: &Group) -> Self {
        Self::new(camera, intersections, 0..group.count(), group)
    }

    /// The ranks that draw it.
    pub(crate) fn drawers(&self) -> Range<usize> {
        self.drawers.clone()
    }

    /// The splats of the own rows, for the bands of others that they may reach.
    pub(crate) fn deal(&self, splats: &Splats, dealt: &mut Dealt) -> Parts {
        dealt.deal(splats, &self.bands, self.down(), (self.rank, self.ranks))
    }

    fn width(&self) -> usize {
        self.camera.size_px[0] as usize
    }

    fn height(&self) -> usize {
        self.camera.size_px[1] as usize
    }

    fn down(&self) -> usize {
        self.camera.grid()[1]
    }

    /// Rows of pixels of each rank.
    fn pixel_rows(&self) -> Vec<Range<usize>> {
        (0..self.ranks).map(|rank| Band::new(&self.camera, self.bands.of(rank)).pixel_rows()).collect()
    }

    /// The rows that the loss of some rows depends on.
    fn near(&self, rows: &Range<usize>) -> Range<usize> {
        let reach = if rows.is_empty() { 0 } else { LOSS_REACH };
        rows.start.saturating_sub(reach)..(rows.end + reach).min(self.height())
    }
}

/// The working memory of a picture.
#[derive(Default)]
pub(crate) struct Drawing {
    /// The own band.
    pub(crate) band: ViewBuffers,
    received: Received,
    near: PictureRows,
    /// Sums over the own band, row by row.
    sums: Vec<[f64; 2]>,
    /// Of the own splats.
    gradients: Gradients,
    /// Sums over bands for every splat, as a mistake would make them.
    #[cfg(test)]
    pub(crate) sums_by_rank: bool,
}

/// What all bands of a picture add up to.
#[derive(Debug, Default)]
pub(crate) struct PictureTotals {
    /// Sums of the loss `[3, H]`.
    pub(crate) sums: Vec<[f64; 2]>,
    /// Intersections of each row of tiles.
    pub(crate) intersections: Vec<u32>,
    /// Splats of all ranks.
    pub(crate) visible: usize,
}

impl Drawing {
    /// Draws the own band of the picture, of splats that others have sent and `own` ones.
    pub(crate) fn draw(
        &mut self,
        level: Level,
        canvas: &Canvas,
        parts: Parts,
        own: (&Splats, &Dealt),
        settings: &RenderSettings,
    ) -> Result<(), BackendError> {
        self.received.collect(&parts, own, &mut self.band.splats);
        drop(parts);
        self.band.ensure(self.received.count(), canvas.band.tiles())?;
        self.band.draw(level, (&canvas.camera, &canvas.band), settings);
        Ok(())
    }

    /// The own rows, for every rank.
    pub(crate) fn rows_for_all(&self, canvas: &Canvas) -> Parts {
        let (held, all) = (canvas.band.pixel_rows(), 0..canvas.height());
        vec![part(&self.band.image, &held, &all); canvas.ranks]
    }

    /// The whole picture.
    pub(crate) fn whole(&mut self, canvas: &Canvas, parts: &Parts) -> Image {
        let mut whole = PictureRows::default();
        whole.assemble(canvas.width(), 0..canvas.height(), &canvas.pixel_rows(), parts);
        whole.image
    }

    /// The own rows, without what does not count, for the ranks whose loss depends on them.
    pub(crate) fn rows_for_loss(&mut self, canvas: &Canvas, target: &Target) -> Result<Parts, BackendError> {
        let held = canvas.band.pixel_rows();
        self.band.photo.read(target, canvas.near(&held))?;
        target.hide_rows(&mut self.band.image.planes, &held);
        Ok(canvas.pixel_rows().iter().map(|rows| part(&self.band.image, &held, &canvas.near(rows))).collect())
    }

    /// The loss of the own rows; its gradient, if a step wants it, goes to the band.
    pub(crate) fn loss(
        &mut self,
        level: Level,
        canvas: &Canvas,
        target: &Target,
        parts: &Parts,
        step: Option<&TrainStep>,
    ) {
        let rows = canvas.band.pixel_rows();
        self.near.assemble(canvas.width(), canvas.near(&rows), &canvas.pixel_rows(), parts);
        let PictureRows { rows: near, image } = &self.near;
        let ViewBuffers { photo, image_gradient, .. } = &mut self.band;
        let gradient = step.map(|step| Wanted::of(step, image_gradient));
        loss_of_rows(level, (image, near.start), photo, rows.clone(), gradient, &mut self.sums);
        if step.is_some() {
            target.hide_rows(&mut self.band.image_gradient, &rows);
        }
    }

    /// In the place of the loss's gradient: a map `[H, W]` for red, and zeros.
    pub(crate) fn map(&mut self, canvas: &Canvas, map: &[f32]) {
        let (rows, width) = (canvas.band.pixel_rows(), canvas.width());
        let gradient = &mut self.band.image_gradient;
        gradient.clear();
        gradient.extend_from_slice(&map[rows.start * width..rows.end * width]);
        gradient.resize(3 * rows.len() * width, 0.0);
    }

    /// The sums of gradients of each other rank's splats, after the `totals`, which all get.
    pub(crate) fn backward(
        &mut self,
        level: Level,
        canvas: &Canvas,
        totals: impl FnOnce(&Self) -> Writer,
        signal: Option<DensitySignal>,
    ) -> Result<Parts, BackendError> {
        self.band.ensure_gradient_rows()?;
        self.band.draw_backward(level, (&canvas.camera, &canvas.band), signal);
        let top = canvas.band.rows().start;
        #[cfg(test)]
        let top = if self.sums_by_rank { 0 } else { top };
        let totals = totals(self);
        let of_rank = |rank| {
            let mut part = totals.clone();
            if rank != canvas.rank {
                self.received.sums(rank, &self.band, (top, canvas.down()), columns_of(signal), &mut part);
            }
            part.words
        };
        Ok((0..canvas.ranks).map(of_rank).collect())
    }

    /// Takes the gradients of the own splats; each rank's message is read from where it stands.
    pub(crate) fn add(
        &mut self,
        splats: &Splats,
        dealt: &Dealt,
        parts: &mut [Reader<'_>],
        signal: Option<DensitySignal>,
    ) {
        self.gradients.clear(splats.capacity());
        for (rank, part) in parts.iter_mut().enumerate() {
            if dealt.is_own(rank) {
                self.received.add_drawn(dealt, &self.band, &mut self.gradients);
            } else {
                dealt.add(rank, part, columns_of(signal), &self.band, &mut self.gradients);
            }
        }
    }

    /// The gradients that [`Self::add`] took.
    pub(crate) fn gradients(&self) -> impl SplatGradients + '_ {
        self.gradients.of_splats(&self.band)
    }

    /// The own sums of the loss and of squared errors, for all.
    pub(crate) fn measures(&self, canvas: &Canvas) -> Vec<u32> {
        let mut out = Writer::default();
        out.doubles(self.sums.as_flattened());
        out.doubles(&squared_errors(&self.band.image, &self.band.photo, canvas.band.pixel_rows()));
        out.words
    }

    /// Sums of the loss and of squared errors over all rows `[3, H]`.
    pub(crate) fn measured(canvas: &Canvas, parts: &Parts) -> (Vec<[f64; 2]>, Vec<f64>) {
        let values = 3 * canvas.height();
        let (mut sums, mut errors) = (vec![[0.0; 2]; values], vec![0.0; values]);
        for (rows, part) in canvas.pixel_rows().into_iter().zip(parts) {
            let mut input = Reader::new(part);
            read_sums(canvas, &rows, &mut input, &mut sums);
            for channel in 0..3 {
                let of_channel = &mut errors[channel * canvas.height()..][rows.clone()];
                of_channel.iter_mut().zip(input.doubles(rows.len())).for_each(|(error, sum)| *error = sum);
            }
        }
        (sums, errors)
    }
}

impl PictureTotals {
    pub(crate) fn new(canvas: &Canvas) -> Self {
        Self { sums: vec![[0.0; 2]; 3 * canvas.height()], ..Self::default() }
    }

    /// Sums and counts of the own band, and how many own splats each view has.
    pub(crate) fn write(drawing: &Drawing, canvas: &Canvas, visible: &[usize]) -> Writer {
        let mut totals = Writer::default();
        totals.doubles(drawing.sums.as_flattened());
        let starts = drawing.band.bins.tile_starts.iter().step_by(canvas.camera.grid()[0].max(1));
        let starts: Vec<u32> = starts.copied().collect();
        totals.words.extend(starts.windows(2).map(|pair| pair[1] - pair[0]));
        visible.iter().for_each(|&count| totals.count(count));
        totals
    }

    /// Reads what [`Self::write`] wrote on a rank that draws this picture; ranks come in their order.
    pub(crate) fn read(&mut self, canvas: &Canvas, rank: usize, input: &mut Reader<'_>) {
        read_sums(canvas, &canvas.pixel_rows()[rank], input, &mut self.sums);
        self.intersections.extend_from_slice(input.words(canvas.bands.of(rank).len()));
    }
}

/// Sums of some rows, to their places among those of all `[3, H]`.
fn read_sums(canvas: &Canvas, rows: &Range<usize>, input: &mut Reader<'_>, sums: &mut [[f64; 2]]) {
    for channel in 0..3 {
        let of_channel = sums[channel * canvas.height()..][rows.clone()].as_flattened_mut();
        let values = input.doubles(of_channel.len());
        of_channel.iter_mut().zip(values).for_each(|(sum, value)| *sum = value);
    }
}
