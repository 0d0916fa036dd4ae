//! What the optimiser does in an iteration.

/// Which parameter groups Adam moves in an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptimiserStep {
    /// All of them.
    All,
    /// All but opacity, whose gradients are lost with the tensor that a reset replaces.
    AllButOpacity,
    /// None yet: a later step takes the gradients, too.
    Later,
    /// None: the reference throws the gradients away.
    Lost,
}

impl OptimiserStep {
    /// A step is made.
    pub(crate) fn moves(self) -> bool {
        matches!(self, Self::All | Self::AllButOpacity)
    }
}
