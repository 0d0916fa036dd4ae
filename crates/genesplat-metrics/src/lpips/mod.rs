//! LPIPS (Zhang et al. 2018, version 0.1): how different two pictures look to a network that was trained to
//! see.
//!
//! Both pictures pass the same network. At five depths (`network.rs`) each pixel's features are scaled to
//! unit length, their squared difference is weighted by a learned head, summed over channels and averaged
//! over pixels; the distance is the sum of the five. 0 is identical; splats are usually between 0.05 and 0.5.
//!
//! Memory: about 0.8 KB a pixel of the pictures, most of it in VGG16's first slice.

mod features;
mod network;

use genesplat_core::Photo;
use rayon::prelude::*;

use self::features::{Convolution, Features};
pub use self::network::{LAYERS, Net};
use crate::weights::NamedTensors;
use crate::{SizeMismatch, check_sizes};

/// What the network is fed, for 8-bit values from 0 to 255.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputRange {
    /// `[0, 1]`: the published tables of 3DGS and its descendants, though the network expects the other.
    ZeroToOne,
    /// `[-1, 1]`: what the authors of LPIPS trained with.
    MinusOneToOne,
}

/// Tensors that are not those of the network.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WeightError {
    /// A tensor is absent.
    #[error("{net} for LPIPS needs the tensor {tensor}, which is not there")]
    Missing {
        /// The network.
        net: Net,
        /// What it needs.
        tensor: String,
    },
    /// A tensor has another shape.
    #[error("{net} for LPIPS needs {tensor} of shape {wanted:?}, and it has {found:?}")]
    Shape {
        /// The network.
        net: Net,
        /// Which tensor.
        tensor: String,
        /// As it should be.
        wanted: Vec<usize>,
        /// As it is.
        found: Vec<usize>,
    },
    /// This tensor holds NaN or an infinity.
    #[error("{0} holds a value that is not finite; the weights are damaged, so get them again")]
    NotFinite(String),
}

/// Two pictures that LPIPS cannot compare.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LpipsError {
    /// They differ in size.
    #[error(transparent)]
    Sizes(#[from] SizeMismatch),
    /// Nothing is left of them in the last layer.
    #[error(
        "LPIPS with {net} needs pictures of at least {} pixels a side, and these have {}x{}",
        net.min_side_px(), size[0], size[1]
    )]
    TooSmall {
        /// The network.
        net: Net,
        /// Width and height, px.
        size: [u32; 2],
    },
}

/// A network with its heads.
#[derive(Debug)]
pub struct Lpips {
    net: Net,
    slices: Vec<Slice>,
}

/// One slice of the network and the head of its tap.
#[derive(Debug)]
struct Slice {
    pool: Option<usize>,
    convolutions: Vec<Convolution>,
    /// Weight of each channel.
    head: Vec<f32>,
}

impl Lpips {
    /// The metric with the weights of `net` among `tensors`; others that are there too do not matter.
    pub fn new(net: Net, tensors: &NamedTensors) -> Result<Self, WeightError> {
        check(net, tensors)?;
        let slice = |(layer, table): (usize, &network::Slice)| Slice {
            pool: table.pool,
            convolutions: table.convolutions.iter().map(|&shape| Convolution::new(shape, tensors)).collect(),
            head: tensors[&network::head(layer)].values.clone(),
        };
        Ok(Self { net, slices: net.slices().iter().enumerate().map(slice).collect() })
    }

    /// Whose features are compared.
    pub fn net(&self) -> Net {
        self.net
    }

    /// The sum of [`Lpips::layers`].
    pub fn distance(&self, a: &Photo, b: &Photo, range: InputRange) -> Result<f64, LpipsError> {
        Ok(self.layers(a, b, range)?.iter().sum())
    }

    /// The distance by layer, the shallowest first. Uses rayon's current pool.
    pub fn layers(&self, a: &Photo, b: &Photo, range: InputRange) -> Result<[f64; LAYERS], LpipsError> {
        check_sizes(a, b)?;
        if a.width.min(a.height) < self.net.min_side_px() {
            return Err(LpipsError::TooSmall { net: self.net, size: [a.width, a.height] });
        }
        let (mut a, mut b) = (Features::of_photo(a, range), Features::of_photo(b, range));
        let mut distances = [0.0; LAYERS];
        for (slice, distance) in self.slices.iter().zip(&mut distances) {
            (a, b) = (slice.apply(a), slice.apply(b));
            *distance = slice.distance(&a, &b);
        }
        Ok(distances)
    }
}

impl Slice {
    fn apply(&self, mut features: Features) -> Features {
        if let Some(window) = self.pool {
            features = features.max_pool(window);
        }
        self.convolutions.iter().fold(features, |features, convolution| convolution.apply(&features))
    }

    /// Mean over pixels of the weighted squared difference of unit-length features. Summed row by row, in
    /// order.
    fn distance(&self, a: &Features, b: &Features) -> f64 {
        let (stride, channels) = (a.width * a.channels, a.channels);
        let row = |(a, b): (&[f32], &[f32])| -> f64 {
            let pixels = a.chunks_exact(channels).zip(b.chunks_exact(channels));
            pixels.map(|(a, b)| self.pixel_distance(a, b)).sum()
        };
        let rows: Vec<f64> = a.values.par_chunks(stride).zip(b.values.par_chunks(stride)).map(row).collect();
        rows.iter().sum::<f64>() / (a.width * a.height) as f64
    }

    fn pixel_distance(&self, a: &[f32], b: &[f32]) -> f64 {
        let (scale_a, scale_b) = (unit_scale(a), unit_scale(b));
        let terms = a.iter().zip(b).zip(&self.head).map(|((a, b), weight)| {
            let difference = a * scale_a - b * scale_b;
            weight * difference * difference
        });
        f64::from(terms.sum::<f32>())
    }
}

/// What brings `features` to unit length; the authors' epsilon keeps a pixel without features at zero.
fn unit_scale(features: &[f32]) -> f32 {
    const EPSILON: f32 = 1e-10;
    1.0 / (features.iter().map(|value| value * value).sum::<f32>().sqrt() + EPSILON)
}

/// True when `tensors` holds something of `net` and nothing that contradicts it: one part (convolutions or
/// heads) of a network's weights tells which network it is of.
pub fn belongs_to(net: Net, tensors: &NamedTensors) -> bool {
    let found: Vec<bool> = net
        .tensors()
        .filter_map(|(name, shape)| tensors.get(&name).map(|tensor| tensor.shape == shape))
        .collect();
    found.contains(&true) && !found.contains(&false)
}

fn check(net: Net, tensors: &NamedTensors) -> Result<(), WeightError> {
    for (tensor, wanted) in net.tensors() {
        let Some(found) = tensors.get(&tensor) else { return Err(WeightError::Missing { net, tensor }) };
        if found.shape != wanted {
            return Err(WeightError::Shape { net, tensor, wanted, found: found.shape.clone() });
        }
        if !found.values.iter().all(|value| value.is_finite()) {
            return Err(WeightError::NotFinite(tensor));
        }
    }
    Ok(())
}
