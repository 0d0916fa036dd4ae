//! The splats of a view: what stage `project` writes and all later stages read.

use genesplat_core::Splat;

use crate::cpu::bytes_of;

/// Rows that one task projects and updates. A constant, so that results do not depend on the number of
/// threads.
pub const CHUNK: usize = 256;

/// The splats of a view: each chunk of rows has as many slots as rows, and its splats fill the first of them,
/// in row order. A splat's index is its slot.
#[derive(Clone, Debug, Default)]
pub struct Splats {
    /// One slot a row `[N]`.
    pub(super) slots: Vec<Splat>,
    pub(super) counts: Vec<u32>,
    /// A row's 3-sigma square meets a tile: what 3DGS's densification average counts `[N]`.
    pub(super) seen: Vec<bool>,
}

impl Splats {
    /// The splat of an index.
    #[inline(always)]
    pub fn get(&self, index: u32) -> &Splat {
        &self.slots[index as usize]
    }

    /// All splats with their indices, in row order.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &Splat)> {
        self.slots.chunks(CHUNK).zip(&self.counts).enumerate().flat_map(|(chunk, (slots, &count))| {
            let first = (chunk * CHUNK) as u32;
            slots[..count as usize].iter().enumerate().map(move |(k, splat)| (first + k as u32, splat))
        })
    }

    /// The splats of one chunk of rows; the first one's index is `chunk * CHUNK`.
    pub fn chunk(&self, chunk: usize) -> &[Splat] {
        &self.slots[chunk * CHUNK..][..self.counts[chunk] as usize]
    }

    /// Geometric visibility of the rows of one chunk.
    pub fn seen(&self, chunk: usize) -> &[bool] {
        &self.seen[chunk * CHUNK..self.seen.len().min((chunk + 1) * CHUNK)]
    }

    /// How many splats there are.
    pub fn len(&self) -> usize {
        self.counts.iter().map(|&count| count as usize).sum()
    }

    /// True where no Gaussian has a splat.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Above every index.
    pub fn capacity(&self) -> usize {
        self.slots.len()
    }

    /// Memory that they take.
    pub fn bytes(&self) -> usize {
        bytes_of(&self.slots) + bytes_of(&self.counts) + bytes_of(&self.seen)
    }

    /// Drops those that are not to be kept.
    pub fn retain(&mut self, keep: impl Fn(&Splat) -> bool) {
        for (slots, count) in self.slots.chunks_mut(CHUNK).zip(&mut self.counts) {
            let mut kept = 0;
            for slot in 0..*count as usize {
                if keep(&slots[slot]) {
                    slots[kept] = slots[slot];
                    kept += 1;
                }
            }
            *count = kept as u32;
        }
    }

    /// Gives each the colour of its row, as it is `[N, 3]`.
    pub fn recolour(&mut self, rgb: &[[f32; 3]]) {
        for (slots, &count) in self.slots.chunks_mut(CHUNK).zip(&self.counts) {
            for splat in &mut slots[..count as usize] {
                (splat.rgb, splat.clamped) = (rgb[splat.row as usize], 0);
            }
        }
    }

    /// Makes room for others.
    pub fn clear(&mut self) {
        self.slots.clear();
        self.counts.clear();
        self.seen.clear();
    }

    /// Appends splats to ones that were appended.
    pub fn extend(&mut self, splats: impl Iterator<Item = Splat>) {
        self.slots.extend(splats);
        self.counts.resize(self.slots.len().div_ceil(CHUNK), 0);
        let last = self.slots.len() % CHUNK;
        self.counts.fill(CHUNK as u32);
        if let Some(count) = self.counts.last_mut().filter(|_| last > 0) {
            *count = last as u32;
        }
    }

    /// Makes slots for `rows` rows.
    pub(super) fn resize(&mut self, rows: usize) {
        self.slots.resize(rows, Splat::default());
        self.counts.resize(rows.div_ceil(CHUNK), 0);
    }
}
