//! One gene group of one individual: a bit a row for "differs from what is shared", and the values of those
//! rows, packed.
//!
//! Bits make crossover a bitwise select, and runs of rows a plain copy.

/// Rows that one word of a bit column covers.
pub(crate) const WORD: usize = u64::BITS as usize;

/// Words that `n` rows need.
pub(crate) fn words(n: usize) -> usize {
    n.div_ceil(WORD)
}

/// `W` genes of every row that differs from what is shared.
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

    /// One bit a row, in `words` words.
    fn bits(&self, words: usize) -> Vec<u64> {
        let mut bits = vec![0; words];
        self.rows.iter().for_each(|&row| bits[row as usize / WORD] |= 1 << (row as usize % WORD));
        bits
    }
}

impl<const W: usize> Column<W> {
    /// A column of `n` rows, all as they are shared.
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

    /// The same values as differences from other shared values, which differ from `shared` as `other` does.
    pub(crate) fn rebased(&self, other: &Self, shared: impl Fn(usize) -> [f32; W]) -> Self {
        let changed = self.differing(other);
        let mut values = Vec::with_capacity(count(&changed));
        let mut own = self.reader();
        for (word, &bits) in changed.iter().enumerate() {
            let rows = ones(bits).map(|bit| word * WORD + bit);
            values.extend(rows.map(|row| own.get(row).unwrap_or_else(|| shared(row))));
        }
        Self { changed, values }
    }

    /// Bits of the rows in which two columns that share the same values differ.
    fn differing(&self, other: &Self) -> Vec<u64> {
        let mut rest = [self.values.as_slice(), other.values.as_slice()];
        let words = self.changed.iter().zip(&other.changed);
        words
            .map(|(&own, &others)| {
                let [own_run, other_run] = [take(&mut rest[0], own), take(&mut rest[1], others)];
                let same = ones(own & others)
                    .filter(|&bit| own_run[rank(own, bit)] == other_run[rank(others, bit)])
                    .fold(0, |same, bit| same | 1 << bit);
                (own | others) & !same
            })
            .collect()
    }

    /// What most of some columns hold, row by row, by a majority vote in one pass (Boyer and Moore, 1981);
    /// one of the values where nothing has more than half of the weight.
    pub(crate) fn majority(voters: &[(&Self, u32)]) -> Self {
        let words = voters.first().map_or(0, |(column, _)| column.changed.len());
        let mut values: Vec<_> = voters.iter().map(|(column, _)| column.values.iter()).collect();
        let mut out = Self { changed: vec![0; words], values: Vec::new() };
        for word in 0..words {
            let any = voters.iter().fold(0, |bits, (column, _)| bits | column.changed[word]);
            for bit in ones(any) {
                let votes = voters.iter().zip(&mut values).map(|((column, weight), values)| {
                    let own = if is_set(column.changed[word], bit) { values.next() } else { None };
                    (own, *weight)
                });
                if let Some(&value) = elected(votes) {
                    out.changed[word] |= 1 << bit;
                    out.values.push(value);
                }
            }
        }
        out.values.shrink_to_fit();
        out
    }

    /// Reads rows in ascending order.
    pub(crate) fn reader(&self) -> Reader<'_, W> {
        Reader { column: self, word: 0, rank: 0 }
    }

    /// Crossover and mutation in one pass. The child has `first`'s rows where a bit of `from_first` is set
    /// and `second`'s elsewhere; then each row of `steps` becomes `step(value, by)`.
    pub(crate) fn child(
        parents: [&Self; 2],
        from_first: impl Fn(usize) -> u64,
        steps: &Steps<W>,
        shared: impl Fn(usize) -> [f32; W],
        step: impl Fn([f32; W], [f32; W]) -> [f32; W],
    ) -> Self {
        let stepped = steps.bits(parents[0].changed.len());
        let changed: Vec<u64> = (0..stepped.len())
            .map(|word| select(from_first(word), parents.map(|parent| parent.changed[word])) | stepped[word])
            .collect();
        let mut values = Vec::with_capacity(count(&changed));
        let mut rest = parents.map(|parent| parent.values.as_slice());
        let mut by = steps.by.iter();
        for word in 0..changed.len() {
            let bits = parents.map(|parent| parent.changed[word]);
            let runs = [take(&mut rest[0], bits[0]), take(&mut rest[1], bits[1])];
            match (from_first(word), stepped[word]) {
                (u64::MAX, 0) => values.extend_from_slice(runs[0]),
                (0, 0) => values.extend_from_slice(runs[1]),
                (mask, stepped) => values.extend(ones(changed[word]).map(|bit| {
                    let parent = usize::from(!is_set(mask, bit));
                    let value = match is_set(bits[parent], bit) {
                        true => runs[parent][rank(bits[parent], bit)],
                        false => shared(word * WORD + bit),
                    };
                    let by = if is_set(stepped, bit) { by.next() } else { None };
                    by.map_or(value, |&by| step(value, by))
                })),
            }
        }
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
    /// The row's own value, if it differs from the shared one. `row` must not be before the last one's word.
    pub(crate) fn get(&mut self, row: usize) -> Option<[f32; W]> {
        let (word, bit) = (row / WORD, row % WORD);
        self.rank += count(&self.column.changed[self.word..word]);
        self.word = word;
        let bits = self.column.changed[word];
        is_set(bits, bit).then(|| self.column.values[self.rank + rank(bits, bit)])
    }
}

/// The candidate that a majority vote leaves standing.
fn elected<T: PartialEq + Default>(votes: impl Iterator<Item = (T, u32)>) -> T {
    let (mut candidate, mut lead) = (T::default(), 0);
    for (vote, weight) in votes {
        if vote == candidate {
            lead += weight;
        } else if weight > lead {
            (candidate, lead) = (vote, weight - lead);
        } else {
            lead -= weight;
        }
    }
    candidate
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

/// The first word's bits where `mask` is set, the second's elsewhere.
fn select(mask: u64, [first, second]: [u64; 2]) -> u64 {
    (first & mask) | (second & !mask)
}

/// Whether a word has a bit.
pub(crate) fn is_set(bits: u64, bit: usize) -> bool {
    bits >> bit & 1 == 1
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

    fn steps(by: &[(u32, f32)]) -> Steps<1> {
        let mut steps = Steps::default();
        by.iter().for_each(|&(row, by)| steps.push(row, [by]));
        steps
    }

    /// A column of `N` rows in which the rows of `own` have the given values.
    fn column(own: &[(u32, f32)]) -> Column<1> {
        let unchanged = Column::unchanged(N);
        Column::child([&unchanged, &unchanged], |_| 0, &steps(own), |_| [0.0], |_, value| value)
    }

    fn read(column: &Column<1>) -> Vec<Option<[f32; 1]>> {
        let mut reader = column.reader();
        (0..N).map(|row| reader.get(row)).collect()
    }

    /// Any set of rows with any values.
    fn own() -> impl Strategy<Value = Vec<(u32, f32)>> {
        prop::collection::btree_map(0..N as u32, -9.0f32..9.0, 0..N).prop_map(|map| map.into_iter().collect())
    }

    /// Any bits, with words of one parent only among them: those take another path than mixed ones.
    fn mask() -> impl Strategy<Value = Vec<u64>> {
        prop::collection::vec(prop_oneof![any::<u64>(), Just(0), Just(u64::MAX)], words(N))
    }

    proptest! {
        #[test]
        fn what_was_stored_is_read(own in own()) {
            let mut expected = vec![None; N];
            own.iter().for_each(|&(row, value)| expected[row as usize] = Some([value]));
            prop_assert_eq!(read(&column(&own)), expected);
        }

        #[test]
        fn columns_differ_where_what_is_read_differs(a in own(), b in own()) {
            let (a, b) = (column(&a), column(&b));
            let expected: Vec<bool> = read(&a).iter().zip(read(&b)).map(|(a, b)| *a != b).collect();
            let bits = a.differing(&b);
            let found: Vec<bool> = (0..N).map(|row| is_set(bits[row / WORD], row % WORD)).collect();
            prop_assert_eq!(found, expected);
        }

        #[test]
        fn a_rebased_column_holds_the_same_values(own in own(), other in own()) {
            let shared = |row: usize| [row as f32];
            let (own, other) = (column(&own), column(&other));
            let values = |column: &Column<1>, others: &[[f32; 1]]| -> Vec<[f32; 1]> {
                read(column).iter().zip(others).map(|(own, other)| own.unwrap_or(*other)).collect()
            };
            let shared_values: Vec<[f32; 1]> = (0..N).map(shared).collect();
            let rebased = own.rebased(&other, shared);
            prop_assert_eq!(values(&rebased, &values(&other, &shared_values)), values(&own, &shared_values));
        }

        #[test]
        fn what_more_than_half_of_the_weight_holds_is_the_majority(
            columns in prop::collection::vec((prop::collection::vec(0..3u8, N), 1..9u32), 1..7),
        ) {
            // 0 stands for a row that is unchanged.
            let columns: Vec<(Column<1>, u32)> = columns
                .iter()
                .map(|(values, weight)| {
                    let own: Vec<(u32, f32)> = (0..).zip(values.iter().map(|&v| f32::from(v)))
                        .filter(|&(_, value)| value > 0.0).collect();
                    (column(&own), *weight)
                })
                .collect();
            let voters: Vec<(&Column<1>, u32)> = columns.iter().map(|(column, weight)| (column, *weight)).collect();
            let majority = Column::majority(&voters);
            let all: u32 = columns.iter().map(|(_, weight)| weight).sum();
            let votes: Vec<(Vec<_>, u32)> = columns.iter().map(|(column, weight)| (read(column), *weight)).collect();
            for (row, found) in read(&majority).into_iter().enumerate() {
                let share = |value: Option<[f32; 1]>| votes.iter().filter(|(rows, _)| rows[row] == value)
                    .map(|(_, weight)| weight).sum::<u32>();
                prop_assert!(share(found) > 0, "somebody holds it");
                for candidate in [None, Some([1.0]), Some([2.0])] {
                    prop_assert!(2 * share(candidate) <= all || found == candidate);
                }
            }
        }

        #[test]
        fn a_child_inherits_by_the_mask_and_then_steps(
            a in own(), b in own(), mask in mask(), by in prop_oneof![Just(Vec::new()), own()],
        ) {
            let (a, b) = (column(&a), column(&b));
            let shared = |row: usize| [row as f32];
            let add = |value: [f32; 1], by: [f32; 1]| [value[0] + by[0]];
            let child = Column::child([&a, &b], |word| mask[word], &steps(&by), shared, add);
            let (a, b) = (read(&a), read(&b));
            let from_first = |row: usize| mask[row / WORD] >> (row % WORD) & 1 == 1;
            let mut expected: Vec<_> = (0..N).map(|row| if from_first(row) { a[row] } else { b[row] }).collect();
            for &(row, by) in &by {
                let row = row as usize;
                expected[row] = Some(add(expected[row].unwrap_or_else(|| shared(row)), [by]));
            }
            prop_assert_eq!(read(&child), expected);
            prop_assert_eq!(child.values.len(), child.values.capacity());
        }
    }
}
