//! Rows of a picture on their way from the ranks that have drawn them to those that need them.

use std::ops::Range;

use genesplat_core::Image;

use crate::wire::{Reader, Writer};

/// Some rows of a picture.
#[derive(Debug, Default)]
pub(crate) struct PictureRows {
    pub(crate) rows: Range<usize>,
    /// `[3, rows, W]`
    pub(crate) image: Image,
}

pub(crate) fn intersection(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    let start = a.start.max(b.start);
    start..a.end.min(b.end).max(start)
}

/// What a rank that has drawn `held` sends to one that needs `wanted`.
pub(crate) fn part(image: &Image, held: &Range<usize>, wanted: &Range<usize>) -> Vec<u32> {
    let (width, rows) = (image.width as usize, intersection(held, wanted));
    let mut out = Writer::default();
    if !rows.is_empty() {
        for plane in image.planes.chunks(held.len() * width) {
            out.rows(&plane[(rows.start - held.start) * width..][..rows.len() * width]);
        }
    }
    out.words
}

impl PictureRows {
    /// Puts `wanted` together from what each rank has sent, of which `held` are the rows.
    pub(crate) fn assemble(
        &mut self,
        width: usize,
        wanted: Range<usize>,
        held: &[Range<usize>],
        parts: &[Vec<u32>],
    ) {
        let Self { rows, image } = self;
        (image.width, image.height) = (width as u32, wanted.len() as u32);
        image.planes.resize(3 * wanted.len() * width, 0.0);
        for (held, part) in held.iter().zip(parts) {
            let (sent, mut input) = (intersection(held, &wanted), Reader::new(part));
            if sent.is_empty() {
                continue;
            }
            for plane in image.planes.chunks_mut(wanted.len() * width) {
                let values = input.rows(sent.len() * width);
                plane[(sent.start - wanted.start) * width..][..values.len()].copy_from_slice(values);
            }
        }
        *rows = wanted;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_put_together() {
        let (width, height) = (3, 10);
        let whole = Image { width: 3, height: 10, planes: (0..90).map(|value| value as f32).collect() };
        let rows_of = |rows: &Range<usize>| {
            let planes = whole
                .planes
                .chunks(width * height)
                .flat_map(|plane| &plane[rows.start * width..rows.end * width]);
            Image { width: 3, height: rows.len() as u32, planes: planes.copied().collect() }
        };
        let held = [0..4, 4..4, 4..9, 9..10];
        for wanted in [0..10, 2..6, 9..10, 5..5] {
            let parts: Vec<_> = held.iter().map(|held| part(&rows_of(held), held, &wanted)).collect();
            let mut assembled = PictureRows::default();
            assembled.assemble(width, wanted.clone(), &held, &parts);
            assert_eq!(assembled.image, rows_of(&wanted));
        }
    }
}
