//! A trained cloud, or one that resembles one, at any number of Gaussians.

use std::path::Path;

use anyhow::{Result, bail};
use genesplat::core::{Camera, Gaussians, Photo, RenderSettings, Rng, Stream, View};
use genesplat::flags::SizeArgs;
use genesplat::io::Scene;
use genesplat::run::sampled::sampled;
use genesplat::run::settings::Dataset;
use genesplat::run::{scene, splat};
use genesplat::train::scene::initialise::ColouredPoint;

use crate::args::{SourceArgs, WorkloadArgs};

const GAUSSIANS: usize = 55_000;
/// Size of the synthetic photo: that of the figures in the design, which were measured on a phone's portrait.
const SIZE_PX: [u32; 2] = [268, 478];
pub(crate) struct Source {
    pub(crate) views: Vec<View>,
    pub(crate) settings: RenderSettings,
    /// What a whole run trains on; none where the photo is synthetic.
    pub(crate) scene: Option<Scene>,
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
            scene: None,
            origin: Origin::Points(synthetic_points(size_px)),
        }
    }

    fn scene(data: &Path, size: SizeArgs) -> Result<Self> {
        let scene = scene::load(&Dataset::of(data, &size.asked()), false, [0.0; 3], 0, None, None)?;
        let points = scene::points(&scene);
        let (views, settings) = (scene.train.clone(), RenderSettings::default());
        Ok(Self { views, settings, scene: Some(scene), origin: Origin::Points(points) })
    }

    /// As large as the splat was trained unless another size is asked for, and rendered as it is meant to be.
    fn trained(data: &Path, path: &Path, size: SizeArgs) -> Result<Self> {
        let splat = splat::open(path)?;
        let scene = splat.load_scene(data, &size.asked())?;
        let (views, settings) = (scene.train.clone(), splat.settings);
        Ok(Self { views, settings, scene: Some(scene), origin: Origin::Trained(splat.cloud) })
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
        let Self { views, settings, origin, .. } = Self::of(&args.source, SIZE_PX)?;
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

/// A camera at the origin that looks along z, and a photo of soft colours.
fn synthetic_view([width, height]: [u32; 2]) -> View {
    let camera = Camera::at_origin(width, height, f64::from(height));
    let pixel = |x: u32, y: u32| [(255 * x / width) as u8, (255 * y / height) as u8, 128];
    let rgb = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y))).collect();
    View {
        name: "synthetic".into(),
        camera,
        photo: Photo { width, height, rgb }.into(),
        mask: None,
        depth: None,
    }
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
