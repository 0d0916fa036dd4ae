//! Photos (8-bit, interleaved, as files hold them) and images (f32, planar, as kernels want them).

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
