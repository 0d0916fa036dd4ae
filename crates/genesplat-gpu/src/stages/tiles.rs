//! Kernels that have a workgroup a tile. A long dispatch is cut into bands of tile rows: a driver may take
//! for a hang what keeps a weak device for two seconds.
//!
//! How long it takes is predicted from the pixels, and from the intersections that the lists have room for,
//! spread evenly over the rows of tiles. What a tile gets does not depend on the band that it is in.

use crate::Result;
use crate::device::recorder::{INVOCATION, Recorder};
use crate::device::shaders::{self, Shader};
use crate::device::{Engine, Grid, Memory, Part};
use crate::layout::{SLOTS, TILE, ViewPass};
use crate::stages::lists::Lists;

/// Where the number of a tile row lies behind that of the row before it, bytes: a multiple of what every
/// device can bind at.
const ROW_STEP: usize = 256;

/// A kernel over the tiles of a view, in so many layers.
pub(crate) struct TileKernel<'a> {
    pub(crate) shader: &'static Shader,
    pub(crate) overrides: &'a [(&'static str, u32)],
    pub(crate) layers: u32,
    /// Instructions for each intersection of the lists, all invocations together.
    pub(crate) for_intersection: u64,
}

impl TileKernel<'_> {
    /// Of one layer, without constants.
    pub(crate) const fn new(shader: &'static Shader) -> Self {
        Self { shader, overrides: &[], layers: 1, for_intersection: 0 }
    }
}

/// What `lab/performance.md` counts in warps, rounded up: a splat reaches half of a tile's blocks.
pub(crate) const RASTERISE: TileKernel<'static> =
    TileKernel { for_intersection: 5_000, ..TileKernel::new(&shaders::RASTERISE) };
pub(crate) const RASTERISE_BACKWARD: TileKernel<'static> =
    TileKernel { for_intersection: 10_000, ..TileKernel::new(&shaders::RASTERISE_BACKWARD) };

/// Sixteen individuals a layer: half of the pixels of a tile take its whole loop.
pub(crate) fn rasterise_individuals(individuals: u32) -> TileKernel<'static> {
    let layers = individuals.div_ceil(SLOTS);
    TileKernel {
        layers,
        for_intersection: 40_000 * u64::from(layers),
        ..TileKernel::new(&shaders::RASTERISE_INDIVIDUALS)
    }
}

/// The numbers of tile rows, from which each band takes its first: a table that only a taller view changes.
pub(crate) fn reserve_first_rows(engine: &Engine, table: &mut Memory, view: &ViewPass) -> Result<()> {
    let bytes = (ROW_STEP * view.tiles_y as usize) as u64;
    if table.bytes < bytes {
        engine.reserve(table, bytes)?;
        let numbers: Vec<[u32; ROW_STEP / 4]> =
            (0..view.tiles_y).map(|row| std::array::from_fn(|at| if at == 0 { row } else { 0 })).collect();
        engine.write(table, 0, &numbers);
    }
    Ok(())
}

/// Tile rows of a band where all of them take so many instructions, and a dispatch may take `most`.
fn rows_of_band(tiles_y: u32, instructions: u64, most: u64) -> u32 {
    let bands = instructions.div_ceil(most.max(1)).max(1);
    u64::from(tiles_y).div_ceil(bands) as u32
}

impl Lists {
    /// A number below that of tile rows, as a kernel reads it.
    pub(super) fn number(&self, number: u32) -> Part<'_> {
        self.first_tile_rows.part(u64::from(number) * ROW_STEP as u64, 16)
    }

    /// Runs a kernel on all tiles; `parts` are its bindings, to which the number of the first tile row is
    /// added.
    pub(crate) fn run_tiles(
        &self,
        recorder: &mut Recorder,
        view: &ViewPass,
        kernel: TileKernel,
        parts: &[&Memory],
    ) {
        let TileKernel { shader, overrides, layers, for_intersection } = kernel;
        let pixels = view.tiles() * u64::from(TILE * TILE * layers);
        let instructions = INVOCATION * pixels + for_intersection * self.capacity;
        let rows = rows_of_band(view.tiles_y, instructions, recorder.instructions_max());
        let parts: Vec<Part> = parts.iter().map(|memory| memory.all()).collect();
        for first in (0..view.tiles_y).step_by(rows as usize) {
            let count = rows.min(view.tiles_y - first);
            let first_row = self.number(first);
            let grid = Grid::Exact([view.tiles_x, count, layers]);
            let share = instructions * u64::from(count) / u64::from(view.tiles_y);
            recorder.run_long(shader, overrides, &[&parts[..], &[first_row]].concat(), grid, share);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::rows_of_band;

    #[test]
    fn bands_are_as_long_as_they_may_be() {
        assert_eq!(rows_of_band(68, 100, 100), 68);
        assert_eq!(rows_of_band(68, 101, 100), 34);
        assert_eq!(rows_of_band(68, 950, 100), 7);
        assert_eq!(
            [rows_of_band(68, u64::MAX, 1), rows_of_band(1, 101, 100), rows_of_band(5, 0, 100)],
            [1, 1, 5]
        );
    }
}
