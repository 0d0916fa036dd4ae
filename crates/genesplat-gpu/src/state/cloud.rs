//! The cloud on the device: parameters, moments and what goes with each row.
//!
//! A row's floats lie in two columns, geometry and colour. Where these are larger than a kernel can see at
//! once, kernels run window by window.

use genesplat_core::memory::ensure_memory;
use genesplat_core::{Gaussians, Genes};

use crate::Result;
use crate::device::{Engine, Memory, Part};
use crate::layout::{GEOMETRY_FLOATS, LATE_STEPS_MAX, SH_FLOATS, Window};

/// Instructions of a row whose colours make up for all steps that they may have to: more than any other stage
/// takes.
pub(crate) const ROW_INSTRUCTIONS: u64 = SH_FLOATS as u64 / 4 * MAKE_UP_INSTRUCTIONS + 1_500;
/// Of one vector that makes up for these steps.
pub(crate) const MAKE_UP_INSTRUCTIONS: u64 = 52 * LATE_STEPS_MAX as u64;

/// A window begins at a multiple of this many rows, so that every column is bound at a multiple of 256 bytes.
pub(crate) const WINDOW_STEP: u64 = 64;

/// Rows that kernels see at once.
pub(crate) struct RowWindow {
    pub(crate) first: u64,
    pub(crate) count: u64,
    pub(crate) uniform: Memory,
}

impl RowWindow {
    /// First row and number of rows, as kernels count.
    pub(crate) fn range(&self) -> [u32; 2] {
        [self.first as u32, self.count as u32]
    }
}

/// Cuts `rows` so that the widest column fits a binding, and that no stage takes a weak device too long for
/// what is between; there is always a window.
pub(crate) fn windows(engine: &Engine, rows: u64) -> Result<Vec<RowWindow>> {
    let rows_max = engine.window_rows.min(engine.instructions_max / ROW_INSTRUCTIONS);
    let step = (rows_max / WINDOW_STEP * WINDOW_STEP).max(WINDOW_STEP);
    (0..rows.div_ceil(step).max(1))
        .map(|index| {
            let first = index * step;
            let count = step.min(rows - first);
            let uniform = window_uniform(engine, [first as u32, count as u32], [0; 2])?;
            Ok(RowWindow { first, count, uniform })
        })
        .collect()
}

/// Two ranges of rows, each its first row and their number, for a kernel; the second may be a stage's own two
/// numbers.
pub(crate) fn window_uniform(
    engine: &Engine,
    [first, count]: [u32; 2],
    [source_first, source_count]: [u32; 2],
) -> Result<Memory> {
    engine.upload("row window", &[Window { first, count, source_first, source_count }])
}

pub(crate) struct Column {
    pub(crate) memory: Memory,
    pub(crate) floats: u32,
}

impl Column {
    pub(crate) fn zeros(engine: &Engine, purpose: &'static str, rows: u64, floats: u32) -> Result<Self> {
        Ok(Self { memory: engine.allocate(purpose, 4 * u64::from(floats) * rows)?, floats })
    }

    /// What kernels see of it.
    pub(crate) fn at(&self, window: &RowWindow) -> Part<'_> {
        let bytes = 4 * u64::from(self.floats);
        self.memory.part(window.first * bytes, window.count * bytes)
    }
}

/// One value for each parameter of each row: the cloud itself, a moment, or a mean.
pub(crate) struct Parameters {
    pub(crate) geometry: Column,
    pub(crate) sh: Column,
}

impl Parameters {
    pub(crate) fn zeros(engine: &Engine, purpose: &'static str, rows: u64) -> Result<Self> {
        Ok(Self {
            geometry: Column::zeros(engine, purpose, rows, GEOMETRY_FLOATS)?,
            sh: Column::zeros(engine, purpose, rows, SH_FLOATS)?,
        })
    }

    pub(crate) fn upload(engine: &Engine, purpose: &'static str, values: &Gaussians) -> Result<Self> {
        let parameters = Self::zeros(engine, purpose, values.len() as u64)?;
        engine.write(&parameters.geometry.memory, 0, &pack_geometry(values));
        engine.write(&parameters.sh.memory, 0, &values.sh);
        Ok(parameters)
    }

    /// Copies `rows` rows to the host; `filter` keeps the 3D filter.
    pub(crate) fn download(&self, engine: &Engine, rows: u64, filter: bool) -> Result<Gaussians> {
        // Geometry is there twice for a moment.
        ensure_memory(2 * Gaussians::BYTES_PER_ROW * rows as usize, "the Gaussians of the device")?;
        let mut geometry = bytemuck::zeroed_vec(rows as usize);
        let mut sh = bytemuck::zeroed_vec(rows as usize);
        engine.read([
            (&self.geometry.memory, bytemuck::cast_slice_mut::<GeometryRow, _>(&mut geometry)),
            (&self.sh.memory, bytemuck::cast_slice_mut(&mut sh)),
        ])?;
        Ok(unpack(&geometry, sh, filter))
    }

    pub(crate) fn genes(&self, engine: &Engine, rows: u64) -> Result<Vec<Genes>> {
        let geometry: Vec<GeometryRow> = engine.read_values(&self.geometry.memory, rows)?;
        Ok(geometry.iter().map(|r| [r[0], r[1], r[2], r[4], r[5], r[6], r[3]]).collect())
    }
}

/// Position and opacity logit; log-scales and 3D filter; rotation.
type GeometryRow = [f32; GEOMETRY_FLOATS as usize];

fn pack_geometry(values: &Gaussians) -> Vec<GeometryRow> {
    (0..values.len())
        .map(|row| {
            let ([px, py, pz], [sx, sy, sz]) = (values.positions[row], values.log_scales[row]);
            let [qw, qx, qy, qz] = values.rotations[row];
            let filter = values.filter_3d.as_ref().map_or(0.0, |filter| filter[row]);
            [px, py, pz, values.opacity_logits[row], sx, sy, sz, filter, qw, qx, qy, qz]
        })
        .collect()
}

fn unpack(rows: &[GeometryRow], sh: Vec<[f32; SH_FLOATS as usize]>, filter: bool) -> Gaussians {
    Gaussians {
        positions: rows.iter().map(|r| [r[0], r[1], r[2]]).collect(),
        log_scales: rows.iter().map(|r| [r[4], r[5], r[6]]).collect(),
        rotations: rows.iter().map(|r| [r[8], r[9], r[10], r[11]]).collect(),
        opacity_logits: rows.iter().map(|r| r[3]).collect(),
        sh,
        filter_3d: filter.then(|| rows.iter().map(|r| r[7]).collect()),
    }
}

/// The genes of one row as a kernel reads them: two vectors of a geometry row, without the 3D filter.
pub(crate) fn pack_genes(genes: &Genes) -> [f32; 8] {
    let [px, py, pz, sx, sy, sz, opacity] = *genes;
    [px, py, pz, opacity, sx, sy, sz, 0.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packing_keeps_every_parameter() {
        let mut cloud = Gaussians::zeros(2);
        cloud.positions[1] = [1.0, 2.0, 3.0];
        cloud.log_scales[1] = [4.0, 5.0, 6.0];
        cloud.rotations[1] = [7.0, 8.0, 9.0, 10.0];
        cloud.opacity_logits[1] = 11.0;
        cloud.sh[1][47] = 12.0;
        cloud.filter_3d = Some(vec![0.5, 0.25]);
        assert_eq!(unpack(&pack_geometry(&cloud), cloud.sh.clone(), true), cloud);
    }
}
