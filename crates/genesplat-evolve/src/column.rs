//! One gene group of one individual: a bit a row for "differs from the base", and the values of those rows, packed.
//!
//! A list of row indices would be smaller while fewer than one row in 32 differs, but a search soon leaves that range
//! (see [`crate::population`]), and bits make crossover a bitwise select and runs of rows a plain copy.

/// Rows that one word of a bit column covers.
pub(crate) const WORD: usize = u64::BITS as usize;

/// Words that `n` rows need.
pub(crate) fn words(n: usize) -> usize {
    n.div_ceil(WORD)
}

/// `W` genes of every row that differs from the base.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Column<const W: usize> {
    /// One bit a row, lowest bit first `[⌈N/64⌉]`.
    changed: Vec<u64>,
    /// Absolute genes of the rows whose bit is set, in ascending order of rows.
    values: Vec<[f32; W]>,
}

/// What a mutation adds to some rows of a column.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Steps<const W: usize> {
    /// Strictly ascending.
    pub(crate) rows: Vec<u32>,
    /// One entry a row.
    pub(crate) by: Vec<[f32; W]>,
}

impl<const W: usize> Steps<W> {
    pub(crate) fn push(&mut self, row: u32, by: [f32; W]) {
        self.rows.push(row);
        self.by.push(by);
    }
}

impl<const W: usize> Column<W> {
    /// A column of `n` rows equal to the base.
    pub(crate) fn unchanged(n: usize) -> Self {
        Self { changed: vec![0; words(n)], values: Vec::new() }
    }

    /// Bits of the rows that differ.
    pub(crate) fn changed(&self) -> &[u64] {
        &self.changed
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.changed.capacity() * size_of::<u64>() + self.values.capacity() * size_of::<[f32; W]>()
    }

    /// Reads rows in ascending order.
    pub(crate) fn reader(&self) -> Reader<'_, W> {
        Reader { column: self, word: 0, rank: 0 }
    }

    /// The child that has `first`'s rows where a bit of `from_first` is set, and `second`'s elsewhere.
    pub(crate) fn cross(first: &Self, second: &Self, from_first: &[u64]) -> Self {
        let select = |((a, b), m): ((&u64, &u64), &u64)| (a & m) | (b & !m);
        let changed: Vec<u64> =
            first.changed.iter().zip(&second.changed).zip(from_first).map(select).collect();
        let mut values = Vec::with_capacity(count(&changed));
        let (mut a_rest, mut b_rest) = (first.values.as_slice(), second.values.as_slice());
        for (word, &mask) in from_first.iter().enumerate() {
            let (a, b) = (first.changed[word], second.changed[word]);
            let a_values = take(&mut a_rest, a);
            let b_values = take(&mut b_rest, b);
            match mask {
                u64::MAX => values.extend_from_slice(a_values),
                0 => values.extend_from_slice(b_values),
                _ => values.extend(ones(changed[word]).map(|bit| match mask >> bit & 1 {
                    1 => a_values[rank(a, bit)],
                    _ => b_values[rank(b, bit)],
                })),
            }
        }
        Self { changed, values }
    }

    /// The column after a mutation: `step(current value, by)` for each row of `steps`, where the current value is the
    /// individual's own, or `base(row)` if it has none.
    pub(crate) fn stepped(
        &self,
        steps: &Steps<W>,
        base: impl Fn(usize) -> [f32; W],
        step: impl Fn([f32; W], [f32; W]) -> [f32; W],
    ) -> Self {
        let mut changed = self.changed.clone();
        steps.rows.iter().for_each(|&row| changed[row as usize / WORD] |= 1 << (row as usize % WORD));
        let mut values = Vec::with_capacity(count(&changed));
        let mut reader = self.reader();
        let mut copied = 0;
        for (&row, &by) in steps.rows.iter().zip(&steps.by) {
            let (rank, own) = reader.seek(row as usize);
            values.extend_from_slice(&self.values[copied..rank]);
            values.push(step(own.unwrap_or_else(|| base(row as usize)), by));
            copied = rank + usize::from(own.is_some());
        }
        values.extend_from_slice(&self.values[copied..]);
        Self { changed, values }
    }
}

/// Finds rows of a column in ascending order, each in constant time on average.
#[derive(Debug)]
pub(crate) struct Reader<'a, const W: usize> {
    column: &'a Column<W>,
    /// The word that the last row was in.
    word: usize,
    /// Changed rows before that word.
    rank: usize,
}

impl<const W: usize> Reader<'_, W> {
    /// The row's own value, if it differs from the base.
    pub(crate) fn get(&mut self, row: usize) -> Option<[f32; W]> {
        self.seek(row).1
    }

    /// Changed rows before `row`, and the row's own value. `row` must not be before the last one's word.
    fn seek(&mut self, row: usize) -> (usize, Option<[f32; W]>) {
        let (word, bit) = (row / WORD, row % WORD);
        self.rank += count(&self.column.changed[self.word..word]);
        self.word = word;
        let bits = self.column.changed[word];
        let at = self.rank + rank(bits, bit);
        (at, (bits >> bit & 1 == 1).then(|| self.column.values[at]))
    }
}

/// Set bits of a word, lowest first.
pub(crate) fn ones(mut bits: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = (bits != 0).then(|| bits.trailing_zeros() as usize)?;
        bits &= bits - 1;
        Some(bit)
    })
}

/// Set bits of all words.
pub(crate) fn count(bits: &[u64]) -> usize {
    bits.iter().map(|word| word.count_ones() as usize).sum()
}

/// Set bits below `bit`.
fn rank(bits: u64, bit: usize) -> usize {
    (bits & ((1 << bit) - 1)).count_ones() as usize
}

/// Splits off the values of one word.
fn take<'a, T>(rest: &mut &'a [T], bits: u64) -> &'a [T] {
    let (head, tail) = rest.split_at(bits.count_ones() as usize);
    *rest = tail;
    head
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const N: usize = 200;

    /// A column of `N` rows in which the rows of `own` have the given values.
    fn column(own: &[(u32, f32)]) -> Column<1> {
        let mut steps = Steps::default();
        own.iter().for_each(|&(row, value)| steps.push(row, [value]));
        Column::unchanged(N).stepped(&steps, |_| [0.0], |_, value| value)
    }

    fn read(column: &Column<1>) -> Vec<Option<[f32; 1]>> {
        let mut reader = column.reader();
        (0..N).map(|row| reader.get(row)).collect()
    }

    /// Any set of rows with any values.
    fn own() -> impl Strategy<Value = Vec<(u32, f32)>> {
        prop::collection::btree_map(0..N as u32, -9.0f32..9.0, 0..N).prop_map(|map| map.into_iter().collect())
    }

    proptest! {
        #[test]
        fn a_step_changes_its_rows_and_no_other(before in own(), steps in own()) {
            let old = column(&before);
            let mut by = Steps::default();
            steps.iter().for_each(|&(row, value)| by.push(row, [value]));
            let new = old.stepped(&by, |row| [row as f32], |current, step| [current[0] + step[0]]);
            let mut expected = read(&old);
            for &(row, step) in &steps {
                let current = expected[row as usize].map_or(row as f32, |own| own[0]);
                expected[row as usize] = Some([current + step]);
            }
            prop_assert_eq!(read(&new), expected);
            prop_assert_eq!(new.values.len(), new.values.capacity());
        }

        #[test]
        fn a_child_has_each_row_from_the_parent_that_the_mask_names(
            a in own(), b in own(), mask in prop::collection::vec(any::<u64>(), words(N)), plain in any::<[bool; 4]>(),
        ) {
            // Words of one parent only take another path than mixed ones.
            let mask: Vec<u64> = mask.into_iter().zip(plain)
                .map(|(word, plain)| match (plain, word & 1) { (true, 1) => u64::MAX, (true, _) => 0, _ => word })
                .collect();
            let (a, b) = (column(&a), column(&b));
            let child = Column::cross(&a, &b, &mask);
            let from_a = |row: usize| mask[row / WORD] >> (row % WORD) & 1 == 1;
            let (a, b) = (read(&a), read(&b));
            let expected: Vec<_> = (0..N).map(|row| if from_a(row) { a[row] } else { b[row] }).collect();
            prop_assert_eq!(read(&child), expected);
            prop_assert_eq!(child.values.len(), child.values.capacity());
        }
    }
}
