//! 256 values that stand for many: a scalar quantiser by Lloyd's algorithm.

use rayon::prelude::*;

/// How many values a byte can name.
const SIZE: usize = 256;
/// Bins of the histogram that the first values are placed by.
const BINS: usize = 4096;
const ITERATIONS: usize = 24;

/// Ascending values, the nearest of which stands for any other.
pub(super) struct Codebook {
    values: Vec<f32>,
}

impl Codebook {
    /// The codebook of `values`, which are finite. Their sum of squared errors is (locally) least.
    pub(super) fn of(values: &[f32]) -> Self {
        let mut sorted = values.to_vec();
        sorted.par_sort_unstable_by(f32::total_cmp);
        if sorted.is_empty() {
            return Self { values: vec![0.0; SIZE] };
        }
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(sorted.iter().scan(0.0, |sum, &value| {
                *sum += f64::from(value);
                Some(*sum)
            }))
            .collect();
        let mut codebook = Self { values: start(&sorted) };
        (0..ITERATIONS).for_each(|_| codebook.step(&sorted, &sums));
        codebook
    }

    /// Moves each value to the mean of those that it stands for; `sums` are the prefix sums of `sorted`.
    fn step(&mut self, sorted: &[f32], sums: &[f64]) {
        let mut from = 0;
        for i in 0..SIZE {
            let end = self.values.get(i + 1).map_or(f32::INFINITY, |next| 0.5 * (self.values[i] + next));
            let to = from + sorted[from..].partition_point(|&value| value <= end);
            if to > from {
                self.values[i] = ((sums[to] - sums[from]) / (to - from) as f64) as f32;
            }
            from = to;
        }
        // A mean of rounded sums may pass its neighbour's by a rounding step.
        self.values.sort_unstable_by(f32::total_cmp);
    }

    /// The index of the nearest value.
    pub(super) fn index(&self, value: f32) -> u8 {
        let above = self.values.partition_point(|&known| known < value).min(SIZE - 1);
        let below = above.saturating_sub(1);
        if value - self.values[below] <= self.values[above] - value { below as u8 } else { above as u8 }
    }

    pub(super) fn into_values(self) -> Vec<f32> {
        self.values
    }
}

/// First values at equal steps of the integral of the density's cube root, which is best for many values
/// (Panter and Dite 1951).
fn start(sorted: &[f32]) -> Vec<f32> {
    let (low, high) = (f64::from(sorted[0]), f64::from(sorted[sorted.len() - 1]));
    let width = ((high - low) / BINS as f64).max(f64::MIN_POSITIVE);
    let mut counts = vec![0u32; BINS];
    for &value in sorted {
        counts[(((f64::from(value) - low) / width) as usize).min(BINS - 1)] += 1;
    }
    let weights: Vec<f64> = counts.iter().map(|&count| f64::from(count).cbrt()).collect();
    let total: f64 = weights.iter().sum();
    let (mut bin, mut before) = (0, 0.0);
    (0..SIZE)
        .map(|i| {
            let wanted = total * (i as f64 + 0.5) / SIZE as f64;
            while bin + 1 < BINS && before + weights[bin] < wanted {
                before += weights[bin];
                bin += 1;
            }
            let within = ((wanted - before) / weights[bin].max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            (low + width * (bin as f64 + within)) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worst(codebook: &Codebook, values: &[f32]) -> f32 {
        values
            .iter()
            .map(|&v| (codebook.values[usize::from(codebook.index(v))] - v).abs())
            .fold(0.0, f32::max)
    }

    #[test]
    fn few_values_are_kept_and_many_are_within_half_a_step() {
        for values in [vec![], vec![3.5; 9], vec![-1.0, 0.25, 0.25, 7.0]] {
            assert!(worst(&Codebook::of(&values), &values) < 1e-6, "{values:?}");
        }
        let even: Vec<f32> = (0..100_000).map(|i| i as f32 / 100_000.0).collect();
        let codebook = Codebook::of(&even);
        assert!(worst(&codebook, &even) < 0.6 / 256.0, "{}", worst(&codebook, &even));
        assert!(codebook.values.is_sorted());
    }

    /// Most values lie close to 0, and get most of the codebook: by the cube root of the density, half the
    /// error of even steps.
    #[test]
    fn dense_values_get_finer_steps() {
        let values: Vec<f32> = (-50_000..50_000).map(|i| (i as f32 / 50_000.0).powi(5)).collect();
        let codebook = Codebook::of(&values);
        let squared: f32 =
            values.iter().map(|&v| (codebook.values[usize::from(codebook.index(v))] - v).powi(2)).sum();
        let even_steps = values.len() as f32 * (2.0f32 / 256.0).powi(2) / 12.0;
        assert!(squared < 0.6 * even_steps, "{squared} {even_steps}");
    }
}
