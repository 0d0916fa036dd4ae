//! From samples to the gains of photos, and whether they are worth anything.

use super::fit::{Seen, colours, fit, robust_mean};
use super::samples::Sample;
use super::{PIVOT, contrast, fall_off, of_channels};

/// Fewest samples that tell a photo's gain.
const SAMPLES_MIN: usize = 20;
/// The same of half a photo, when gains are judged.
const HALF_MIN: usize = 8;
/// Fewest training photos that can be told apart.
const PHOTOS_MIN: usize = 3;
/// Parts of the logarithms of gains, of which the best is believed.
const SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// The gains of photos: by what factor each is brighter than the mean exposure, of 8-bit values.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Estimate {
    /// Of training photos and test photos; `None` where too few points are shared.
    pub(super) gains: [Vec<Option<[f32; 3]>>; 2],
    /// Standard deviation of the training photos' exposure, stops of light at a gamma of 2.2.
    pub(super) stops: f64,
    /// By what share of it the mean difference of a photo's half from the colours of points is smaller, with
    /// the gain that its other half tells, as far as gains are believed: of [`SHARES`], the one with which
    /// it is least.
    pub(super) explained: f64,
    /// The powers of colours that photos follow: 1 for all where that explains no more.
    pub(super) contrasts: [Vec<f32>; 2],
    /// What lenses do to corners: [`fall_off`].
    pub(super) fall_off: f32,
    /// Which test photos have none.
    pub(super) plain_corners: Vec<bool>,
}

/// Contrasts are used where differences are smaller than this part of those without them.
const PAYS: f64 = 0.99;

/// One channel's logarithms.
struct Channel {
    /// Those of training photos and test photos.
    gains: [Vec<Option<f64>>; 2],
    /// Sums of absolute differences with [`SHARES`] of gains.
    differences: [f64; SHARES.len()],
}

/// From the samples of each training photo and of each test photo; `None` where too little is shared.
pub(super) fn estimate(train: &[Vec<Sample>], test: &[Vec<Sample>]) -> Option<Estimate> {
    let shared = Shared::of(train);
    let [train, test] = [train, test].map(|photos| shared.samples(photos));
    let is_known = |samples: &Vec<Sample>| samples.len() >= SAMPLES_MIN;
    if train.iter().filter(|samples| is_known(samples)).count() < PHOTOS_MIN {
        return None;
    }
    let fall_off = fall_off::find(&train, shared.points.len());
    let points = shared.points.len();
    let train = without(fall_off, train);
    let plain_corners = fall_off::are_without(fall_off, &train, &test, points);
    let as_lens = |(samples, is_plain): (Vec<Sample>, &bool)| {
        without(if *is_plain { 0.0 } else { fall_off }, vec![samples]).remove(0)
    };
    let test: Vec<Vec<Sample>> = test.into_iter().zip(&plain_corners).map(as_lens).collect();
    let of = |train: &[Vec<Sample>], test: &[Vec<Sample>]| {
        of_channels(|channel| of_channel(train, test, points, channel))
    };
    let found = contrast::find(&train, &test, points);
    let [plain, flat] =
        [of(&train, &test), of(&contrast::without(&found[0], &train), &contrast::without(&found[1], &test))];
    let [with_plain, with_flat] = [&plain, &flat].map(believed);
    let before = sum(&plain, 0);
    let pays = with_flat.1 < PAYS * with_plain.1;
    let (channels, (share, after)) = if pays { (flat, with_flat) } else { (plain, with_plain) };
    let contrasts = found.map(|contrasts| {
        contrasts
            .iter()
            .map(|found| if pays { 1.0 + share * (found - 1.0) } else { 1.0 })
            .collect::<Vec<f64>>()
    });
    let explained = if before > 0.0 { 1.0 - after / before } else { 0.0 };
    let stops = stops(&gains(&channels, 1.0, &contrasts));
    let gains = gains(&channels, share, &contrasts);
    let contrasts = contrasts.map(|of| of.iter().map(|contrast| *contrast as f32).collect());
    Some(Estimate { gains, stops, explained, contrasts, fall_off, plain_corners })
}

/// At [`PIVOT`], of photos with these contrasts: this share of what was found.
fn gains(channels: &[Channel; 3], share: f64, contrasts: &[Vec<f64>; 2]) -> [Vec<Option<[f32; 3]>>; 2] {
    [0, 1].map(|part| {
        let of = |(photo, contrast): (usize, &f64)| {
            let [r, g, b] = channels.each_ref().map(|channel| channel.gains[part][photo]);
            let log = |log: f64| contrast * share * log + (contrast - 1.0) * f64::from(PIVOT).ln();
            Some([r?, g?, b?].map(|found| log(found).exp() as f32))
        };
        contrasts[part].iter().enumerate().map(of).collect()
    })
}

fn sum(channels: &[Channel; 3], at: usize) -> f64 {
    channels.iter().map(|channel| channel.differences[at]).sum()
}

/// The share with which halves of photos are most alike, and what their differences are then.
fn believed(channels: &[Channel; 3]) -> (f64, f64) {
    let best =
        (1..SHARES.len()).fold(0, |best, at| if sum(channels, at) < sum(channels, best) { at } else { best });
    (SHARES[best], sum(channels, best))
}

/// What a lens without this fall-off would have shown.
fn without(fall_off: f32, mut photos: Vec<Vec<Sample>>) -> Vec<Vec<Sample>> {
    for sample in photos.iter_mut().flatten() {
        sample.logs = sample.logs.map(|log| log - fall_off * sample.radius_squared);
    }
    photos
}

/// Points that at least two training photos show, in order.
struct Shared {
    points: Vec<u32>,
}

impl Shared {
    fn of(train: &[Vec<Sample>]) -> Self {
        let known = train.iter().filter(|samples| samples.len() >= SAMPLES_MIN).flatten();
        let mut all: Vec<u32> = known.map(|sample| sample.point).collect();
        all.sort_unstable();
        let shared = all.chunk_by(|a, b| a == b).filter(|photos| photos.len() > 1);
        Self { points: shared.map(|photos| photos[0]).collect() }
    }

    /// The samples at these points, by their places among them; none of a photo that has too few.
    fn samples(&self, photos: &[Vec<Sample>]) -> Vec<Vec<Sample>> {
        let place = |sample: &Sample| {
            let place = self.points.binary_search(&sample.point).ok()?;
            Some(Sample { point: place as u32, ..*sample })
        };
        let of_photo = |samples: &Vec<Sample>| {
            let samples: Vec<Sample> = samples.iter().filter_map(place).collect();
            if samples.len() >= SAMPLES_MIN { samples } else { Vec::new() }
        };
        photos.iter().map(of_photo).collect()
    }
}

fn of_channel(train: &[Vec<Sample>], test: &[Vec<Sample>], points: usize, channel: usize) -> Channel {
    let value = |sample: &Sample| f64::from(sample.logs[channel]);
    let seen: Vec<Seen> = (0..)
        .zip(train)
        .flat_map(|(photo, samples)| {
            samples.iter().map(move |sample| Seen { photo, point: sample.point, value: value(sample) })
        })
        .collect();
    let found = fit(&seen, train.len(), points);
    // The difference of a sample from the colour of its point.
    let differences = |samples: &[Sample], is_left: Option<bool>| -> Vec<f64> {
        let of_half = samples.iter().filter(|sample| is_left.is_none_or(|left| left == sample.is_left));
        of_half.filter_map(|sample| Some(value(sample) - found.colours[sample.point as usize]?)).collect()
    };
    let with = SHARES.map(|share| {
        colours(&seen, &found.gains.iter().map(|gain| share * gain).collect::<Vec<_>>(), points)
    });
    let mut sums = [0.0; SHARES.len()];
    for samples in train {
        for is_left in [false, true] {
            let other = differences(samples, Some(!is_left));
            let Some(gain) = robust_mean(&other).filter(|_| other.len() >= HALF_MIN) else { continue };
            for sample in samples.iter().filter(|sample| sample.is_left == is_left) {
                for ((sum, share), colours) in sums.iter_mut().zip(SHARES).zip(&with) {
                    let colour = colours[sample.point as usize];
                    *sum += colour.map_or(0.0, |colour| (value(sample) - colour - share * gain).abs());
                }
            }
        }
    }
    let known = |(samples, gain): (&Vec<Sample>, &f64)| (!samples.is_empty()).then_some(*gain);
    let of_test = |samples: &Vec<Sample>| {
        let differences = differences(samples, None);
        robust_mean(&differences).filter(|_| differences.len() >= SAMPLES_MIN)
    };
    let gains = [train.iter().zip(&found.gains).map(known).collect(), test.iter().map(of_test).collect()];
    Channel { gains, differences: sums }
}

/// Of the training photos whose gains are known, the mean of channels.
fn stops([train, _]: &[Vec<Option<[f32; 3]>>; 2]) -> f64 {
    let of = |gain: &[f32; 3]| 2.2 / 3.0 * gain.iter().map(|gain| f64::from(gain.log2())).sum::<f64>();
    let known: Vec<f64> = train.iter().flatten().map(of).collect();
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    (known.iter().map(|stops| (stops - mean).powi(2)).sum::<f64>() / known.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Photos that see 60 of 200 points each, whose gains are these; `tilt` makes the left half of every
    /// second photo darker, as light does that moves.
    fn photos(gains: &[[f32; 3]], tilt: f32) -> Vec<Vec<Sample>> {
        let of = |(photo, gain): (usize, &[f32; 3])| {
            let sample = |place: u32| {
                let point = (37 * photo as u32 + 3 * place) % 200;
                let is_left = place.is_multiple_of(2);
                let colour = 0.2 + 0.5 * (point as f32 / 200.0);
                let noise = 0.02 * ((point * 7919 + 31 * photo as u32) % 11) as f32 / 11.0;
                let tilted = if is_left == photo.is_multiple_of(2) { tilt } else { -tilt };
                let logs = [0, 1, 2].map(|c: usize| (colour * gain[c]).ln() + noise + tilted);
                Sample { point, is_left, radius_squared: 0.5, logs }
            };
            (0..60).map(sample).collect()
        };
        gains.iter().enumerate().map(of).collect()
    }

    #[test]
    fn gains_of_training_and_test_photos_are_found() {
        let put: Vec<[f32; 3]> =
            (0..12).map(|photo| [0.7 + 0.05 * photo as f32, 1.0, 1.3 - 0.02 * photo as f32]).collect();
        let (mut train, test) = (photos(&put, 0.0), photos(&put[..4], 0.0));
        // One that shares nothing is not known, and changes nothing.
        train.push(
            (700..740)
                .map(|point| Sample { point, is_left: true, radius_squared: 0.5, logs: [-1.0; 3] })
                .collect(),
        );
        let found = estimate(&train, &test).unwrap();
        assert_eq!(found.gains.each_ref().map(Vec::len), [13, 4]);
        assert_eq!(found.gains[0][12], None);
        for channel in 0..3 {
            let mean = (put.iter().map(|gain| gain[channel].ln()).sum::<f32>() / 12.0).exp();
            for (photo, put) in put.iter().enumerate() {
                let right = put[channel] / mean;
                let train = found.gains[0][photo].unwrap()[channel] / right;
                let test = found.gains[1].get(photo).map_or(1.0, |gain| gain.unwrap()[channel] / right);
                assert!((train - 1.0).abs() < 0.01 && (test - 1.0).abs() < 0.01, "{photo}: {train} {test}");
            }
        }
        assert!(found.explained > 0.9 && found.stops > 0.1, "{} {}", found.explained, found.stops);
    }

    #[test]
    fn what_one_half_of_a_photo_says_must_hold_in_the_other() {
        let same = vec![[1.0; 3]; 12];
        assert!(estimate(&photos(&same, 0.0), &[]).unwrap().explained < 0.02);
        let tilted = estimate(&photos(&same, 0.2), &[]).unwrap();
        assert!(tilted.explained < 0.02, "{}", tilted.explained);
        let gains = tilted.gains[0].iter().flatten().flatten();
        assert!(gains.copied().all(|gain| (gain - 1.0).abs() < 0.005), "{:?}", tilted.gains[0]);
    }

    #[test]
    fn too_little_tells_nothing() {
        let two = photos(&[[1.0; 3], [0.8; 3]], 0.0);
        assert_eq!(estimate(&two, &[]), None);
        assert_eq!(estimate(&[], &[]), None);
        let few: Vec<_> = photos(&[[1.0; 3]; 9], 0.0).into_iter().map(|photo| photo[..19].to_vec()).collect();
        assert_eq!(estimate(&few, &[]), None);
    }
}
