//! Density control: where Gaussians are added and removed.
//!
//! A plan is pure: it reads statistics and genes, and says which rows there will be. The device applies it.
//! Which plan a method follows, and with what thresholds, is in its file below `method/`.

pub(crate) mod adaptive;
pub(crate) mod cap;
pub(crate) mod edges;
pub(crate) mod relocation;
pub(crate) mod selection;

use genesplat_core::RowEdit;

/// What density control has decided.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Plan {
    /// The new rows.
    pub(crate) edit: RowEdit,
    /// Dead Gaussians moved to living ones (MCMC).
    pub(crate) relocated: usize,
    /// Gaussians duplicated.
    pub(crate) cloned: usize,
    /// Gaussians replaced by two children.
    pub(crate) split: usize,
    /// Rows removed: after growing, new ones included; by selection before it.
    pub(crate) pruned: usize,
    /// Gaussians when growth ended, before what is pruned after it.
    pub(crate) grown_to: usize,
    /// Gaussians that wanted to grow but had no room below the cap.
    pub(crate) refused: usize,
}

impl Plan {
    /// Applies `edit`, which prunes nothing after growing; what else it counts is zero yet.
    fn of(edit: RowEdit) -> Self {
        let grown_to = edit.sources.len();
        Self { edit, relocated: 0, cloned: 0, split: 0, pruned: 0, grown_to, refused: 0 }
    }
}
