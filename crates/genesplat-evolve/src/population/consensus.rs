//! What the individuals of a generation have in common: the genes that they are differences from.
//!
//! Keeping, breeding and scoring an individual cost what it changes. At the paper's settings individuals
//! differ from the base in more than half of their rows after 30 generations, but from what most of their
//! parents hold in a quarter, and in a twentieth towards the end (`lab/performance.md`): selection makes them
//! cousins.

use std::sync::Arc;

use genesplat_core::{Genes, SparseDelta};
use rayon::prelude::*;

use crate::individual::Genome;

/// Fraction of the rows that must have changed before the consensus moves: every genome and the scorer have
/// to follow.
const SHIFT_MIN: f64 = 0.005;

/// What most parents of a generation hold, gene group by gene group.
#[derive(Debug)]
pub(crate) struct Consensus {
    /// Of every row `[N, 7]`.
    genes: Vec<Genes>,
    /// Those that the search began with.
    base: Vec<Genes>,
    /// What the consensus holds otherwise than the one before.
    shift: SparseDelta,
}

impl Consensus {
    /// That of the initial population: the base itself.
    pub(crate) fn new(base: Vec<Genes>) -> Self {
        Self { genes: base.clone(), base, shift: SparseDelta::default() }
    }

    /// What genomes are differences from.
    pub(crate) fn genes(&self) -> &[Genes] {
        &self.genes
    }

    /// Moves to what most of `genomes` hold, each with its weight, and they along, if that is far enough from
    /// where it is.
    pub(crate) fn follow(&mut self, genomes: &mut [Arc<Genome>], weights: &[u32]) {
        let voters: Vec<_> = genomes.iter().map(Arc::as_ref).zip(weights.iter().copied()).collect();
        let majority = Genome::majority(&voters);
        let shift = majority.to_delta(&self.genes);
        if (shift.rows.len() as f64) < SHIFT_MIN * self.genes.len() as f64 {
            self.shift = SparseDelta::default();
            return;
        }
        genomes.par_iter_mut().for_each(|genome| *genome = Arc::new(genome.rebased(&majority, &self.genes)));
        for (&row, &genes) in shift.rows.iter().zip(&shift.genes) {
            self.genes[row as usize] = genes;
        }
        self.shift = shift;
    }

    /// What makes the consensus of the generation before the one of this generation.
    pub(crate) fn shift(&self) -> &SparseDelta {
        &self.shift
    }

    /// What makes it the base again, whether or not who follows has followed the last shift.
    pub(crate) fn way_back(&self) -> SparseDelta {
        let mut shifted = self.shift.rows.iter().peekable();
        let rows = (0..).zip(self.base.iter().zip(&self.genes));
        let back = rows.filter(|(row, (base, genes))| {
            let is_shifted = shifted.next_if(|&&shifted| shifted == *row).is_some();
            is_shifted || base != genes
        });
        let (rows, genes) = back.map(|(row, (&base, _))| (row, base)).unzip();
        SparseDelta { rows, genes }
    }

    /// An individual as its difference from the base.
    pub(crate) fn delta_from_base(&self, genome: &Genome) -> SparseDelta {
        let own = genome.to_delta(&self.genes);
        let mut own = own.rows.into_iter().zip(own.genes).peekable();
        let genes = (0..).zip(&self.genes).map(|(row, &shared)| {
            own.next_if(|(changed, _)| *changed == row).map_or(shared, |(_, genes)| genes)
        });
        let changed = (0..).zip(genes).zip(&self.base).filter(|((_, genes), base)| genes != *base);
        let (rows, genes) = changed.map(|(genes, _)| genes).unzip();
        SparseDelta { rows, genes }
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        (self.genes.capacity() + self.base.capacity()) * size_of::<Genes>() + self.shift.bytes()
    }
}
