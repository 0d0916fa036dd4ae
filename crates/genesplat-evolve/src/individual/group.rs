//! The three primitive gene parameters of section 3.2: position, scale and opacity.

use genesplat_core::Genes;

/// Number of groups.
pub(crate) const GROUPS: usize = 3;

/// Genes that mutate and are inherited together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    /// `x, y, z`, world units.
    Position,
    /// Three natural logarithms of standard deviations.
    Scale,
    /// One logit.
    Opacity,
}

impl Group {
    /// In the order of the genes of a row.
    pub(crate) const ALL: [Self; GROUPS] = [Self::Position, Self::Scale, Self::Opacity];

    /// Where the group's genes begin in a [`Genes`].
    pub(crate) const fn start(self) -> usize {
        match self {
            Self::Position => 0,
            Self::Scale => 3,
            Self::Opacity => 6,
        }
    }

    /// How many genes it has.
    pub(crate) const fn width(self) -> usize {
        match self {
            Self::Position | Self::Scale => 3,
            Self::Opacity => 1,
        }
    }

    /// The group's genes; `W` is its width.
    #[inline]
    pub(crate) fn of<const W: usize>(self, gene: &Genes) -> [f32; W] {
        debug_assert_eq!(W, self.width());
        std::array::from_fn(|component| gene[self.start() + component])
    }
}
