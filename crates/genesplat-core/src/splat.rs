//! A Gaussian on the screen: what all devices blend, and what the blending says of it to a loss.

/// One splat of one view: a cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct Splat {
    /// Mean, px.
    pub mean_px: [f32; 2],
    /// `[−½·A, −B, −½·C] · log2(e)` of the inverse covariance `[A B; B C]`: the exponent comes out in powers
    /// of two.
    pub conic_log2: [f32; 3],
    /// `log2` of the effective opacity.
    pub log2_opacity: f32,
    /// Colour, not below 0.
    pub rgb: [f32; 3],
    /// Camera z, world units.
    pub depth: f32,
    /// Half extent of the ellipse `alpha ≥ 1/255`, px.
    pub half_extent_px: [f32; 2],
    /// Row of the cloud; of `project_versions`, index of the version.
    pub row: u32,
    /// Bit `c` is set where channel `c` was clamped at 0.
    pub clamped: u32,
}

impl Splat {
    /// The same with its mean in px from `origin` (the corner of a tile).
    #[inline(always)]
    pub fn seen_from(&self, origin: [usize; 2]) -> Self {
        let mean_px = [self.mean_px[0] - origin[0] as f32, self.mean_px[1] - origin[1] as f32];
        Self { mean_px, ..*self }
    }
}

/// A loss's gradient by one splat: sums over the pixels of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatSums {
    /// `Σ p · (1, dx, dy, dx², dx·dy, dy²)`, where p is the gradient by the logarithm of alpha before it is
    /// limited, and d = pixel − mean, px.
    pub moments: [f32; 6],
    /// By the colour.
    pub rgb: [f32; 3],
    /// By the mean, px, with absolute values at each pixel.
    pub absolute_mean_px: [f32; 2],
}
