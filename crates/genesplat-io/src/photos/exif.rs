//! What EXIF data tell of the camera that took a photo.

use std::io::BufReader;
use std::path::Path;

use image::{ImageDecoder, ImageReader};

use crate::input;

/// Where the first directory points to that of the camera's settings.
const SETTINGS: usize = 0x8769;
const MODEL: usize = 0x0110;
const FOCAL_LENGTH: usize = 0x920A;
/// The same for a picture as large as 35 mm film: it follows digital zoom.
const FOCAL_LENGTH_35_MM: usize = 0xA405;

/// Bytes of a value of each of TIFF's types.
const VALUE_BYTES: [usize; 13] = [0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8];

/// What tells a lens from others: the camera's model and two focal lengths, in the bytes of their file.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct LensTags([Option<Vec<u8>>; 3]);

/// The lens that took the photo at `path`; `None` where its EXIF data have no focal length.
pub fn lens_tags(path: &Path) -> Option<LensTags> {
    let reader = ImageReader::new(BufReader::new(input::open(path).ok()?)).with_guessed_format().ok()?;
    of_exif(&reader.into_decoder().ok()?.exif_metadata().ok()??)
}

pub(super) fn of_exif(exif: &[u8]) -> Option<LensTags> {
    let tiff = Tiff::of(exif)?;
    let first = tiff.number(4, 4)?;
    let settings = tiff.number(tiff.entry(first, SETTINGS)? + 8, 4)?;
    let [focal, focal_35] = [FOCAL_LENGTH, FOCAL_LENGTH_35_MM].map(|tag| tiff.value(settings, tag));
    focal.as_ref().or(focal_35.as_ref())?;
    Some(LensTags([tiff.value(first, MODEL), focal, focal_35]))
}

/// Directories of tagged values, as TIFF has them.
struct Tiff<'a> {
    bytes: &'a [u8],
    is_little_endian: bool,
}

impl<'a> Tiff<'a> {
    fn of(bytes: &'a [u8]) -> Option<Self> {
        let is_little_endian = match bytes.get(..4)? {
            b"II*\0" => true,
            b"MM\0*" => false,
            _ => return None,
        };
        Some(Self { bytes, is_little_endian })
    }

    fn number(&self, at: usize, size: usize) -> Option<usize> {
        let bytes = self.bytes.get(at..at.checked_add(size)?)?;
        let add = |sum: usize, byte: &u8| sum << 8 | usize::from(*byte);
        Some(if self.is_little_endian { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) })
    }

    /// Where the entry of a tag begins: its tag, type and count, then the value or where that is.
    fn entry(&self, directory: usize, tag: usize) -> Option<usize> {
        let count = self.number(directory, 2)?;
        (0..count).map(|index| directory + 2 + 12 * index).find(|&at| self.number(at, 2) == Some(tag))
    }

    fn value(&self, directory: usize, tag: usize) -> Option<Vec<u8>> {
        let entry = self.entry(directory, tag)?;
        let each = *VALUE_BYTES.get(self.number(entry + 2, 2)?)?;
        let size = each.checked_mul(self.number(entry + 4, 4)?)?;
        let at = if size <= 4 { entry + 8 } else { self.number(entry + 8, 4)? };
        Some(self.bytes.get(at..at.checked_add(size)?)?.to_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// EXIF data of a model and both focal lengths, after the tag of an orientation.
    fn exif(model: &[u8; 8], tenths_of_mm: u8, mm_35: u8) -> Vec<u8> {
        let entry = |tag: u16, kind: u8, count: u8, value: [u8; 4]| {
            [&tag.to_le_bytes()[..], &[kind, 0, count, 0, 0, 0], &value].concat()
        };
        let first =
            [entry(0x0110, 2, 8, [80, 0, 0, 0]), entry(0x0112, 3, 1, [6, 0, 0, 0]), entry(0x8769, 4, 1, [50, 0, 0, 0])];
        let settings = [entry(0x920A, 5, 1, [88, 0, 0, 0]), entry(0xA405, 3, 1, [mm_35, 0, 0, 0])];
        let head = [b"II*\0\x08\0\0\0\x03\0".to_vec(), first.concat(), vec![0; 4], vec![2, 0], settings.concat()];
        let head = [head.concat(), vec![0; 4]].concat();
        assert_eq!(head.len(), 80);
        [&head[..], model, &[tenths_of_mm, 0, 0, 0, 10, 0, 0, 0]].concat()
    }

    #[test]
    fn lenses_differ_by_model_and_focal_lengths() {
        let wide = exif(b"Phone 7\0", 68, 26);
        let of = |model, focal, focal_35| of_exif(&exif(model, focal, focal_35)).unwrap();
        let tags = of_exif(&wide).unwrap();
        assert_eq!(tags, LensTags([Some(b"Phone 7\0".to_vec()), Some(wide[88..96].to_vec()), Some(vec![26, 0])]));
        assert_eq!(tags, of(b"Phone 7\0", 68, 26));
        for other in [of(b"Phone 8\0", 68, 26), of(b"Phone 7\0", 90, 26), of(b"Phone 7\0", 68, 52)] {
            assert_ne!(tags, other);
        }
    }

    #[test]
    fn damaged_data_name_no_lens_or_another() {
        let whole = exif(b"Phone 7\0", 68, 26);
        assert!((0..74).all(|end| of_exif(&whole[..end]).is_none()));
        for at in 0..whole.len() {
            for value in [0, 1, 0x7F, 0xFF] {
                let mut damaged = whole.clone();
                damaged[at] = value;
                of_exif(&damaged);
            }
        }
        assert_eq!(of_exif(b"MM\0*\0\0\0\x08\0\0"), None);
    }
}
