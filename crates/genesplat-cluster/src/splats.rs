//! Splats on their way to the bands that they may reach, and sums of their gradients on the way back. Those
//! that are drawn where they are held go nowhere.

use std::ops::Range;

use genesplat_kernels::cpu::ViewBuffers;
use genesplat_kernels::cpu::stages::{GradientRow, Splat, Splats, tile_rows};

use crate::bands::Bands;
use crate::gradients::Gradients;
use crate::wire::{Reader, Writer};

/// What blending needs of a splat, 48 bytes.
type SentSplat = [f32; 12];

/// Splats whose gradient rows are asked for ahead of the one that is summed: they lie scattered.
const AHEAD: usize = 16;

/// Which splats each rank draws, by index.
#[derive(Debug, Default)]
pub(crate) struct Dealt {
    own: usize,
    indices: Vec<Vec<u32>>,
}

impl Dealt {
    /// The splats for each other rank than the `own` one, in row order, for a picture of `down` rows of
    /// tiles.
    pub(crate) fn deal(
        &mut self,
        splats: &Splats,
        bands: &Bands,
        down: usize,
        (own, ranks): (usize, usize),
    ) -> Vec<Vec<u32>> {
        self.own = own;
        self.indices.resize_with(ranks, Vec::new);
        self.indices.iter_mut().for_each(Vec::clear);
        let mut parts = vec![Writer::default(); ranks];
        for (index, splat) in splats.iter() {
            for rank in bands.reached(&tile_rows(splat, down)) {
                self.indices[rank].push(index);
                if rank != own {
                    parts[rank].rows(&[written(splat)]);
                }
            }
        }
        parts.into_iter().map(|part| part.words).collect()
    }

    /// Of this rank nothing is sent.
    pub(crate) fn is_own(&self, rank: usize) -> bool {
        rank == self.own
    }

    /// Those that are drawn here.
    fn own(&self) -> &[u32] {
        &self.indices[self.own]
    }

    /// Adds what `rank` has summed for the splats that it was sent. Bands lie in the order of the ranks, so a
    /// splat's tiles are added in their order where ranks come in theirs.
    pub(crate) fn add(
        &self,
        rank: usize,
        input: &mut Reader<'_>,
        columns: &[usize],
        band: &ViewBuffers,
        gradients: &mut Gradients,
    ) {
        for &index in &self.indices[rank] {
            let rows = input.words(1)[0];
            for _ in 0..rows {
                let mut row = GradientRow::default();
                columns
                    .iter()
                    .zip(input.rows::<f32>(columns.len()))
                    .for_each(|(&column, &value)| row.0[column] = value);
                gradients.sum_mut(index, band).add(&row);
            }
        }
    }
}

/// The splats that a band is drawn of.
#[derive(Debug, Default)]
pub(crate) struct Received {
    /// Index of the first one of each rank; one more at the end.
    starts: Vec<usize>,
    own: usize,
}

impl Received {
    /// Makes what others have sent and the `own` ones the splats of a view: ranks hold rows in order, so ties
    /// of depth break as they do in one process.
    pub(crate) fn collect(
        &mut self,
        parts: &[Vec<u32>],
        (own, dealt): (&Splats, &Dealt),
        splats: &mut Splats,
    ) {
        let of_others = |part: &Vec<u32>| size_of_val(part.as_slice()) / size_of::<SentSplat>();
        self.own = dealt.own;
        self.starts.clear();
        self.starts.push(0);
        splats.clear();
        for (rank, part) in parts.iter().enumerate() {
            if rank == dealt.own {
                splats.extend(dealt.own().iter().map(|&index| *own.get(index)));
            } else {
                splats.extend(Reader::new(part).rows::<SentSplat>(of_others(part)).iter().map(read));
            }
            self.starts.push(splats.len());
        }
    }

    pub(crate) fn count(&self) -> usize {
        self.starts.last().copied().unwrap_or(0)
    }

    fn of(&self, rank: usize) -> Range<usize> {
        self.starts[rank]..self.starts[rank + 1]
    }

    /// Adds the rows of the own splats that were drawn here.
    pub(crate) fn add_drawn(&self, dealt: &Dealt, band: &ViewBuffers, gradients: &mut Gradients) {
        for (drawn, &splat) in self.of(self.own).zip(dealt.own()) {
            gradients.add_drawn(splat, drawn, band);
        }
    }

    /// What goes back to another rank: for each of its splats how many rows, and the rows.
    ///
    /// A sum of tiles may begin here where no tile comes before: the one row of a splat whose first tiles are
    /// in this band is their sum. Of any other all tiles have a row, since sums of floats depend on where
    /// they begin. The band begins at row `top` of the `down` rows of tiles.
    pub(crate) fn sums(
        &self,
        rank: usize,
        band: &ViewBuffers,
        (top, down): (usize, usize),
        columns: &[usize],
        out: &mut Writer,
    ) {
        for index in self.of(rank) {
            band.prefetch_gradient_rows(index + AHEAD);
            let rows = band.gradient_rows_of(index);
            let begins_here = tile_rows(band.splats.get(index as u32), down).start >= top;
            if begins_here && rows.len() > 0 {
                let mut sum = GradientRow::default();
                rows.for_each(|row| sum.add(row));
                write_rows([&sum].into_iter(), columns, out);
            } else {
                write_rows(rows, columns, out);
            }
        }
    }
}

fn write_rows<'a>(rows: impl ExactSizeIterator<Item = &'a GradientRow>, columns: &[usize], out: &mut Writer) {
    out.words.push(rows.len() as u32);
    for row in rows {
        out.words.extend(columns.iter().map(|&column| row.0[column].to_bits()));
    }
}

fn written(splat: &Splat) -> SentSplat {
    let Splat {
        mean_px: [x, y], conic_log2: [a, b, c], log2_opacity, rgb: [red, green, blue], depth, ..
    } = *splat;
    let [width, height] = splat.half_extent_px;
    [x, y, a, b, c, log2_opacity, red, green, blue, depth, width, height]
}

fn read(sent: &SentSplat) -> Splat {
    let [x, y, a, b, c, log2_opacity, red, green, blue, depth, width, height] = *sent;
    Splat {
        mean_px: [x, y],
        conic_log2: [a, b, c],
        log2_opacity,
        rgb: [red, green, blue],
        depth,
        half_extent_px: [width, height],
        ..Splat::default()
    }
}
