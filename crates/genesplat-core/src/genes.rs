//! What evolution may change: seven genes a Gaussian (section 3 of the paper; colour and rotation stay
//! fixed).

/// Genes a Gaussian: position 3, log-scale 3, opacity logit 1.
pub const GENES: usize = 7;

/// One Gaussian's genes: `[x, y, z, ln sx, ln sy, ln sz, logit o]`.
pub type Genes = [f32; GENES];

/// The opacity logit among them.
pub fn opacity_logit(genes: &Genes) -> f32 {
    genes[6]
}

/// The log-scales among them.
pub fn log_scales(&[_, _, _, x, y, z, _]: &Genes) -> [f32; 3] {
    [x, y, z]
}

/// An individual as its difference from a shared base: the rows that differ and their new values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SparseDelta {
    /// Rows of the base that differ, strictly ascending.
    pub rows: Vec<u32>,
    /// Their new genes (absolute, not differences); one entry a row.
    pub genes: Vec<Genes>,
}

impl SparseDelta {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.rows.capacity() * size_of::<u32>() + self.genes.capacity() * size_of::<Genes>()
    }

    /// True for an individual equal to its base.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
}
