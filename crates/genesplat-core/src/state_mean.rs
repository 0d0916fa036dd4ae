//! The mean of a run's recent states (weight averaging; Izmailov et al., 2018). A change of rows empties it.

use std::borrow::Cow;

use crate::gaussians::Gaussians;

/// A running mean of states.
#[derive(Clone, Debug, Default, PartialEq)]
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

    /// Their mean `[N]`, without 3D filter; empty before the first.
    pub fn mean(&self) -> &Gaussians {
        &self.mean
    }

    /// Adds a state.
    ///
    /// # Panics
    /// When `cloud` has another number of rows than the states before it.
    pub fn add(&mut self, cloud: &Gaussians) {
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

    /// The mean with the 3D filter of `cloud`, whose place it takes; before the first state, the cloud.
    pub fn in_place_of(self, cloud: Gaussians) -> Gaussians {
        if self.states == 0 { cloud } else { Gaussians { filter_3d: cloud.filter_3d, ..self.mean } }
    }

    /// `cloud`, or the mean as it would be in its place.
    pub fn look<'a>(&'a self, cloud: &'a Gaussians, held: Held) -> Cow<'a, Gaussians> {
        match (held, &cloud.filter_3d) {
            (Held::Mean, None) if self.states > 0 => Cow::Borrowed(&self.mean),
            (Held::Mean, Some(filter)) if self.states > 0 => {
                Cow::Owned(Gaussians { filter_3d: Some(filter.clone()), ..self.mean.clone() })
            }
            _ => Cow::Borrowed(cloud),
        }
    }
}

/// Which of the clouds that a device holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Held {
    /// The one that is trained.
    #[default]
    Cloud,
    /// The mean of its recent states, with its 3D filter; before the first state, the cloud.
    Mean,
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

    #[test]
    fn every_parameter_is_averaged_and_the_filter_stays() {
        let mut mean = StateMean::default();
        [1.0, 2.0, 6.0].into_iter().for_each(|value| mean.add(&state(value)));
        assert_eq!((mean.states(), StateMean::default().states()), (3, 0));
        assert_eq!(*mean.mean(), Gaussians { filter_3d: None, ..state(3.0) });
        let (cloud, unfiltered) = (state(5.0), Gaussians { filter_3d: None, ..state(5.0) });
        assert_eq!(*mean.look(&cloud, Held::Cloud), cloud);
        assert_eq!(*mean.look(&unfiltered, Held::Mean), *mean.mean());
        let in_place = Gaussians { filter_3d: Some(vec![5.0; 2]), ..state(3.0) };
        assert_eq!(*mean.look(&cloud, Held::Mean), in_place);
        assert_eq!(mean.in_place_of(cloud), in_place);
    }

    #[test]
    fn without_states_the_cloud_is_its_own_mean() {
        assert_eq!(*StateMean::default().look(&state(5.0), Held::Mean), state(5.0));
        assert_eq!(StateMean::default().in_place_of(state(5.0)), state(5.0));
    }
}
