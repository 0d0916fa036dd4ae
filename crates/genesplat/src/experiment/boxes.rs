//! Where a picture got better and worse: boxes that the program places, not the author.
//!
//! For two renders of one photo, the squared error of each pixel is summed over the channels; its change is then summed
//! over every square window of a fixed size. The two boxes are the windows where error fell most and where it rose
//! most. The rule has no parameter to tune but the size of the window, a sixth of the longer side.

use genesplat::core::Photo;

/// A square of pixels, by its leftmost column, topmost row and side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Square {
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) side: u32,
}

/// The boxes where error fell and rose most; `None` where it fell (or rose) nowhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Changes {
    pub(crate) fell: Option<Square>,
    pub(crate) rose: Option<Square>,
}

/// Finds the boxes. All three pictures have one size.
pub(crate) fn changes(photo: &Photo, without: &Photo, with: &Photo) -> Changes {
    let side = (photo.width.max(photo.height) / 6).clamp(1, photo.width.min(photo.height));
    let sums = Sums::new(photo, without, with);
    let windows = (0..=photo.height - side)
        .flat_map(|y| (0..=photo.width - side).map(move |x| Square { x, y, side }))
        .map(|square| (sums.rise(square), square));
    let (mut fell, mut rose) = ((0, None), (0, None));
    for (rise, square) in windows {
        if rise < fell.0 {
            fell = (rise, Some(square));
        }
        if rise > rose.0 {
            rose = (rise, Some(square));
        }
    }
    Changes { fell: fell.1, rose: rose.1 }
}

/// Sums of the rise of error over all rectangles from the corner, `[H + 1, W + 1]`; exact integers.
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
                row += squared_error(with.pixel(x, y), truth) - squared_error(without.pixel(x, y), truth);
                let at = (y as usize + 1) * stride + x as usize + 1;
                values[at] = values[at - stride] + row;
            }
        }
        Self { stride, values }
    }

    /// How much the error of a square rose.
    fn rise(&self, Square { x, y, side }: Square) -> i64 {
        let at = |x: u32, y: u32| self.values[y as usize * self.stride + x as usize];
        at(x + side, y + side) - at(x, y + side) - at(x + side, y) + at(x, y)
    }
}

fn squared_error(a: [u8; 3], b: [u8; 3]) -> i64 {
    a.iter().zip(b).map(|(&a, b)| i64::from(a.abs_diff(b)).pow(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: u32 = 60;

    /// Grey, but for a square of `value`.
    fn picture(x: u32, y: u32, side: u32, value: u8) -> Photo {
        let mut photo = Photo { width: WIDTH, height: 40, rgb: vec![100; 3 * 60 * 40] };
        for row in y..y + side {
            let at = 3 * (row * WIDTH + x) as usize;
            photo.rgb[at..at + 3 * side as usize].fill(value);
        }
        photo
    }

    #[test]
    fn planted_errors_are_found() {
        let photo = picture(0, 0, 0, 0);
        // An error that evolution removes, of exactly the window's size, and another that it makes.
        let (without, with) = (picture(41, 7, 10, 160), picture(5, 23, 10, 60));
        let found = changes(&photo, &without, &with);
        assert_eq!(found.fell, Some(Square { x: 41, y: 7, side: 10 }));
        assert_eq!(found.rose, Some(Square { x: 5, y: 23, side: 10 }));
        let swapped = changes(&photo, &with, &without);
        assert_eq!((swapped.fell, swapped.rose), (found.rose, found.fell));
    }

    #[test]
    fn an_error_at_the_border_is_boxed_within_the_picture() {
        let found = changes(&picture(0, 0, 0, 0), &picture(56, 36, 4, 0), &picture(0, 0, 0, 0));
        assert_eq!(found.rose, None, "nothing got worse");
        let Square { x, y, side } = found.fell.unwrap();
        assert!(x <= 56 && y <= 36 && x + side <= 60 && y + side <= 40 && x + side >= 60 && y + side >= 40);
    }

    #[test]
    fn equal_renders_have_no_boxes() {
        let same = picture(3, 3, 5, 9);
        assert_eq!(changes(&picture(0, 0, 0, 0), &same, &same), Changes { fell: None, rose: None });
    }
}
