//! All that a run needs to go on as if it had never stopped, and its bytes.
//!
//! Randomness needs no state (streams are addressed by iteration), so a checkpoint is the device's contents
//! plus a few counters. The format is private to this version of the crate: a magic number, what the run
//! began with, counters as `postcard` writes them, columns of rows, and a checksum over everything, so that a
//! file cut short by a full disk is recognised.

use std::io::{self, Read, Write};
use std::ops::Range;
use std::sync::Arc;

use genesplat_core::spherical_harmonics::SH_DEGREE_MAX;
use genesplat_core::{Alone, DeviceState, Photo, RowOwners};
use serde::{Deserialize, Serialize};

use super::Seconds;
use super::observe::StageRecord;
use crate::optimiser_step::OptimiserStep;
use crate::timeline::Event;
use columns::ColumnReader;
pub use joint::JointWriter;
use summed::Summed;

mod columns;
mod joint;
mod summed;

/// Opens every checkpoint; the last byte is the version of the format.
const MAGIC: [u8; 8] = *b"GSPLATC\x0f";

/// The next thing to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Cursor {
    /// Counted from 1.
    pub iteration: u32,
    /// Events of this iteration before it are done.
    pub event: Event,
}

impl Cursor {
    /// The beginning of an iteration.
    pub fn start_of(iteration: u32) -> Self {
        Self { iteration, event: Event::Step }
    }
}

/// What a run has done so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Degree of the spherical harmonics that the run began with: 0 for points, that of a cloud from
    /// elsewhere.
    pub sh_degree_start: u8,
    /// Adam steps made.
    pub steps: u32,
    /// Adam steps that the opacity group made (it misses some).
    pub opacity_steps: u32,
    /// Wall-clock seconds.
    pub seconds: Seconds,
    /// Evolution stages so far.
    pub stages: Vec<StageRecord>,
}

impl Progress {
    /// A step was taken on.
    pub(crate) fn count(&mut self, step: OptimiserStep) {
        self.steps += u32::from(step.moves());
        self.opacity_steps += u32::from(step == OptimiserStep::All);
    }

    /// A step that was taken on will never be made.
    pub(crate) fn take_back(&mut self, step: OptimiserStep) {
        self.steps -= u32::from(step.moves());
        self.opacity_steps -= u32::from(step == OptimiserStep::All);
    }
}

/// A run that can be resumed exactly.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// What the run began with, in words of whoever runs it, who tells by them whose checkpoint it is. Empty
    /// where nobody has said so.
    pub origin: String,
    /// Where to go on.
    pub cursor: Cursor,
    /// What was done.
    pub progress: Progress,
    /// What the device held.
    pub state: DeviceState,
    /// What the virtual views show; none before they were looked at.
    pub virtual_pictures: Vec<Arc<Photo>>,
}

/// Why a checkpoint cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The file could not be read, or is shorter than it says.
    #[error(
        "the checkpoint could not be read to its end ({0}); try again, or remove it to begin the run anew, without --resume"
    )]
    Io(#[from] io::Error),
    /// Another format, or another version of it.
    #[error("this is not a checkpoint of this version of genesplat; resume with the version that wrote it")]
    Foreign,
    /// Bytes were changed.
    #[error("the checkpoint is damaged ({0}); remove it to begin the run anew, without --resume")]
    Damaged(&'static str),
}

impl Checkpoint {
    /// Writes the checkpoint; wrap files in a `BufWriter`.
    pub fn write(&self, writer: impl Write) -> io::Result<()> {
        self.write_together(writer, &Alone)
    }

    /// The same by all owners of the rows; all but the first give a sink.
    pub fn write_together(&self, writer: impl Write, owners: &dyn RowOwners) -> io::Result<()> {
        let mut out = JointWriter::new(Summed::new(writer), owners);
        out.bytes(&MAGIC);
        out.text(&self.origin);
        out.value(&self.cursor);
        out.value(&self.progress);
        out.state(&self.state)?;
        out.pictures(&self.virtual_pictures);
        let Summed { mut inner, sum, .. } = out.finish()?;
        inner.write_all(&sum.to_le_bytes())?;
        inner.flush()
    }

    /// Reads a checkpoint; wrap files in a `BufReader`. A damaged length ends at the end of the file, never
    /// in a huge allocation: columns grow as they are read.
    pub fn read(reader: impl Read) -> Result<Self, CheckpointError> {
        Self::read_share(reader, &|rows| 0..rows)
    }

    /// The same, of which only some rows are kept: `share` says which, of so many.
    pub fn read_share(
        reader: impl Read,
        share: &dyn Fn(usize) -> Range<usize>,
    ) -> Result<Self, CheckpointError> {
        let mut columns = ColumnReader { input: Summed::new(reader), share };
        let origin = columns.origin()?;
        let (cursor, progress) = (columns.value()?, columns.value()?);
        let state = columns.state()?;
        let virtual_pictures = columns.pictures()?;
        let checkpoint = Self { origin, cursor, progress, state, virtual_pictures };
        let (mut sum, Summed { mut inner, sum: expected, .. }) = ([0; 8], columns.input);
        inner.read_exact(&mut sum)?;
        if u64::from_le_bytes(sum) != expected {
            return Err(CheckpointError::Damaged("its checksum does not match"));
        }
        if inner.read(&mut [0])? > 0 {
            return Err(CheckpointError::Damaged("something follows its end"));
        }
        checkpoint.check()?;
        Ok(checkpoint)
    }

    /// What the run began with, from the first bytes of its checkpoint; nothing behind them is looked at.
    pub fn read_origin(reader: impl Read) -> Result<String, CheckpointError> {
        ColumnReader { input: Summed::new(reader), share: &|_| 0..0 }.origin()
    }

    fn check(&self) -> Result<(), CheckpointError> {
        if self.progress.sh_degree_start > SH_DEGREE_MAX {
            return Err(CheckpointError::Damaged(
                "it names a degree of spherical harmonics that there is not",
            ));
        }
        let DeviceState { cloud, moments, statistics, mean, .. } = &self.state;
        let n = cloud.len();
        let genes = [statistics.gene_gradient_sum.len(), statistics.gene_views.len()];
        let consistent = cloud.is_consistent()
            && moments.is_consistent(n)
            && [statistics.gradient_sum.len(), statistics.weight_sum.len()] == [n, n]
            && (genes == [n, n] || genes == [0, 0])
            && mean.mean().is_consistent()
            && [0, n].contains(&mean.mean().len());
        if consistent { Ok(()) } else { Err(CheckpointError::Damaged("its columns differ in length")) }
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Gaussians, Moments, StateMean, Statistics};

    use super::*;
    use crate::run::observe::StageKind;

    fn example() -> Checkpoint {
        let mut cloud = Gaussians::zeros(3);
        cloud.positions[1] = [1.5, -0.0, f32::MIN_POSITIVE];
        cloud.sh[2][47] = 4.0;
        cloud.filter_3d = Some(vec![0.1, 0.2, 0.3]);
        let mut moments = Moments::zeros(3);
        moments.second.rotations[0] = [1.0, 2.0, 3.0, 4.0];
        moments.pending = Moments::column(3);
        moments.pending.sh[1][4] = 0.5;
        let stage = StageRecord {
            kind: StageKind::Genetic,
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
            origin: "seed = 7".into(),
            cursor: Cursor { iteration: 6000, event: Event::Search },
            progress: Progress {
                sh_degree_start: 2,
                steps: 5945,
                opacity_steps: 5944,
                seconds: Seconds { gradient: 2.5, evolution: 1.5 },
                stages: vec![stage],
            },
            state: DeviceState {
                cloud,
                moments,
                statistics: Statistics {
                    gradient_sum: vec![1.0, 2.0, 3.0],
                    weight_sum: vec![4.0, 5.0, 6.0],
                    gene_gradient_sum: vec![[0.5; 7]; 3],
                    gene_views: vec![7, 8, 9],
                },
                mean: StateMean::new(4, Gaussians::zeros(3)),
            },
            virtual_pictures: (0..2)
                .map(|_| Arc::new(Photo { width: 2, height: 1, rgb: (1..7).collect() }))
                .collect(),
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
        assert_eq!(Checkpoint::read_origin(&bytes(&checkpoint)[..40]).unwrap(), checkpoint.origin);
        checkpoint.state.cloud.filter_3d = None;
        checkpoint.virtual_pictures.clear();
        checkpoint.state.statistics.gene_gradient_sum.clear();
        checkpoint.state.statistics.gene_views.clear();
        assert_eq!(Checkpoint::read(bytes(&checkpoint).as_slice()).unwrap(), checkpoint);
    }

    #[test]
    fn other_bytes_ask_for_another_version() {
        let bytes = bytes(&example());
        let (_, sum) = bytes.split_last_chunk().unwrap();
        let expected = (3830, 9_516_174_398_100_119_810);
        assert_eq!(
            (bytes.len(), u64::from_le_bytes(*sum)),
            expected,
            "a change of these asks for a change of MAGIC"
        );
    }

    /// Of each column the share of a process, also of one that has none.
    #[test]
    fn shares_are_read_without_the_other_rows() {
        let (checkpoint, bytes) = (example(), bytes(&example()));
        let read =
            |share: &dyn Fn(usize) -> Range<usize>| Checkpoint::read_share(bytes.as_slice(), share).unwrap();
        let (first, rest) = (read(&|_| 0..1), read(&|rows| 1..rows));
        let mut cloud = first.state.cloud;
        cloud.append(rest.state.cloud);
        assert_eq!(cloud, checkpoint.state.cloud);
        assert_eq!([first.state.statistics.gene_views, rest.state.statistics.gene_views].concat(), [7, 8, 9]);
        assert_eq!(rest.state.moments.pending.sh[0][4], 0.5);
        let none = read(&|_| 0..0);
        assert_eq!((none.cursor, &none.progress), (checkpoint.cursor, &checkpoint.progress));
        assert_eq!((none.state.cloud.len(), none.state.cloud.filter_3d), (0, Some(Vec::new())));
        assert_eq!(none.state.mean.states(), checkpoint.state.mean.states());
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
        let spoil: [fn(&mut Checkpoint); 6] = [
            |checkpoint| _ = checkpoint.state.statistics.weight_sum.pop(),
            |checkpoint| _ = checkpoint.state.statistics.gene_views.pop(),
            |checkpoint| _ = checkpoint.state.cloud.sh.pop(),
            |checkpoint| _ = checkpoint.state.moments.second.rotations.pop(),
            |checkpoint| _ = checkpoint.state.moments.pending.positions.pop(),
            |checkpoint| {
                let mut mean = Gaussians::zeros(3);
                mean.sh.pop();
                checkpoint.state.mean = StateMean::new(4, mean);
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
    fn a_damaged_length_ends_at_the_end_of_the_file() {
        let origin = [&MAGIC[..], &[0xff, 0xff, 0xff, 0xff, 0x7f], &[b'x'; 64]].concat();
        assert!(matches!(Checkpoint::read_origin(origin.as_slice()), Err(CheckpointError::Io(_))));
        let columns = [&MAGIC[..], &[0], &[1, 0, 0, 0, 0], &[0; 16], &[0]].concat();
        let huge = [&columns[..], &[0xff, 0xff, 0xff, 0xff, 0x7f], &[0; 64]].concat();
        assert!(matches!(Checkpoint::read(huge.as_slice()), Err(CheckpointError::Io(_))));
    }
}
