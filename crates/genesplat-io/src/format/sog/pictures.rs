//! The ZIP file of a `.sog`, and its pictures.

use std::io::{self, Cursor, Read, Write};
use std::path::Path;

use image_webp::{ColorType, WebPDecoder, WebPEncoder};
use rayon::prelude::*;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::meta::Meta;
use super::{FormatError, WriteProgress};
use crate::archive::entries;

/// Sides of a WebP picture have 14 bits.
const SIDE_MAX: usize = 1 << 14;

const META: &str = "meta.json";
/// Far more than codebooks take.
const META_BYTES_MAX: u64 = 1 << 24;

/// A picture may be larger than its Gaussians need, by so much: short files can claim enormous pictures.
const SPARE_PIXELS: usize = 1 << 20;

/// The file of a picture may have so many bytes, and so many more for each pixel that the picture may have:
/// twice what pixels take that are not compressed.
const PICTURE_BYTES: [u64; 2] = [1 << 16, 8];

/// Size of a picture, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Grid {
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Grid {
    /// A nearly square picture with a pixel for each Gaussian, and sides that are multiples of 4; `None`
    /// where there is no such WebP.
    pub(super) fn for_gaussians(count: usize) -> Option<Self> {
        let width = ((count.max(1) as f64).sqrt().ceil() as usize).next_multiple_of(4);
        let height = count.max(1).div_ceil(width).next_multiple_of(4);
        (width <= SIDE_MAX && height <= SIDE_MAX).then_some(Self { width, height })
    }

    fn pixels(self) -> usize {
        self.width * self.height
    }
}

/// Red, green, blue and alpha, row by row; just bytes.
pub(super) struct Picture {
    pub(super) grid: Grid,
    pub(super) pixels: Vec<[u8; 4]>,
}

impl Picture {
    /// A picture that begins with `pixels`, filled up with black.
    pub(super) fn of(grid: Grid, pixels: impl Iterator<Item = [u8; 4]>) -> Self {
        let mut pixels: Vec<[u8; 4]> = pixels.collect();
        pixels.resize(grid.pixels(), [0, 0, 0, 255]);
        Self { grid, pixels }
    }

    fn to_webp(&self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let (width, height) = (self.grid.width as u32, self.grid.height as u32);
        WebPEncoder::new(&mut bytes)
            .encode(self.pixels.as_flattened(), width, height, ColorType::Rgba8)
            .map_err(io::Error::other)?;
        Ok(bytes)
    }
}

/// Pictures on their way into a ZIP file.
#[derive(Default)]
pub(super) struct ArchiveWriter {
    files: Vec<(String, Picture)>,
}

impl ArchiveWriter {
    /// Adds a picture and returns its name.
    pub(super) fn add(&mut self, name: &str, picture: Picture) -> String {
        self.files.push((name.to_owned(), picture));
        name.to_owned()
    }

    /// The bytes of the file.
    pub(super) fn finish(self, meta: &Meta, progress: &dyn WriteProgress) -> io::Result<Vec<u8>> {
        let compress = |(name, picture): (String, Picture)| {
            let bytes = picture.to_webp()?;
            progress.done(1);
            Ok((name, bytes))
        };
        let files: Vec<(String, Vec<u8>)> =
            self.files.into_par_iter().with_max_len(1).map(compress).collect::<io::Result<_>>()?;
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        // Pictures are compressed already, and readers map files that are not.
        let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        zip.start_file(META, stored)?;
        zip.write_all(&serde_json::to_vec(meta)?)?;
        for (name, bytes) in files {
            zip.start_file(name, stored)?;
            zip.write_all(&bytes)?;
        }
        Ok(zip.finish()?.into_inner())
    }
}

/// An opened file.
pub(super) struct Archive<'a> {
    path: &'a Path,
    zip: ZipArchive<Cursor<&'a [u8]>>,
}

impl<'a> Archive<'a> {
    pub(super) fn open(path: &'a Path, bytes: &'a [u8]) -> Result<Self, FormatError> {
        let zip = entries::open(Cursor::new(bytes)).map_err(|problem| {
            FormatError::damaged(path, format!("is no readable ZIP file: it {problem}"))
        })?;
        Ok(Self { path, zip })
    }

    pub(super) fn damaged(&self, problem: String) -> FormatError {
        FormatError::damaged(self.path, problem)
    }

    pub(super) fn meta(&mut self) -> Result<Meta, FormatError> {
        let bytes = self.file(META, META_BYTES_MAX)?;
        serde_json::from_slice(&bytes)
            .map_err(|error| self.damaged(format!("has a {META} that is not valid ({error})")))
    }

    /// The file `name`, which may have at most `most` bytes: a short entry can unpack to any number of them.
    fn file(&mut self, name: &str, most: u64) -> Result<Vec<u8>, FormatError> {
        let path = self.path;
        let broken = |error: &dyn std::fmt::Display| {
            FormatError::damaged(path, format!("has no readable {name} ({error})"))
        };
        let file = self.zip.by_name(name).map_err(|error| broken(&error))?;
        let mut bytes = Vec::new();
        // One byte more than there may be shows whether there are more.
        file.take(most + 1).read_to_end(&mut bytes).map_err(|error| broken(&error))?;
        if bytes.len() as u64 > most {
            return Err(self.damaged(format!("has more than {most} bytes in {name}, far more than it needs")));
        }
        Ok(bytes)
    }

    /// The first `count` pixels of the picture `name`.
    pub(super) fn pixels(&mut self, name: &str, count: usize) -> Result<Vec<[u8; 4]>, FormatError> {
        let Picture { grid: Grid { width, height }, mut pixels } = self.picture_for(name, Some(count))?;
        if pixels.len() < count {
            return Err(self.damaged(format!("has {width}x{height} pixels in {name} for {count} Gaussians")));
        }
        pixels.truncate(count);
        Ok(pixels)
    }

    /// The picture `name`, a palette's.
    pub(super) fn picture(&mut self, name: &str) -> Result<Picture, FormatError> {
        self.picture_for(name, None)
    }

    fn picture_for(&mut self, name: &str, count: Option<usize>) -> Result<Picture, FormatError> {
        let pixels_max = 2 * count.unwrap_or(0) + SPARE_PIXELS;
        let file = self.file(name, PICTURE_BYTES[0] + PICTURE_BYTES[1] * pixels_max as u64)?;
        let broken =
            |error| FormatError::damaged(self.path, format!("has no readable picture in {name} ({error})"));
        let mut decoder = WebPDecoder::new(Cursor::new(file)).map_err(broken)?;
        let (width, height) = decoder.dimensions();
        let grid = Grid { width: width as usize, height: height as usize };
        if grid.pixels() > pixels_max {
            return Err(
                self.damaged(format!("has {width}x{height} pixels in {name}, far more than it needs"))
            );
        }
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut bytes = vec![0; channels * grid.pixels()];
        decoder.read_image(&mut bytes).map_err(broken)?;
        let pixel = |bytes: &[u8]| [bytes[0], bytes[1], bytes[2], bytes.get(3).copied().unwrap_or(255)];
        Ok(Picture { grid, pixels: bytes.chunks_exact(channels).map(pixel).collect() })
    }

    /// The value that a byte names.
    pub(super) fn decoded(&self, codebook: &[f32], index: u8) -> Result<f32, FormatError> {
        codebook.get(usize::from(index)).copied().ok_or_else(|| {
            self.damaged(format!("uses entry {index} of a codebook that has {} of them", codebook.len()))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_have_a_pixel_for_each_and_sides_that_fit() {
        for count in [0, 1, 16, 17, 33_979, SIDE_MAX * SIDE_MAX] {
            let grid = Grid::for_gaussians(count).unwrap();
            assert!(
                grid.pixels() >= count && grid.width.is_multiple_of(4) && grid.height.is_multiple_of(4),
                "{count} {grid:?}"
            );
        }
        assert_eq!(Grid::for_gaussians(SIDE_MAX * SIDE_MAX + 1), None);
    }
}
