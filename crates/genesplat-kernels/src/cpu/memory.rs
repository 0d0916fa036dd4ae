//! What the verbs of the CPU backend will take, so that they can ask for it before they change anything.
//!
//! These are upper bounds, but for the intersections of a view: how many there are is known once they are
//! listed. A view is taken to have at most twice as many as the one before, and what depends on them most,
//! the gradient rows, is asked for when they are known.

use genesplat_core::memory::ensure_memory;
use genesplat_core::{BackendError, Gaussians, Held, SparseDelta};

use super::backend::CpuBackend;
use super::blend::gradient_row::GradientRow;
use super::score::POOL_BYTES;
use super::view::{Pinhole, TILE, ViewBuffers};

/// Splat, flags, and what stage `bin` keeps of a row: keys twice, a copy by range, counts and places.
const ROW: usize = 128;
/// Blended tile, image and its gradient, and the tile's starts in all parts.
const TILE_BYTES: usize = 40 * TILE * TILE + 1024;
/// Intersection, its place, its copies before they are sorted, and its gradient row.
const INTERSECTION: usize = 32 + size_of::<GradientRow>();
/// Intersections of a row, as long as no view tells.
const PER_ROW: usize = 4;
/// Sums for density control and evolution, and how many steps a row's colour has made.
const STATISTICS: usize = 41;
/// Working pictures of a photo's loss, for each pixel.
const PHOTO_LOSS: usize = 64;
/// A row version, its splat, and its holders.
const VERSION: usize = 64 + ROW + 16;

impl ViewBuffers {
    /// Fails where there is no room to draw so many splats on so many tiles.
    pub fn ensure(&self, rows: usize, tiles: usize) -> Result<(), BackendError> {
        let intersections = (2 * self.bins.intersections.len()).max(PER_ROW * rows);
        let wanted = rows * ROW + tiles * TILE_BYTES + intersections * INTERSECTION;
        ensure_memory(wanted.saturating_sub(self.bytes()), "a view")
    }

    /// Once a view is rendered. A `Vec` that grows takes up to twice what it needs.
    pub fn ensure_gradient_rows(&self) -> Result<(), BackendError> {
        let (wanted, there) = (self.bins.intersections.len(), self.gradient_rows.capacity());
        if wanted <= there {
            return Ok(());
        }
        ensure_memory((2 * wanted).max(2 * there) * size_of::<GradientRow>(), "the gradients of a view")
    }
}

impl CpuBackend {
    fn rows(&self) -> usize {
        self.trained.rows()
    }

    pub(super) fn ensure_view(&self, camera: &Pinhole) -> Result<(), BackendError> {
        self.buffers.ensure(self.rows(), camera.grid().iter().product())
    }

    /// Any of these views, one after the other.
    pub(super) fn ensure_views(&self, views: &[usize]) -> Result<(), BackendError> {
        let tiles = |&view: &usize| self.views[view].camera.grid().iter().product();
        self.buffers.ensure(self.rows(), views.iter().map(tiles).max().unwrap_or(0))
    }

    /// A cloud of so many rows, its moments and statistics, none of which is there.
    pub fn ensure_training(rows: usize) -> Result<(), BackendError> {
        ensure_memory(rows * (2 * Gaussians::BYTES_PER_ROW + STATISTICS), "the moments of the cloud")
    }

    /// A copy of the cloud.
    pub fn ensure_cloud(&self, purpose: &str) -> Result<(), BackendError> {
        ensure_memory(self.rows() * Gaussians::BYTES_PER_ROW, purpose)
    }

    /// The cloud, its moments, and gradients that wait for a step.
    fn clouds_held(&self) -> usize {
        3 + usize::from(self.trained.has_pending())
    }

    /// A mean that has a 3D filter is a copy.
    pub(super) fn ensure_look(&self, held: Held) -> Result<(), BackendError> {
        let is_copy = held == Held::Mean && self.trained.has_filter_3d();
        if is_copy { self.ensure_cloud("a mean") } else { Ok(()) }
    }

    /// A copy of all that is held but the views.
    pub(super) fn ensure_state(&self) -> Result<(), BackendError> {
        let clouds = self.clouds_held() + usize::from(self.mean.states() > 0);
        ensure_memory(self.rows() * (clouds * Gaussians::BYTES_PER_ROW + STATISTICS), "a checkpoint")
    }

    pub(super) fn ensure_statistics(&self) -> Result<(), BackendError> {
        ensure_memory(self.rows() * STATISTICS, "statistics")
    }

    /// As many new rows; columns are made one after the other, and one exists twice.
    pub fn ensure_rows(&self, rows: usize) -> Result<(), BackendError> {
        let (more, clouds) = (rows.saturating_sub(self.rows()), self.clouds_held());
        ensure_memory(
            more * clouds * Gaussians::BYTES_PER_ROW + rows * (Gaussians::BYTES_PER_ROW + STATISTICS),
            "a larger cloud",
        )
    }

    /// A weight of each row in so many views.
    pub(super) fn ensure_weights(&self, views: usize) -> Result<(), BackendError> {
        ensure_memory(self.rows() * views * size_of::<f32>(), "weights of views")
    }

    /// Pools of at most so many individuals, differences from so many rows, two views at a time, and the
    /// photos that are scored for the first time.
    pub(super) fn ensure_scores(
        &self,
        rows: usize,
        population: &[SparseDelta],
        views: &[usize],
    ) -> Result<(), BackendError> {
        let pixels = |&view: &usize| self.views[view].camera.grid().iter().product::<usize>() * TILE * TILE;
        let (most, all) =
            (views.iter().map(pixels).max().unwrap_or(0), views.iter().map(pixels).sum::<usize>());
        let pictures = most * 3 * size_of::<f32>() * population.len();
        let versions = rows + population.iter().map(|delta| delta.rows.len()).sum::<usize>();
        let buffers = 2 * (pictures.min(POOL_BYTES) + versions * (VERSION + PER_ROW * INTERSECTION));
        let wanted = buffers + all * PHOTO_LOSS + versions * VERSION;
        ensure_memory(wanted.saturating_sub(self.scorer.bytes()), "a population")
    }
}
