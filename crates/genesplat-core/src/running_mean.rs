//! The mean of a run's recent states: what recombination breeds from.
//!
//! In an evolution strategy the parents of intermediate recombination are averaged, gene by gene (Beyer & Schwefel,
//! "Evolution strategies: a comprehensive introduction", 2002, section 2.3). Here the parents are the last states of one
//! run. They share their rows, so that a mean of rows means something; a change of rows ends the line.

use crate::gaussians::Gaussians;

/// The mean of the states that were added.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunningMean {
    states: u32,
    mean: Gaussians,
}

impl RunningMean {
    /// A mean that was saved: `states` clouds, averaged.
    pub fn new(states: u32, mean: Gaussians) -> Self {
        Self { states, mean }
    }

    /// How many states were added.
    pub fn states(&self) -> u32 {
        self.states
    }

    /// Their mean; empty before the first. It has no 3D filter.
    pub fn mean(&self) -> &Gaussians {
        &self.mean
    }

    /// Adds a state of the same rows.
    ///
    /// # Panics
    /// When `cloud` has another number of rows than the states before it.
    pub fn add(&mut self, cloud: &Gaussians) {
        if self.states == 0 {
            self.mean = Gaussians { filter_3d: None, ..cloud.clone() };
        }
        assert_eq!(self.mean.len(), cloud.len(), "states of one line have the same rows");
        self.states += 1;
        let share = 1.0 / self.states as f32;
        for (means, values) in columns_mut(&mut self.mean).into_iter().zip(columns(cloud)) {
            for (mean, &value) in means.iter_mut().zip(values) {
                *mean += (value - *mean) * share;
            }
        }
    }

    /// Exchanges the mean with `cloud`, whose 3D filter stays where it is. Twice is as never.
    pub fn exchange(&mut self, cloud: &mut Gaussians) {
        std::mem::swap(&mut self.mean.filter_3d, &mut cloud.filter_3d);
        std::mem::swap(&mut self.mean, cloud);
    }
}

fn columns(cloud: &Gaussians) -> [&[f32]; 5] {
    [
        cloud.positions.as_flattened(),
        cloud.log_scales.as_flattened(),
        cloud.rotations.as_flattened(),
        &cloud.opacity_logits,
        cloud.sh.as_flattened(),
    ]
}

fn columns_mut(cloud: &mut Gaussians) -> [&mut [f32]; 5] {
    [
        cloud.positions.as_flattened_mut(),
        cloud.log_scales.as_flattened_mut(),
        cloud.rotations.as_flattened_mut(),
        &mut cloud.opacity_logits,
        cloud.sh.as_flattened_mut(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(value: f32) -> Gaussians {
        let mut cloud = Gaussians::zeros(2);
        columns_mut(&mut cloud).into_iter().for_each(|column| column.fill(value));
        cloud.filter_3d = Some(vec![value; 2]);
        cloud
    }

    #[test]
    fn every_parameter_is_averaged() {
        let mut mean = RunningMean::default();
        [1.0, 2.0, 6.0].into_iter().for_each(|value| mean.add(&state(value)));
        assert_eq!(mean.states(), 3);
        assert_eq!(*mean.mean(), Gaussians { filter_3d: None, ..state(3.0) });
    }

    #[test]
    fn exchanging_twice_changes_nothing() {
        let (mut mean, mut cloud) = (RunningMean::default(), state(5.0));
        mean.add(&state(1.0));
        mean.exchange(&mut cloud);
        assert_eq!(cloud, Gaussians { filter_3d: Some(vec![5.0; 2]), ..state(1.0) });
        assert_eq!(*mean.mean(), Gaussians { filter_3d: None, ..state(5.0) });
        mean.exchange(&mut cloud);
        assert_eq!(cloud, state(5.0));
    }
}
