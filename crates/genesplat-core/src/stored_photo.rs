//! Photos of views, which need not be in memory.

use std::fmt::Debug;
use std::io;
use std::ops::Range;
use std::sync::Arc;

use crate::image::Photo;

/// Where photos are kept that are not in memory.
pub trait PhotoStore: Debug + Send + Sync {
    /// Fills `out` with the bytes from `at` on.
    fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()>;
}

/// A photo was put somewhere, and cannot be read from there any more.
#[derive(Debug, thiserror::Error)]
#[error("a photo that was set aside cannot be read again: {0}; start the run once more with --resume")]
pub struct PhotoLost(#[from] io::Error);

/// The photo of a view: in memory, or in a store that it is read from whenever it is looked at.
#[derive(Clone, Debug)]
pub struct StoredPhoto {
    width: u32,
    height: u32,
    place: Place,
}

#[derive(Clone, Debug)]
enum Place {
    Memory(Arc<Photo>),
    /// Values `[H, W, 3]` from this byte on.
    Store(Arc<dyn PhotoStore>, u64),
}

impl StoredPhoto {
    /// A photo of `width` x `height` px whose values `[H, W, 3]` begin at the byte `at` of `store`.
    pub fn in_store(store: Arc<dyn PhotoStore>, at: u64, width: u32, height: u32) -> Self {
        Self { width, height, place: Place::Store(store, at) }
    }

    /// Width, px.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, px.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Bytes of memory that it takes while nobody looks.
    pub fn held_bytes(&self) -> usize {
        match &self.place {
            Place::Memory(photo) => photo.rgb.len(),
            Place::Store(..) => 0,
        }
    }

    /// Whether both are the same bytes of the same place, so that what was made of one serves the other.
    pub fn is_same(&self, other: &Self) -> bool {
        match (&self.place, &other.place) {
            (Place::Memory(photo), Place::Memory(other)) => Arc::ptr_eq(photo, other),
            (Place::Store(store, at), Place::Store(other, other_at)) => {
                Arc::ptr_eq(store, other) && at == other_at
            }
            _ => false,
        }
    }

    /// The whole photo.
    pub fn read(&self) -> Result<Arc<Photo>, PhotoLost> {
        match &self.place {
            Place::Memory(photo) => Ok(Arc::clone(photo)),
            Place::Store(store, at) => {
                let mut rgb = vec![0; 3 * self.pixels()];
                store.read(*at, &mut rgb)?;
                Ok(Arc::new(Photo { width: self.width, height: self.height, rgb }))
            }
        }
    }

    /// Values of some rows `[rows, W, 3]`, in `scratch` where they are not in memory.
    pub fn rows<'a>(&'a self, rows: &Range<usize>, scratch: &'a mut Vec<u8>) -> Result<&'a [u8], PhotoLost> {
        let stride = 3 * self.width as usize;
        let range = rows.start * stride..rows.end * stride;
        match &self.place {
            Place::Memory(photo) => Ok(&photo.rgb[range]),
            Place::Store(store, at) => {
                scratch.resize(range.len(), 0);
                store.read(at + range.start as u64, scratch)?;
                Ok(scratch)
            }
        }
    }
}

impl From<Arc<Photo>> for StoredPhoto {
    fn from(photo: Arc<Photo>) -> Self {
        Self { width: photo.width, height: photo.height, place: Place::Memory(photo) }
    }
}

impl From<Photo> for StoredPhoto {
    fn from(photo: Photo) -> Self {
        Arc::new(photo).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug)]
    struct Bytes(Vec<u8>);

    impl PhotoStore for Bytes {
        fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
            let bytes = self.0.get(at as usize..at as usize + out.len());
            out.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
            Ok(())
        }
    }

    #[test]
    fn a_photo_is_the_same_wherever_it_is() {
        let photo = Photo { width: 2, height: 3, rgb: (1..=18).collect() };
        let store = Arc::new(Bytes([vec![0; 7], photo.rgb.clone()].concat()));
        let stored = [StoredPhoto::in_store(store, 7, 2, 3), photo.clone().into()];
        for place in &stored {
            let mut scratch = Vec::new();
            assert_eq!((place.width(), place.height(), place.pixels()), (2, 3, 6));
            assert_eq!(*place.read().unwrap(), photo);
            assert_eq!(place.rows(&(1..3), &mut scratch).unwrap(), &photo.rgb[6..]);
            assert_eq!(place.rows(&(0..1), &mut scratch).unwrap(), &photo.rgb[..6]);
        }
        for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            assert_eq!(stored[a].clone().is_same(&stored[b]), a == b);
        }
        assert!(!stored[1].is_same(&photo.into()), "a copy is somewhere else");
        assert_eq!(stored.map(|place| place.held_bytes()), [0, 18]);
    }

    #[test]
    fn a_photo_that_is_gone_is_a_sentence() {
        let gone = StoredPhoto::in_store(Arc::new(Bytes(vec![0; 17])), 0, 2, 3);
        let sentence = gone.read().unwrap_err().to_string();
        assert!(sentence.contains("cannot be read again") && sentence.contains("--resume"), "{sentence}");
        assert!(gone.rows(&(2..3), &mut Vec::new()).is_err() && gone.rows(&(0..2), &mut Vec::new()).is_ok());
    }
}
