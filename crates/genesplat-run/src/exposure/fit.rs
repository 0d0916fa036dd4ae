//! Gains of photos from the colours of points that they share: logarithms of one channel, `value = gain of
//! the photo + colour of the point`, by Huber's weights and conjugate gradients. Sums have a fixed order.

use rayon::prelude::*;

/// A photo sees a point: the logarithm of a channel there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) photo: u32,
    pub(super) point: u32,
    pub(super) value: f64,
}

/// Logarithms, as far as they were found.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Fit {
    /// Of each photo; their mean is 0 over the photos that see something.
    pub(super) gains: Vec<f64>,
    /// Of each point at the mean exposure; `None` where no photo sees it.
    pub(super) colours: Vec<Option<f64>>,
}

/// Times that weights are found anew.
const ROUNDS: usize = 10;
/// Most steps of the solver in each round, which begins where the last one ended.
const STEPS: usize = 60;
/// The root mean square of what is left of gains where it ends: a thousandth of what 8 bits tell.
const LEFT: f64 = 1e-5;
/// A mean that moves by less has been found.
const STILL: f64 = 1e-6;
/// Huber's constant: 95 % as good as a mean where errors are Gaussian.
const HUBER: f64 = 1.345;
/// From a median of absolute values to a standard deviation.
const MAD_SIGMA: f64 = 1.4826;
/// Least scale of errors: a thousandth of a value.
const SCALE_MIN: f64 = 1e-3;
/// Weight of a gain of 0, where one sample of a photo has 1: what nothing ties down stays there.
const PRIOR: f64 = 0.1;

/// Gains of `photos` photos and colours of `points` points.
pub(super) fn fit(seen: &[Seen], photos: usize, points: usize) -> Fit {
    let mut gains = vec![0.0; photos];
    let mut weights = vec![1.0; seen.len()];
    for _ in 0..ROUNDS {
        let system = System::new(seen, &weights, photos, points);
        system.solve(&mut gains);
        let colours = system.means(&gains);
        let errors =
            seen.iter().map(|seen| seen.value - gains[seen.photo as usize] - colours[seen.point as usize]);
        weights = huber_weights(&errors.collect::<Vec<_>>());
    }
    centred(seen, gains, points)
}

/// Colours of points where all photos have these gains, by [`robust_mean`].
pub(super) fn colours(seen: &[Seen], gains: &[f64], points: usize) -> Vec<Option<f64>> {
    // Where the values of each point begin, in one list of all.
    let mut starts = vec![0; points + 1];
    seen.iter().for_each(|seen| starts[seen.point as usize + 1] += 1);
    (0..points).for_each(|point| starts[point + 1] += starts[point]);
    let (mut next, mut values) = (starts.clone(), vec![0.0; seen.len()]);
    for seen in seen {
        let place = &mut next[seen.point as usize];
        values[*place] = seen.value - gains[seen.photo as usize];
        *place += 1;
    }
    let of_point =
        |scratch: &mut Scratch, point: usize| scratch.robust_mean(&values[starts[point]..starts[point + 1]]);
    (0..points).into_par_iter().map_init(Scratch::default, of_point).collect()
}

/// With gains whose mean is 0 over the photos that see something.
fn centred(seen: &[Seen], mut gains: Vec<f64>, points: usize) -> Fit {
    let mut sees = vec![false; gains.len()];
    seen.iter().for_each(|seen| sees[seen.photo as usize] = true);
    let all = || gains.iter().zip(&sees).filter(|(_, sees)| **sees).map(|(gain, _)| *gain);
    let mean = all().sum::<f64>() / all().count().max(1) as f64;
    gains.iter_mut().zip(&sees).for_each(|(gain, sees)| *gain = if *sees { *gain - mean } else { 0.0 });
    let colours = colours(seen, &gains, points);
    Fit { gains, colours }
}

/// The mean of what lies near the median, farther values with less weight; `None` of nothing.
pub(super) fn robust_mean(values: &[f64]) -> Option<f64> {
    Scratch::default().robust_mean(values)
}

/// Room for one robust mean after the other.
#[derive(Default)]
struct Scratch {
    errors: Vec<f64>,
    keys: Vec<i64>,
}

impl Scratch {
    fn robust_mean(&mut self, values: &[f64]) -> Option<f64> {
        let mut mean = self.median(values.iter().copied())?;
        for _ in 0..ROUNDS {
            let mut errors = std::mem::take(&mut self.errors);
            errors.clear();
            errors.extend(values.iter().map(|value| value - mean));
            let near = self.near(&errors);
            let (mut weighted, mut weights) = (0.0, 0.0);
            for error in &errors {
                let weight = huber_weight(error.abs(), near);
                weighted += error * weight;
                weights += weight;
            }
            self.errors = errors;
            let step = weighted / weights;
            mean += step;
            if step.abs() < STILL {
                break;
            }
        }
        Some(mean)
    }

    /// Errors up to this size have the weight 1.
    fn near(&mut self, errors: &[f64]) -> f64 {
        let usual = self.median(errors.iter().map(|error| error.abs())).unwrap_or(0.0);
        HUBER * (MAD_SIGMA * usual).max(SCALE_MIN)
    }

    fn median(&mut self, values: impl Iterator<Item = f64>) -> Option<f64> {
        self.keys.clear();
        self.keys.extend(values.map(key));
        let middle = self.keys.len() / 2;
        (!self.keys.is_empty()).then(|| of_key(*self.keys.select_nth_unstable(middle).1))
    }
}

/// An integer that is in the order of values ([`f64::total_cmp`]), and is compared faster.
fn key(value: f64) -> i64 {
    turned(value.to_bits().cast_signed())
}

fn of_key(key: i64) -> f64 {
    f64::from_bits(turned(key).cast_unsigned())
}

/// The larger a negative number's other bits are, the less it is.
fn turned(bits: i64) -> i64 {
    bits ^ ((bits >> 63) & i64::MAX)
}

pub(super) fn median(values: &[f64]) -> Option<f64> {
    Scratch::default().median(values.iter().copied())
}

/// 1 for what is as near as most, less for what is farther.
pub(super) fn huber_weights(errors: &[f64]) -> Vec<f64> {
    let near = Scratch::default().near(errors);
    errors.iter().map(|error| huber_weight(error.abs(), near)).collect()
}

fn huber_weight(size: f64, near: f64) -> f64 {
    if size <= near { 1.0 } else { near / size }
}

/// The weighted least squares of the gains, from which colours are eliminated.
struct System<'a> {
    seen: &'a [Seen],
    weights: &'a [f64],
    /// Sums of weights.
    of_photos: Vec<f64>,
    of_points: Vec<f64>,
}

impl<'a> System<'a> {
    fn new(seen: &'a [Seen], weights: &'a [f64], photos: usize, points: usize) -> Self {
        let (mut of_photos, mut of_points) = (vec![PRIOR; photos], vec![0.0; points]);
        for (seen, weight) in seen.iter().zip(weights) {
            of_photos[seen.photo as usize] += weight;
            of_points[seen.point as usize] += weight;
        }
        Self { seen, weights, of_photos, of_points }
    }

    /// Of each point, the weighted mean of `value`; 0 where there is none.
    fn point_means(&self, value: impl Fn(&Seen) -> f64) -> Vec<f64> {
        let mut means = vec![0.0; self.of_points.len()];
        for (seen, weight) in self.seen.iter().zip(self.weights) {
            means[seen.point as usize] += weight * value(seen);
        }
        means.iter_mut().zip(&self.of_points).for_each(|(mean, sum)| *mean /= sum.max(f64::MIN_POSITIVE));
        means
    }

    /// Colours of points at these gains.
    fn means(&self, gains: &[f64]) -> Vec<f64> {
        self.point_means(|seen| seen.value - gains[seen.photo as usize])
    }

    /// Of each photo, the weighted sum of what `value` has more than the mean of its point.
    fn photo_sums(&self, value: impl Fn(&Seen) -> f64) -> Vec<f64> {
        let (means, mut sums) = (self.point_means(&value), vec![0.0; self.of_photos.len()]);
        for (seen, weight) in self.seen.iter().zip(self.weights) {
            sums[seen.photo as usize] += weight * (value(seen) - means[seen.point as usize]);
        }
        sums
    }

    /// The matrix of the gains, times `gains`.
    fn times(&self, gains: &[f64]) -> Vec<f64> {
        let mut sums = self.photo_sums(|seen| gains[seen.photo as usize]);
        sums.iter_mut().zip(gains).for_each(|(sum, gain)| *sum += PRIOR * gain);
        sums
    }

    /// Moves `gains` to the solution, by conjugate gradients whose preconditioner is the diagonal.
    fn solve(&self, gains: &mut [f64]) {
        let right = self.photo_sums(|seen| seen.value);
        let mut rest: Vec<f64> =
            right.iter().zip(self.times(gains)).map(|(right, left)| right - left).collect();
        let scaled = |rest: &[f64]| -> Vec<f64> {
            rest.iter().zip(&self.of_photos).map(|(rest, sum)| rest / sum).collect()
        };
        let enough = LEFT * LEFT * self.of_photos.iter().sum::<f64>();
        let mut direction = scaled(&rest);
        let mut size = dot(&rest, &direction);
        for _ in 0..STEPS {
            if size <= enough {
                break;
            }
            let moved = self.times(&direction);
            let step = size / dot(&direction, &moved);
            gains.iter_mut().zip(&direction).for_each(|(gain, along)| *gain += step * along);
            rest.iter_mut().zip(&moved).for_each(|(rest, moved)| *rest -= step * moved);
            let next = scaled(&rest);
            let next_size = dot(&rest, &next);
            let turn = next_size / size;
            direction.iter_mut().zip(&next).for_each(|(along, next)| *along = next + turn * *along);
            size = next_size;
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain of photos, each of which shares points with the next few only; every tenth sample is wrong.
    fn chain(photos: u32, gain: impl Fn(u32) -> f64) -> Vec<Seen> {
        let sees = |photo: u32| (0..40).map(move |place| (photo, 8 * photo + place));
        let seen = (0..photos).flat_map(sees).map(|(photo, point)| {
            let colour = -1.0 - 0.1 * f64::from(point % 7);
            let wrong = if (13 * photo + point) % 10 == 0 { 0.8 } else { 0.0 };
            Seen { photo, point, value: colour + gain(photo) + wrong }
        });
        seen.collect()
    }

    #[test]
    fn known_gains_are_found_along_a_chain_with_wrong_samples() {
        let gain = |photo: u32| 0.3 * f64::from(photo).sin();
        let found = fit(&chain(60, gain), 60, 8 * 60 + 40);
        let mean = (0..60).map(gain).sum::<f64>() / 60.0;
        for photo in 0..60 {
            let error = found.gains[photo as usize] - (gain(photo) - mean);
            assert!(error.abs() < 0.02, "photo {photo}: off by {error}");
        }
        assert!(found.gains.iter().sum::<f64>().abs() < 1e-9);
        assert!((found.colours[50].unwrap() - (-1.0 - 0.1 + mean)).abs() < 0.03);
    }

    #[test]
    fn what_nobody_sees_has_neither_gain_nor_colour() {
        let seen = [(0, 0, -1.0), (1, 0, -0.5), (0, 2, -2.0), (1, 2, -1.5)];
        let seen = seen.map(|(photo, point, value)| Seen { photo, point, value });
        let found = fit(&seen, 3, 3);
        assert!(found.gains[2] == 0.0 && found.colours[1].is_none());
        assert!((found.gains[1] - found.gains[0] - 0.5).abs() < 0.05, "{:?}", found.gains);
        assert_eq!(fit(&[], 2, 0), Fit { gains: vec![0.0; 2], colours: Vec::new() });
    }

    #[test]
    fn a_robust_mean_passes_over_what_is_far() {
        let values = [1.0, 1.01, 0.99, 1.0, 1.02, 0.98, 9.0];
        assert!((robust_mean(&values).unwrap() - 1.0).abs() < 0.02);
        assert_eq!(robust_mean(&[]), None);
        assert_eq!(robust_mean(&[2.0]), Some(2.0));
        assert_eq!(median(&[-3.0, 5.0, -0.5, 0.0, -7.0]), Some(-0.5));
    }
}
