//! How well a splat reproduces photos.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Result;
use genesplat_core::{Image, RenderSettings, View};
use genesplat_io::photos::write_own_png;
use genesplat_metrics::{Evaluation, Lpips, ViewScore, cc_psnr, depth_error, psnr_under, score_view};
use rayon::prelude::*;

use crate::TEST;
use crate::device::Device;
use crate::exposure::{Light, Shade};
use crate::output::Bar;
use crate::scene;

/// How well a splat reproduces photos.
#[derive(Clone, Debug, PartialEq)]
pub struct Scores {
    /// Of renders; where photos were brought to one exposure, at that which each photo is expected to have.
    pub scores: Evaluation,
    /// Of the same renders at other exposures; `None` where photos keep their own.
    pub at_other: Option<AtOther>,
    /// Mean PSNR after a fit of each render's colours to its photo, dB; not finite where there is no photo.
    pub cc_psnr: f64,
    /// Mean over the photos that have a depth map, of [`genesplat_metrics::depth_error`].
    pub depth_error: Option<f64>,
}

/// Mean PSNR of photos, dB; not finite where there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtOther {
    /// Whether [`Scores::scores`] looks at no photo for its exposure, or is what its points tell.
    pub is_foretold: bool,
    /// Against renders at the mean exposure.
    pub mean_exposure: f64,
    /// Against renders at the exposure that the points of each photo tell.
    pub track_exposure: f64,
}

/// Scores all of `views`, for the cloud that `device` holds; in a `light`, renders are put at the exposure of
/// each photo.
pub fn evaluate_all(
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    lpips: Option<&Lpips>,
    light: Option<Light<'_>>,
) -> Result<Scores> {
    let bar = Bar::new("scores", views.len() as u64);
    let evaluation =
        evaluate_until(&AtomicBool::new(false), device, views, settings, (lpips, light), None, bar)?;
    Ok(evaluation.expect("nothing sets the flag"))
}

/// What is measured beside PSNR and SSIM, and the exposure of photos.
type With<'a> = (Option<&'a Lpips>, Option<Light<'a>>);

/// Scores some photos at a time, so that `stop` can end it (`None`): LPIPS of many takes minutes. Renders as
/// they were scored are written to `test/` of the run in `folder`.
pub(crate) fn evaluate_until(
    stop: &AtomicBool,
    device: &mut Device,
    views: &[View],
    settings: &RenderSettings,
    (lpips, light): With<'_>,
    folder: Option<&Path>,
    mut bar: Bar,
) -> Result<Option<Scores>> {
    let scoring = Scoring { settings, lpips, light, folder };
    let names = scene::picture_names(views);
    let mut scored = Vec::with_capacity(views.len());
    let (mut views, mut names) = (views, &names[..]);
    while !views.is_empty() {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        let count = scoring.photos_at_once(views);
        scored.extend(scoring.score(device, &views[..count], &names[..count])?);
        (views, names) = (&views[count..], &names[count..]);
        bar.set(scored.len() as u64, String::new);
    }
    let mean = |of: fn(&Scored) -> f64| scored.iter().map(of).sum::<f64>() / scored.len() as f64;
    let cc_psnr = mean(|of_photo| of_photo.cc_psnr);
    let at_other = light.map(|light| AtOther {
        is_foretold: light.is_foretold(),
        mean_exposure: mean(|of_photo| of_photo.at_mean),
        track_exposure: mean(|of_photo| of_photo.at_track),
    });
    let errors: Vec<f64> = scored.iter().filter_map(|of_photo| of_photo.depth_error).collect();
    let depth_error = (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64);
    let scores = Evaluation::from_views(scored.into_iter().map(|of_photo| of_photo.score).collect());
    Ok(Some(Scores { scores, at_other, cc_psnr, depth_error }))
}

/// Scores the first photos of `views`, as many as are scored at once, for who wants to know how long it
/// takes; their number.
pub(crate) fn score_some(device: &mut Device, views: &[View], lpips: Option<&Lpips>) -> Result<usize> {
    let settings = RenderSettings::default();
    let scoring = Scoring { settings: &settings, lpips, light: None, folder: None };
    let views = &views[..scoring.photos_at_once(views).min(views.len())];
    scoring.score(device, views, &scene::picture_names(views))?;
    Ok(views.len())
}

/// Pixels of the photos that are scored at once: each takes some 80 bytes.
const PIXELS_AT_ONCE: u64 = 8 << 20;

/// What all photos are scored with.
struct Scoring<'a> {
    settings: &'a RenderSettings,
    lpips: Option<&'a Lpips>,
    light: Option<Light<'a>>,
    folder: Option<&'a Path>,
}

/// A view, with its photo as it was taken, and its render as the cloud is.
struct Rendered {
    view: View,
    image: Image,
    depth_error: Option<f64>,
}

/// What a photo adds to [`Scores`].
struct Scored {
    score: ViewScore,
    at_mean: f64,
    at_track: f64,
    cc_psnr: f64,
    depth_error: Option<f64>,
}

impl Scoring<'_> {
    /// How many of the first of `views` have a core and memory for themselves; LPIPS needs all for one.
    fn photos_at_once(&self, views: &[View]) -> usize {
        let most = if self.lpips.is_some() { 1 } else { rayon::current_num_threads() };
        let mut pixels = 0;
        let fitting = views.iter().take(most).take_while(|view| {
            pixels += u64::from(view.camera.width) * u64::from(view.camera.height);
            pixels <= PIXELS_AT_ONCE
        });
        fitting.count().max(1)
    }

    /// Renders one after the other, then scores all at once, in the order of the views.
    fn score(&self, device: &mut Device, views: &[View], names: &[String]) -> Result<Vec<Scored>> {
        let rendered = views.iter().map(|view| self.render(device, view)).collect::<Result<Vec<_>>>()?;
        rendered.par_iter().zip(names).map(|(rendered, name)| self.score_one(rendered, name)).collect()
    }

    fn render(&self, device: &mut Device, view: &View) -> Result<Rendered> {
        let view = self.light.map_or_else(|| Ok(view.clone()), |light| light.as_taken(view))?;
        let depth_error = depth_error(device.as_mut(), &view, self.settings)?;
        Ok(Rendered { image: device.render(&view.camera, self.settings)?, view, depth_error })
    }

    fn score_one(&self, Rendered { view, image, depth_error }: &Rendered, name: &str) -> Result<Scored> {
        let (photo, mask) = (view.photo.read()?, view.mask.as_deref());
        let [expected, at_mean, at_track] = self.shades(&view.name).map(|shade| {
            let mut image = image.clone();
            shade.put_on(&mut image, &view.camera);
            image.to_photo()
        });
        let path = Path::new(TEST).join(name);
        self.folder.map_or(Ok(()), |folder| write_own_png(folder, path, &expected))?;
        Ok(Scored {
            score: score_view(view, &expected, &photo, self.lpips)?,
            at_mean: psnr_under(mask, &at_mean, &photo)?,
            at_track: psnr_under(mask, &at_track, &photo)?,
            cc_psnr: cc_psnr(mask, &at_track, &photo)?,
            depth_error: *depth_error,
        })
    }

    /// Of a photo: as it is expected to be, at the mean exposure, and as its points tell.
    fn shades(&self, name: &str) -> [Shade; 3] {
        let of = |light: Light<'_>| [light.foretold(name), light.mean(), light.of_photo(name)];
        self.light.map_or([Shade::NONE; 3], of)
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Camera, Gaussians, Photo};

    use super::*;
    use crate::device::{self, DeviceChoice};

    /// Three photos, of sizes of their own.
    fn views() -> Vec<View> {
        let view = |number: u32| {
            let (width, height) = (40 + 8 * number, 32);
            let rgb = (0..3 * width * height).map(|i| (i * (7 + number) % 251) as u8).collect();
            let (camera, photo) = (Camera::at_origin(width, height, 40.0), Photo { width, height, rgb });
            View { name: format!("{number}.png"), camera, photo: photo.into(), mask: None, depth: None }
        };
        (0..3).map(view).collect()
    }

    fn scoring(settings: &RenderSettings) -> Scoring<'_> {
        Scoring { settings, lpips: None, light: None, folder: None }
    }

    #[test]
    fn scores_are_the_same_one_by_one_and_at_once() {
        let mut device = device::open(DeviceChoice::Cpu).unwrap();
        device.upload(Gaussians::zeros(0).into()).unwrap();
        let (views, settings) = (views(), RenderSettings::default());
        let names = scene::picture_names(&views);
        let scoring = scoring(&settings);
        let at_once = scoring.score(&mut device, &views, &names).unwrap();
        for (index, found) in at_once.iter().enumerate() {
            let alone = &scoring.score(&mut device, &views[index..=index], &names[index..=index]).unwrap()[0];
            assert_eq!((&found.score, found.cc_psnr), (&alone.score, alone.cc_psnr));
            assert_eq!(found.score.name, views[index].name);
        }
        let means = evaluate_all(&mut device, &views, &settings, None, None).unwrap();
        let sum: f64 = at_once.iter().map(|found| found.score.psnr).sum();
        assert_eq!((means.scores.views.len(), means.scores.psnr), (3, sum / 3.0));
    }

    #[test]
    fn as_many_photos_are_scored_at_once_as_there_are_cores_and_memory() {
        let settings = RenderSettings::default();
        let scoring = scoring(&settings);
        let of_side = |side: u32| View { camera: Camera::at_origin(side, side, 40.0), ..views().remove(0) };
        let cores = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let at_once = |side: u32| cores.install(|| scoring.photos_at_once(&vec![of_side(side); 5]));
        assert_eq!([at_once(100), at_once(2000), at_once(9000)], [3, 2, 1]);
        assert_eq!(scoring.photos_at_once(&[of_side(100)]), 1);
    }
}
