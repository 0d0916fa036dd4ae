//! What surrounds the subject of the photos.

use genesplat_core::{Photo, PhotoLost, View};

/// So many photos are looked at, evenly spread: a notice must not cost a pass over thousands.
const LOOKED_AT: usize = 16;

/// A subject is on white where this part of its photo's border is.
const WHITE_BORDER: f64 = 0.9;

/// A pixel is white from this 8-bit value on, in all channels; JPEG leaves no less of it.
const WHITE: u8 = 250;

/// Whether most photos show their subject on white. Before any other colour Gaussians must stand for that
/// white, and those that float before the subject cost nothing in the photos that see them before white.
pub fn are_on_white(views: &[&View]) -> Result<bool, PhotoLost> {
    let every = views.len().div_ceil(LOOKED_AT).max(1);
    let looked_at = || views.iter().step_by(every);
    let of_view = |view: &&View| {
        Ok(white_border(&*view.photo.read()?, view.mask.as_ref().map(|mask| &mask.counts[..])))
    };
    let on_white = looked_at().map(of_view).collect::<Result<Vec<_>, PhotoLost>>()?;
    Ok(2 * on_white.into_iter().filter(|&part| part >= WHITE_BORDER).count() > looked_at().count())
}

/// The white part of a photo's border, of the pixels that count.
fn white_border(photo: &Photo, counts: Option<&[bool]>) -> f64 {
    let [width, height] = [photo.width, photo.height].map(|side| side as usize);
    // Corners count twice.
    let rows = [0, height - 1].into_iter().flat_map(|row| (0..width).map(move |column| row * width + column));
    let columns =
        [0, width - 1].into_iter().flat_map(|column| (0..height).map(move |row| row * width + column));
    let border: Vec<usize> =
        rows.chain(columns).filter(|&at| counts.is_none_or(|counts| counts[at])).collect();
    let is_white = |at: &usize| photo.rgb[3 * at..3 * at + 3].iter().all(|&value| value >= WHITE);
    border.iter().filter(|at| is_white(at)).count() as f64 / border.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::{Camera, Mask};

    use super::*;

    /// Its inner pixels are black; of its border so many rows from the top are of another grey than the rest.
    fn view(top: u8, rows: usize, rest: u8) -> View {
        let (width, height) = (20, 10);
        let grey = |at: usize| match (at % width, at / width) {
            (1..19, 1..9) => 0,
            (_, row) if row < rows => top,
            _ => rest,
        };
        let rgb = (0..width * height).flat_map(|at| [grey(at); 3]).collect();
        let photo = Photo { width: width as u32, height: height as u32, rgb };
        View {
            name: String::new(),
            camera: Camera::at_origin(20, 10, 10.0),
            photo: photo.into(),
            mask: None,
            depth: None,
        }
    }

    #[test]
    fn a_white_border_is_told_from_a_white_sky() {
        let is_white = |view: View| are_on_white(&[&view]).unwrap();
        assert!(is_white(view(255, 10, 0)) && is_white(view(250, 10, 0)));
        assert!(!is_white(view(249, 10, 0)) && !is_white(view(0, 10, 0)));
        // 20 pixels above and below, ten at each side: 38 of 60; all of them.
        assert!(!is_white(view(255, 9, 100)) && is_white(view(255, 1, 255)));
    }

    #[test]
    fn most_photos_decide_and_hidden_pixels_do_not() {
        let (white, grey) = (view(255, 10, 0), view(100, 10, 0));
        assert!(are_on_white(&[&white, &grey, &white]).unwrap());
        assert!(!are_on_white(&[&white, &grey]).unwrap() && !are_on_white(&[]).unwrap());
        let counts = (0..200).map(|at| at >= 20).collect();
        let hidden = View { mask: Some(Arc::new(Mask { counts })), ..view(100, 1, 255) };
        assert!(are_on_white(&[&hidden]).unwrap());
        let nothing = View { mask: Some(Arc::new(Mask { counts: vec![false; 200] })), ..white };
        assert!(!are_on_white(&[&nothing]).unwrap());
    }
}
