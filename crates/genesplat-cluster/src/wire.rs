//! What messages are made of: words of 32 bits, which floats are copied into as they are.

use bytemuck::Pod;
use genesplat_core::{DeviceState, Gaussians, Moments, StateMean, Statistics};
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

    pub(crate) fn text(&mut self, text: &str) {
        self.count(text.len());
        self.words.extend(text.bytes().map(u32::from));
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

    pub(crate) fn statistics(&mut self, statistics: &Statistics, rows: Range<usize>) {
        self.column(&statistics.gradient_sum, rows.clone());
        self.column(&statistics.weight_sum, rows.clone());
        self.column(&statistics.absolute_sum, rows.clone());
        self.column(&statistics.gene_gradient_sum, rows.clone());
        self.column(&statistics.gene_views, rows);
    }

    /// Some rows of all that a device holds.
    pub(crate) fn state(&mut self, (cloud, moments, statistics, mean): StateRef<'_>, rows: Range<usize>) {
        for table in [cloud, &moments.first, &moments.second, &moments.pending] {
            self.cloud(table, rows.clone());
        }
        self.statistics(statistics, rows.clone());
        self.count(mean.states() as usize);
        self.cloud(mean.mean(), rows);
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

/// A [`DeviceState`] that is lent.
pub(crate) type StateRef<'a> = (&'a Gaussians, &'a Moments, &'a Statistics, &'a StateMean);

pub(crate) fn lend(state: &DeviceState) -> StateRef<'_> {
    (&state.cloud, &state.moments, &state.statistics, &state.mean)
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

    pub(crate) fn text(&mut self) -> String {
        let count = self.count();
        let bytes = self.words(count).iter().map(|&word| word as u8).collect();
        String::from_utf8(bytes).unwrap_or_default()
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

    pub(crate) fn statistics(&mut self, statistics: &mut Statistics) {
        self.column(&mut statistics.gradient_sum);
        self.column(&mut statistics.weight_sum);
        self.column(&mut statistics.absolute_sum);
        self.column(&mut statistics.gene_gradient_sum);
        self.column(&mut statistics.gene_views);
    }

    /// Appends the rows of a state.
    pub(crate) fn state(&mut self, state: &mut DeviceState) {
        let Moments { first, second, pending } = &mut state.moments;
        for table in [&mut state.cloud, first, second, pending] {
            self.cloud(table);
        }
        self.statistics(&mut state.statistics);
        let (states, mut mean) = (self.count(), std::mem::take(&mut state.mean).into_mean());
        self.cloud(&mut mean);
        state.mean = StateMean::new(states as u32, mean);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state() -> DeviceState {
        let cloud = |value: f32| {
            let mut cloud = Gaussians::zeros(5);
            cloud.opacity_logits = (0..5).map(|row| value + row as f32).collect();
            cloud
        };
        let mut mean = StateMean::default();
        mean.add(&cloud(9.0));
        DeviceState {
            cloud: Gaussians { filter_3d: Some(vec![0.5; 5]), ..cloud(1.0) },
            moments: Moments { first: cloud(2.0), second: cloud(3.0), pending: Gaussians::default() },
            statistics: Statistics { weight_sum: vec![7.0; 5], gene_views: vec![3; 5], ..Statistics::default() },
            mean,
        }
    }

    #[test]
    fn a_state_in_parts_is_the_state() {
        let (state, mut joined) = (state(), DeviceState::default());
        for rows in [0..0, 0..2, 2..5] {
            let mut out = Writer::default();
            out.state(lend(&state), rows);
            let mut input = Reader::new(&out.words);
            input.state(&mut joined);
            assert!(input.is_at_end());
        }
        assert_eq!(joined, state);
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
