//! Contrast of photos, which cameras choose as they choose exposure: one number a photo, the power of the
//! colours of points that its values follow. Its logarithm has about the mean 0 over training photos.

use rayon::prelude::*;

use super::fit::{Fit, Seen, fit, huber_weights, median, robust_mean};
use super::of_channels;
use super::samples::Sample;

/// Times that colours and contrasts are found in turn, and weights for each.
const ROUNDS: usize = 4;
/// Standard deviation of contrasts, before anything is known of a photo.
const SPREAD: f64 = 0.1;
/// So many neighbouring samples tell as much as one that is far from all others.
const ALIKE: f64 = 10.0;

/// The logarithms of red, green or blue of points.
type Colours = Vec<Option<f64>>;

/// Those of training photos and of test photos with these samples of `points` points.
pub(super) fn find(train: &[Vec<Sample>], test: &[Vec<Sample>], points: usize) -> [Vec<f64>; 2] {
    let mut contrasts = vec![1.0; train.len()];
    let mut of_test = vec![1.0; test.len()];
    for _ in 0..ROUNDS {
        let flat = without(&contrasts, train);
        let colours = of_channels(|channel| of_channel(&flat, points, channel).colours);
        contrasts = train.par_iter().map(|samples| of_photo(samples, &colours)).collect();
        of_test = test.par_iter().map(|samples| of_photo(samples, &colours)).collect();
        // Colours are means, so they vary less than what each photo shows.
        let known = contrasts.iter().zip(train).filter(|(_, samples)| !samples.is_empty());
        let logs: Vec<f64> = known.map(|(contrast, _)| contrast.ln()).collect();
        let usual = (logs.iter().sum::<f64>() / logs.len().max(1) as f64).exp();
        let as_usual = |(contrast, samples): (&mut f64, &Vec<Sample>)| {
            *contrast = if samples.is_empty() { 1.0 } else { *contrast / usual };
        };
        contrasts.iter_mut().zip(train).for_each(as_usual);
        of_test.iter_mut().zip(test).for_each(as_usual);
    }
    [contrasts, of_test]
}

/// What photos of the usual contrast would show.
pub(super) fn without(contrasts: &[f64], photos: &[Vec<Sample>]) -> Vec<Vec<Sample>> {
    let flat = |(contrast, samples): (&f64, &Vec<Sample>)| {
        let flat = |at: &Sample| Sample { logs: at.logs.map(|log| log / *contrast as f32), ..*at };
        samples.iter().map(flat).collect()
    };
    contrasts.iter().zip(photos).map(flat).collect()
}

fn of_channel(photos: &[Vec<Sample>], points: usize, channel: usize) -> Fit {
    let seen = |(photo, samples): (u32, &Vec<Sample>)| -> Vec<Seen> {
        let of = |at: &Sample| Seen { photo, point: at.point, value: f64::from(at.logs[channel]) };
        samples.iter().map(of).collect()
    };
    let seen: Vec<Seen> = (0..).zip(photos).flat_map(seen).collect();
    fit(&seen, photos.len(), points)
}

/// A channel, the colour of a point there, and what the photo shows.
type Pair = (usize, f64, f64);

fn of_photo(samples: &[Sample], colours: &[Colours; 3]) -> f64 {
    let pair = |(at, channel): (&Sample, usize)| {
        Some((channel, colours[channel][at.point as usize]?, f64::from(at.logs[channel])))
    };
    let places = samples.iter().flat_map(|at| [0, 1, 2].map(|channel: usize| (at, channel)));
    let pairs: Vec<Pair> = places.filter_map(pair).collect();
    let mut contrast = 1.0;
    for _ in 0..ROUNDS {
        let errors = less_channels(&pairs, |(_, colour, value)| value - contrast * colour);
        let along = less_channels(&pairs, |(_, colour, _)| colour);
        let weights = huber_weights(&errors);
        let sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
        let usual = ALIKE * (median(&sizes).unwrap_or(0.0) / SPREAD).powi(2);
        let sum = |a: &[f64], b: &[f64]| -> f64 {
            weights.iter().zip(a).zip(b).map(|((weight, a), b)| weight * a * b).sum()
        };
        let across = sum(&along, &along) + usual;
        let step = sum(&along, &errors) - usual * (contrast - 1.0);
        contrast = (contrast + if across > 0.0 { step / across } else { 0.0 }).clamp(0.5, 2.0);
    }
    contrast
}

/// Values less the robust mean of their channel.
fn less_channels(pairs: &[Pair], value: impl Fn(Pair) -> f64) -> Vec<f64> {
    let means = [0, 1, 2].map(|channel| {
        let of_channel = pairs.iter().filter(|pair| pair.0 == channel);
        robust_mean(&of_channel.map(|pair| value(*pair)).collect::<Vec<_>>()).unwrap_or(0.0)
    });
    pairs.iter().map(|pair| value(*pair) - means[pair.0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Photos that follow points by these powers, each of them also brighter or darker.
    fn photos(powers: &[f64]) -> Vec<Vec<Sample>> {
        let of = |(photo, power): (u32, &f64)| {
            let sample = |place: u32| {
                let point = (37 * photo + 3 * place) % 200;
                let noise = 0.02 * f64::from((point * 7919 + 31 * photo) % 11) / 11.0;
                let log = |channel: u32| {
                    let colour = -1.0 + 0.6 * f64::from(point + 5 * channel).cos();
                    (0.2 * f64::from(photo).sin() + power * colour + noise) as f32
                };
                Sample {
                    point,
                    is_left: place.is_multiple_of(2),
                    radius_squared: 0.5,
                    logs: [0, 1, 2].map(log),
                }
            };
            (0..90).map(sample).collect()
        };
        (0..).zip(powers).map(of).collect()
    }

    #[test]
    fn known_contrasts_are_found_of_training_and_test_photos() {
        let powers: Vec<f64> = (0..12).map(|photo| 1.0 + 0.15 * f64::from(photo).cos()).collect();
        let usual = (powers.iter().map(|power| power.ln()).sum::<f64>() / 12.0).exp();
        let train = photos(&powers);
        let mut with_none = train.clone();
        with_none.push(Vec::new());
        let [of_train, of_test] = find(&with_none, &train[..3], 200);
        for (power, found) in powers.iter().zip(&of_train).chain(powers.iter().zip(&of_test)) {
            assert!((found - power / usual).abs() < 0.02, "{found} {}", power / usual);
        }
        assert_eq!((of_train[12], of_test.len()), (1.0, 3));
    }

    #[test]
    fn photos_of_one_contrast_have_it_and_noise_has_none() {
        let [found, _] = find(&photos(&[1.0; 12]), &[], 200);
        assert!(found.iter().all(|contrast| (contrast - 1.0).abs() < 0.01), "{found:?}");
        let few: Vec<Vec<Sample>> = photos(&[1.0; 12]).iter().map(|photo| photo[..1].to_vec()).collect();
        assert!(find(&few, &[], 200)[0].iter().all(|contrast| (contrast - 1.0).abs() < 0.05));
    }
}
