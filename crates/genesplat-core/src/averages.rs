//! Means of a run's recent states (weight averaging; Izmailov et al., 2018), and the blends of them that may take the
//! cloud's place.
//!
//! A window of states is averaged in two halves, so that a blend can also go along the line from the older mean to the
//! younger one, where the run is heading. A change of rows empties the averages.

use serde::{Deserialize, Serialize};

use crate::gaussians::Gaussians;

/// Halves of a window: the older states and the younger ones.
pub const WINDOW_HALVES: usize = 2;

/// A running mean of states.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StateMean {
    states: u32,
    mean: Gaussians,
}

impl StateMean {
    /// A mean that was saved: `states` clouds, averaged.
    pub fn new(states: u32, mean: Gaussians) -> Self {
        Self { states, mean }
    }

    /// How many states were added.
    pub fn states(&self) -> u32 {
        self.states
    }

    /// The mean itself.
    pub fn into_mean(self) -> Gaussians {
        self.mean
    }

    /// Their mean `[N]`, without 3D filter; empty before the first.
    pub fn mean(&self) -> &Gaussians {
        &self.mean
    }

    fn add(&mut self, cloud: &Gaussians) {
        if self.states == 0 {
            self.mean = Gaussians { filter_3d: None, ..cloud.clone() };
        }
        assert_eq!(self.mean.len(), cloud.len(), "averaged states have the same rows");
        self.states += 1;
        let fraction = 1.0 / self.states as f32;
        for (means, values) in self.mean.columns_mut().into_iter().zip(cloud.columns()) {
            for (mean, &value) in means.iter_mut().zip(values) {
                *mean += (value - *mean) * fraction;
            }
        }
    }
}

/// Means of the older and the younger states of a window.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WindowAverages {
    halves: [StateMean; WINDOW_HALVES],
}

impl WindowAverages {
    /// Averages that were saved.
    pub fn new(halves: [StateMean; WINDOW_HALVES]) -> Self {
        Self { halves }
    }

    /// The older and the younger half.
    pub fn halves(&self) -> &[StateMean; WINDOW_HALVES] {
        &self.halves
    }

    /// The halves themselves.
    pub fn into_halves(self) -> [StateMean; WINDOW_HALVES] {
        self.halves
    }

    /// How many states each half is the mean of.
    pub fn states(&self) -> [u32; WINDOW_HALVES] {
        self.halves.each_ref().map(|half| half.states)
    }

    /// Adds a state to a half, 0 for the older one.
    ///
    /// # Panics
    /// When `cloud` has another number of rows than the states before it.
    pub fn add(&mut self, half: usize, cloud: &Gaussians) {
        self.halves[half].add(cloud);
    }

    /// What `blend` makes of `cloud`, whose 3D filter it keeps. A half without states has no say.
    pub fn blended(&self, cloud: &Gaussians, blend: &Blend) -> Gaussians {
        let mut blended = cloud.clone();
        let halves = self.halves.iter().zip(blend.weights);
        for (half, weight) in halves.filter(|(half, weight)| half.states > 0 && *weight != 0.0) {
            let columns = blended.columns_mut().into_iter().zip(cloud.columns()).zip(half.mean.columns());
            for ((blended, cloud), mean) in columns {
                for ((blended, &cloud), &mean) in blended.iter_mut().zip(cloud).zip(mean) {
                    *blended += weight * (mean - cloud);
                }
            }
        }
        blended
    }
}

/// A blend of cloud and averages: `cloud + Σ weight · (mean of a half − cloud)`. The default, all zero, is the cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Blend {
    /// Weights of the older and the younger half.
    pub weights: [f32; WINDOW_HALVES],
}

/// How a cloud does on one training view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ViewLoss {
    /// Eq. 5 of the paper: `0.8 · L1 + 0.2 · (1 − SSIM)`.
    pub loss: f32,
    /// Mean squared error of the unclamped picture, in units of full brightness.
    pub squared_error: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(value: f32) -> Gaussians {
        let mut cloud = Gaussians::zeros(2);
        cloud.columns_mut().into_iter().for_each(|column| column.fill(value));
        cloud.filter_3d = Some(vec![value; 2]);
        cloud
    }

    fn averages(older: &[f32], younger: &[f32]) -> WindowAverages {
        let mut averages = WindowAverages::default();
        older.iter().for_each(|&value| averages.add(0, &state(value)));
        younger.iter().for_each(|&value| averages.add(1, &state(value)));
        averages
    }

    fn blended(averages: &WindowAverages, cloud: &Gaussians, weights: [f32; WINDOW_HALVES]) -> Gaussians {
        averages.blended(cloud, &Blend { weights })
    }

    #[test]
    fn every_parameter_is_averaged() {
        let averages = averages(&[1.0, 2.0, 6.0], &[]);
        assert_eq!(averages.halves()[0].states(), 3);
        assert_eq!(*averages.halves()[0].mean(), Gaussians { filter_3d: None, ..state(3.0) });
        assert_eq!((averages.states(), WindowAverages::default().states()), ([3, 0], [0, 0]));
    }

    #[test]
    fn blends_lie_on_the_line_and_beyond_it() {
        let (averages, cloud) = (averages(&[1.0, 3.0], &[4.0]), state(5.0));
        let bits = |cloud: &Gaussians| cloud.opacity_logits[0].to_bits();
        let unchanged = blended(&averages, &state(-0.0), [0.0; 2]);
        assert_eq!(bits(&unchanged), bits(&state(-0.0)), "no weight is no change, to the bit");
        let mean = Gaussians { filter_3d: Some(vec![5.0; 2]), ..state(3.0) };
        assert_eq!(blended(&averages, &cloud, [0.5; 2]), mean, "half of each mean, none of the cloud");
        let beyond = Gaussians { filter_3d: Some(vec![5.0; 2]), ..state(6.0) };
        assert_eq!(blended(&averages, &cloud, [-1.0, 2.0]), beyond, "5 − (2 − 5) + 2 (4 − 5)");
    }

    #[test]
    fn a_half_without_states_has_no_say() {
        let (averages, cloud) = (averages(&[], &[2.0]), state(1.0));
        let expected = Gaussians { filter_3d: Some(vec![1.0; 2]), ..state(4.0) };
        assert_eq!(blended(&averages, &cloud, [100.0, 3.0]), expected);
    }
}
