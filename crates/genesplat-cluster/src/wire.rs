//! What messages are made of: words of 32 bits, which floats are copied into as they are.

use bytemuck::Pod;
use genesplat_core::Gaussians;
use std::ops::Range;

/// A message that is written.
#[derive(Clone, Debug, Default)]
pub(crate) struct Writer {
    pub(crate) words: Vec<u32>,
}

/// A message that is read; both sides know what comes next.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader<'a> {
    words: &'a [u32],
}

impl Writer {
    pub(crate) fn count(&mut self, count: usize) {
        let count = count as u64;
        self.words.extend([count as u32, (count >> 32) as u32]);
    }

    /// Rows whose size is a multiple of a word.
    pub(crate) fn rows<T: Pod>(&mut self, rows: &[T]) {
        self.words.extend_from_slice(bytemuck::cast_slice(rows));
    }

    pub(crate) fn doubles(&mut self, values: &[f64]) {
        let words = |value: &f64| {
            let bits = value.to_bits();
            [bits as u32, (bits >> 32) as u32]
        };
        self.words.extend(values.iter().flat_map(words));
    }

    /// Four in a word, the last one filled up.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.count(bytes.len());
        let (words, rest) = bytes.as_chunks();
        self.words.extend(words.iter().map(|&word| u32::from_le_bytes(word)));
        if !rest.is_empty() {
            let mut last = [0; 4];
            last[..rest.len()].copy_from_slice(rest);
            self.words.push(u32::from_le_bytes(last));
        }
    }

    pub(crate) fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    /// Some rows of a column, or none where the column has none.
    fn column<T: Pod>(&mut self, column: &[T], rows: Range<usize>) {
        let rows = if column.is_empty() { 0..0 } else { rows };
        self.count(rows.len());
        self.rows(&column[rows]);
    }

    pub(crate) fn cloud(&mut self, cloud: &Gaussians, rows: Range<usize>) {
        self.column(&cloud.positions, rows.clone());
        self.column(&cloud.log_scales, rows.clone());
        self.column(&cloud.rotations, rows.clone());
        self.column(&cloud.opacity_logits, rows.clone());
        self.column(&cloud.sh, rows.clone());
        self.count(usize::from(cloud.filter_3d.is_some()));
        self.column(cloud.filter_3d.as_deref().unwrap_or_default(), rows);
    }
}

/// Makes room for so many rows and no more.
pub(crate) fn reserve(table: &mut Gaussians, rows: usize) {
    table.positions.reserve_exact(rows);
    table.log_scales.reserve_exact(rows);
    table.rotations.reserve_exact(rows);
    table.opacity_logits.reserve_exact(rows);
    table.sh.reserve_exact(rows);
}

impl<'a> Reader<'a> {
    pub(crate) fn new(words: &'a [u32]) -> Self {
        Self { words }
    }

    #[cfg(test)]
    fn is_at_end(&self) -> bool {
        self.words.is_empty()
    }

    pub(crate) fn words(&mut self, count: usize) -> &'a [u32] {
        let (words, rest) = self.words.split_at(count);
        self.words = rest;
        words
    }

    pub(crate) fn count(&mut self) -> usize {
        let words = self.words(2);
        (u64::from(words[0]) | u64::from(words[1]) << 32) as usize
    }

    pub(crate) fn rows<T: Pod>(&mut self, count: usize) -> &'a [T] {
        bytemuck::cast_slice(self.words(count * size_of::<T>() / size_of::<u32>()))
    }

    pub(crate) fn doubles(&mut self, count: usize) -> impl Iterator<Item = f64> + use<'a> {
        let pairs = self.words(2 * count).chunks_exact(2);
        pairs.map(|words| f64::from_bits(u64::from(words[0]) | u64::from(words[1]) << 32))
    }

    pub(crate) fn bytes(&mut self) -> Vec<u8> {
        let count = self.count();
        let words = self.words(count.div_ceil(size_of::<u32>()));
        words.iter().flat_map(|word| word.to_le_bytes()).take(count).collect()
    }

    pub(crate) fn text(&mut self) -> String {
        String::from_utf8(self.bytes()).unwrap_or_default()
    }

    /// Appends the rows of a column.
    fn column<T: Pod>(&mut self, column: &mut Vec<T>) {
        let count = self.count();
        column.extend_from_slice(self.rows(count));
    }

    /// Appends the rows of a cloud.
    pub(crate) fn cloud(&mut self, cloud: &mut Gaussians) {
        self.column(&mut cloud.positions);
        self.column(&mut cloud.log_scales);
        self.column(&mut cloud.rotations);
        self.column(&mut cloud.opacity_logits);
        self.column(&mut cloud.sh);
        if self.count() > 0 {
            cloud.filter_3d.get_or_insert_default();
        }
        let mut none = Vec::new();
        self.column(cloud.filter_3d.as_mut().unwrap_or(&mut none));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cloud_in_parts_is_the_cloud() {
        let filter_3d = Some(vec![0.5; 5]);
        let opacity_logits = (0..5).map(|row| row as f32).collect();
        let (cloud, mut joined) =
            (Gaussians { filter_3d, opacity_logits, ..Gaussians::zeros(5) }, Gaussians::default());
        for rows in [0..0, 0..2, 2..5] {
            let mut out = Writer::default();
            out.cloud(&cloud, rows);
            let mut input = Reader::new(&out.words);
            input.cloud(&mut joined);
            assert!(input.is_at_end());
        }
        assert_eq!(joined, cloud);
    }

    #[test]
    fn numbers_and_texts_survive() {
        let mut out = Writer::default();
        out.count(1 << 40);
        out.doubles(&[-0.0, 1e300]);
        out.text("naïve");
        let mut input = Reader::new(&out.words);
        assert_eq!(
            (input.count(), input.doubles(2).map(f64::to_bits).collect()),
            (1 << 40, vec![(-0.0f64).to_bits(), 1e300f64.to_bits()])
        );
        assert_eq!(input.text(), "naïve");
    }
}
