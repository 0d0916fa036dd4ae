//! Views at half of their size: a quarter of the pixels.

use std::io;
use std::sync::Arc;

use crate::backend::View;
use crate::camera::Camera;
use crate::image::Mask;
use crate::stored_photo::{PhotoStore, StoredPhoto};

impl View {
    /// The view at half of its size: a pixel is the mean of those of its four that count, and counts where
    /// one of them does. A last odd row or column is left out, and so is a depth map. The photo is halved
    /// whenever it is read, so that it takes no memory.
    pub fn halved(&self) -> Self {
        let camera = Camera {
            width: self.camera.width / 2,
            height: self.camera.height / 2,
            focal_px: self.camera.focal_px.map(|focal| 0.5 * focal),
            principal_px: self.camera.principal_px.map(|centre| 0.5 * centre),
            ..self.camera
        };
        let (width, height) = (self.photo.width(), self.photo.height());
        let halved = Halved { photo: self.photo.clone(), mask: self.mask.clone() };
        let mask = self.mask.as_ref().map(|mask| Arc::new(halved_mask(mask, width as usize)));
        let photo = StoredPhoto::in_store(Arc::new(halved), 0, width / 2, height / 2);
        Self { name: self.name.clone(), camera, photo, mask, depth: None }
    }
}

fn halved_mask(mask: &Mask, width: usize) -> Mask {
    let pairs = mask.counts.chunks_exact(2 * width);
    let counts = |rows: &[bool]| -> Vec<bool> {
        let (upper, lower) = rows.split_at(width);
        let pair = |(upper, lower): (&[bool], &[bool])| upper.iter().chain(lower).any(|&counts| counts);
        upper.chunks_exact(2).zip(lower.chunks_exact(2)).map(pair).collect()
    };
    Mask { counts: pairs.flat_map(counts).collect() }
}

#[derive(Debug)]
struct Halved {
    photo: StoredPhoto,
    mask: Option<Arc<Mask>>,
}

impl PhotoStore for Halved {
    fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        let row_bytes = 3 * (self.photo.width() as usize / 2);
        let (first, end) = (at as usize, at as usize + out.len());
        let rows = first / row_bytes..end.div_ceil(row_bytes);
        let mut scratch = Vec::new();
        let values =
            self.photo.rows(&(2 * rows.start..2 * rows.end), &mut scratch).map_err(io::Error::other)?;
        let mut halved = vec![0; row_bytes * rows.len()];
        let pairs = values.chunks_exact(6 * self.photo.width() as usize);
        for ((row, pair), halved) in rows.clone().zip(pairs).zip(halved.chunks_exact_mut(row_bytes)) {
            self.halve(row, pair, halved);
        }
        out.copy_from_slice(&halved[first - rows.start * row_bytes..][..end - first]);
        Ok(())
    }
}

impl Halved {
    /// Two rows become the row of that number.
    fn halve(&self, row: usize, pair: &[u8], halved: &mut [u8]) {
        let width = self.photo.width() as usize;
        let (upper, lower) = pair.split_at(3 * width);
        let beside = upper.chunks_exact(6).zip(lower.chunks_exact(6));
        for (x, (out, (upper, lower))) in halved.chunks_exact_mut(3).zip(beside).enumerate() {
            let of_four = |channel: usize| {
                [upper[channel], upper[channel + 3], lower[channel], lower[channel + 3]].map(u16::from)
            };
            let Some(mask) = &self.mask else {
                let mean = |channel| ((of_four(channel).iter().sum::<u16>() + 2) / 4) as u8;
                out.copy_from_slice(&[mean(0), mean(1), mean(2)]);
                continue;
            };
            let at = 2 * row * width + 2 * x;
            let counts = [0, 1, width, width + 1].map(|beside| u16::from(mask.counts[at + beside]));
            let count = counts.iter().sum::<u16>();
            let mean = |channel| {
                let shown = of_four(channel).into_iter().zip(counts).map(|(value, counts)| value * counts);
                ((shown.sum::<u16>() + count / 2) / count.max(1)) as u8
            };
            out.copy_from_slice(&[mean(0), mean(1), mean(2)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Photo;

    fn view(mask: Option<Vec<bool>>) -> View {
        // Five columns and five rows, of which the last are left out.
        let rgb = (0..25u8).flat_map(|at| [10 * at, at, 0]).collect();
        View {
            name: "a".into(),
            camera: Camera { principal_px: [2.0, 3.0], ..Camera::at_origin(5, 5, 8.0) },
            photo: Photo { width: 5, height: 5, rgb }.into(),
            mask: mask.map(|counts| Arc::new(Mask { counts })),
            depth: None,
        }
    }

    #[test]
    fn a_pixel_is_the_mean_of_four() {
        let half = view(None).halved();
        let photo = half.photo.read().unwrap();
        assert_eq!([photo.width, photo.height, half.camera.width, half.camera.height], [2; 4]);
        // Of 0, 1, 5, 6; of 2, 3, 7, 8; ten rows of values further down.
        assert_eq!(photo.rgb, [30, 3, 0, 50, 5, 0, 130, 13, 0, 150, 15, 0]);
        assert_eq!(half.photo.rows(&(1..2), &mut Vec::new()).unwrap(), &photo.rgb[6..]);
        assert_eq!((half.camera.focal_px, half.camera.principal_px), ([4.0; 2], [1.0, 1.5]));
        // What a point's pixel is in the whole, from its edge, is twice what it is in the half.
        let point = glam::DVec3::new(0.3, -0.2, 2.0);
        let [whole, half] = [view(None).camera, half.camera].map(|camera| camera.pixel_from_camera(point));
        assert!((0..2).all(|axis| (whole[axis] + 0.5 - 2.0 * (half[axis] + 0.5)).abs() < 1e-12));
    }

    #[test]
    fn what_is_hidden_has_no_say() {
        let hidden = [0, 1, 5, 2, 3, 7, 8];
        let half = view(Some((0..25).map(|at| !hidden.contains(&at)).collect())).halved();
        assert_eq!(half.mask.unwrap().counts, [true, false, true, true]);
        let rgb = &half.photo.read().unwrap().rgb;
        assert_eq!(rgb[..6], [60, 6, 0, 0, 0, 0], "the one that counts, and nothing");
    }
}
