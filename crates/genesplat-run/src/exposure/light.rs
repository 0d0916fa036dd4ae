//! Renders at the exposure of a photo.

use std::io;
use std::sync::Arc;

use anyhow::Result;
use genesplat_core::{Camera, Image, Photo, PhotoStore, StoredPhoto, View};

use super::Exposure;
use super::fall_off::of_row;

/// What renders and photos that are compared have to do with the exposure that photos were brought to.
#[derive(Clone, Copy, Debug)]
pub struct Light<'a> {
    exposure: &'a Exposure,
    /// By what factor the cloud is brighter than the mean exposure.
    cloud: f32,
    /// Whether the photos are those that training sees.
    is_brought: bool,
    /// What is expected of photos that nobody has looked at ([`Exposure::foretold`]).
    foretold: Option<&'a Exposure>,
}

impl<'a> Light<'a> {
    /// Of a finished cloud, and photos as they were taken.
    pub fn finished(exposure: &'a Exposure) -> Self {
        Self { exposure, cloud: 1.0, is_brought: false, foretold: None }
    }

    /// Of a cloud under training.
    pub fn in_training(exposure: &'a Exposure) -> Self {
        Self { cloud: exposure.dark, ..Self::finished(exposure) }
    }

    /// With photos that were brought to the exposure that training sees.
    pub fn brought(self) -> Self {
        Self { is_brought: true, ..self }
    }

    /// With figures of renders at the exposure that photos are expected to have.
    pub fn foretelling(self, foretold: Option<&'a Exposure>) -> Self {
        Self { foretold, ..self }
    }

    pub(crate) fn is_foretold(&self) -> bool {
        self.foretold.is_some()
    }

    /// What makes a render look as the photo of this name is expected to.
    pub(crate) fn foretold(&self, name: &str) -> Shade {
        self.foretold.unwrap_or(self.exposure).taking(name, self.cloud)
    }

    /// What makes a render look as the photo of this name.
    pub fn of_photo(&self, name: &str) -> Shade {
        self.exposure.taking(name, self.cloud)
    }

    /// What brings a render to the mean exposure.
    pub(crate) fn mean(&self) -> Shade {
        Shade { factors: [1.0 / self.cloud; 3], ..Shade::NONE }
    }

    /// The view with its photo at the mean exposure, as a page shows it beside renders. It is made when
    /// somebody looks.
    pub(crate) fn at_mean(&self, view: &View) -> View {
        let shade = if self.is_brought {
            Shade { factors: [self.exposure.brightness(); 3], ..Shade::NONE }
        } else {
            self.exposure.bringing(&view.name, 1.0)
        };
        let (width, height) = (view.photo.width(), view.photo.height());
        let shaded = Shaded { photo: view.photo.clone(), camera: view.camera, shade };
        View { photo: StoredPhoto::in_store(Arc::new(shaded), 0, width, height), ..view.clone() }
    }

    /// The view with its photo as it was taken.
    pub(crate) fn as_taken(&self, view: &View) -> Result<View> {
        if !self.is_brought {
            return Ok(view.clone());
        }
        let shade = self.exposure.taking(&view.name, self.exposure.dark);
        Ok(View { photo: shade.of_photo(&*view.photo.read()?, &view.camera).into(), ..view.clone() })
    }
}

/// What pixels are multiplied by, after they were raised to a power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    /// Of red, green and blue.
    pub(crate) factors: [f32; 3],
    /// The power, where white is 1.
    pub(crate) contrast: f32,
    /// [`Exposure::fall_off`]
    pub(crate) fall_off: f32,
}

impl Shade {
    /// Changes nothing.
    pub(crate) const NONE: Self = Self { factors: [1.0; 3], contrast: 1.0, fall_off: 0.0 };

    /// Changes what `camera` sees.
    pub fn put_on(&self, image: &mut Image, camera: &Camera) {
        if self.contrast != 1.0 {
            image.planes.iter_mut().for_each(|value| *value = value.max(0.0).powf(self.contrast));
        }
        image.scale(self.factors);
        if self.fall_off == 0.0 {
            return;
        }
        let [width, height] = [image.width, image.height].map(|side| side as usize);
        for y in 0..height {
            let factors = of_row(self.fall_off, camera, y);
            for plane in image.planes.chunks_exact_mut((width * height).max(1)) {
                plane[y * width..][..width]
                    .iter_mut()
                    .zip(&factors)
                    .for_each(|(value, factor)| *value *= factor);
            }
        }
    }

    /// The photo of `camera` with its pixels changed.
    pub(crate) fn of_photo(&self, photo: &Photo, camera: &Camera) -> Photo {
        let raised: [f32; 256] =
            std::array::from_fn(|value| 255.0 * (value as f32 / 255.0).powf(self.contrast));
        let mut rgb = photo.rgb.clone();
        let pixels = rgb.as_chunks_mut::<3>().0;
        if self.fall_off == 0.0 {
            let tables = self.factors.map(|factor| raised.map(|value| rounded(value * factor)));
            for pixel in pixels {
                *pixel = std::array::from_fn(|channel| tables[channel][usize::from(pixel[channel])]);
            }
            return Photo { rgb, ..*photo };
        }
        for (y, row) in pixels.chunks_exact_mut(photo.width as usize).enumerate() {
            for (pixel, along) in row.iter_mut().zip(of_row(self.fall_off, camera, y)) {
                let value =
                    |channel: usize| raised[usize::from(pixel[channel])] * along * self.factors[channel];
                *pixel = std::array::from_fn(|channel| rounded(value(channel)));
            }
        }
        Photo { rgb, ..*photo }
    }
}

/// An 8-bit value, multiplied.
pub(super) fn times(value: u8, factor: f32) -> u8 {
    rounded(f32::from(value) * factor)
}

/// To the nearest, halves upwards, as [`f32::round`] does, which is a call.
fn rounded(value: f32) -> u8 {
    let whole = value as u8;
    whole.saturating_add(u8::from(value - f32::from(whole) >= 0.5))
}

/// A photo in a shade, for who looks at few.
#[derive(Debug)]
struct Shaded {
    photo: StoredPhoto,
    camera: Camera,
    shade: Shade,
}

impl PhotoStore for Shaded {
    fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        let photo = self.photo.read().map_err(io::Error::other)?;
        let shaded = self.shade.of_photo(&photo, &self.camera);
        let asked = shaded.rgb.get(at as usize..at as usize + out.len());
        out.copy_from_slice(asked.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_rounded_as_the_library_does() {
        let values = (-40..4200).map(|sixteenth| sixteenth as f32 / 16.0);
        let near_halves = (0..256).flat_map(|whole| {
            let half = whole as f32 + 0.5;
            [half.next_down(), half, half.next_up()]
        });
        for value in values.chain(near_halves).chain([f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30]) {
            assert_eq!(rounded(value), value.round().clamp(0.0, 255.0) as u8, "{value}");
        }
    }
}
