//! Pictures arranged on a white sheet, with names and marked places.

use std::sync::LazyLock;

use genesplat::core::Photo;
use genesplat::io::photos::resize;
use image::GrayImage;

use crate::report::crops::{Square, where_better};

/// White between pictures, px.
const GAP_PX: u32 = 8;
/// Side of an enlarged crop, px.
const CROP_PX: u32 = 240;
/// Width of a frame's line, px.
const LINE_PX: u32 = 3;
const INK: u8 = 40;

/// The printable characters of ASCII in DejaVu Sans, white on black, in cells of one width.
static LETTERS: LazyLock<GrayImage> = LazyLock::new(|| {
    let bytes = include_bytes!("../../assets/letters.png");
    image::load_from_memory(bytes).expect("the file is a part of the program").to_luma8()
});
const LETTER_WIDTH_PX: u32 = 34;
const LETTER_HEIGHT_PX: u32 = 40;
/// White between two letters, px.
const LETTER_GAP_PX: u32 = 3;
const SPACE_PX: u32 = 9;

/// Where error fell.
const GREEN: [u8; 3] = [0, 200, 60];
/// Where error rose.
const RED: [u8; 3] = [230, 20, 20];
const PLACES: [usize; 2] = [2, 1];

/// A place to show enlarged, and the colour of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Mark {
    square: Square,
    colour: [u8; 3],
}

/// A photo and two renders of it, and where the error of the second is lower than that of the first by most (green), or
/// higher (red).
pub(crate) fn changes(photo: &Photo, names: [&str; 2], [without, with]: [&Photo; 2]) -> Photo {
    let fell = where_better(photo, without, with, PLACES[0]).into_iter().map(|square| (square, GREEN));
    let rose = where_better(photo, with, without, PLACES[1]).into_iter().map(|square| (square, RED));
    let marks: Vec<Mark> = fell.chain(rose).map(|(square, colour)| Mark { square, colour }).collect();
    comparison(&[("photo", photo), (names[0], without), (names[1], with)], &marks)
}

/// The first picture whole, with the places framed; beside it a row for each place, with what each picture has there,
/// enlarged. Without places, the pictures stand side by side. All have one size.
fn comparison(pictures: &[(&str, &Photo)], marks: &[Mark]) -> Photo {
    let columns: Vec<Photo> = match marks {
        [] => pictures.iter().map(|(name, picture)| titled(name, picture)).collect(),
        _ => pictures.iter().map(|(name, picture)| titled(name, &crops(picture, marks))).collect(),
    };
    let height = columns.first().map_or(0, |column| column.height);
    let whole = pictures.first().filter(|_| !marks.is_empty());
    let whole = whole.map(|(_, picture)| framed(picture, height, marks));
    side_by_side(&whole.into_iter().chain(columns).collect::<Vec<_>>())
}

/// A picture at this height, with frames around the places.
fn framed(picture: &Photo, height: u32, marks: &[Mark]) -> Photo {
    let scale = f64::from(height) / f64::from(picture.height);
    let scaled = |length: u32| (scale * f64::from(length)).round() as u32;
    let mut whole = resize(picture, scaled(picture.width).max(1), height);
    for Mark { square: Square { x, y, side }, colour } in marks {
        let side = scaled(*side).min(whole.width).min(whole.height);
        let (x, y) = (scaled(*x).min(whole.width - side), scaled(*y).min(whole.height - side));
        outline(&mut whole, Square { x, y, side }, *colour);
    }
    whole
}

/// What a picture has in the places, enlarged, one below the other.
fn crops(picture: &Photo, marks: &[Mark]) -> Photo {
    let crop = |Mark { square: Square { x, y, side }, colour }: &Mark| {
        let pixels = (*y..y + side).flat_map(|row| (*x..x + side).flat_map(move |x| picture.pixel(x, row)));
        let pixels = Photo { width: *side, height: *side, rgb: pixels.collect() };
        let mut enlarged = resize(&pixels, CROP_PX, CROP_PX);
        outline(&mut enlarged, Square { x: 0, y: 0, side: CROP_PX }, *colour);
        enlarged
    };
    stacked(&marks.iter().map(crop).collect::<Vec<_>>())
}

/// Draws the border of a square, within it.
fn outline(picture: &mut Photo, Square { x, y, side }: Square, colour: [u8; 3]) {
    let width = picture.width;
    let mut fill = |columns: std::ops::Range<u32>, rows: std::ops::Range<u32>| {
        for row in rows {
            let at = |column: u32| 3 * (row * width + column) as usize;
            let line = &mut picture.rgb[at(columns.start)..at(columns.end)];
            line.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&colour));
        }
    };
    let line = LINE_PX.min(side);
    fill(x..x + side, y..y + line);
    fill(x..x + side, y + side - line..y + side);
    fill(x..x + line, y..y + side);
    fill(x + side - line..x + side, y..y + side);
}

/// A picture with its name above it; what of the name is wider than the picture is cut off.
fn titled(name: &str, picture: &Photo) -> Photo {
    let mut title = blank(picture.width, LETTER_HEIGHT_PX);
    let mut left = 0;
    for letter in name.chars() {
        left += draw_letter(&mut title, letter, left);
    }
    placed_on_white(&[(0, 0, &title), (0, LETTER_HEIGHT_PX, picture)])
}

/// Draws a letter so many pixels from the left; returns the pixels to the next one.
fn draw_letter(line: &mut Photo, letter: char, left: u32) -> u32 {
    let index = if letter.is_ascii_graphic() { letter as u32 - 32 } else { 0 };
    let at = |x: u32, y: u32| LETTERS.get_pixel(LETTER_WIDTH_PX * index + x, y).0[0];
    let has_ink = |x: &u32| (0..LETTER_HEIGHT_PX).any(|y| at(*x, y) > 0);
    let first = (0..LETTER_WIDTH_PX).find(has_ink);
    let last = (0..LETTER_WIDTH_PX).rfind(has_ink);
    let (Some(first), Some(last)) = (first, last) else { return SPACE_PX };
    let columns = (first..=last).take_while(|x| left + x - first < line.width);
    for (x, y) in columns.flat_map(|x| (0..LETTER_HEIGHT_PX).map(move |y| (x, y))) {
        let grey = 255 - (u32::from(255 - INK) * u32::from(at(x, y)) / 255) as u8;
        let place = 3 * (y * line.width + left + x - first) as usize;
        line.rgb[place..place + 3].fill(grey);
    }
    last - first + 1 + LETTER_GAP_PX
}

fn blank(width: u32, height: u32) -> Photo {
    Photo { width, height, rgb: vec![255; 3 * (width * height) as usize] }
}

/// Pictures from left to right, with white between them and below the shorter ones.
fn side_by_side(pictures: &[Photo]) -> Photo {
    let ends = pictures.iter().scan(0, |end, picture| {
        *end += picture.width + GAP_PX;
        Some((*end - picture.width - GAP_PX, 0, picture))
    });
    placed_on_white(&ends.collect::<Vec<_>>())
}

pub(crate) fn stacked(pictures: &[Photo]) -> Photo {
    let ends = pictures.iter().scan(0, |end, picture| {
        *end += picture.height + GAP_PX;
        Some((0, *end - picture.height - GAP_PX, picture))
    });
    placed_on_white(&ends.collect::<Vec<_>>())
}

/// A white sheet that just holds pictures at these places.
fn placed_on_white(placed: &[(u32, u32, &Photo)]) -> Photo {
    let width = placed.iter().map(|(x, _, picture)| x + picture.width).max().unwrap_or(0);
    let height = placed.iter().map(|(_, y, picture)| y + picture.height).max().unwrap_or(0);
    let mut sheet = blank(width, height);
    for (x, y, picture) in placed {
        for (row, line) in picture.rgb.chunks_exact(3 * picture.width as usize).enumerate() {
            let at = 3 * ((y + row as u32) * width + x) as usize;
            sheet.rgb[at..at + line.len()].copy_from_slice(line);
        }
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32, value: u8) -> Photo {
        Photo { width, height, rgb: vec![value; 3 * (width * height) as usize] }
    }

    #[test]
    fn pictures_stand_side_by_side() {
        let joined = side_by_side(&[picture(1, 2, 1), picture(1, 1, 2)]);
        assert_eq!((joined.width, joined.height), (2 + GAP_PX, 2));
        let places = [(0, 0), (1, 0), (1 + GAP_PX, 0), (0, 1), (1 + GAP_PX, 1)];
        assert_eq!(places.map(|(x, y)| joined.pixel(x, y)[0]), [1, 255, 2, 1, 255]);
    }

    #[test]
    fn places_are_framed_in_the_whole_picture_and_enlarged_beside_it() {
        let (photo, mut without) = (picture(240, 120, 100), picture(240, 120, 100));
        // The error fills the place at (60, 40) of 40 px.
        for y in 40..80 {
            let at = 3 * (y * 240 + 60) as usize;
            without.rgb[at..at + 3 * 40].fill(180);
        }
        let mark = |x, colour| Mark { square: Square { x, y: 40, side: 40 }, colour };
        let marks = [mark(60, GREEN), mark(150, RED)];
        let sheet = comparison(&[("photo", &photo), ("a", &without)], &marks);
        let top = LETTER_HEIGHT_PX;
        let tall = top + 2 * CROP_PX + GAP_PX;
        let wide = 2 * tall;
        assert_eq!((sheet.width, sheet.height), (wide + 2 * (CROP_PX + GAP_PX), tall));
        let scaled = |length: u32| (f64::from(length) * f64::from(tall) / 120.0).round() as u32;
        assert_eq!(sheet.pixel(scaled(60), scaled(40)), GREEN);
        assert_eq!(sheet.pixel(scaled(150), scaled(40)), RED);
        let (first, second) = (wide + GAP_PX, wide + 2 * GAP_PX + CROP_PX);
        let centre = |left: u32, row: u32| sheet.pixel(left + 120, top + 120 + row * (CROP_PX + GAP_PX))[0];
        assert_eq!([centre(first, 0), centre(second, 0), centre(second, 1)], [100, 180, 100]);
        assert_eq!(sheet.pixel(second, top), GREEN, "the frame of the crop");
        let is_dark = |left: u32| (0..CROP_PX).any(|x| (0..top).any(|y| sheet.pixel(left + x, y)[0] < 100));
        assert!(is_dark(first) && is_dark(second), "each column has its name");
    }

    #[test]
    fn names_stay_above_their_picture() {
        let sheet = titled("a name that is far too long for this", &picture(50, 10, 0));
        assert_eq!((sheet.width, sheet.height), (50, 10 + LETTER_HEIGHT_PX));
        let sheet = comparison(&[("é", &picture(9, 9, 0)), ("", &picture(9, 9, 0))], &[]);
        assert_eq!(sheet.width, 18 + GAP_PX, "nothing to mark, nothing enlarged");
    }

    #[test]
    fn places_where_error_fell_are_green_and_those_where_it_rose_red() {
        let (photo, mut without, mut with) =
            (picture(320, 200, 100), picture(320, 200, 100), picture(320, 200, 100));
        // The window is 53 px; an error fills it at (100, 40) in one render, and at (200, 120) in the other.
        for y in 40..93 {
            let at = |x: u32, y: u32| 3 * (y * 320 + x) as usize;
            without.rgb[at(100, y)..at(153, y)].fill(180);
            with.rgb[at(200, y + 80)..at(253, y + 80)].fill(180);
        }
        let sheet = changes(&photo, ["off", "renew"], [&without, &with]);
        let count = |colour| sheet.rgb.chunks_exact(3).filter(|pixel| *pixel == colour).count();
        assert!(count(GREEN) > 100 && count(RED) > 100);
        let swapped = changes(&photo, ["off", "renew"], [&photo, &without]);
        assert!(swapped.rgb.chunks_exact(3).all(|pixel| pixel != GREEN), "nothing got better");
    }

    #[test]
    fn each_place_that_differs_has_a_row_of_crops() {
        let grey = |value| picture(60, 60, value);
        let whole = changes(&grey(9), ["a", "b"], [&grey(50), &grey(9)]);
        let same = changes(&grey(9), ["a", "b"], [&grey(9), &grey(9)]);
        assert!(whole.width > whole.height && whole.height > 2 * same.height, "{} px", whole.height);
    }
}
