//! A cloud that costs what a trained one costs, with any number of Gaussians.
//!
//! Points are sampled again with a jitter of their own spacing until there are as many as wanted; Gaussians
//! as wide as the distance to their new neighbours then cover the same surfaces, as densification does.

use anyhow::Result;
use genesplat_core::gaussians::logit;
use genesplat_core::{Gaussians, Rng, Stream};
use genesplat_train::scene::initialise::{ColouredPoint, cloud_from_points, in_spatial_order};

/// Opacities are spread evenly over this range.
const OPACITY: [f32; 2] = [0.02, 0.98];
/// Width of a Gaussian against the distance to its neighbours. With this, a tile list has as many entries a
/// Gaussian as one of a real cloud in training (fox, 270x480 px: 3.4 at 14,678 Gaussians, 2.1 at 65,353, 1.8
/// at 130,564).
const WIDTH: f32 = 0.5;
/// Standard deviation of the natural logarithm of an axis against the mean of the axes.
const STRETCH: f32 = 0.6;

/// The cloud of so many, from points of which there are 4 at least.
pub fn sampled(points: &[ColouredPoint], count: usize) -> Result<Gaussians> {
    trained_looking(&in_spatial_order(&resample(points, count)?))
}

/// `count` points, each near a random one of `points`.
fn resample(points: &[ColouredPoint], count: usize) -> Result<Vec<ColouredPoint>> {
    let spacing = cloud_from_points(points)?.log_scales;
    let rng = Rng::new(0);
    let sample = |row: usize| {
        let draw = rng.at(Stream::Test, 0, row as u32, 0);
        let index = draw.below(0, points.len() as u32) as usize;
        let (position, rgb) = points[index];
        let jitter = normals(&rng, 1, row);
        let width = spacing[index][0].exp();
        (std::array::from_fn(|axis| position[axis] + width * jitter[axis]), rgb)
    };
    Ok((0..count).map(sample).collect())
}

fn trained_looking(points: &[ColouredPoint]) -> Result<Gaussians> {
    let mut cloud = cloud_from_points(points)?;
    let rng = Rng::new(0);
    for row in 0..cloud.len() {
        let stretch = normals(&rng, 2, row);
        cloud.log_scales[row]
            .iter_mut()
            .zip(stretch)
            .for_each(|(axis, normal)| *axis += WIDTH.ln() + STRETCH * normal);
        cloud.rotations[row] = normals(&rng, 3, row);
        let uniform = rng.at(Stream::Test, 4, row as u32, 0).uniform(0);
        cloud.opacity_logits[row] = logit(OPACITY[0] + (OPACITY[1] - OPACITY[0]) * uniform);
    }
    Ok(cloud)
}

fn normals(rng: &Rng, purpose: u32, row: usize) -> [f32; 4] {
    let draw = rng.at(Stream::Test, purpose, row as u32, 0);
    let ([a, b], [c, d]) = (draw.normals(0), draw.normals(1));
    [a, b, c, d]
}
