//! Photos in and out: decode, composite, undistort, resize, encode.
//!
//! What is decoded here is what the quality figures are measured against, so each rule follows the reference trainer:
//! sizes by its `-r` rule, resampling as Pillow's bicubic filter with antialiasing (two passes with 8-bit values
//! between them), and transparency composited on a background *before* the resize, truncated to 8 bit.

mod decode;
mod lens;
mod resize;
mod size;
mod undistort;

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use genesplat_core::Photo;
use image::{ColorType, DynamicImage, ImageEncoder, ImageReader};

pub use lens::Lens;
pub(crate) use lens::{Polynomial, Projection};
pub use resize::resize;
pub use size::PhotoSize;
pub(crate) use undistort::{pinhole, undistort};

use crate::atomic::write_atomically;

/// Why a photo could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhotoError {
    /// The operating system refused to read.
    #[error("cannot read the photo {path}: {source}")]
    Read {
        /// The photo.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not a picture, or a damaged one.
    #[error("cannot decode the photo {path}: {reason}; export it again as PNG or JPEG")]
    Decode {
        /// The photo.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The operating system refused to write.
    #[error("cannot write the picture {path}: {source}")]
    Write {
        /// The picture.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Reads a PNG or JPEG; transparency is composited on black.
pub fn read_photo(path: &Path) -> Result<Photo, PhotoError> {
    read_photo_on(path, [0; 3])
}

/// Reads a PNG or JPEG; transparency is composited on `background`.
///
/// The format is told by the content, not by the name. Orientation tags are ignored, as COLMAP and the reference
/// trainer ignore them.
pub fn read_photo_on(path: &Path, background: [u8; 3]) -> Result<Photo, PhotoError> {
    read_image(path).map(|image| composite(&image, background))
}

/// [`read_photo`], and what of the picture was discarded: a comparison of pictures does not see it.
pub fn read_photo_and_discarded(path: &Path) -> Result<(Photo, Discarded), PhotoError> {
    read_image(path).map(|image| (composite(&image, [0; 3]), Discarded::of(&image)))
}

/// What a picture has and a [`Photo`] cannot hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Discarded {
    /// More than 8 bits a channel.
    pub depth: bool,
    /// Pixels that are not opaque.
    pub transparency: bool,
}

impl Discarded {
    fn of(image: &DynamicImage) -> Self {
        let color = image.color();
        let transparency = color.has_alpha() && image.to_rgba8().pixels().any(|pixel| pixel.0[3] < u8::MAX);
        Self { depth: color.bytes_per_pixel() > color.channel_count(), transparency }
    }
}

fn read_image(path: &Path) -> Result<DynamicImage, PhotoError> {
    let bytes = fs::read(path).map_err(|source| PhotoError::Read { path: path.to_owned(), source })?;
    decode::decode(&bytes).map_err(|reason| PhotoError::Decode { path: path.to_owned(), reason })
}

/// Width and height of the photo at `path`, from its header alone.
pub fn photo_size(path: &Path) -> Result<(u32, u32), PhotoError> {
    let read = |source| PhotoError::Read { path: path.to_owned(), source };
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format).map_err(read)?;
    reader.into_dimensions().map_err(|error| PhotoError::Decode { path: path.to_owned(), reason: error.to_string() })
}

/// Writes `photo` as a PNG, whole or not at all.
pub fn write_png(path: &Path, photo: &Photo) -> Result<(), PhotoError> {
    let write = |source| PhotoError::Write { path: path.to_owned(), source };
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&photo.rgb, photo.width, photo.height, ColorType::Rgb8.into())
        .map_err(|error| write(io::Error::other(error)))?;
    write_atomically(path, |out| out.write_all(&bytes)).map_err(write)
}

/// `photo` as a JPEG of `quality` 1 to 100, for pages and previews.
///
/// # Panics
/// If a side is beyond 65,535 px, which the format cannot hold.
pub fn encode_jpeg(photo: &Photo, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(&photo.rgb, photo.width, photo.height, ColorType::Rgb8.into())
        .expect("memory takes every picture that the format can hold");
    bytes
}

fn composite(image: &DynamicImage, background: [u8; 3]) -> Photo {
    let (width, height) = (image.width(), image.height());
    if !image.color().has_alpha() {
        return Photo { width, height, rgb: image.to_rgb8().into_raw() };
    }
    let rgb = image.to_rgba8().pixels().flat_map(|pixel| over(pixel.0, background)).collect();
    Photo { width, height, rgb }
}

/// One straight-alpha pixel over `background`, truncated to 8 bit as the reference's Blender loader does.
fn over([r, g, b, alpha]: [u8; 4], background: [u8; 3]) -> [u8; 3] {
    let alpha = u32::from(alpha);
    let blend = |value: u8, behind: u8| (u32::from(value) * alpha + u32::from(behind) * (255 - alpha)) / 255;
    [blend(r, background[0]), blend(g, background[1]), blend(b, background[2])].map(|value| value as u8)
}
