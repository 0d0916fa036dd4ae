//! The parts of a checkpoint as `postcard` has them: values, and columns of rows behind their number.

use std::io::{self, Read, Write};
use std::ops::Range;

use genesplat_core::{DeviceState, Gaussians, Moments, StateMean, Statistics};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::CheckpointError;
use super::joint::JointWriter;
use super::summed::Summed;
use crate::densify::renew::Trial;

/// Floats that are written or read at once.
const PIECE: usize = 1 << 18;

fn bytes_of(value: &impl Serialize) -> Vec<u8> {
    postcard::to_stdvec(value).expect("memory takes all bytes")
}

impl<W: Write> JointWriter<'_, W> {
    /// A value that all have.
    pub(super) fn value(&mut self, value: &impl Serialize) {
        self.bytes(&bytes_of(value));
    }

    /// A column whose number is that of its floats, divided by `width`.
    fn floats(&mut self, column: &[f32], width: usize) -> io::Result<()> {
        let counts = self.counts(column.len())?;
        self.value(&(counts.iter().sum::<usize>() / width));
        self.rows(&counts, PIECE, |part| column[part].iter().flat_map(|value| value.to_le_bytes()).collect())
    }

    fn numbers(&mut self, column: &[u32]) -> io::Result<()> {
        let counts = self.counts(column.len())?;
        self.value(&counts.iter().sum::<usize>());
        self.rows(&counts, PIECE, |part| column[part].iter().flat_map(bytes_of).collect())
    }

    fn cloud(&mut self, cloud: &Gaussians) -> io::Result<()> {
        self.floats(cloud.positions.as_flattened(), 3)?;
        self.floats(cloud.log_scales.as_flattened(), 3)?;
        self.floats(cloud.rotations.as_flattened(), 4)?;
        self.floats(&cloud.opacity_logits, 1)?;
        self.floats(cloud.sh.as_flattened(), 1)?;
        self.value(&cloud.filter_3d.is_some());
        cloud.filter_3d.as_ref().map_or(Ok(()), |filter| self.floats(filter, 1))
    }

    fn moments(&mut self, moments: &Moments) -> io::Result<()> {
        [&moments.first, &moments.second, &moments.pending].into_iter().try_for_each(|table| self.cloud(table))
    }

    fn statistics(&mut self, statistics: &Statistics) -> io::Result<()> {
        self.floats(&statistics.gradient_sum, 1)?;
        self.floats(&statistics.weight_sum, 1)?;
        self.floats(&statistics.absolute_sum, 1)?;
        self.floats(statistics.gene_gradient_sum.as_flattened(), 7)?;
        self.numbers(&statistics.gene_views)
    }

    pub(super) fn state(&mut self, state: &DeviceState) -> io::Result<()> {
        self.cloud(&state.cloud)?;
        self.moments(&state.moments)?;
        self.statistics(&state.statistics)?;
        self.value(&state.mean.states());
        self.cloud(state.mean.mean())
    }

    pub(super) fn trial(&mut self, trial: Option<&Trial>) -> io::Result<()> {
        self.value(&trial.is_some());
        let Some(trial) = trial else { return Ok(()) };
        self.value(&trial.record);
        self.cloud(&trial.cloud)?;
        self.moments(&trial.moments)
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

    /// A column of rows of `W` floats, whose number is that of `counted` of them.
    fn floats<const W: usize>(&mut self, counted: usize) -> Result<Vec<[f32; W]>, CheckpointError> {
        let (count, per_row) = (self.value::<usize>()?, W / counted);
        if !count.is_multiple_of(per_row) {
            return Err(CheckpointError::Damaged("a column ends within a row"));
        }
        let (rows, at_once) = (count / per_row, PIECE / W);
        let share = (self.share)(rows);
        let (mut kept, mut bytes) = (Vec::new(), Vec::new());
        for start in (0..rows).step_by(at_once) {
            let part = start..rows.min(start + at_once);
            bytes.resize(part.len() * W * size_of::<f32>(), 0);
            self.input.read_exact(&mut bytes).map_err(|error| self.input.cause_of(error))?;
            let (rows, _) = bytes.as_chunks::<4>().0.as_chunks::<W>();
            let wanted = share.start.clamp(part.start, part.end)..share.end.clamp(part.start, part.end);
            kept.extend(rows[wanted.start - start..wanted.end - start].iter().map(|row| row.map(f32::from_le_bytes)));
        }
        Ok(kept)
    }

    fn column(&mut self) -> Result<Vec<f32>, CheckpointError> {
        self.floats::<1>(1).map(Vec::into_flattened)
    }

    fn numbers(&mut self) -> Result<Vec<u32>, CheckpointError> {
        let count = self.value()?;
        let (share, mut kept) = ((self.share)(count), Vec::new());
        for row in 0..count {
            let number: u32 = self.value()?;
            if share.contains(&row) {
                kept.push(number);
            }
        }
        Ok(kept)
    }

    fn cloud(&mut self) -> Result<Gaussians, CheckpointError> {
        Ok(Gaussians {
            positions: self.floats(3)?,
            log_scales: self.floats(3)?,
            rotations: self.floats(4)?,
            opacity_logits: self.column()?,
            sh: self.floats(1)?,
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
            absolute_sum: self.column()?,
            gene_gradient_sum: self.floats(7)?,
            gene_views: self.numbers()?,
        })
    }

    pub(super) fn state(&mut self) -> Result<DeviceState, CheckpointError> {
        let (cloud, moments, statistics) = (self.cloud()?, self.moments()?, self.statistics()?);
        Ok(DeviceState { cloud, moments, statistics, mean: StateMean::new(self.value()?, self.cloud()?) })
    }

    pub(super) fn trial(&mut self) -> Result<Option<Trial>, CheckpointError> {
        if !self.value::<bool>()? {
            return Ok(None);
        }
        Ok(Some(Trial { record: self.value()?, cloud: self.cloud()?, moments: self.moments()? }))
    }
}
