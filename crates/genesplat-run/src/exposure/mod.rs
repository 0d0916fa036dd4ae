//! Photos of other exposure and white balance than the rest: brought to one exposure before training, where
//! points that photos share say that it helps.
//!
//! A photo has three numbers, the factors by which its red, green and blue are brighter than on average of
//! the training photos. They are those by which its pixels differ from the colours of COLMAP's points. Whether
//! they are worth anything is judged on the halves of photos: the gain that one half tells must make the
//! other half more alike. A test photo's gain comes from the points that it shares with training photos, and
//! is put on its render: the photo itself is compared as it is.

mod estimate;
mod fit;
mod samples;

use std::borrow::Cow;
use std::collections::BTreeMap;

use anyhow::{Result, bail};
use genesplat_core::{BackendError, Camera, Gaussians, Image, Photo, RenderSettings, Renderer, View};
use genesplat_io::{Scene, Spill, plural, replace_photos};
use serde::{Deserialize, Serialize};

use crate::output;

/// Share of what shared points differ by that gains must explain to be kept.
const WORTH: f64 = 0.2;

/// Values from which on a photo may be clipped, and surely is: white stays white.
const WHITE: [f32; 2] = [240.0, 250.0];

/// Whether photos are brought to one exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExposureUse {
    /// Where it helps by what shared points say.
    #[default]
    Auto,
    /// Whatever they say.
    On,
    /// Never.
    Off,
}

impl ExposureUse {
    /// As flags and files call it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::On => "on",
            Self::Off => "off",
        }
    }
}

/// The exposure of a scene's photos.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Standard deviation over training photos, stops of light at a gamma of 2.2.
    pub stops: f32,
    /// Share of what shared points differ by that the photos' gains explain.
    pub explained: f32,
    /// By what factors red, green and blue of a photo are brighter than on average, by the names of views,
    /// test photos among them. One that is not there is taken as it is.
    pub photos: BTreeMap<String, [f32; 3]>,
}

/// The exposure of the photos of `scene`, if they are to be brought to one, and says why or why not.
pub fn decide(scene: &Scene, asked: ExposureUse) -> Result<Option<Exposure>> {
    if asked == ExposureUse::Off {
        return Ok(None);
    }
    let Some(exposure) = estimate(scene)? else {
        let why = "the scene does not say which photos share which points (COLMAP's tracks do), or too few are shared";
        if asked == ExposureUse::On {
            bail!("photos cannot be brought to one exposure: {why}; leave out --exposure on");
        }
        output::tell(&format!("photos keep their exposure: {why}"));
        return Ok(None);
    };
    let is_kept = asked == ExposureUse::On || f64::from(exposure.explained) >= WORTH;
    output::tell(&exposure.sentence(is_kept, scene));
    Ok(is_kept.then_some(exposure))
}

/// What shared points say; `None` where they say nothing.
pub fn estimate(scene: &Scene) -> Result<Option<Exposure>> {
    let [train, test] =
        [&scene.train, &scene.test].map(|views| samples::of_views(views, &scene.points, &scene.seen));
    let Some(found) = estimate::estimate(&train?, &test?) else { return Ok(None) };
    let [train, test] = found.gains;
    let named = |(view, gain): (&View, Option<[f32; 3]>)| Some((view.name.clone(), gain?));
    let photos = scene.train.iter().zip(train).chain(scene.test.iter().zip(test)).filter_map(named).collect();
    let (stops, explained) = (found.stops as f32, found.explained as f32);
    Ok(Some(Exposure { stops, explained, photos }))
}

impl Exposure {
    /// The gains of the photo of this name.
    pub fn gain(&self, name: &str) -> [f32; 3] {
        self.photos.get(name).copied().unwrap_or([1.0; 3])
    }

    /// Without the photos whose names `keeps` does not want.
    pub(crate) fn only(&self, keeps: impl Fn(&str) -> bool) -> Self {
        let photos = self.photos.iter().filter(|(name, _)| keeps(name));
        Self { photos: photos.map(|(name, gain)| (name.clone(), *gain)).collect(), ..*self }
    }

    /// Brings the training photos of `scene` to one exposure; `spill` says where photos go that are in a file.
    pub fn bring(&self, scene: &mut Scene, spill: Option<&Spill>) -> Result<()> {
        let brought = |view: &View| Ok(brought(&*view.photo.read()?, self.gain(&view.name)));
        Ok(replace_photos(&mut scene.train, spill, brought)?)
    }

    /// What was found, and whether it is kept.
    fn sentence(&self, is_kept: bool, scene: &Scene) -> String {
        let percent = (100.0 * self.explained).round().max(0.0);
        let differ = format!("photos differ by {:.2} stops", self.stops);
        if !is_kept {
            let least = 100.0 * WORTH;
            return format!(
                "{differ}, and keep their exposure: one exposure would explain {percent} % of what shared points differ by, and it \
                 pays from {least} % on (--exposure on does it all the same)"
            );
        }
        let alone =
            |views: &[View]| views.iter().filter(|view| !self.photos.contains_key(&view.name)).count();
        let as_they_are = match alone(&scene.train) + alone(&scene.test) {
            0 => String::new(),
            count => {
                format!("; {count} {} too few points, and stay as they are", plural(count, "shares", "share"))
            }
        };
        format!(
            "{differ}, and are brought to one exposure, which explains {percent} % of what shared points differ by (--exposure off \
             leaves them as they are){as_they_are}"
        )
    }
}

/// `photo` at the mean exposure. What is clipped to white has no known brightness, and stays white.
fn brought(photo: &Photo, gain: [f32; 3]) -> Photo {
    let tables = gain.map(table);
    let rgb = photo.rgb.chunks_exact(3).flat_map(|rgb| [0, 1, 2].map(|c| tables[c][usize::from(rgb[c])]));
    Photo { rgb: rgb.collect(), ..*photo }
}

/// What each 8-bit value of a photo with this gain becomes.
fn table(gain: f32) -> [u8; 256] {
    std::array::from_fn(|value| {
        let value = value as f32;
        let brought = value / gain;
        let clipped = ((value - WHITE[0]) / (WHITE[1] - WHITE[0])).clamp(0.0, 1.0);
        (brought + clipped * (value - brought).max(0.0)).round().clamp(0.0, 255.0) as u8
    })
}

/// Draws what another device draws, at the exposure of a photo.
pub(crate) struct Exposed<'a> {
    pub(crate) renderer: &'a mut dyn Renderer,
    pub(crate) gain: [f32; 3],
}

impl Renderer for Exposed<'_> {
    fn describe(&self) -> String {
        self.renderer.describe()
    }

    fn gaussian_count(&self) -> usize {
        self.renderer.gaussian_count()
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.renderer.download()
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        Ok(put_on(self.renderer.render(camera, settings)?, self.gain))
    }
}

/// A render at the mean exposure, at that of a photo with this gain.
pub(crate) fn put_on(mut image: Image, gain: [f32; 3]) -> Image {
    let pixels = image.planes.len() / 3;
    for (plane, gain) in image.planes.chunks_exact_mut(pixels.max(1)).zip(gain) {
        plane.iter_mut().for_each(|value| *value *= gain);
    }
    image
}

#[cfg(test)]
mod tests;
