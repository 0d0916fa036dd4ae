//! Pictures arranged on a white sheet, with marked places.

use genesplat_core::Photo;
use genesplat_io::photos::resize;

use crate::report::crops::{Square, where_better};

/// White between pictures, px.
const GAP_PX: u32 = 8;
/// Side of an enlarged crop, px.
const CROP_PX: u32 = 240;
/// Width of a frame's line, px.
const LINE_PX: u32 = 3;

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

/// A photo and two renders of it, and where the error of the second is lower than that of the first by most
/// (green), or higher (red). The photo is whole, with the places framed; beside it, in the order photo,
/// first, second, is what each picture has there, enlarged. Where nothing differs, the pictures stand side by
/// side.
pub fn changes(photo: &Photo, [without, with]: [&Photo; 2]) -> Photo {
    let fell = where_better(photo, without, with, PLACES[0]).into_iter().map(|square| (square, GREEN));
    let rose = where_better(photo, with, without, PLACES[1]).into_iter().map(|square| (square, RED));
    let marks: Vec<Mark> = fell.chain(rose).map(|(square, colour)| Mark { square, colour }).collect();
    let pictures = [photo, without, with];
    if marks.is_empty() {
        return side_by_side(&pictures.map(Clone::clone));
    }
    let [a, b, c] = pictures.map(|picture| crops(picture, &marks));
    side_by_side(&[framed(photo, a.height, &marks), a, b, c])
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

/// Pictures one below the other.
pub fn stacked(pictures: &[Photo]) -> Photo {
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
        let (photo, mut without, mut with) =
            (picture(240, 120, 100), picture(240, 120, 100), picture(240, 120, 100));
        // Errors that fill a place of 40 px, the first at (60, 40) and the second at (150, 40).
        for y in 40..80 {
            let at = |x: u32| 3 * (y * 240 + x) as usize;
            without.rgb[at(60)..at(100)].fill(180);
            with.rgb[at(150)..at(190)].fill(20);
        }
        let sheet = changes(&photo, [&without, &with]);
        let tall = 2 * CROP_PX + GAP_PX;
        let wide = 2 * tall;
        assert_eq!((sheet.width, sheet.height), (wide + 3 * (CROP_PX + GAP_PX), tall));
        let scaled = |length: u32| (f64::from(length) * f64::from(tall) / 120.0).round() as u32;
        assert_eq!(sheet.pixel(scaled(60), scaled(40)), GREEN);
        assert_eq!(sheet.pixel(scaled(150), scaled(40)), RED);
        let left = |column: u32| wide + GAP_PX + column * (CROP_PX + GAP_PX);
        let centre =
            |column: u32, row: u32| sheet.pixel(left(column) + 120, 120 + row * (CROP_PX + GAP_PX))[0];
        assert_eq!(
            [0, 1, 2].map(|column| [centre(column, 0), centre(column, 1)]),
            [[100, 100], [180, 100], [100, 20]]
        );
        assert_eq!(
            [sheet.pixel(left(1), 0), sheet.pixel(left(1), tall - 1)],
            [GREEN, RED],
            "frames of the crops"
        );
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
        let sheet = changes(&photo, [&without, &with]);
        let count = |colour| sheet.rgb.chunks_exact(3).filter(|pixel| *pixel == colour).count();
        assert!(count(GREEN) > 100 && count(RED) > 100);
        let swapped = changes(&photo, [&photo, &without]);
        assert!(swapped.rgb.chunks_exact(3).all(|pixel| pixel != GREEN), "nothing got better");
    }

    #[test]
    fn each_place_that_differs_has_a_row_of_crops() {
        let grey = |value| picture(60, 60, value);
        let whole = changes(&grey(9), [&grey(50), &grey(9)]);
        let same = changes(&grey(9), [&grey(9), &grey(9)]);
        assert!(whole.width > whole.height && whole.height > 2 * same.height, "{} px", whole.height);
    }
}
