//! Pictures arranged on a white sheet.

use genesplat::core::Photo;

/// White between pictures, px.
pub const GAP_PX: u32 = 4;

/// A white picture.
pub fn blank(width: u32, height: u32) -> Photo {
    Photo { width, height, rgb: vec![255; 3 * (width * height) as usize] }
}

/// Pictures from left to right, with white between them and below the shorter ones.
pub fn side_by_side(pictures: &[Photo]) -> Photo {
    let mut offset = 0;
    let placed: Vec<_> = pictures
        .iter()
        .map(|picture| {
            let at = offset;
            offset += picture.width + GAP_PX;
            (at, 0, picture)
        })
        .collect();
    placed_on_white(&placed)
}

/// Pictures from top to bottom, with white between them.
pub fn stacked(pictures: &[Photo]) -> Photo {
    let mut offset = 0;
    let placed: Vec<_> = pictures
        .iter()
        .map(|picture| {
            let at = offset;
            offset += picture.height + GAP_PX;
            (0, at, picture)
        })
        .collect();
    placed_on_white(&placed)
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
        assert_eq!(
            [(0, 0), (1, 0), (5, 0), (0, 1), (5, 1)].map(|(x, y)| joined.pixel(x, y)[0]),
            [1, 255, 2, 1, 255]
        );
    }
}
