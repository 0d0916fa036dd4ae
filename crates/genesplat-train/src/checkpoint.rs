//! All that a run needs to go on as if it had never stopped, and its bytes.
//!
//! Randomness needs no state (streams are addressed by iteration), so a checkpoint is the device's contents plus a few
//! counters. The format is private to this version of the crate: a magic number, little-endian sections of known
//! length, and a checksum over everything, so that a file cut short by a full disk is recognised.

use std::io::{self, Read, Write};

use genesplat_core::lineage::{Lineage, Parent};
use genesplat_core::{Backend, BackendError, Gaussians, Moments, Statistics};

use crate::observe::{StageKind, StageRecord};
use crate::renew::Trial;
use crate::schedule::{OptimiserStep, Phase};

/// Opens every checkpoint; the last byte is the version of the format.
const MAGIC: [u8; 8] = *b"GSPLATC\x06";

/// The next thing to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cursor {
    /// Counted from 1.
    pub iteration: u32,
    /// Phases of this iteration before it are done.
    pub phase: Phase,
}

impl Cursor {
    /// The beginning of an iteration.
    pub fn start_of(iteration: u32) -> Self {
        Self { iteration, phase: Phase::Step }
    }

    /// What follows the gradient step of an iteration.
    pub fn after_step(iteration: u32) -> Self {
        Self { iteration, phase: Phase::ORDER[1] }
    }
}

/// What a run has done so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// Adam steps made.
    pub steps: u32,
    /// Adam steps that the opacity group made (it misses some).
    pub opacity_steps: u32,
    /// Wall-clock seconds spent on gradients and density control.
    pub gradient_seconds: f64,
    /// Wall-clock seconds spent on evolution, or on the control in its place.
    pub evolution_seconds: f64,
    /// Evolution stages so far.
    pub stages: Vec<StageRecord>,
}

impl Progress {
    /// A step was taken on.
    pub(crate) fn count(&mut self, step: OptimiserStep) {
        self.steps += u32::from(step != OptimiserStep::Lost);
        self.opacity_steps += u32::from(step == OptimiserStep::All);
    }

    /// A step that was taken on will never be made.
    pub(crate) fn take_back(&mut self, step: OptimiserStep) {
        self.steps -= u32::from(step != OptimiserStep::Lost);
        self.opacity_steps -= u32::from(step == OptimiserStep::All);
    }
}

/// A run that can be resumed exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Where to go on.
    pub cursor: Cursor,
    /// What was done.
    pub progress: Progress,
    /// The Gaussians.
    pub cloud: Gaussians,
    /// Adam's moments.
    pub moments: Moments,
    /// Sums for density control and evolution.
    pub statistics: Statistics,
    /// States that recombination averages.
    pub lineage: Lineage,
    /// The renewal that has yet to prove itself.
    pub trial: Option<Trial>,
}

/// Why a checkpoint cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The file could not be read, or is shorter than it says.
    #[error(
        "the checkpoint could not be read to its end ({0}); start the run anew, or from an earlier checkpoint"
    )]
    Io(#[from] io::Error),
    /// Another format, or another version of it.
    #[error("this is not a checkpoint of this version of genesplat; resume with the version that wrote it")]
    Foreign,
    /// Bytes were changed.
    #[error("the checkpoint is damaged ({0}); start the run anew, or from an earlier checkpoint")]
    Damaged(&'static str),
}

impl Checkpoint {
    /// All that it takes to go on from `cursor` with what the device holds.
    pub(crate) fn capture<B: Backend>(
        backend: &mut B,
        cursor: Cursor,
        progress: Progress,
        trial: Option<Trial>,
    ) -> Result<Self, BackendError> {
        Ok(Self {
            cursor,
            progress,
            cloud: backend.download()?.into_owned(),
            moments: backend.download_moments()?.into_owned(),
            statistics: backend.statistics()?,
            lineage: backend.lineage()?.into_owned(),
            trial,
        })
    }

    /// Writes the checkpoint; wrap files in a `BufWriter`.
    pub fn write(&self, writer: impl Write) -> io::Result<()> {
        let mut out = Encoder { writer, checksum: Checksum::default() };
        out.bytes(&MAGIC)?;
        out.u32(self.cursor.iteration)?;
        out.u32(self.cursor.phase as u32)?;
        out.progress(&self.progress)?;
        out.cloud(&self.cloud)?;
        out.cloud(&self.moments.first)?;
        out.cloud(&self.moments.second)?;
        out.floats(&self.statistics.gradient_sum)?;
        out.floats(&self.statistics.weight_sum)?;
        out.floats(&self.statistics.absolute_sum)?;
        out.floats(self.statistics.gene_gradient_sum.as_flattened())?;
        out.counts(&self.statistics.gene_views)?;
        for parent in self.lineage.parents() {
            out.u32(parent.states())?;
            out.cloud(parent.mean())?;
        }
        out.flag(self.trial.is_some())?;
        self.trial.as_ref().map_or(Ok(()), |trial| out.trial(trial))?;
        let checksum = out.checksum.0;
        out.writer.write_all(&checksum.to_le_bytes())?;
        out.writer.flush()
    }

    /// Reads a checkpoint; wrap files in a `BufReader`.
    pub fn read(reader: impl Read) -> Result<Self, CheckpointError> {
        let mut input = Decoder { reader, checksum: Checksum::default() };
        if input.array::<8>()? != MAGIC {
            return Err(CheckpointError::Foreign);
        }
        let checkpoint = input.checkpoint()?;
        let expected = input.checksum.0;
        if u64::from_le_bytes(input.array()?) != expected {
            return Err(CheckpointError::Damaged("its checksum does not match"));
        }
        if input.reader.read(&mut [0])? > 0 {
            return Err(CheckpointError::Damaged("something follows its end"));
        }
        checkpoint.check_rows()?;
        Ok(checkpoint)
    }

    fn check_rows(&self) -> Result<(), CheckpointError> {
        let (n, statistics) = (self.cloud.len(), &self.statistics);
        let genes = [statistics.gene_gradient_sum.len(), statistics.gene_views.len()];
        let consistent = [&self.cloud, &self.moments.first, &self.moments.second]
            .into_iter()
            .all(|columns| columns.is_consistent() && columns.len() == n)
            && [statistics.gradient_sum.len(), statistics.weight_sum.len()] == [n, n]
            && [0, n].contains(&statistics.absolute_sum.len())
            && (genes == [n, n] || genes == [0, 0])
            && self.trial.as_ref().is_none_or(Trial::is_consistent)
            && self
                .lineage
                .parents()
                .iter()
                .all(|parent| parent.mean().is_consistent() && [0, n].contains(&parent.mean().len()));
        if consistent { Ok(()) } else { Err(CheckpointError::Damaged("its columns differ in length")) }
    }
}

/// FNV-1a, 64 bits: enough to notice damage, and no defence against forgery.
#[derive(Clone, Copy)]
struct Checksum(u64);

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

struct Encoder<W> {
    writer: W,
    checksum: Checksum,
}

impl<W: Write> Encoder<W> {
    fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.checksum.add(bytes);
        self.writer.write_all(bytes)
    }

    fn u32(&mut self, value: u32) -> io::Result<()> {
        self.bytes(&value.to_le_bytes())
    }

    /// Something follows, or not.
    fn flag(&mut self, flag: bool) -> io::Result<()> {
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

    fn progress(&mut self, progress: &Progress) -> io::Result<()> {
        self.u32(progress.steps)?;
        self.u32(progress.opacity_steps)?;
        self.f64(progress.gradient_seconds)?;
        self.f64(progress.evolution_seconds)?;
        self.u64(progress.stages.len() as u64)?;
        progress.stages.iter().try_for_each(|stage| self.stage(stage))
    }

    fn trial(&mut self, trial: &Trial) -> io::Result<()> {
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

struct Decoder<R> {
    reader: R,
    checksum: Checksum,
}

impl<R: Read> Decoder<R> {
    fn checkpoint(&mut self) -> Result<Checkpoint, CheckpointError> {
        Ok(Checkpoint {
            cursor: Cursor { iteration: self.u32()?, phase: self.phase()? },
            progress: self.progress()?,
            cloud: self.cloud()?,
            moments: Moments { first: self.cloud()?, second: self.cloud()? },
            statistics: Statistics {
                gradient_sum: self.floats()?,
                weight_sum: self.floats()?,
                absolute_sum: self.floats()?,
                gene_gradient_sum: self.rows()?,
                gene_views: self.words()?.into_iter().map(u32::from_le_bytes).collect(),
            },
            lineage: Lineage::new([self.parent()?, self.parent()?]),
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

    fn parent(&mut self) -> Result<Parent, CheckpointError> {
        Ok(Parent::new(self.u32()?, self.cloud()?))
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CheckpointError> {
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
        let phase = Phase::ORDER.get(self.u32()? as usize).copied();
        phase.ok_or(CheckpointError::Damaged("it names an unknown phase"))
    }

    fn progress(&mut self) -> Result<Progress, CheckpointError> {
        Ok(Progress {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Checkpoint {
        let mut cloud = Gaussians::zeros(3);
        cloud.positions[1] = [1.5, -0.0, f32::MIN_POSITIVE];
        cloud.sh[2][47] = 4.0;
        cloud.filter_3d = Some(vec![0.1, 0.2, 0.3]);
        let mut moments = Moments::zeros(3);
        moments.second.rotations[0] = [1.0, 2.0, 3.0, 4.0];
        let stage = StageRecord {
            kind: StageKind::Renewal,
            iteration: 3000,
            generations: 101,
            renders: 54_606,
            fitness_before: 0.5,
            fitness_after: 0.25,
            guard_psnr: Some([30.0, 30.5]),
            changed: 17,
            population_bytes: 1 << 40,
            seconds: 1.5,
        };
        Checkpoint {
            cursor: Cursor { iteration: 6000, phase: Phase::EvolveAfterReset },
            progress: Progress {
                steps: 5945,
                opacity_steps: 5944,
                gradient_seconds: 2.5,
                evolution_seconds: 1.5,
                stages: vec![stage],
            },
            cloud,
            moments,
            statistics: Statistics {
                gradient_sum: vec![1.0, 2.0, 3.0],
                weight_sum: vec![4.0, 5.0, 6.0],
                absolute_sum: vec![7.0, 8.0, 9.0],
                gene_gradient_sum: vec![[0.5; 7]; 3],
                gene_views: vec![7, 8, 9],
            },
            lineage: Lineage::new([Parent::default(), Parent::new(4, Gaussians::zeros(3))]),
            trial: Some(Trial { record: stage, cloud: Gaussians::zeros(2), moments: Moments::zeros(2) }),
        }
    }

    fn bytes(checkpoint: &Checkpoint) -> Vec<u8> {
        let mut bytes = Vec::new();
        checkpoint.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn a_checkpoint_survives_the_round_trip_bit_for_bit() {
        let mut checkpoint = example();
        assert_eq!(Checkpoint::read(bytes(&checkpoint).as_slice()).unwrap(), checkpoint);
        checkpoint.cloud.filter_3d = None;
        checkpoint.trial = None;
        checkpoint.statistics.gene_gradient_sum.clear();
        checkpoint.statistics.gene_views.clear();
        checkpoint.statistics.absolute_sum.clear();
        assert_eq!(Checkpoint::read(bytes(&checkpoint).as_slice()).unwrap(), checkpoint);
    }

    #[test]
    fn every_cut_and_every_changed_byte_is_noticed() {
        let whole = bytes(&example());
        for length in 0..whole.len() {
            let cut = Checkpoint::read(&whole[..length]);
            assert!(matches!(cut, Err(CheckpointError::Io(_))), "cut at {length}");
        }
        for position in 0..whole.len() {
            let mut changed = whole.clone();
            changed[position] ^= 0x10;
            assert!(Checkpoint::read(changed.as_slice()).is_err(), "changed at {position}");
        }
        let more = [&whole[..], &[0]].concat();
        assert!(matches!(Checkpoint::read(more.as_slice()), Err(CheckpointError::Damaged(_))), "and more");
    }

    #[test]
    fn other_files_are_recognised() {
        let error = Checkpoint::read(&b"ply\nformat binary_little_endian 1.0\n"[..]).unwrap_err();
        assert!(matches!(error, CheckpointError::Foreign), "{error}");
    }

    #[test]
    fn columns_must_agree() {
        let spoil: [fn(&mut Checkpoint); 7] = [
            |checkpoint| _ = checkpoint.statistics.weight_sum.pop(),
            |checkpoint| _ = checkpoint.statistics.absolute_sum.pop(),
            |checkpoint| _ = checkpoint.statistics.gene_views.pop(),
            |checkpoint| _ = checkpoint.cloud.sh.pop(),
            |checkpoint| _ = checkpoint.moments.second.rotations.pop(),
            |checkpoint| _ = checkpoint.trial.as_mut().unwrap().cloud.log_scales.pop(),
            |checkpoint| {
                let mut mean = Gaussians::zeros(3);
                mean.sh.pop();
                checkpoint.lineage = Lineage::new([Parent::default(), Parent::new(4, mean)]);
            },
        ];
        for (case, spoil) in spoil.iter().enumerate() {
            let mut checkpoint = example();
            spoil(&mut checkpoint);
            let error = Checkpoint::read(bytes(&checkpoint).as_slice()).unwrap_err();
            assert!(matches!(error, CheckpointError::Damaged(_)), "{case}: {error}");
        }
    }

    #[test]
    fn numbers_in_the_file_are_places_in_the_lists() {
        assert!(Phase::ORDER.iter().enumerate().all(|(place, &phase)| phase as usize == place));
        assert!(StageKind::ALL.iter().enumerate().all(|(place, &kind)| kind as usize == place));
    }
}
