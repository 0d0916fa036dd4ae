//! Which rank draws which rows of tiles of a picture: as the load was when the picture was drawn last.

use std::ops::Range;

/// What a tile costs besides its intersections, in intersections: its pixels have a loss.
const TILE_LOAD: usize = 48;

/// Rows of tiles of each rank.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Bands {
    /// Where each begins; one more at the end.
    starts: Vec<usize>,
    /// The rank of each row of tiles.
    rank_of_row: Vec<usize>,
}

impl Bands {
    /// Cuts a picture of `across` times `down` tiles for some of `count` ranks; `intersections` are those of
    /// each row of tiles, or none where it was never drawn.
    pub(crate) fn new(
        [across, down]: [usize; 2],
        intersections: &[u32],
        ranks: &Range<usize>,
        count: usize,
    ) -> Self {
        let of_row =
            |row: usize| intersections.get(row).map_or(0, |&count| count as usize) + TILE_LOAD * across;
        let mut sums = vec![0; down + 1];
        for row in 0..down {
            sums[row + 1] = sums[row] + of_row(row);
        }
        let start = |rank: usize| {
            // Where the load before is nearest to what it should be.
            let wanted = sums[down] * (rank.clamp(ranks.start, ranks.end) - ranks.start) / ranks.len();
            let above = sums.partition_point(|&sum| sum < wanted);
            let is_nearer = above > 0 && wanted - sums[above - 1] < sums[above] - wanted;
            if is_nearer { above - 1 } else { above }
        };
        Self::from_starts((0..count).map(start).chain([down]).collect())
    }

    fn from_starts(starts: Vec<usize>) -> Self {
        let bands = starts.windows(2).enumerate();
        let rank_of_row =
            bands.flat_map(|(rank, band)| std::iter::repeat_n(rank, band[1] - band[0])).collect();
        Self { starts, rank_of_row }
    }

    /// The rows of one rank.
    pub(crate) fn of(&self, rank: usize) -> Range<usize> {
        self.starts[rank]..self.starts[rank + 1]
    }

    /// The ranks that draw some of `rows`.
    pub(crate) fn reached(&self, rows: &Range<usize>) -> impl Iterator<Item = usize> {
        let ranks = match self.rank_of_row[rows.clone()] {
            [] => 0..0,
            [first, .., last] => first..last + 1,
            [only] => only..only + 1,
        };
        ranks.filter(|&rank| !self.of(rank).is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_follow_the_load() {
        let bands =
            |intersections: &[u32], ranks| Bands::new([10, 8], intersections, &(0..ranks), ranks).starts;
        assert_eq!(bands(&[], 2), [0, 4, 8]);
        assert_eq!(bands(&[100_000, 0, 0, 0, 0, 0, 0, 100_000], 2), [0, 4, 8]);
        assert_eq!(bands(&[0, 0, 0, 0, 0, 0, 50_000, 50_000], 2), [0, 7, 8]);
        assert_eq!(bands(&[], 3), [0, 3, 5, 8]);
        assert_eq!(Bands::new([1, 2], &[], &(0..5), 5).starts.last(), Some(&2));
        assert_eq!(Bands::new([10, 8], &[], &(1..3), 4).starts, [0, 0, 4, 8, 8]);
        assert_eq!(Bands::new([10, 8], &[], &(3..4), 4).starts, [0, 0, 0, 0, 8]);
    }

    #[test]
    fn rows_reach_the_bands_that_they_meet() {
        let bands = Bands::from_starts(vec![0, 3, 3, 5, 8]);
        let reached = |rows: Range<usize>| bands.reached(&rows).collect::<Vec<_>>();
        assert_eq!(reached(0..3), [0]);
        assert_eq!(reached(2..4), [0, 2]);
        assert_eq!(reached(3..4), [2]);
        assert_eq!(reached(4..8), [2, 3]);
        assert_eq!(reached(0..8), [0, 2, 3]);
        assert_eq!(reached(4..4), [0; 0]);
    }
}
