//! The parts of a checkpoint: values as `postcard` has them, and columns of rows behind their number.

use std::io::{self, Read, Write};
use std::ops::Range;
use std::sync::Arc;

use genesplat_core::{DeviceState, Gaussians, Moments, Photo, StateMean, Statistics};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::joint::JointWriter;
use super::summed::Summed;
use super::{CheckpointError, MAGIC};

/// Floats or numbers that are written or read at once.
const PIECE: usize = 1 << 18;

fn bytes_of(value: &impl Serialize) -> Vec<u8> {
    postcard::to_stdvec(value).expect("memory takes all bytes")
}

fn words_of<T: Copy>(values: &[T], word: fn(T) -> [u8; 4]) -> Vec<u8> {
    let mut words = vec![[0; 4]; values.len()];
    words.iter_mut().zip(values).for_each(|(bytes, &value)| *bytes = word(value));
    words.into_flattened()
}

impl<W: Write> JointWriter<'_, W> {
    /// A value that all have.
    pub(super) fn value(&mut self, value: &impl Serialize) {
        self.bytes(&bytes_of(value));
    }

    pub(super) fn text(&mut self, text: &str) {
        self.value(&text.len());
        self.bytes(text.as_bytes());
    }

    /// A column of rows of `N` floats.
    fn floats<const N: usize>(&mut self, column: &[[f32; N]]) -> io::Result<()> {
        self.column(column.len(), PIECE / N, |rows| words_of(column[rows].as_flattened(), f32::to_le_bytes))
    }

    fn numbers(&mut self, column: &[u32]) -> io::Result<()> {
        self.column(column.len(), PIECE, |rows| words_of(&column[rows], u32::to_le_bytes))
    }

    fn column(
        &mut self,
        own: usize,
        piece: usize,
        bytes: impl Fn(Range<usize>) -> Vec<u8>,
    ) -> io::Result<()> {
        let counts = self.counts(own)?;
        self.value(&counts.iter().sum::<usize>());
        self.rows(&counts, piece, bytes)
    }

    fn cloud(&mut self, cloud: &Gaussians) -> io::Result<()> {
        self.floats(&cloud.positions)?;
        self.floats(&cloud.log_scales)?;
        self.floats(&cloud.rotations)?;
        self.floats::<1>(cloud.opacity_logits.as_chunks().0)?;
        self.floats(&cloud.sh)?;
        self.value(&cloud.filter_3d.is_some());
        cloud.filter_3d.as_ref().map_or(Ok(()), |filter| self.floats::<1>(filter.as_chunks().0))
    }

    fn moments(&mut self, moments: &Moments) -> io::Result<()> {
        [&moments.first, &moments.second, &moments.pending]
            .into_iter()
            .try_for_each(|table| self.cloud(table))
    }

    fn statistics(&mut self, statistics: &Statistics) -> io::Result<()> {
        for column in [&statistics.gradient_sum, &statistics.weight_sum] {
            self.floats::<1>(column.as_chunks().0)?;
        }
        self.floats(&statistics.gene_gradient_sum)?;
        self.numbers(&statistics.gene_views)
    }

    pub(super) fn state(&mut self, state: &DeviceState) -> io::Result<()> {
        self.cloud(&state.cloud)?;
        self.moments(&state.moments)?;
        self.statistics(&state.statistics)?;
        self.value(&state.mean.states());
        self.cloud(state.mean.mean())
    }

    pub(super) fn pictures(&mut self, pictures: &[Arc<Photo>]) {
        self.value(&pictures.len());
        for picture in pictures {
            self.value(&[picture.width, picture.height]);
            self.bytes(&picture.rgb);
        }
    }
}

/// Reads what [`JointWriter`] has written, and keeps of each column the rows that `share` says, of so many.
pub(super) struct ColumnReader<'a, R> {
    pub(super) input: Summed<R>,
    pub(super) share: &'a dyn Fn(usize) -> Range<usize>,
}

impl<R: Read> ColumnReader<'_, R> {
    pub(super) fn value<T: DeserializeOwned>(&mut self) -> Result<T, CheckpointError> {
        match postcard::from_io((&mut self.input, &mut [0; 8])) {
            Ok((value, _)) => Ok(value),
            Err(error @ postcard::Error::DeserializeUnexpectedEnd) => Err(self.input.cause_of(error).into()),
            Err(_) => Err(CheckpointError::Damaged("it holds a value that there is not")),
        }
    }

    /// The text behind the magic number.
    pub(super) fn origin(&mut self) -> Result<String, CheckpointError> {
        let mut magic = [0; MAGIC.len()];
        self.input.read_exact(&mut magic).map_err(|error| self.input.cause_of(error))?;
        if magic != MAGIC {
            return Err(CheckpointError::Foreign);
        }
        let length = self.value::<usize>()?;
        let text = self.bytes(length as u64)?;
        String::from_utf8(text).map_err(|_| CheckpointError::Damaged("what its run began with is no text"))
    }

    /// So many bytes; memory is taken for those that are there.
    fn bytes(&mut self, count: u64) -> Result<Vec<u8>, CheckpointError> {
        let mut bytes = Vec::new();
        let read = (&mut self.input).take(count).read_to_end(&mut bytes);
        read.map_err(|error| self.input.cause_of(error))?;
        if bytes.len() as u64 == count {
            Ok(bytes)
        } else {
            Err(io::Error::from(io::ErrorKind::UnexpectedEof).into())
        }
    }

    /// A column of rows of `N` floats.
    fn floats<const N: usize>(&mut self) -> Result<Vec<[f32; N]>, CheckpointError> {
        self.words(|row| row.map(f32::from_le_bytes))
    }

    fn column(&mut self) -> Result<Vec<f32>, CheckpointError> {
        self.floats::<1>().map(Vec::into_flattened)
    }

    fn numbers(&mut self) -> Result<Vec<u32>, CheckpointError> {
        self.words(|[number]| u32::from_le_bytes(number))
    }

    /// The own rows of a column of rows of `N` words.
    fn words<const N: usize, T>(
        &mut self,
        of_row: impl Fn([[u8; 4]; N]) -> T,
    ) -> Result<Vec<T>, CheckpointError> {
        let (rows, at_once) = (self.value::<usize>()?, PIECE / N);
        let share = (self.share)(rows);
        let (mut kept, mut bytes) = (Vec::new(), Vec::new());
        for start in (0..rows).step_by(at_once) {
            let part = start..rows.min(start + at_once);
            bytes.resize(part.len() * N * size_of::<f32>(), 0);
            self.input.read_exact(&mut bytes).map_err(|error| self.input.cause_of(error))?;
            let (rows, _) = bytes.as_chunks::<4>().0.as_chunks::<N>();
            let wanted = share.start.clamp(part.start, part.end)..share.end.clamp(part.start, part.end);
            kept.extend(rows[wanted.start - start..wanted.end - start].iter().map(|&row| of_row(row)));
        }
        Ok(kept)
    }

    fn cloud(&mut self) -> Result<Gaussians, CheckpointError> {
        Ok(Gaussians {
            positions: self.floats()?,
            log_scales: self.floats()?,
            rotations: self.floats()?,
            opacity_logits: self.column()?,
            sh: self.floats()?,
            filter_3d: if self.value()? { Some(self.column()?) } else { None },
        })
    }

    fn moments(&mut self) -> Result<Moments, CheckpointError> {
        Ok(Moments { first: self.cloud()?, second: self.cloud()?, pending: self.cloud()? })
    }

    fn statistics(&mut self) -> Result<Statistics, CheckpointError> {
        Ok(Statistics {
            gradient_sum: self.column()?,
            weight_sum: self.column()?,
            gene_gradient_sum: self.floats()?,
            gene_views: self.numbers()?,
        })
    }

    pub(super) fn state(&mut self) -> Result<DeviceState, CheckpointError> {
        let (cloud, moments, statistics) = (self.cloud()?, self.moments()?, self.statistics()?);
        let mean = StateMean::new(self.value()?, self.cloud()?);
        Ok(DeviceState { cloud, moments, statistics, mean })
    }

    pub(super) fn pictures(&mut self) -> Result<Vec<Arc<Photo>>, CheckpointError> {
        let count = self.value::<usize>()?;
        (0..count).map(|_| self.picture().map(Arc::new)).collect()
    }

    fn picture(&mut self) -> Result<Photo, CheckpointError> {
        let [width, height] = self.value::<[u32; 2]>()?;
        let rgb = self.bytes((3 * u64::from(width)).saturating_mul(height.into()))?;
        Ok(Photo { width, height, rgb })
    }
}
