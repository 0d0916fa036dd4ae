//! Which rank holds which rows.

use std::ops::Range;

use genesplat_kernels::cpu::stages::ROWS_TOGETHER;

/// The rows of each rank: contiguous, as many as can be alike, and whole pieces of the work that kernels cut,
/// so that a row lies in the same lane of the same vector wherever it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Shares {
    rows: usize,
    ranks: usize,
}

impl Shares {
    pub(crate) fn new(rows: usize, ranks: usize) -> Self {
        Self { rows, ranks }
    }

    /// Rows of the whole cloud.
    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// The rows of one rank.
    pub(crate) fn of(&self, rank: usize) -> Range<usize> {
        let pieces = self.rows.div_ceil(ROWS_TOGETHER);
        let start = |rank: usize| self.rows.min(pieces * rank / self.ranks * ROWS_TOGETHER);
        start(rank)..start(rank + 1)
    }

    pub(crate) fn all(&self) -> impl Iterator<Item = Range<usize>> {
        (0..self.ranks).map(|rank| self.of(rank))
    }
}

/// The places of some `rows`, ascending, that lie in `share`.
pub(crate) fn places_in(rows: &[u32], share: &Range<usize>) -> Range<usize> {
    let place = |row: usize| rows.partition_point(|&other| (other as usize) < row);
    place(share.start)..place(share.end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_whole_pieces_and_leave_no_row_out() {
        for rows in [0, 1, 255, 256, 257, 5000, 100_000] {
            for ranks in 1..=5 {
                let shares = Shares::new(rows, ranks);
                let mut end = 0;
                for share in shares.all() {
                    assert_eq!(share.start, end);
                    assert!(share.start.is_multiple_of(ROWS_TOGETHER) || share.start == rows);
                    assert!(share.len() <= rows / ranks + 2 * ROWS_TOGETHER);
                    end = share.end;
                }
                assert_eq!(end, rows);
            }
        }
    }

    #[test]
    fn rows_of_a_share_are_found() {
        assert_eq!(places_in(&[1, 4, 5, 9], &(4..9)), 1..3);
        assert_eq!(places_in(&[1, 4], &(5..9)), 2..2);
    }
}
