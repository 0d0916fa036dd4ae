//! The bytes of a checkpoint: little-endian sections of known length.

use std::io::{self, Read, Write};

use genesplat_core::averages::StateMean;
use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;
use genesplat_core::{DeviceState, Gaussians, Moments, Statistics, WindowAverages};

use super::{Checkpoint, CheckpointError, Cursor, Progress};
use crate::config::Trigger;
use crate::densify::renew::Trial;
use crate::run::observe::{StageKind, StageRecord};
use crate::schedule::Phase;

/// FNV-1a, 64 bits: enough to notice damage, and no defence against forgery.
#[derive(Clone, Copy)]
pub(super) struct Checksum(pub(super) u64);

impl Default for Checksum {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Checksum {
    fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

pub(super) struct Encoder<W> {
    pub(super) writer: W,
    pub(super) checksum: Checksum,
}

impl<W: Write> Encoder<W> {
    pub(super) fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.checksum.add(bytes);
        self.writer.write_all(bytes)
    }

    pub(super) fn u32(&mut self, value: u32) -> io::Result<()> {
        self.bytes(&value.to_le_bytes())
    }

    /// Something follows, or not.
    pub(super) fn flag(&mut self, flag: bool) -> io::Result<()> {
        self.u32(flag.into())
    }

    fn u64(&mut self, value: u64) -> io::Result<()> {
        self.bytes(&value.to_le_bytes())
    }

    fn f64(&mut self, value: f64) -> io::Result<()> {
        self.bytes(&value.to_le_bytes())
    }

    fn floats(&mut self, values: &[f32]) -> io::Result<()> {
        self.u64(values.len() as u64)?;
        values.iter().try_for_each(|value| self.bytes(&value.to_le_bytes()))
    }

    fn counts(&mut self, values: &[u32]) -> io::Result<()> {
        self.u64(values.len() as u64)?;
        values.iter().try_for_each(|&value| self.u32(value))
    }

    pub(super) fn state(&mut self, state: &DeviceState) -> io::Result<()> {
        let DeviceState { cloud, moments, statistics, averages } = state;
        [cloud, &moments.first, &moments.second].into_iter().try_for_each(|columns| self.cloud(columns))?;
        self.floats(&statistics.gradient_sum)?;
        self.floats(&statistics.weight_sum)?;
        self.floats(&statistics.absolute_sum)?;
        self.floats(statistics.gene_gradient_sum.as_flattened())?;
        self.counts(&statistics.gene_views)?;
        averages.halves().iter().try_for_each(|half| {
            self.u32(half.states())?;
            self.cloud(half.mean())
        })
    }

    pub(super) fn progress(&mut self, progress: &Progress) -> io::Result<()> {
        self.u32(progress.sh_degree_start.into())?;
        self.u32(progress.steps)?;
        self.u32(progress.opacity_steps)?;
        self.f64(progress.gradient_seconds)?;
        self.f64(progress.evolution_seconds)?;
        self.u64(progress.stages.len() as u64)?;
        progress.stages.iter().try_for_each(|stage| self.stage(stage))
    }

    pub(super) fn trial(&mut self, trial: &Trial) -> io::Result<()> {
        self.stage(&trial.record)?;
        self.cloud(&trial.cloud)?;
        self.cloud(&trial.moments.first)?;
        self.cloud(&trial.moments.second)
    }

    fn stage(&mut self, stage: &StageRecord) -> io::Result<()> {
        self.u32(stage.kind as u32)?;
        self.u32(stage.iteration)?;
        self.u32(stage.generations)?;
        self.u64(stage.renders)?;
        self.f64(stage.fitness_before)?;
        self.f64(stage.fitness_after)?;
        self.flag(stage.guard_psnr.is_some())?;
        stage.guard_psnr.into_iter().flatten().try_for_each(|psnr| self.f64(psnr))?;
        self.u64(stage.changed as u64)?;
        self.u64(stage.population_bytes)?;
        self.f64(stage.seconds)
    }

    fn cloud(&mut self, cloud: &Gaussians) -> io::Result<()> {
        self.floats(cloud.positions.as_flattened())?;
        self.floats(cloud.log_scales.as_flattened())?;
        self.floats(cloud.rotations.as_flattened())?;
        self.floats(&cloud.opacity_logits)?;
        self.floats(cloud.sh.as_flattened())?;
        self.flag(cloud.filter_3d.is_some())?;
        cloud.filter_3d.as_ref().map_or(Ok(()), |filter| self.floats(filter))
    }
}

pub(super) struct Decoder<R> {
    pub(super) reader: R,
    pub(super) checksum: Checksum,
}

impl<R: Read> Decoder<R> {
    pub(super) fn checkpoint(&mut self) -> Result<Checkpoint, CheckpointError> {
        Ok(Checkpoint {
            cursor: Cursor { iteration: self.u32()?, phase: self.phase()? },
            progress: self.progress()?,
            state: self.state()?,
            trial: if self.flag()? { Some(self.trial()?) } else { None },
        })
    }

    fn trial(&mut self) -> Result<Trial, CheckpointError> {
        Ok(Trial {
            record: self.stage()?,
            cloud: self.cloud()?,
            moments: Moments { first: self.cloud()?, second: self.cloud()? },
        })
    }

    fn state(&mut self) -> Result<DeviceState, CheckpointError> {
        Ok(DeviceState {
            cloud: self.cloud()?,
            moments: Moments { first: self.cloud()?, second: self.cloud()? },
            statistics: Statistics {
                gradient_sum: self.floats()?,
                weight_sum: self.floats()?,
                absolute_sum: self.floats()?,
                gene_gradient_sum: self.rows()?,
                gene_views: self.words()?.into_iter().map(u32::from_le_bytes).collect(),
            },
            averages: WindowAverages::new([self.state_mean()?, self.state_mean()?]),
        })
    }

    fn state_mean(&mut self) -> Result<StateMean, CheckpointError> {
        Ok(StateMean::new(self.u32()?, self.cloud()?))
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], CheckpointError> {
        let mut bytes = [0; N];
        self.reader.read_exact(&mut bytes)?;
        self.checksum.add(&bytes);
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, CheckpointError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn flag(&mut self) -> Result<bool, CheckpointError> {
        Ok(self.u32()? != 0)
    }

    fn u64(&mut self) -> Result<u64, CheckpointError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64, CheckpointError> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    /// A section of 4-byte values. A damaged length ends at the end of the file, never in a huge allocation.
    fn words(&mut self) -> Result<Vec<[u8; 4]>, CheckpointError> {
        let length = self.u64()?.saturating_mul(4);
        let mut bytes = Vec::new();
        if self.reader.by_ref().take(length).read_to_end(&mut bytes)? as u64 != length {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
        }
        self.checksum.add(&bytes);
        Ok(bytes.as_chunks().0.to_vec())
    }

    fn floats(&mut self) -> Result<Vec<f32>, CheckpointError> {
        Ok(self.words()?.into_iter().map(f32::from_le_bytes).collect())
    }

    /// A section of `[N, K]` floats.
    fn rows<const K: usize>(&mut self) -> Result<Vec<[f32; K]>, CheckpointError> {
        match self.floats()?.as_chunks() {
            (rows, []) => Ok(rows.to_vec()),
            _ => Err(CheckpointError::Damaged("a column ends within a row")),
        }
    }

    fn phase(&mut self) -> Result<Phase, CheckpointError> {
        let number = self.u32()?;
        let phase = Phase::order(Trigger::default()).into_iter().find(|&phase| phase as u32 == number);
        phase.ok_or(CheckpointError::Damaged("it names an unknown phase"))
    }

    fn sh_degree(&mut self) -> Result<u8, CheckpointError> {
        let degree = u8::try_from(self.u32()?).ok().filter(|&degree| degree <= SH_DEGREE_MAX);
        degree.ok_or(CheckpointError::Damaged("it names a degree of spherical harmonics that there is not"))
    }

    fn progress(&mut self) -> Result<Progress, CheckpointError> {
        Ok(Progress {
            sh_degree_start: self.sh_degree()?,
            steps: self.u32()?,
            opacity_steps: self.u32()?,
            gradient_seconds: self.f64()?,
            evolution_seconds: self.f64()?,
            stages: (0..self.u64()?).map(|_| self.stage()).collect::<Result<_, _>>()?,
        })
    }

    fn stage_kind(&mut self) -> Result<StageKind, CheckpointError> {
        let kind = StageKind::ALL.get(self.u32()? as usize).copied();
        kind.ok_or(CheckpointError::Damaged("it names an unknown kind of stage"))
    }

    fn stage(&mut self) -> Result<StageRecord, CheckpointError> {
        Ok(StageRecord {
            kind: self.stage_kind()?,
            iteration: self.u32()?,
            generations: self.u32()?,
            renders: self.u64()?,
            fitness_before: self.f64()?,
            fitness_after: self.f64()?,
            guard_psnr: if self.flag()? { Some([self.f64()?, self.f64()?]) } else { None },
            changed: self.u64()? as usize,
            population_bytes: self.u64()?,
            seconds: self.f64()?,
        })
    }

    fn cloud(&mut self) -> Result<Gaussians, CheckpointError> {
        Ok(Gaussians {
            positions: self.rows()?,
            log_scales: self.rows()?,
            rotations: self.rows()?,
            opacity_logits: self.floats()?,
            sh: self.rows()?,
            filter_3d: if self.flag()? { Some(self.floats()?) } else { None },
        })
    }
}
