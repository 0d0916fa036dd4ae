//! What the individuals of a generation have in common: the cloud that they are scored as differences from.
//!
//! Scoring an individual costs what it changes. A search soon leaves its base behind: at the paper's settings individuals
//! differ from it in two thirds of their rows after 30 generations. But selection makes all individuals of a generation
//! cousins, a few generations apart, and from what most of their parents hold they differ in a quarter of the rows then, and
//! in a twentieth towards the end (`docs/performance.md`).

use std::sync::Arc;

use genesplat_core::{Gene, SparseDelta};

use crate::individual::Genome;

/// Share of the rows that must have changed hands before the consensus moves: whoever scores has to prepare the new one,
/// which costs about as much as a few individuals.
const SHIFT_MIN: f64 = 0.005;

/// What most parents of a generation hold, gene group by gene group.
#[derive(Debug)]
pub(crate) struct Consensus {
    genome: Genome,
    /// What it holds otherwise than the one before.
    shift: SparseDelta,
}

impl Consensus {
    /// That of the initial population: the base itself, of `n` rows.
    pub(crate) fn base(n: usize) -> Self {
        Self { genome: Genome::base(n), shift: SparseDelta::default() }
    }

    /// Moves to what most of `parents` hold, who count as often as they breed, if that is far enough from where it is.
    pub(crate) fn follow<'a>(&mut self, parents: impl Iterator<Item = &'a Arc<Genome>>, base: &[Gene]) {
        let mut voters: Vec<(&Genome, u32)> = Vec::new();
        for parent in parents {
            match voters.iter_mut().find(|(voter, _)| std::ptr::eq(*voter, Arc::as_ptr(parent))) {
                Some((_, weight)) => *weight += 1,
                None => voters.push((parent, 1)),
            }
        }
        let next = Genome::majority(&voters);
        let shift = next.to_delta_from(&self.genome, base);
        if shift.rows.len() as f64 >= SHIFT_MIN * base.len() as f64 {
            *self = Self { genome: next, shift };
        } else {
            self.shift = SparseDelta::default();
        }
    }

    /// What makes the consensus of the generation before the one of this generation.
    pub(crate) fn shift(&self) -> &SparseDelta {
        &self.shift
    }

    /// What makes it the base again.
    pub(crate) fn way_back(&self, base: &[Gene]) -> SparseDelta {
        Genome::base(base.len()).to_delta_from(&self.genome, base)
    }

    /// An individual as its difference from the consensus.
    pub(crate) fn delta_of(&self, genome: &Genome, base: &[Gene]) -> SparseDelta {
        genome.to_delta_from(&self.genome, base)
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.genome.bytes() + self.shift.bytes()
    }
}
