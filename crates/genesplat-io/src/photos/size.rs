//! At which size photos are loaded, by the reference's rules.

/// Width above which [`PhotoSize::Auto`] reduces (3DGS, `camera_utils`).
const AUTO_WIDTH: u32 = 1600;

/// At which size photos are loaded; cameras follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum PhotoSize {
    /// The reference's default (`-r -1`): as they are up to a width of 1,600 px, reduced to that width
    /// beyond.
    #[default]
    Auto,
    /// Both sides divided by this and rounded half to even, as the reference's `-r 2`, `4` and `8`.
    Downscale(u32),
    /// The longer side at most this many pixels, aspect kept; never enlarges.
    MaxSide(u32),
}

impl PhotoSize {
    /// The loaded size of a photo of `width` x `height` px; never below 1 px.
    pub fn of(self, width: u32, height: u32) -> (u32, u32) {
        let (w, h) = (f64::from(width), f64::from(height));
        let (w, h) = match self {
            Self::Auto if width > AUTO_WIDTH => {
                let scale = w / f64::from(AUTO_WIDTH);
                ((w / scale).trunc(), (h / scale).trunc())
            }
            Self::Downscale(factor) if factor > 1 => {
                ((w / f64::from(factor)).round_ties_even(), (h / f64::from(factor)).round_ties_even())
            }
            Self::MaxSide(side) if side < width.max(height) => {
                let scale = f64::from(side) / w.max(h);
                ((w * scale).round(), (h * scale).round())
            }
            _ => (w, h),
        };
        ((w as u32).max(1), (h as u32).max(1))
    }
}
