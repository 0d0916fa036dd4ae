//! Where two renders of a photo differ most: windows that the program chooses, not the author.
//!
//! For every square window, a sixth of the longer side wide, the absolute errors of both renders are summed.
//! The windows of the largest differences are taken, none overlapping an earlier one.

use genesplat_core::Photo;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Square {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) side: u32,
}

impl Square {
    fn overlaps(self, other: Self) -> bool {
        self.x.abs_diff(other.x) < self.side && self.y.abs_diff(other.y) < self.side
    }
}

/// At most `count` windows where the error of `with` is lower than that of `without`, by most first. All
/// three pictures have one size.
pub(crate) fn where_better(photo: &Photo, without: &Photo, with: &Photo, count: usize) -> Vec<Square> {
    let side = (photo.width.max(photo.height) / 6).clamp(1, photo.width.min(photo.height));
    let sums = Sums::new(photo, without, with);
    let mut found: Vec<Square> = Vec::new();
    while found.len() < count {
        let windows = (0..=photo.height - side)
            .flat_map(|y| (0..=photo.width - side).map(move |x| Square { x, y, side }))
            .filter(|square| !found.iter().any(|other| square.overlaps(*other)))
            .map(|square| (sums.fall(square), square));
        // Of equals the first, so that no two machines choose differently.
        match windows.reduce(|best, next| if next.0 > best.0 { next } else { best }) {
            Some((fall, square)) if fall > 0 => found.push(square),
            _ => break,
        }
    }
    found
}

/// Sums of the fall of error over all rectangles from the corner, `[H + 1, W + 1]`; exact integers.
struct Sums {
    stride: usize,
    values: Vec<i64>,
}

impl Sums {
    fn new(photo: &Photo, without: &Photo, with: &Photo) -> Self {
        let stride = photo.width as usize + 1;
        let mut values = vec![0; stride * (photo.height as usize + 1)];
        for y in 0..photo.height {
            let mut row = 0;
            for x in 0..photo.width {
                let truth = photo.pixel(x, y);
                row += error(without.pixel(x, y), truth) - error(with.pixel(x, y), truth);
                let at = (y as usize + 1) * stride + x as usize + 1;
                values[at] = values[at - stride] + row;
            }
        }
        Self { stride, values }
    }

    fn fall(&self, Square { x, y, side }: Square) -> i64 {
        let at = |x: u32, y: u32| self.values[y as usize * self.stride + x as usize];
        at(x + side, y + side) - at(x, y + side) - at(x + side, y) + at(x, y)
    }
}

fn error(a: [u8; 3], b: [u8; 3]) -> i64 {
    a.iter().zip(b).map(|(&a, b)| i64::from(a.abs_diff(b))).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: u32 = 60;

    /// Grey, but for squares of another value.
    fn picture(squares: &[(u32, u32, u32, u8)]) -> Photo {
        let mut photo = Photo { width: WIDTH, height: 40, rgb: vec![100; 3 * 60 * 40] };
        for &(x, y, side, value) in squares {
            for row in y..y + side {
                let at = 3 * (row * WIDTH + x) as usize;
                photo.rgb[at..at + 3 * side as usize].fill(value);
            }
        }
        photo
    }

    #[test]
    fn planted_errors_are_found_in_order_of_their_size() {
        let photo = picture(&[]);
        // Errors of exactly the window's size that one render has and the other has not, and one the other
        // way round.
        let without = picture(&[(41, 7, 10, 160), (3, 28, 10, 130)]);
        let with = picture(&[(20, 10, 10, 60)]);
        let places = |squares: Vec<Square>| squares.iter().map(|s| (s.x, s.y, s.side)).collect::<Vec<_>>();
        assert_eq!(places(where_better(&photo, &without, &with, 2)), [(41, 7, 10), (3, 28, 10)]);
        assert_eq!(places(where_better(&photo, &with, &without, 1)), [(20, 10, 10)]);
    }

    #[test]
    fn windows_do_not_overlap_and_stay_within_the_picture() {
        let found = where_better(&picture(&[]), &picture(&[(30, 20, 20, 0)]), &picture(&[]), 4);
        assert_eq!(found.len(), 4);
        for (index, square) in found.iter().enumerate() {
            assert!(square.x + square.side <= WIDTH && square.y + square.side <= 40);
            assert!(found[..index].iter().all(|other| !square.overlaps(*other)), "{found:?}");
        }
    }

    #[test]
    fn equal_renders_have_no_windows() {
        let same = picture(&[(3, 3, 5, 9)]);
        assert!(where_better(&picture(&[]), &same, &same, 3).is_empty());
    }
}
