//! Photos in and out: decode, composite, resize, encode.
//!
//! What is decoded here is what the quality figures are measured against, so each rule follows the reference trainer:
//! sizes by its `-r` rule, resampling as Pillow's bicubic filter with antialiasing (two passes with 8-bit values
//! between them), and transparency composited on a background *before* the resize, truncated to 8 bit.

mod resize;

use std::fs;
use std::io::{self, Cursor, Write};
use std::path::{Path, PathBuf};

use genesplat_core::Photo;
use image::{ColorType, DynamicImage, ImageEncoder, ImageFormat, ImageReader};

pub(crate) use resize::cubic;
pub use resize::resize;

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

/// At which size photos are loaded; cameras follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum PhotoSize {
    /// The reference's default (`-r -1`): as they are up to a width of 1,600 px, reduced to that width beyond.
    #[default]
    Auto,
    /// Both sides divided by this and rounded half to even, as the reference's `-r 2`, `4` and `8`.
    Downscale(u32),
    /// The longer side at most this many pixels, aspect kept; never enlarges.
    MaxSide(u32),
}

impl PhotoSize {
    /// The loaded size of a photo of `width` x `height` px; never below 1 px.
    pub fn of(self, width: u32, height: u32) -> (u32, u32) {
        let (w, h) = (f64::from(width), f64::from(height));
        let (w, h) = match self {
            Self::Auto if width > AUTO_WIDTH => {
                let scale = w / f64::from(AUTO_WIDTH);
                ((w / scale).trunc(), (h / scale).trunc())
            }
            Self::Downscale(factor) if factor > 1 => {
                ((w / f64::from(factor)).round_ties_even(), (h / f64::from(factor)).round_ties_even())
            }
            Self::MaxSide(side) if side < width.max(height) => {
                let scale = f64::from(side) / w.max(h);
                ((w * scale).round(), (h * scale).round())
            }
            _ => (w, h),
        };
        ((w as u32).max(1), (h as u32).max(1))
    }
}

/// Width above which [`PhotoSize::Auto`] reduces (3DGS, `camera_utils`).
const AUTO_WIDTH: u32 = 1600;

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

/// [`read_photo`], and what the picture has beyond a photo: for who compares pictures, it is lost.
pub fn read_photo_with_losses(path: &Path) -> Result<(Photo, Losses), PhotoError> {
    read_image(path).map(|image| (composite(&image, [0; 3]), Losses::of(&image)))
}

/// What a picture has, and a [`Photo`] cannot hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// More than 8 bits a channel.
    pub depth: bool,
    /// Pixels that are not opaque.
    pub transparency: bool,
}

impl Losses {
    fn of(image: &DynamicImage) -> Self {
        let color = image.color();
        let transparency = color.has_alpha() && image.to_rgba8().pixels().any(|pixel| pixel.0[3] < u8::MAX);
        Self { depth: color.bytes_per_pixel() > color.channel_count(), transparency }
    }
}

fn read_image(path: &Path) -> Result<DynamicImage, PhotoError> {
    let bytes = fs::read(path).map_err(|source| PhotoError::Read { path: path.to_owned(), source })?;
    decode(&bytes).map_err(|reason| PhotoError::Decode { path: path.to_owned(), reason })
}

/// Width and height of the photo at `path`, from its header alone.
pub fn photo_size(path: &Path) -> Result<(u32, u32), PhotoError> {
    let read = |source| PhotoError::Read { path: path.to_owned(), source };
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format).map_err(read)?;
    reader
        .into_dimensions()
        .map_err(|error| PhotoError::Decode { path: path.to_owned(), reason: error.to_string() })
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

/// Most pixels of a photo: a few damaged bytes must not ask for all memory.
const PIXELS_MAX: u64 = 1 << 28;
/// Four channels of 16 bits.
const PIXEL_BYTES_MAX: u64 = 8;

fn dimensions(bytes: &[u8]) -> Result<(u32, u32), String> {
    let reader =
        ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string())?;
    reader.into_dimensions().map_err(|error| error.to_string())
}

fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    let mut reader =
        ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string())?;
    let format = reader.format().ok_or("it is neither a PNG nor a JPEG")?;
    if format == ImageFormat::Jpeg && !jpeg_is_whole(bytes) {
        return Err("the file was cut off before the end of the picture".into());
    }
    let (width, height) = dimensions(bytes)?;
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("it has {width}x{height} pixels, and at most {PIXELS_MAX} in all are read"));
    }
    // The limit that counts is that of pixels.
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(PIXELS_MAX * PIXEL_BYTES_MAX);
    reader.limits(limits);
    reader.decode().map_err(|error| error.to_string())
}

/// True when an end-of-image marker follows the start of the scan data.
///
/// JPEG decoders fill what a torn file lacks with grey, which would be trained on unnoticed. Inside scan data a byte
/// 0xFF is always followed by 0x00 or a restart marker (ITU-T T.81, B.1.1.5), so the marker cannot occur by chance.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xDA;
    const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];
    let mut at = 2;
    while let Some(&[0xFF, marker, high, low]) = bytes.get(at..at + 4) {
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == START_OF_SCAN {
            return bytes.get(at..).is_some_and(|scan| scan.windows(2).any(|pair| pair == END_OF_IMAGE));
        }
    }
    // Fill bytes or an unusual header: leave the verdict to the decoder.
    true
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
