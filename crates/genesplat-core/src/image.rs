//! Photos (8-bit, interleaved, as files hold them), their masks, and images (f32, planar, as kernels want
//! them).

use std::ops::Range;

/// A photo: 8-bit RGB, `[H, W, 3]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Photo {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// Values `[H, W, 3]`.
    pub rgb: Vec<u8>,
}

impl Photo {
    /// Values of one pixel.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        let at = 3 * (y as usize * self.width as usize + x as usize);
        [self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]]
    }
}

/// Which pixels of a photo count. What a photo has elsewhere (a passer-by, the photographer's hand) has no
/// effect on anything.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// True where the pixel counts `[H, W]`.
    pub counts: Vec<bool>,
}

impl Mask {
    /// How many pixels count.
    pub fn counted(&self) -> usize {
        self.counts.iter().filter(|counts| **counts).count()
    }

    /// Puts zeros where nothing counts into planes that hold these pixels of `[.., H, W]`.
    pub fn hide_part<T: Default>(&self, planes: &mut [T], pixels: Range<usize>) {
        for plane in planes.chunks_mut(pixels.len().max(1)) {
            let hidden = plane.iter_mut().zip(&self.counts[pixels.clone()]).filter(|(_, counts)| !**counts);
            hidden.for_each(|(value, _)| *value = T::default());
        }
    }

    /// `photo`, black where nothing counts.
    pub fn hide_in(&self, photo: &Photo) -> Photo {
        let shown = |(rgb, &counts): (&[u8], &bool)| if counts { [rgb[0], rgb[1], rgb[2]] } else { [0; 3] };
        Photo { rgb: photo.rgb.chunks_exact(3).zip(&self.counts).flat_map(shown).collect(), ..*photo }
    }
}

/// A rendered image: planar f32 RGB, `[3, H, W]`, nominally in `[0, 1]` but not clamped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width, px.
    pub width: u32,
    /// Height, px.
    pub height: u32,
    /// Values `[3, H, W]`.
    pub planes: Vec<f32>,
}

impl Image {
    /// A black image.
    pub fn zeros(width: u32, height: u32) -> Self {
        Self { width, height, planes: vec![0.0; 3 * width as usize * height as usize] }
    }

    /// Values of one pixel.
    pub fn pixel(&self, x: u32, y: u32) -> [f32; 3] {
        let pixels = self.width as usize * self.height as usize;
        let at = y as usize * self.width as usize + x as usize;
        [self.planes[at], self.planes[pixels + at], self.planes[2 * pixels + at]]
    }

    /// Multiplies red, green and blue by these.
    pub fn scale(&mut self, factors: [f32; 3]) {
        if factors == [1.0; 3] {
            return;
        }
        let pixels = self.width as usize * self.height as usize;
        for (plane, factor) in self.planes.chunks_exact_mut(pixels.max(1)).zip(factors) {
            plane.iter_mut().for_each(|value| *value *= factor);
        }
    }

    /// As 8-bit: clamped, `× 255 + 0.5`, truncated (what the reference evaluation writes and measures).
    pub fn to_photo(&self) -> Photo {
        let pixels = self.width as usize * self.height as usize;
        let mut rgb = vec![0; 3 * pixels];
        for (index, out) in rgb.chunks_exact_mut(3).enumerate() {
            for (channel, value) in out.iter_mut().enumerate() {
                *value = (self.planes[channel * pixels + index].clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
            }
        }
        Photo { width: self.width, height: self.height, rgb }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_count_is_hidden() {
        let mask = Mask { counts: vec![true, false, false, true] };
        assert_eq!(mask.counted(), 2);
        let mut planes: Vec<f32> = (1..=8).map(|value| value as f32).collect();
        mask.hide_part(&mut planes, 0..4);
        assert_eq!(planes, [1.0, 0.0, 0.0, 4.0, 5.0, 0.0, 0.0, 8.0]);
        let mut lower: Vec<f32> = (1..=4).map(|value| value as f32).collect();
        mask.hide_part(&mut lower, 2..4);
        assert_eq!(lower, [0.0, 2.0, 0.0, 4.0]);
        let photo = Photo { width: 2, height: 2, rgb: (1..=12).collect() };
        assert_eq!(mask.hide_in(&photo).rgb, [1, 2, 3, 0, 0, 0, 0, 0, 0, 10, 11, 12]);
    }

    #[test]
    fn eight_bit_values_are_rounded_and_clamped() {
        let planes = vec![0.49 / 255.0, 0.51 / 255.0, 254.6 / 255.0, 1.5, -0.1, 0.0];
        assert_eq!(Image { width: 2, height: 1, planes }.to_photo().rgb, [0, 255, 0, 1, 255, 0]);
    }

    #[test]
    fn eight_bit_values_survive_the_round_trip() {
        let rgb: Vec<u8> = (0..=255).flat_map(|v| [v, 255 - v, v / 2]).collect();
        let photo = Photo { width: 16, height: 16, rgb };
        let mut image = Image::zeros(16, 16);
        for (index, &value) in photo.rgb.iter().enumerate() {
            image.planes[index % 3 * 256 + index / 3] = f32::from(value) / 255.0;
        }
        assert_eq!(image.to_photo(), photo);
        assert_eq!(photo.pixel(1, 0), [1, 254, 0]);
        assert!((image.pixel(1, 0)[1] - 254.0 / 255.0).abs() < 1e-6);
    }
}
