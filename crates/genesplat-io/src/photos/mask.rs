//! Masks of photos: which pixels count, at the size and through the lens at which the photo is loaded.
//!
//! A pixel of a reduced or undistorted photo is mixed from many. It counts only where all that it is mixed
//! from does, so what a mask hides reaches no pixel that counts; the mask grows by up to two pixels for that.

use std::ops::Range;
use std::path::Path;

use genesplat_core::{Mask, Photo};
use image::DynamicImage;

use super::resize::{reach_beyond, reaches, wrapped};
use super::{EncodedPhoto, PhotoError};

/// Which pixels of a photo count.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PhotoMask {
    pub(super) size: [u32; 2],
    /// `[H, W]`
    pub(super) counts: Vec<bool>,
}

impl PhotoMask {
    /// What the picture at `path` leaves: all that is not black, as COLMAP and nerfstudio have it. What a
    /// lossy file has made of black is darker than grey.
    pub(crate) fn open(path: &Path) -> Result<Self, PhotoError> {
        EncodedPhoto::open(path).and_then(Self::of)
    }

    /// The same of a file that is read.
    pub(crate) fn of(encoded: EncodedPhoto) -> Result<Self, PhotoError> {
        let _room = encoded.wait_for_room();
        let least = if encoded.encoded.is_lossy() { 128 } else { 1 };
        let photo = encoded.decode_on_black()?;
        let counts = photo.rgb.chunks_exact(3).map(|rgb| rgb.iter().any(|&level| level >= least)).collect();
        Ok(Self { size: [photo.width, photo.height], counts })
    }

    /// What is opaque; `None` where all is.
    pub(super) fn of_opaque(image: &DynamicImage) -> Option<Self> {
        let has_alpha = image.color().has_alpha();
        let counts: Vec<bool> =
            has_alpha.then(|| image.to_rgba8().pixels().map(|pixel| pixel.0[3] == u8::MAX).collect())?;
        counts.contains(&false).then(|| Self { size: [image.width(), image.height()], counts })
    }

    pub(crate) fn size(&self) -> [u32; 2] {
        self.size
    }

    /// What both leave; both have one size.
    pub(crate) fn and(mut self, other: &Self) -> Self {
        self.counts.iter_mut().zip(&other.counts).for_each(|(counts, other)| *counts &= other);
        self
    }

    /// Paints what does not count.
    pub(crate) fn paint(&self, photo: &mut Photo, colour: [u8; 3]) {
        let hidden = photo.rgb.chunks_exact_mut(3).zip(&self.counts).filter(|(_, counts)| !**counts);
        hidden.for_each(|(rgb, _)| rgb.copy_from_slice(&colour));
    }

    pub(super) fn counts_at(&self, x: usize, y: usize) -> bool {
        self.counts[y * self.size[0] as usize + x]
    }

    /// That of the photo that [`super::resize()`] makes.
    pub(crate) fn resized(&self, size: [u32; 2]) -> Self {
        let [columns, rows] = [0, 1].map(|axis| reaches(self.size[axis] as usize, size[axis] as usize, 0));
        self.mixed(&columns, &rows)
    }

    /// The same of a photo whose left and right ends meet, with so many columns of the other end at either
    /// end.
    pub(super) fn resized_round(&self, size: [u32; 2], beyond: u32) -> Self {
        let [width, height] = self.size.map(|side| side as usize);
        let pad = reach_beyond(self.size[0], size[0]);
        let counts = wrapped(&self.counts, width, pad);
        let round = Self { size: [(width + 2 * pad) as u32, self.size[1]], counts };
        let (columns, rows) = (reaches(width, size[0] as usize, pad), reaches(height, size[1] as usize, 0));
        let reduced = round.mixed(&columns, &rows);
        let counts = wrapped(&reduced.counts, size[0] as usize, beyond as usize);
        Self { size: [size[0] + 2 * beyond, size[1]], counts }
    }

    /// Where what is mixed from these columns and rows counts.
    fn mixed(&self, columns: &[Range<usize>], rows: &[Range<usize>]) -> Self {
        let row_of = |row: &[bool]| {
            columns.iter().map(|reach| row[reach.clone()].iter().all(|counts| *counts)).collect()
        };
        let narrowed: Vec<Vec<bool>> = self.counts.chunks_exact(self.size[0] as usize).map(row_of).collect();
        let counts = rows.iter().flat_map(|reach| {
            let narrowed = &narrowed;
            (0..columns.len()).map(move |column| narrowed[reach.clone()].iter().all(|row| row[column]))
        });
        Self { size: [columns.len() as u32, rows.len() as u32], counts: counts.collect() }
    }
}

impl From<PhotoMask> for Mask {
    fn from(mask: PhotoMask) -> Self {
        Self { counts: mask.counts }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{resize, write_png};
    use super::*;

    fn stripes(size: [u32; 2]) -> PhotoMask {
        let counts = (0..size[0] * size[1]).map(|index| (index % size[0] + index / size[0] / 4) % 48 < 36);
        PhotoMask { size, counts: counts.collect() }
    }

    fn noise(size: [u32; 2], seed: u32) -> Photo {
        let rgb = (0..3 * size[0] * size[1])
            .map(|at| (at.wrapping_mul(2_654_435_761 ^ seed) >> 24) as u8)
            .collect();
        Photo { width: size[0], height: size[1], rgb }
    }

    #[test]
    fn whatever_is_not_black_counts() {
        let folder = tempfile::tempdir().unwrap();
        let (file, rgb) = (folder.path().join("mask.png"), vec![255, 0, 0, 0, 0, 0, 0, 0, 9]);
        write_png(&file, &Photo { width: 3, height: 1, rgb }).unwrap();
        assert_eq!(PhotoMask::open(&file).unwrap().counts, [true, false, true]);
    }

    #[test]
    fn what_is_hidden_reaches_no_reduced_pixel_that_counts() {
        let (size, smaller) = ([97, 61], [41, 26]);
        let (mask, one) = (stripes(size), noise(size, 1));
        let mut other = one.clone();
        mask.paint(&mut other, [255, 0, 9]);
        let [one, other] = [one, other].map(|photo| resize(&photo, smaller[0], smaller[1]));
        let reduced = mask.resized(smaller);
        let counted = reduced.counts.iter().filter(|counts| **counts).count();
        assert!(counted > 200, "{counted}");
        let differ = |at: &usize| one.rgb[3 * at..3 * at + 3] != other.rgb[3 * at..3 * at + 3];
        assert!((0..one.rgb.len() / 3).filter(differ).all(|at| !reduced.counts[at]));
        assert!((0..one.rgb.len() / 3).any(|at| differ(&at)), "the mask hides something");
        assert_eq!(mask.resized(size), mask);
    }
}
