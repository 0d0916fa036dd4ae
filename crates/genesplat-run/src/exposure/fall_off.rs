//! Lenses that show corners darker than the middle: one number for all photos of a scene.
//!
//! A pixel at the share `r²` of the way to the corner, squared, is `exp(fall_off · r²)` times as bright. The
//! number is the one by which points come out alike wherever in a photo they are seen.

use genesplat_core::Camera;

use super::fit::{Seen, fit, robust_mean};
use super::samples::Sample;

/// Times that gains and fall-off are found in turn.
const ROUNDS: usize = 6;
/// Less is none: it would be noise. So is what makes corners brighter, which no lens does.
const LEAST: f64 = 0.03;
/// What no lens exceeds.
const MOST: f64 = 0.7;
/// Errors beyond this count less.
const NEAR: f64 = 0.03;

/// The square of a pixel's distance from the principal point; 1 where that is half the diagonal.
pub(super) fn radius_squared(camera: &Camera, x: f64, y: f64) -> f64 {
    let [cx, cy] = camera.principal_px;
    let diagonal = f64::from(camera.width).powi(2) + f64::from(camera.height).powi(2);
    4.0 * ((x - cx).powi(2) + (y - cy).powi(2)) / diagonal
}

/// The factors of a row of pixels.
pub(super) fn of_row(fall_off: f32, camera: &Camera, y: usize) -> Vec<f32> {
    let of = |x: u32| {
        let radius = radius_squared(camera, f64::from(x) + 0.5, y as f64 + 0.5);
        (f64::from(fall_off) * radius).exp() as f32
    };
    (0..camera.width).map(of).collect()
}

/// That of the photos with these samples of `points` points; 0 where there is none to speak of.
pub(super) fn find(photos: &[Vec<Sample>], points: usize) -> f32 {
    let samples =
        || (0u32..).zip(photos).flat_map(|(photo, samples)| samples.iter().map(move |at| (photo, at)));
    let mean = |sample: &Sample| sample.logs.iter().map(|log| f64::from(*log)).sum::<f64>() / 3.0;
    let radii: Vec<Seen> = samples()
        .map(|(photo, at)| Seen { photo, point: at.point, value: f64::from(at.radius_squared) })
        .collect();
    // What neither a photo nor a point can explain.
    let own = without_means(&radii, photos.len(), points);
    let mut fall_off = 0.0;
    for _ in 0..ROUNDS {
        let value = |at: &Sample| mean(at) - fall_off * f64::from(at.radius_squared);
        let seen: Vec<Seen> =
            samples().map(|(photo, at)| Seen { photo, point: at.point, value: value(at) }).collect();
        let found = fit(&seen, photos.len(), points);
        let (mut along, mut across) = (0.0, 0.0);
        for (seen, own) in seen.iter().zip(&own) {
            let Some(colour) = found.colours[seen.point as usize] else { continue };
            let error = seen.value - found.gains[seen.photo as usize] - colour;
            let weight = 1.0 / error.abs().max(NEAR);
            along += weight * own * error;
            across += weight * own * own;
        }
        fall_off += if across > 0.0 { along / across } else { 0.0 };
    }
    let is_some = fall_off < -LEAST;
    if is_some { fall_off.max(-MOST) as f32 } else { 0.0 }
}

/// A photo has other corners than the rest where its differences from points are smaller than this part of
/// what they are with theirs.
const OTHER: f64 = 0.97;

/// Whether each of these photos, which training does not see, shows corners as bright as the middle, though
/// the lens of training photos, whose samples are without it, has this fall-off.
pub(super) fn are_without(
    fall_off: f32,
    train: &[Vec<Sample>],
    test: &[Vec<Sample>],
    points: usize,
) -> Vec<bool> {
    let mean = |sample: &Sample| sample.logs.iter().map(|log| f64::from(*log)).sum::<f64>() / 3.0;
    let seen = |(photo, samples): (u32, &Vec<Sample>)| -> Vec<Seen> {
        samples.iter().map(|at| Seen { photo, point: at.point, value: mean(at) }).collect()
    };
    let seen: Vec<Seen> = (0u32..).zip(train).flat_map(seen).collect();
    let colours = fit(&seen, train.len(), points).colours;
    let difference = |samples: &[Sample], fall_off: f32| -> f64 {
        let of = |at: &Sample| {
            let corner = f64::from(fall_off * at.radius_squared);
            Some(mean(at) - corner - colours[at.point as usize]?)
        };
        let values: Vec<f64> = samples.iter().filter_map(of).collect();
        let gain = robust_mean(&values).unwrap_or(0.0);
        values.iter().map(|value| (value - gain).abs()).sum()
    };
    test.iter().map(|samples| difference(samples, 0.0) < OTHER * difference(samples, fall_off)).collect()
}

/// Values less the mean of their point, then less what is left of the mean of their photo.
fn without_means(seen: &[Seen], photos: usize, points: usize) -> Vec<f64> {
    let less = |values: Vec<f64>, place: &dyn Fn(&Seen) -> u32, count: usize| {
        let (mut sums, mut counts) = (vec![0.0; count], vec![0.0; count]);
        for (seen, value) in seen.iter().zip(&values) {
            sums[place(seen) as usize] += value;
            counts[place(seen) as usize] += 1.0;
        }
        let mean = |seen: &Seen| sums[place(seen) as usize] / counts[place(seen) as usize];
        seen.iter().zip(values).map(|(seen, value)| value - mean(seen)).collect::<Vec<f64>>()
    };
    let values = less(seen.iter().map(|seen| seen.value).collect(), &|seen| seen.point, points);
    less(values, &|seen| seen.photo, photos)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Photos with gains that see points at many places, through a lens with this fall-off.
    fn photos(put: f32) -> Vec<Vec<Sample>> {
        let of = |photo: u32| {
            let sample = |place: u32| {
                let point = (37 * photo + 3 * place) % 200;
                let radius_squared = ((17 * point + 53 * photo) % 100) as f32 / 100.0;
                let gain = 0.2 * (photo as f32).sin();
                let noise = 0.02 * ((point * 7919 + 31 * photo) % 11) as f32 / 11.0;
                let log = -1.0 + 0.3 * (point as f32).cos() + gain + put * radius_squared + noise;
                Sample { point, is_left: place.is_multiple_of(2), radius_squared, logs: [log; 3] }
            };
            (0..60).map(sample).collect()
        };
        (0..12).map(of).collect()
    }

    #[test]
    fn a_known_fall_off_is_found_and_none_is_none() {
        assert!((find(&photos(-0.2), 200) + 0.2).abs() < 0.01, "{}", find(&photos(-0.2), 200));
        assert_eq!(find(&photos(0.0), 200), 0.0);
        assert_eq!(find(&photos(0.2), 200), 0.0, "no lens makes corners brighter");
        assert_eq!(find(&[], 0), 0.0);
    }

    #[test]
    fn a_row_is_as_bright_as_its_radius_says() {
        let camera = Camera::at_origin(6, 8, 5.0);
        let row = of_row(-0.5, &camera, 3);
        let corner = (-0.5 * radius_squared(&camera, 0.0, 0.0)).exp();
        assert!((corner - (-0.5f64).exp()).abs() < 1e-12);
        assert!(row[2] > row[1] && row[1] > row[0] && f64::from(row[0]) > corner && row[2] < 1.0);
    }
}
