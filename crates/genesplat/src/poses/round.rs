//! Photos of all around: twice as wide as high, and closed on themselves.
//!
//! Their shape alone does not tell, since phones take such photos, too; and programs that export frames drop
//! what their files say. So their rims are looked at: left and right meet, and each of the others is one
//! point of the sphere.

use std::path::Path;

use anyhow::{Result, bail};
use genesplat::core::Photo;
use genesplat::io::photos::{photo_size, read_photo, resize};
use genesplat::io::shown;
use rayon::prelude::*;

/// So many photos are looked at, at even distances: they say what the others are.
const LOOKED_AT: usize = 9;
/// Most that the ends of a photo may differ beyond neighbouring columns, of 255, on average of their rows.
const SEAM_MAX: f64 = 4.0;
/// Most that pixels of one colour differ from their mean, on average.
const PLAIN_MAX: f64 = 10.0;
/// Photos are reduced to this before they are looked at: noise is no difference.
const SMALL_PX: u32 = 256;

/// Whether the photos `names` in `images` show all around. Fails where some do and others do not.
pub(crate) fn show_all_around(images: &Path, names: &[String]) -> Result<bool> {
    let looked_at: Vec<&String> = names.iter().step_by(names.len().div_ceil(LOOKED_AT).max(1)).collect();
    let are_round = looked_at.par_iter().map(|name| is_round(&images.join(name)));
    let are_round = are_round.collect::<Result<Vec<bool>>>()?;
    let [round, other] = [true, false].map(|wanted| are_round.iter().position(|is| *is == wanted));
    if let (Some(round), Some(other)) = (round, other) {
        bail!(
            "{} shows all around, and {} does not; find the cameras of such photos apart from the others",
            shown(looked_at[round]),
            shown(looked_at[other])
        );
    }
    Ok(round.is_some())
}

fn is_round(photo: &Path) -> Result<bool> {
    let (width, height) = photo_size(photo)?;
    Ok(width == 2 * height && closes(&read_photo(photo)?))
}

/// Whether the left and the right end of `photo` meet, and its upper and lower row are one point each.
fn closes(photo: &Photo) -> bool {
    let small = resize(photo, SMALL_PX.min(photo.width), SMALL_PX.min(photo.height));
    let columns: Vec<Vec<u8>> = (0..small.width).map(|at| column(&small, at)).collect();
    let (Some(first), Some(last)) = (columns.first(), columns.last()) else { return false };
    let between = mean(columns.windows(2).map(|pair| difference(&pair[0], &pair[1])));
    let meet = difference(first, last) <= 2.0 * between + SEAM_MAX;
    // What stands before a plain background has plain rims, too.
    meet && !is_plain(first) && [0, photo.height - 1].iter().all(|at| is_plain(&row(photo, *at)))
}

fn column(photo: &Photo, at: u32) -> Vec<u8> {
    (0..photo.height).flat_map(|row| photo.pixel(at, row)).collect()
}

/// Without its noise.
fn row(photo: &Photo, at: u32) -> Vec<u8> {
    let (width, length) = (photo.width, 3 * photo.width as usize);
    let rgb = photo.rgb[length * at as usize..][..length].to_vec();
    resize(&Photo { width, height: 1, rgb }, SMALL_PX.min(width), 1).rgb
}

/// Whether pixels have one colour, or nearly so.
fn is_plain(rgb: &[u8]) -> bool {
    (0..3).all(|channel| {
        let values = || rgb.iter().skip(channel).step_by(3).map(|value| f64::from(*value));
        let mean_value = mean(values());
        mean(values().map(|value| (value - mean_value).abs())) <= PLAIN_MAX
    })
}

fn difference(a: &[u8], b: &[u8]) -> f64 {
    mean(a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))))
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0u32, 0.0), |(count, sum), value| (count + 1, sum + value));
    sum / f64::from(count.max(1))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use genesplat::io::photos::write_png;

    use super::*;

    /// A photo of the whole turn, or of a part of it, of something that lies all around.
    fn photo(turn: f64, rise: f64) -> Photo {
        let (width, height) = (256, 128);
        let value = |at: u32| {
            let longitude = turn * TAU * (f64::from(at % width) + 0.5) / f64::from(width);
            let latitude = rise * PI * ((f64::from(at / width) + 0.5) / f64::from(height) - 0.5);
            let [x, y, z] =
                [latitude.cos() * longitude.cos(), latitude.cos() * longitude.sin(), latitude.sin()];
            [x - z, y + 0.5 * z, z - y].map(|at| (128.0 + 100.0 * (2.0 * at).sin()) as u8)
        };
        Photo { width, height, rgb: (0..width * height).flat_map(value).collect() }
    }

    #[test]
    fn only_what_closes_on_itself_shows_all_around() {
        assert!(closes(&photo(1.0, 1.0)));
        for (turn, rise) in [(0.5, 1.0), (0.93, 1.0), (1.0, 0.5), (0.3, 0.3)] {
            assert!(!closes(&photo(turn, rise)), "{turn} of a turn, {rise} of the way from below to above");
        }
    }

    #[test]
    fn what_stands_before_a_plain_background_does_not() {
        let mut plain = photo(1.0, 1.0);
        let (width, rows) = (plain.width as usize, plain.height as usize);
        for (at, rgb) in plain.rgb.chunks_exact_mut(3).enumerate() {
            let is_inner =
                (20..width - 20).contains(&(at % width)) && (20..rows - 20).contains(&(at / width));
            rgb.iter_mut().filter(|_| !is_inner).for_each(|value| *value = 240);
        }
        assert!(!closes(&plain));
    }

    #[test]
    fn photos_of_both_kinds_are_refused_and_the_shape_is_asked_first() {
        let place = tempfile::tempdir().unwrap();
        let names = ["a.png", "b.png"].map(str::to_owned);
        let write = |photos: [Photo; 2]| {
            names
                .iter()
                .zip(photos)
                .for_each(|(name, photo)| write_png(&place.path().join(name), &photo).unwrap());
            show_all_around(place.path(), &names).map_err(|error| error.to_string())
        };
        let [round, part] = [photo(1.0, 1.0), photo(0.3, 0.3)];
        assert_eq!(write([round.clone(), round.clone()]), Ok(true));
        assert_eq!(write([part.clone(), resize(&round, 255, 128)]), Ok(false));
        let refused = write([part, round]).unwrap_err();
        assert!(refused.contains("b.png shows all around, and a.png does not"), "{refused}");
    }
}
