//! `.glb` with `KHR_gaussian_splatting`, Khronos's extension of glTF 2.0 for splats.
//!
//! A mesh primitive of points: `POSITION`, and under names that begin with `KHR_gaussian_splatting:` the
//! rotation `(x, y, z, w)`, the standard deviations themselves (not their logarithms), the opacity from 0 to
//! 1, and a vector `SH_DEGREE_l_COEF_n` of red, green and blue for each harmonic. Viewers that do not know
//! the extension show points, in the colours of `COLOR_0`. All is written in full precision.
//!
//! glTF has y up: the half turn about x is baked into positions, rotations and harmonics.

mod accessor;
mod nodes;
mod read;
mod schema;
mod write;

pub(super) use read::decode;
pub(super) use write::encode;

const MAGIC: [u8; 4] = *b"glTF";
const VERSION: u32 = 2;
const JSON_CHUNK: [u8; 4] = *b"JSON";
const BINARY_CHUNK: [u8; 4] = *b"BIN\0";

const EXTENSION: &str = "KHR_gaussian_splatting";

const POSITION: &str = "POSITION";
const ROTATION: &str = "KHR_gaussian_splatting:ROTATION";
const SCALE: &str = "KHR_gaussian_splatting:SCALE";
const OPACITY: &str = "KHR_gaussian_splatting:OPACITY";
/// The colour of points for viewers that do not know the extension.
const COLOUR: &str = "COLOR_0";

/// The kernel and the colour space that every trainer of splats uses.
const KERNEL: &str = "ellipse";
const COLOUR_SPACE: &str = "srgb_rec709_display";

/// Number of coefficients of degree 0 to 3.
const ORDERS: [usize; 4] = [1, 3, 5, 7];

/// Name of coefficient `n` of a degree.
fn harmonic(degree: usize, n: usize) -> String {
    format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}")
}
