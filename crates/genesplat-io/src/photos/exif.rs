//! What EXIF data tell of the camera that took a photo.

use std::io::BufReader;
use std::path::Path;

use exif::{In, Reader, Tag};
use image::{ImageDecoder, ImageReader};

use crate::input;

/// What tells a lens from others: the camera's model, the focal length, and that for a picture as large as 35
/// mm film, which follows digital zoom.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct LensTags([Option<String>; 3]);

/// The lens that took the photo at `path`; `None` where its EXIF data have no focal length.
pub fn lens_tags(path: &Path) -> Option<LensTags> {
    let reader = ImageReader::new(BufReader::new(input::open(path).ok()?)).with_guessed_format().ok()?;
    of_exif(reader.into_decoder().ok()?.exif_metadata().ok()??)
}

/// Cameras write tags of their own that nobody reads: what is wrong with one leaves the others.
pub(super) fn of_exif(exif: Vec<u8>) -> Option<LensTags> {
    let mut reader = Reader::new();
    let read = reader.continue_on_error(true).read_raw(exif);
    let data = read.or_else(|error| error.distill_partial_result(|_| {})).ok()?;
    let value = |tag| Some(data.get_field(tag, In::PRIMARY)?.display_value().to_string());
    let [model, focal, focal_35] = [Tag::Model, Tag::FocalLength, Tag::FocalLengthIn35mmFilm].map(value);
    focal.as_ref().or(focal_35.as_ref())?;
    Some(LensTags([model, focal, focal_35]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// EXIF data of a model and both focal lengths, after the tag of an orientation.
    fn exif(model: &[u8; 8], tenths_of_mm: u8, mm_35: u8) -> Vec<u8> {
        let entry = |tag: u16, kind: u8, count: u8, value: [u8; 4]| {
            [&tag.to_le_bytes()[..], &[kind, 0, count, 0, 0, 0], &value].concat()
        };
        let first = [
            entry(0x0110, 2, 8, [80, 0, 0, 0]),
            entry(0x0112, 3, 1, [6, 0, 0, 0]),
            entry(0x8769, 4, 1, [50, 0, 0, 0]),
        ];
        let settings = [entry(0x920A, 5, 1, [88, 0, 0, 0]), entry(0xA405, 3, 1, [mm_35, 0, 0, 0])];
        let head =
            [b"II*\0\x08\0\0\0\x03\0".to_vec(), first.concat(), vec![0; 4], vec![2, 0], settings.concat()];
        let head = [head.concat(), vec![0; 4]].concat();
        assert_eq!(head.len(), 80);
        [&head[..], model, &[tenths_of_mm, 0, 0, 0, 10, 0, 0, 0]].concat()
    }

    #[test]
    fn lenses_differ_by_model_and_focal_lengths() {
        let wide = exif(b"Phone 7\0", 68, 26);
        let of = |model, focal, focal_35| of_exif(exif(model, focal, focal_35)).unwrap();
        let tags = of_exif(wide).unwrap();
        assert_eq!(tags.0.clone().map(Option::unwrap), ["\"Phone 7\"", "6.8", "26"]);
        assert_eq!(tags, of(b"Phone 7\0", 68, 26));
        for other in [of(b"Phone 8\0", 68, 26), of(b"Phone 7\0", 90, 26), of(b"Phone 7\0", 68, 52)] {
            assert_ne!(tags, other);
        }
    }

    #[test]
    fn damaged_data_name_no_lens_or_another() {
        let whole = exif(b"Phone 7\0", 68, 26);
        assert!((0..60).all(|end| of_exif(whole[..end].to_vec()).is_none()));
        for at in 0..whole.len() {
            for value in [0, 1, 0x7F, 0xFF] {
                let mut damaged = whole.clone();
                damaged[at] = value;
                of_exif(damaged);
            }
        }
        assert_eq!(of_exif(b"MM\0*\0\0\0\x08\0\0".to_vec()), None);
    }
}
