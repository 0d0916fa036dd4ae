//! Photos of other exposure and white balance than the rest: brought to one exposure before training, by what
//! the points that photos share say, where that is worth it.
//!
//! A photo has three numbers, the factors by which its red, green and blue are brighter than on average of
//! the training photos (of 8-bit values: the tone curve of a camera makes of a factor of light another one of
//! values). They are those by which its pixels differ from the colours of COLMAP's points; their logarithms
//! have the mean 0, so no cast drifts in. What they explain is told by the halves of photos: how much more
//! alike one half becomes by the gain that the other half tells. Of the logarithms, that share is believed
//! with which halves are most alike, which may be none.
//!
//! A fourth number is their contrast, where that makes halves more alike: the power that a photo follows.
//!
//! Beside, there is one number for all photos: how much darker their corners are (`fall_off`).
//!
//! The photos that training sees are darker than the mean by one factor, [`Exposure::dark`], so that what the
//! darkest photo shows white is not cut off in any; the cloud is made brighter by it when it is shown or
//! saved, which is exact, since colours are linear in their harmonics. So no device knows of exposure.
//!
//! A photo is compared as it was taken, with its render at some exposure. Figures are of that which training
//! photos taken nearby have ([`Exposure::foretold`]), so that a test photo is looked at for nothing; beside
//! them stand those at the exposure that the photo's own points tell.

mod contrast;
mod estimate;
mod fall_off;
mod fit;
mod light;
mod nearby;
mod samples;

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Result, anyhow};
use genesplat_core::View;
use genesplat_io::{Scene, Spill, plural, replace_photos};
use serde::{Deserialize, Serialize};

pub use light::{Light, Shade};
pub(crate) use samples::by_photo;

use crate::output;

/// Darkest that photos are made, so that 8 bits still tell their shades apart.
const DARK_MIN: f32 = 0.4;

/// The value, of 1, that contrast leaves as it is.
const PIVOT: f32 = 0.35;

/// Of red, green and blue, side by side.
fn of_channels<T: Send>(of: impl Fn(usize) -> T + Sync) -> [T; 3] {
    let (red, (green, blue)) = rayon::join(|| of(0), || rayon::join(|| of(1), || of(2)));
    [red, green, blue]
}

/// Whether photos are brought to one exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Corrections {
    /// They are, by what shared points say.
    On,
    /// They are where shared points say something that is worth it.
    #[default]
    Auto,
    /// They are trained on as they are.
    Off,
}

impl Corrections {
    /// As flags and files call it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Auto => "auto",
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
    /// The powers of what is seen at the mean exposure that photos follow; 1 where none is
    /// there.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub contrasts: BTreeMap<String, f32>,
    /// By what factor the photos that training sees are brighter than the mean exposure, at most 1.
    pub dark: f32,
    /// Logarithm of how bright corners are, where the middle is 1, in all photos; not above 0.
    pub fall_off: f32,
    /// Test photos that another lens has taken, without it.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub plain_corners: BTreeSet<String>,
}

/// With `auto`, gains that explain less than this of what shared points differ by are not used.
const WORTH: f32 = 0.05;

/// The exposure of the photos of `scene`, which is shown on `background`, if they are to be brought to one,
/// and says what they differ by.
pub fn decide(scene: &Scene, asked: Corrections, background: [f32; 3]) -> Result<Option<Exposure>> {
    if asked == Corrections::Off {
        return Ok(None);
    }
    match (told_by_points(scene, background)?, asked) {
        (Ok(exposure), Corrections::Auto) if exposure.explained < WORTH => {
            output::tell(&exposure.sentence_of_none());
            Ok(None)
        }
        (Ok(exposure), _) => {
            output::tell(&exposure.sentence(scene));
            Ok(Some(exposure))
        }
        // Nobody has asked.
        (Err(_), Corrections::Auto) => Ok(None),
        (Err(why), _) => {
            Err(anyhow!("photos cannot be brought to one exposure: {why}; leave out --corrections on"))
        }
    }
}

/// That, or why there is none.
fn told_by_points(scene: &Scene, background: [f32; 3]) -> Result<Result<Exposure, &'static str>> {
    if background != [0.0; 3] {
        return Ok(Err("a white background has no exposure"));
    }
    Ok(estimate(scene)?.ok_or(
        "the scene does not say which photos share which points (COLMAP's tracks do), or too few are shared",
    ))
}

/// What shared points say; `None` where they say nothing.
pub fn estimate(scene: &Scene) -> Result<Option<Exposure>> {
    let [train, test] = [&scene.train, &scene.test].map(|views| samples::of_photos(scene, views));
    let Some(found) = estimate::estimate(&train?, &test?) else { return Ok(None) };
    // All parts of a photo have what it has.
    let photos = || [&scene.train, &scene.test].into_iter().flat_map(|views| by_photo(scene, views));
    let names = |views: &[View]| views.iter().map(|view| view.name.clone()).collect::<Vec<_>>();
    let known = |(views, gain): (&[View], Option<[f32; 3]>)| Some((names(views), gain?));
    let of_views = |(names, gain): (Vec<String>, [f32; 3])| names.into_iter().map(move |name| (name, gain));
    let gains =
        photos().zip(found.gains.into_iter().flatten()).filter_map(known).flat_map(of_views).collect();
    let contrasts = photos().zip(found.contrasts.into_iter().flatten()).filter(|(_, power)| *power != 1.0);
    let contrasts =
        contrasts.flat_map(|(views, power)| names(views).into_iter().map(move |name| (name, power)));
    let (stops, explained, contrasts) = (found.stops as f32, found.explained as f32, contrasts.collect());
    let plain = by_photo(scene, &scene.test).zip(&found.plain_corners).filter(|(_, is_plain)| **is_plain);
    let plain_corners = plain.flat_map(|(views, _)| names(views)).collect();
    let fall_off = found.fall_off;
    let mut exposure =
        Exposure { stops, explained, photos: gains, contrasts, dark: 1.0, fall_off, plain_corners };
    exposure.dark = exposure.darkness(&scene.train);
    Ok(Some(exposure))
}

impl Exposure {
    /// The gains of the photo of this name.
    pub fn gain(&self, name: &str) -> [f32; 3] {
        self.photos.get(name).copied().unwrap_or([1.0; 3])
    }

    /// What makes of the mean exposure, `bright` times as bright as it is, what the photo of this name shows.
    fn taking(&self, name: &str, bright: f32) -> Shade {
        let contrast = self.contrast(name);
        let factors = self.gain(name).map(|gain| gain * PIVOT.powf(1.0 - contrast) / bright.powf(contrast));
        Shade { factors, contrast, fall_off: self.fall_off_of(name) }
    }

    /// The reverse of [`Self::taking`].
    fn bringing(&self, name: &str, bright: f32) -> Shade {
        let taking = self.taking(name, 1.0);
        let contrast = 1.0 / taking.contrast;
        let factors = taking.factors.map(|factor| bright * factor.powf(-contrast));
        Shade { factors, contrast, fall_off: -taking.fall_off * contrast }
    }

    /// How bright the mean exposure may be so that nothing in photos of `views` is brighter than white.
    fn darkness(&self, views: &[View]) -> f32 {
        let brightest = |view: &View| {
            let Shade { factors, fall_off, .. } = self.bringing(&view.name, 1.0);
            factors.iter().fold(1.0, |most, factor| f32::max(most, *factor)) * fall_off.exp()
        };
        (1.0 / views.iter().map(brightest).fold(1.0, f32::max)).max(DARK_MIN)
    }

    fn fall_off_of(&self, name: &str) -> f32 {
        if self.plain_corners.contains(name) { 0.0 } else { self.fall_off }
    }

    fn contrast(&self, name: &str) -> f32 {
        self.contrasts.get(name).copied().unwrap_or(1.0)
    }

    /// By what factor the mean exposure is brighter than a cloud under training.
    pub fn brightness(&self) -> f32 {
        1.0 / self.dark
    }

    /// Without the photos whose names `keeps` does not want.
    pub(crate) fn only(&self, keeps: impl Fn(&str) -> bool) -> Self {
        let mut only = self.clone();
        only.photos.retain(|name, _| keeps(name));
        only.contrasts.retain(|name, _| keeps(name));
        only.plain_corners.retain(|name| keeps(name));
        only
    }

    /// Brings the training photos of `scene`, and its points, to the exposure that training sees; `spill`
    /// says where photos go that are in a file.
    pub fn bring(&self, scene: &mut Scene, spill: Option<&Spill>) -> Result<()> {
        for point in &mut scene.points {
            point.rgb = point.rgb.map(|value| light::times(value, self.dark));
        }
        let brought = |view: &View| {
            let shade = self.bringing(&view.name, self.dark);
            Ok(shade.of_photo(&*view.photo.read()?, &view.camera))
        };
        Ok(replace_photos(&mut scene.train, spill, brought)?)
    }

    /// What was done, for a report.
    pub fn told(&self) -> String {
        let percent = (100.0 * self.explained).round().max(0.0);
        format!(
            "photos differ by {:.2} stops, and were brought to one exposure, which explains {percent} % of what shared points differ \
             by{}; renders show the mean exposure",
            self.stops,
            self.corners()
        )
    }

    fn corners(&self) -> String {
        let percent = 100.0 * (1.0 - self.fall_off.exp());
        if self.fall_off < 0.0 {
            format!(", with corners that are {percent:.0} % darker")
        } else {
            String::new()
        }
    }

    /// What was found, and is not used.
    fn sentence_of_none(&self) -> String {
        let percent = (100.0 * self.explained).round().max(0.0);
        format!(
            "photos differ by {:.2} stops, and keep their exposure: one for all explains only {percent} % of what shared points differ by",
            self.stops
        )
    }

    /// What was found.
    fn sentence(&self, scene: &Scene) -> String {
        let percent = (100.0 * self.explained).round().max(0.0);
        let differ = format!("photos differ by {:.2} stops", self.stops);
        let alone =
            |views: &[View]| views.iter().filter(|view| !self.photos.contains_key(&view.name)).count();
        let as_they_are = match alone(&scene.train) + alone(&scene.test) {
            0 => String::new(),
            count => {
                format!("; {count} {} too few points, and stay as they are", plural(count, "shares", "share"))
            }
        };
        format!(
            "{differ}, and are brought to one exposure, which explains {percent} % of what shared points differ by{}{as_they_are}",
            self.corners()
        )
    }
}

#[cfg(test)]
mod tests;
