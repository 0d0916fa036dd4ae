//! What is drawn at once of a picture: some of its rows of tiles.

use std::ops::Range;

use super::pinhole::{Pinhole, TILE};

/// Rows of tiles of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Band {
    rows: Range<usize>,
    grid: [usize; 2],
    size_px: [usize; 2],
}

impl Band {
    /// Some rows of tiles of what `camera` sees.
    pub fn new(camera: &Pinhole, rows: Range<usize>) -> Self {
        Self { rows, grid: camera.grid(), size_px: camera.size_px.map(|pixels| pixels as usize) }
    }

    /// All of them.
    pub fn whole(camera: &Pinhole) -> Self {
        Self::new(camera, 0..camera.grid()[1])
    }

    /// Rows of tiles.
    pub fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// Rows of pixels, of which the picture's last tiles may have fewer.
    pub fn pixel_rows(&self) -> Range<usize> {
        let end = |row: usize| self.size_px[1].min(row * TILE);
        end(self.rows.start)..end(self.rows.end)
    }

    /// Tiles across and down the whole picture.
    pub(crate) fn grid(&self) -> [usize; 2] {
        self.grid
    }

    /// How many tiles it has.
    pub fn tiles(&self) -> usize {
        self.rows.len() * self.grid[0]
    }

    /// Width and height of the band, px.
    pub(crate) fn size_px(&self) -> [usize; 2] {
        [self.size_px[0], self.pixel_rows().len()]
    }

    /// Where one of the band's tiles begins in the picture, px.
    pub(crate) fn origin(&self, tile: usize) -> [usize; 2] {
        [tile % self.grid[0] * TILE, (self.rows.start + tile / self.grid[0]) * TILE]
    }
}
