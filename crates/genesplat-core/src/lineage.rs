//! The recent states of a run, and the children that can be bred from them.
//!
//! In an evolution strategy, *intermediate* recombination averages the parents gene by gene, and *extended line*
//! recombination also looks beyond them, along the line that joins them (Beyer & Schwefel, "Evolution strategies: a
//! comprehensive introduction", 2002, section 2.3; Mühlenbein & Schlierkamp-Voosen, 1993). Here the parents are two
//! means of states that one run passed through, an older and a younger one. They share their rows with the cloud, so
//! that a combination of rows means something; a change of rows ends the line. A child is the cloud plus a few numbers
//! times the differences from its parents: a genome that a handful of renders can judge.

use crate::gaussians::Gaussians;

/// Parents of a line: the mean of the older states, and that of the younger ones.
pub const PARENTS: usize = 2;

/// Parameters that share a weight: positions, log-scales, rotations, opacity logits, base colours, other colours.
pub const PARAMETER_GROUPS: usize = 6;

/// Coefficients of the base colour, the first of a row of spherical harmonics.
const SH_DC: usize = 3;

/// A mean of states.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parent {
    states: u32,
    mean: Gaussians,
}

impl Parent {
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

    fn add(&mut self, cloud: &Gaussians) {
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
}

/// What a run remembers of its recent states.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lineage {
    parents: [Parent; PARENTS],
}

impl Lineage {
    /// A line that was saved.
    pub fn new(parents: [Parent; PARENTS]) -> Self {
        Self { parents }
    }

    /// The older and the younger parent.
    pub fn parents(&self) -> &[Parent; PARENTS] {
        &self.parents
    }

    /// How many states each parent is the mean of.
    pub fn states(&self) -> [u32; PARENTS] {
        self.parents.each_ref().map(|parent| parent.states)
    }

    /// Adds a state to a parent, 0 for the older one.
    ///
    /// # Panics
    /// When `cloud` has another number of rows than the states before it.
    pub fn add(&mut self, parent: usize, cloud: &Gaussians) {
        self.parents[parent].add(cloud);
    }

    /// Writes the child that `blend` makes of `cloud` into `child`; it has the cloud's 3D filter. Parents without states
    /// have no say.
    pub fn breed(&self, cloud: &Gaussians, blend: &Blend, child: &mut Gaussians) {
        if child.len() == cloud.len() {
            columns_mut(child)
                .into_iter()
                .zip(columns(cloud))
                .for_each(|(to, from)| to.copy_from_slice(from));
            child.filter_3d.clone_from(&cloud.filter_3d);
        } else {
            child.clone_from(cloud);
        }
        for (index, parent) in self.parents.iter().enumerate().filter(|(_, parent)| parent.states > 0) {
            move_towards(child, cloud, &parent.mean, blend.weights.map(|group| group[index]));
        }
    }
}

/// A child as its difference from a cloud: the genome of recombination.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Blend {
    /// `child = cloud + Σ weight · (parent − cloud)`, by group of parameters `[PARAMETER_GROUPS, PARENTS]`. The default,
    /// all zero, is the cloud itself.
    pub weights: [[f32; PARENTS]; PARAMETER_GROUPS],
}

/// How an individual does on one training view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Judgement {
    /// Eq. 5 of the paper.
    pub loss: f32,
    /// Mean squared error of the unclamped picture, in units of full brightness.
    pub squared_error: f32,
}

fn move_towards(
    child: &mut Gaussians,
    cloud: &Gaussians,
    parent: &Gaussians,
    weights: [f32; PARAMETER_GROUPS],
) {
    let [.., base, others] = weights;
    let columns = columns_mut(child).into_iter().zip(columns(cloud)).zip(columns(parent));
    for (((child, cloud), parent), weight) in columns.zip(weights).take(SH_COLUMN) {
        add_scaled(child, cloud, parent, weight);
    }
    for ((child, cloud), parent) in child.sh.iter_mut().zip(&cloud.sh).zip(&parent.sh) {
        add_scaled(&mut child[..SH_DC], &cloud[..SH_DC], &parent[..SH_DC], base);
        add_scaled(&mut child[SH_DC..], &cloud[SH_DC..], &parent[SH_DC..], others);
    }
}

/// `child += weight · (parent − cloud)`.
fn add_scaled(child: &mut [f32], cloud: &[f32], parent: &[f32], weight: f32) {
    for ((child, &cloud), &parent) in child.iter_mut().zip(cloud).zip(parent) {
        *child += weight * (parent - cloud);
    }
}

/// Index of the last of [`columns`], whose rows belong to two groups of parameters.
const SH_COLUMN: usize = 4;

fn columns(cloud: &Gaussians) -> [&[f32]; SH_COLUMN + 1] {
    [
        cloud.positions.as_flattened(),
        cloud.log_scales.as_flattened(),
        cloud.rotations.as_flattened(),
        &cloud.opacity_logits,
        cloud.sh.as_flattened(),
    ]
}

fn columns_mut(cloud: &mut Gaussians) -> [&mut [f32]; SH_COLUMN + 1] {
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

    fn line(older: &[f32], younger: &[f32]) -> Lineage {
        let mut line = Lineage::default();
        older.iter().for_each(|&value| line.add(0, &state(value)));
        younger.iter().for_each(|&value| line.add(1, &state(value)));
        line
    }

    fn child(line: &Lineage, cloud: &Gaussians, weights: [[f32; PARENTS]; PARAMETER_GROUPS]) -> Gaussians {
        let mut child = Gaussians::default();
        line.breed(cloud, &Blend { weights }, &mut child);
        child
    }

    #[test]
    fn every_parameter_is_averaged() {
        let line = line(&[1.0, 2.0, 6.0], &[]);
        assert_eq!(line.parents()[0].states(), 3);
        assert_eq!(*line.parents()[0].mean(), Gaussians { filter_3d: None, ..state(3.0) });
        assert_eq!((line.states(), Lineage::default().states()), ([3, 0], [0, 0]));
    }

    #[test]
    fn children_lie_on_the_line_and_beyond_it() {
        let (line, cloud) = (line(&[1.0, 3.0], &[4.0]), state(5.0));
        assert_eq!(child(&line, &cloud, [[0.0; 2]; 6]), cloud, "no weight is no change");
        let intermediate = Gaussians { filter_3d: Some(vec![5.0; 2]), ..state(3.0) };
        assert_eq!(
            child(&line, &cloud, [[0.5; 2]; 6]),
            intermediate,
            "half of each parent, none of the cloud"
        );
        let beyond = Gaussians { filter_3d: Some(vec![5.0; 2]), ..state(6.0) };
        assert_eq!(child(&line, &cloud, [[-1.0, 2.0]; 6]), beyond, "5 − (2 − 5) + 2 (4 − 5)");
    }

    #[test]
    fn groups_have_weights_of_their_own() {
        let (line, cloud) = (line(&[], &[2.0]), state(1.0));
        let weights = std::array::from_fn(|group| [100.0, 1.0 + group as f32]);
        let found = child(&line, &cloud, weights);
        let columns = [found.positions[1][2], found.log_scales[1][0], found.rotations[0][3]];
        assert_eq!(columns, [2.0, 3.0, 4.0], "the older parent has no states, and no say");
        assert_eq!(
            (found.opacity_logits[1], found.sh[1][2], found.sh[1][3], found.sh[0][47]),
            (5.0, 6.0, 7.0, 7.0)
        );
    }

    #[test]
    fn room_is_reused_whatever_was_in_it() {
        let (line, cloud) = (line(&[1.0], &[2.0]), state(3.0));
        let blend = Blend { weights: [[0.25, 0.5]; 6] };
        let (mut fresh, mut used) = (Gaussians::default(), state(9.0));
        line.breed(&cloud, &blend, &mut fresh);
        line.breed(&cloud, &blend, &mut used);
        assert_eq!(fresh, used);
    }
}
