//! `meta.json`: what the pictures of a `.sog` are called, and how their bytes become values.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

/// The version that is read and written.
pub(super) const VERSION: u64 = 2;

/// The model of a cloud whose opacities are compensated for the screen filter.
pub(super) const ANTIALIASED: &str = "antialiased";

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Meta {
    /// Files of version 1 do not say.
    #[serde(default)]
    pub(super) version: u64,
    pub(super) count: u64,
    /// Whether opacities are compensated for the screen filter, as PlayCanvas's programs said it up to
    /// splat-transform 2.
    #[serde(default)]
    pub(super) antialias: bool,
    /// The same, as they say it from splat-transform 3 on: [`ANTIALIASED`], or nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) model: Option<String>,
    pub(super) means: Means,
    pub(super) scales: Coded,
    pub(super) quats: Plain,
    pub(super) sh0: Coded,
    #[serde(rename = "shN", default, skip_serializing_if = "Option::is_none")]
    pub(super) sh_n: Option<Palette>,
}

/// Positions between two corners, on the logarithmic scale; the pictures of lower and upper bytes.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Means {
    pub(super) mins: [f32; 3],
    pub(super) maxs: [f32; 3],
    pub(super) files: [String; 2],
}

/// Bytes that are indices of values.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Coded {
    #[serde(deserialize_with = "codebook")]
    pub(super) codebook: Vec<f32>,
    pub(super) files: [String; 1],
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Plain {
    pub(super) files: [String; 1],
}

/// Harmonics of degree 1 to `bands`; the pictures of the palette and of each Gaussian's entry.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Palette {
    pub(super) count: u64,
    pub(super) bands: u8,
    #[serde(deserialize_with = "codebook")]
    pub(super) codebook: Vec<f32>,
    pub(super) files: [String; 2],
}

/// Values of a codebook. PlayCanvas's older programs wrote `null` for the first; its engine puts it one step
/// of an even codebook before the second, and so does this.
fn codebook<'de, D: Deserializer<'de>>(source: D) -> Result<Vec<f32>, D::Error> {
    let mut values = Vec::<Option<f32>>::deserialize(source)?;
    if let [first @ None, Some(second), .., Some(last)] = &mut values[..] {
        *first = Some(*second + (*second - *last) / 255.0);
    }
    values.into_iter().collect::<Option<_>>().ok_or_else(|| D::Error::custom("a codebook with null in it"))
}
