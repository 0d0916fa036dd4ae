//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! A pool of individuals is uploaded as [row versions](genesplat_core::row_versions): to a view these are the
//! rows of one large cloud, projected, sorted and listed by tile once for all individuals. A workgroup then
//! makes the pictures of sixteen individuals in one tile: an alpha is evaluated once, and blended for those
//! that hold it.

use genesplat_core::SparseDelta;
use genesplat_core::row_versions::{Holders, RowVersion, pieces_of, row_versions};
use rayon::prelude::*;

use crate::Result;
use crate::device::{Engine, Grid, Memory, Recorder, shaders};
use crate::layout::OWN_GENES;
use crate::stages::lists::Lists;
use crate::stages::pixels::Pixels;
use crate::state::{RowWindow, Settled, Trained, pack_genes, window_uniform};

/// Buffers of the views of a pool, kept from call to call.
pub(crate) struct PoolBuffers {
    /// Tile lists of the row versions.
    pub(crate) lists: Lists,
    /// Pictures and sums of the loss, one layer an individual.
    pub(crate) pixels: Pixels,
}

impl PoolBuffers {
    pub(crate) fn new(engine: &Engine) -> Result<Self> {
        Ok(Self { lists: Lists::new(engine, 4)?, pixels: Pixels::new(engine)? })
    }

    /// Frees everything until it is reserved anew, for what may be fewer individuals.
    pub(crate) fn release(&mut self) {
        self.lists.release();
        self.lists.wanted_capacity = None;
        self.pixels.release();
    }
}

/// Some individuals on the device.
pub(crate) struct Pool {
    pub(crate) individuals: u32,
    pub(crate) versions: u32,
    /// Row of each version, and where its genes are `[K, 2]`; row by row.
    places: Memory,
    /// Genes that are not the cloud's: position, opacity logit; log-scales, nothing.
    genes: Memory,
    /// A bit for each individual `[K, 4]`.
    pub(crate) holders: Memory,
    /// For each window of rows: its rows and their versions, as a kernel reads them, and the number of those
    /// versions.
    windows: Vec<(Memory, u64)>,
}

impl Pool {
    /// The row versions of `individuals`; nothing where they are more than `most`.
    pub(crate) fn upload(
        engine: &Engine,
        cloud: &Trained,
        individuals: &[SparseDelta],
        most: u64,
    ) -> Result<Option<Self>> {
        let pieces: Vec<_> = pieces_of(cloud.rows() as usize).collect();
        let of_piece = |rows| row_versions(individuals, rows);
        let versions: Vec<_> = pieces.into_par_iter().flat_map_iter(of_piece).collect();
        if versions.len() as u64 > most {
            return Ok(None);
        }
        let mut genes = Vec::new();
        let place = |version: &RowVersion| {
            let at = version.genes.map_or(OWN_GENES, |_| genes.len() as u32);
            genes.extend(version.genes.map(pack_genes));
            [version.row, at]
        };
        let places: Vec<[u32; 2]> = versions.iter().map(place).collect();
        let holders: Vec<Holders> = versions.iter().map(|version| version.holders.to_le()).collect();
        let of_window = |window: &RowWindow| {
            let until = |row: u64| versions.partition_point(|version| u64::from(version.row) < row) as u32;
            let [first, end] = [window.first, window.first + window.count].map(until);
            Ok((window_uniform(engine, window.range(), [first, end - first])?, u64::from(end - first)))
        };
        Ok(Some(Self {
            individuals: individuals.len() as u32,
            versions: versions.len() as u32,
            places: engine.upload("rows of row versions", &places)?,
            genes: engine.upload("genes of row versions", &genes)?,
            holders: engine.upload("holders of row versions", &holders)?,
            windows: cloud.windows().iter().map(of_window).collect::<Result<_>>()?,
        }))
    }

    /// Stage `project` of the row versions.
    pub(crate) fn record_project(&self, recorder: &mut Recorder, trained: &Settled, lists: &Lists) {
        recorder.stage("score_project");
        let outputs = [&lists.splats, &lists.depths, &lists.tile_counts].map(Memory::all);
        for (window, (uniform, count)) in trained.windows.iter().zip(&self.windows) {
            let cloud = [trained.cloud.geometry.at(window), trained.cloud.sh.at(window)];
            let inputs = [lists.view.all(), uniform.all()];
            let parts = [&inputs[..], &cloud, &[self.places.all(), self.genes.all()], &outputs].concat();
            recorder.run(&shaders::PROJECT_ROW_VERSIONS, &parts, Grid::Items(*count));
        }
    }
}
