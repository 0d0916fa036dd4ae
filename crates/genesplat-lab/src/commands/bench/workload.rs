//! A trained cloud, or one that resembles one, at any number of Gaussians.
//!
//! For the latter, points are sampled again with a jitter of their own spacing until there are as many as
//! wanted; Gaussians as wide as the distance to their new neighbours then cover the same surfaces, as
//! densification does.

use std::path::Path;

use anyhow::{Result, bail};
use genesplat::core::gaussians::logit;
use genesplat::core::{Camera, Gaussians, Photo, RenderSettings, Rng, Stream, View};
use genesplat::flags::SizeArgs;
use genesplat::run::settings::Dataset;
use genesplat::run::{scene, splat};
use genesplat::train::scene::initialise::{ColouredPoint, cloud_from_points, in_spatial_order};

use crate::args::{SourceArgs, WorkloadArgs};

const GAUSSIANS: usize = 55_000;
/// Size of the synthetic photo: that of the figures in the design, which were measured on a phone's portrait.
const SIZE_PX: [u32; 2] = [268, 478];
/// Opacities are spread evenly over this range.
const OPACITY: [f32; 2] = [0.02, 0.98];
/// Width of a Gaussian against the distance to its neighbours. With this, a tile list has as many entries a
/// Gaussian as one of a real cloud in training (fox, 270x480 px: 3.4 at 14,678 Gaussians, 2.1 at 65,353, 1.8
/// at 130,564).
const WIDTH: f32 = 0.5;
/// Standard deviation of the natural logarithm of an axis against the mean of the axes.
const STRETCH: f32 = 0.6;

pub(crate) struct Source {
    pub(crate) views: Vec<View>,
    pub(crate) settings: RenderSettings,
    origin: Origin,
}

enum Origin {
    /// To be sampled from; at least 4, as the loader sees to.
    Points(Vec<ColouredPoint>),
    Trained(Gaussians),
}

impl Source {
    /// The scene and its splat, if there are any; else the synthetic scene, whose photo has `synthetic_px`.
    pub(crate) fn of(SourceArgs { data, splat, size }: &SourceArgs, synthetic_px: [u32; 2]) -> Result<Self> {
        match (data, splat) {
            (Some(data), Some(splat)) => Self::trained(data, splat, *size),
            (Some(data), None) => Self::scene(data, *size),
            (None, _) if size.size().is_some() => {
                bail!("--max-side and --downscale reduce photos; name a scene with --data, or leave them out")
            }
            (None, _) => Ok(Self::synthetic(synthetic_px)),
        }
    }

    fn synthetic(size_px: [u32; 2]) -> Self {
        Self {
            views: vec![synthetic_view(size_px)],
            settings: RenderSettings::default(),
            origin: Origin::Points(synthetic_points(size_px)),
        }
    }

    fn scene(data: &Path, size: SizeArgs) -> Result<Self> {
        let scene = scene::load(&Dataset::of(data, &size.asked()), [0.0; 3], 0, None, None)?;
        let points = scene::points(&scene);
        Ok(Self { views: scene.train, settings: RenderSettings::default(), origin: Origin::Points(points) })
    }

    /// As large as the splat was trained unless another size is asked for, and rendered as it is meant to be.
    fn trained(data: &Path, path: &Path, size: SizeArgs) -> Result<Self> {
        let splat = splat::open(path)?;
        let scene = splat.load_scene(data, &size.asked())?;
        Ok(Self { views: scene.train, settings: splat.settings, origin: Origin::Trained(splat.cloud) })
    }

    pub(crate) fn trained_count(&self) -> Option<usize> {
        match &self.origin {
            Origin::Points(_) => None,
            Origin::Trained(cloud) => Some(cloud.len()),
        }
    }

    pub(crate) fn cloud(&self, count: usize) -> Result<Gaussians> {
        match &self.origin {
            Origin::Points(points) => sampled(points, count),
            Origin::Trained(cloud) => Ok(cloud.clone()),
        }
    }

    /// The photos, how to render, and a cloud as it was asked for.
    pub(crate) fn of_cpu(args: &WorkloadArgs) -> Result<(Vec<View>, RenderSettings, Gaussians)> {
        let Self { views, settings, origin } = Self::of(&args.source, SIZE_PX)?;
        let cloud = match origin {
            Origin::Points(points) => {
                let default = if args.source.data.is_some() { points.len() } else { GAUSSIANS };
                sampled(&points, args.gaussians.map_or(default, |count| count as usize))?
            }
            Origin::Trained(cloud) => cloud,
        };
        Ok((views, settings, cloud))
    }
}

fn sampled(points: &[ColouredPoint], count: usize) -> Result<Gaussians> {
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

/// A camera at the origin that looks along z, and a photo of soft colours.
fn synthetic_view([width, height]: [u32; 2]) -> View {
    let camera = Camera::at_origin(width, height, f64::from(height));
    let pixel = |x: u32, y: u32| [(255 * x / width) as u8, (255 * y / height) as u8, 128];
    let rgb = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y))).collect();
    View { name: "synthetic".into(), camera, photo: Photo { width, height, rgb }.into(), mask: None }
}

/// A wavy wall that fills the picture, twice as wide, with a second one behind it.
fn synthetic_points(size_px: [u32; 2]) -> Vec<ColouredPoint> {
    const POINTS: u32 = 15_000;
    let [width, height] = size_px.map(|side| side as f32);
    let rng = Rng::new(0);
    let point = |row: u32| {
        let draw = rng.at(Stream::Test, 5, row, 0);
        let depth = if draw.uniform(2) < 0.6 { 4.0 } else { 6.0 };
        let (x, y) = (2.0 * draw.uniform(0) - 1.0, 2.0 * draw.uniform(1) - 1.0);
        let position = [depth * x * width / height, 0.6 * depth * y, depth + 0.3 * (5.0 * x).sin()];
        (position, [(255.0 * draw.uniform(0)) as u8, (255.0 * draw.uniform(1)) as u8, 128])
    };
    (0..POINTS).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trained_cloud_is_measured_as_it_is() {
        let trained = Source { origin: Origin::Trained(Gaussians::zeros(7)), ..Source::synthetic([16, 16]) };
        assert_eq!((trained.trained_count(), trained.cloud(99).unwrap().len()), (Some(7), 7));
        let synthetic = Source::synthetic([16, 16]);
        assert_eq!((synthetic.trained_count(), synthetic.cloud(99).unwrap().len()), (None, 99));
    }
}
