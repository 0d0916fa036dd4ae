//! Pictures: JPEG, reduction, a colour scale, and where a render differs from a photo.

use std::fmt::Write;
use std::ops::Range;

use genesplat_core::{Mask, Photo, PhotoLost, View};
use image::{ExtendedColorType, ImageEncoder};

/// A colour scale from dark to bright, so that it can be read without colours, too.
const SCALE: [[f32; 3]; 5] =
    [[0.05, 0.04, 0.12], [0.28, 0.13, 0.42], [0.73, 0.26, 0.38], [0.96, 0.58, 0.26], [1.0, 0.95, 0.76]];
/// What has no value.
const NOTHING: [u8; 3] = [18, 18, 20];
/// The difference at which the scale of errors ends, of 1.
pub(crate) const ERROR_MAX: f32 = 0.25;

pub(crate) fn encode_jpeg(photo: &Photo, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(&photo.rgb, photo.width, photo.height, ExtendedColorType::Rgb8)
        .expect("memory takes every picture whose sides were checked");
    bytes
}

/// The pixels of `from` that pixel `at` of `of` covers, at least one.
fn span(at: u32, of: u32, from: u32) -> Range<u32> {
    let begin = (u64::from(at) * u64::from(from) / u64::from(of)) as u32;
    let end = (u64::from(at + 1) * u64::from(from)).div_ceil(u64::from(of)) as u32;
    begin..end.clamp(begin + 1, from)
}

/// The photo at another size; each pixel is the mean of what it covers, or the nearest where it covers less
/// than one.
pub(crate) fn resized(photo: &Photo, width: u32, height: u32) -> Photo {
    if (width, height) == (photo.width, photo.height) {
        return photo.clone();
    }
    let mut rgb = Vec::with_capacity(3 * width as usize * height as usize);
    for y in 0..height {
        let rows = span(y, height, photo.height);
        for x in 0..width {
            rgb.extend(mean(photo, span(x, width, photo.width), rows.clone()));
        }
    }
    Photo { width, height, rgb }
}

fn mean(photo: &Photo, columns: Range<u32>, rows: Range<u32>) -> [u8; 3] {
    let (mut sum, count) = ([0_u32; 3], columns.len() * rows.len());
    for y in rows {
        for x in columns.clone() {
            photo.pixel(x, y).iter().zip(&mut sum).for_each(|(&value, sum)| *sum += u32::from(value));
        }
    }
    sum.map(|sum| ((sum + count as u32 / 2) / count as u32) as u8)
}

/// A picture of values on the colour scale: 0 is dark, 1 is bright.
pub(crate) fn coloured(width: u32, height: u32, values: impl Iterator<Item = Option<f32>>) -> Photo {
    let table: Vec<[u8; 3]> = (0..=255).map(|step| colour(step as f32 / 255.0)).collect();
    let pixel =
        |value: Option<f32>| value.map_or(NOTHING, |value| table[(value.clamp(0.0, 1.0) * 255.0) as usize]);
    Photo { width, height, rgb: values.flat_map(pixel).collect() }
}

fn colour(value: f32) -> [u8; 3] {
    let at = value * (SCALE.len() - 1) as f32;
    let below = (at as usize).min(SCALE.len() - 2);
    let share = at - below as f32;
    std::array::from_fn(|channel| {
        let mixed = SCALE[below][channel] * (1.0 - share) + SCALE[below + 1][channel] * share;
        (255.0 * mixed + 0.5) as u8
    })
}

/// Where `render` differs from the photo of `view`: the mean difference of the channels, bright at
/// [`ERROR_MAX`]. What a mask hides has none.
pub(crate) fn error_picture(render: &Photo, view: &View) -> Result<Photo, PhotoLost> {
    let Photo { width, height, .. } = *render;
    let photo = resized(&*view.photo.read()?, width, height);
    let differences = render.rgb.chunks_exact(3).zip(photo.rgb.chunks_exact(3)).map(|(a, b)| {
        let sum: u32 = a.iter().zip(b).map(|(&a, &b)| u32::from(a.abs_diff(b))).sum();
        sum as f32 / (3.0 * 255.0) / ERROR_MAX
    });
    let covered = |x, y| [span(x, width, view.photo.width()), span(y, height, view.photo.height())];
    let is_counted =
        |(x, y)| view.mask.as_ref().is_none_or(|mask| counts(mask, view.photo.width(), covered(x, y)));
    let counted = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(is_counted);
    Ok(coloured(
        width,
        height,
        differences.zip(counted).map(|(difference, counts)| counts.then_some(difference)),
    ))
}

/// Whether all of these columns and rows count.
fn counts(mask: &Mask, width: u32, [columns, rows]: [Range<u32>; 2]) -> bool {
    let row = |y: u32| &mask.counts[(y * width + columns.start) as usize..(y * width + columns.end) as usize];
    rows.into_iter().all(|y| row(y).iter().all(|&counts| counts))
}

/// The value that one in fifty is above.
pub(crate) fn high_quantile(values: impl Iterator<Item = f32>) -> Option<f32> {
    let mut values: Vec<f32> = values.filter(|value| value.is_finite()).collect();
    let at = (values.len() * 49 / 50).min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

/// The colour scale from dark to bright, as a gradient of CSS.
pub(crate) fn css_gradient() -> String {
    let mut stops = String::new();
    for step in 0..SCALE.len() {
        let [r, g, b] = colour(step as f32 / (SCALE.len() - 1) as f32);
        write!(stops, ",rgb({r} {g} {b})").expect("text grows");
    }
    format!("linear-gradient(90deg{stops})")
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::Camera;

    use super::*;

    fn photo(width: u32, height: u32, rgb: impl Fn(u32, u32) -> [u8; 3]) -> Photo {
        let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Photo { width, height, rgb: rows.flat_map(|(x, y)| rgb(x, y)).collect() }
    }

    #[test]
    fn reduction_takes_means_and_enlargement_repeats() {
        let checks = photo(4, 4, |x, y| if (x + y) % 2 == 0 { [200, 0, 10] } else { [100, 0, 20] });
        assert_eq!(resized(&checks, 2, 2), photo(2, 2, |_, _| [150, 0, 15]));
        let large = resized(&photo(2, 1, |x, _| [x as u8; 3]), 4, 2);
        assert_eq!(large, photo(4, 2, |x, _| [(x / 2) as u8; 3]));
    }

    #[test]
    fn errors_are_bright_where_pictures_differ() {
        let (grey, spot) =
            (photo(4, 4, |_, _| [90; 3]), photo(4, 4, |x, _| [if x == 2 { 250 } else { 90 }; 3]));
        let camera = Camera::at_origin(4, 4, 4.0);
        let mut view = View { name: String::new(), camera, photo: spot.into(), mask: None, depth: None };
        let errors = error_picture(&grey, &view).unwrap();
        assert_eq!((errors.pixel(2, 1), errors.pixel(1, 1)), (colour(1.0), colour(0.0)));
        view.mask = Some(Arc::new(Mask { counts: (0..16).map(|pixel| pixel != 6).collect() }));
        let errors = error_picture(&grey, &view).unwrap();
        assert_eq!(
            (errors.pixel(2, 1), errors.pixel(2, 2)),
            (NOTHING, colour(1.0)),
            "what a mask hides has no error"
        );
        let half = photo(2, 2, |_, _| [90; 3]);
        assert_eq!(
            error_picture(&half, &view).unwrap().pixel(1, 0),
            NOTHING,
            "nor has what it hides a part of"
        );
    }

    #[test]
    fn a_jpeg_is_one_and_the_scale_grows_brighter() {
        let jpeg = encode_jpeg(&photo(20, 10, |x, y| [x as u8, y as u8, 7]), 80);
        assert!(jpeg.starts_with(&[0xff, 0xd8, 0xff]));
        let brightness =
            |step: usize| colour(step as f32 / 8.0).iter().map(|&value| u32::from(value)).sum::<u32>();
        assert!((0..8).all(|step| brightness(step) < brightness(step + 1)));
        assert_eq!(css_gradient().matches("rgb(").count(), SCALE.len());
        assert_eq!(high_quantile((0..100).map(|value| value as f32)), Some(98.0));
        assert_eq!(high_quantile(std::iter::empty()), None);
    }
}
