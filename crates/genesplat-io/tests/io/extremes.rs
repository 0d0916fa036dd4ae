//! Numbers that overflow only when they are used are refused as NaN is, and what is written of all others is
//! read.

use std::fs;
use std::path::Path;

use genesplat_core::Gaussians;
use genesplat_io::format::{self, Format, Options, SpzVersion};
use genesplat_io::ply::leave_out_faults;
use proptest::prelude::*;

use crate::formats::varied;

/// The logarithm of 1e9 in f32.
const LOG_SCALE_MAX: f32 = 20.723_266;

/// Of each parameter, some values that can be used and some that cannot.
#[derive(Clone, Copy, Debug)]
enum Parameter {
    Position,
    LogScale,
    Rotation,
    Opacity,
    Colour,
    Filter,
}

use Parameter::{Colour, Filter, LogScale, Opacity, Position, Rotation};

const ALL: [Parameter; 6] = [Position, LogScale, Rotation, Opacity, Colour, Filter];

impl Parameter {
    /// `value` in a row of the cloud, at every other place where the parameter has several.
    fn set(self, cloud: &mut Gaussians, row: usize, value: f32) {
        let values: &mut [f32] = match self {
            Position => &mut cloud.positions[row],
            LogScale => &mut cloud.log_scales[row],
            Rotation => &mut cloud.rotations[row],
            Opacity => &mut cloud.opacity_logits[row..=row],
            Colour => &mut cloud.sh[row],
            Filter => &mut cloud.filter_3d.get_or_insert_with(|| vec![0.0; cloud.positions.len()])[row..=row],
        };
        values.iter_mut().step_by(2).for_each(|place| *place = value);
    }

    fn can_be(self, value: f32) -> bool {
        match self {
            LogScale => (-1e9..=LOG_SCALE_MAX).contains(&value),
            Filter => (0.0..=1e9).contains(&value),
            _ => (-1e9..=1e9).contains(&value),
        }
    }
}

const VALUES: [f32; 20] = [
    0.0,
    -0.0,
    f32::MIN_POSITIVE,
    1e-45,
    -1e-30,
    -200.0,
    LOG_SCALE_MAX,
    20.724,
    44.0,
    89.0,
    8e6,
    1e9,
    -1e9,
    1.1e9,
    1e19,
    -1e38,
    f32::MAX,
    f32::MIN,
    f32::INFINITY,
    f32::NAN,
];

/// All of them, and both versions of one.
fn written(cloud: &Gaussians) -> impl Iterator<Item = (Format, Result<Vec<u8>, String>)> {
    let versions =
        [SpzVersion::V3, SpzVersion::V4].map(|spz_version| Options { spz_version, ..Options::default() });
    let kinds = Format::ALL.into_iter().flat_map(move |format| versions.map(|options| (format, options)));
    kinds.map(|(format, options)| {
        let mut cloud = cloud.clone();
        if format == Format::Spz {
            // As far as it holds.
            cloud.positions.as_flattened_mut().iter_mut().for_each(|value| *value = value.clamp(-8e6, 8e6));
        }
        let bytes = format::to_bytes(Path::new("cloud"), format, &cloud, &options, &());
        (format, bytes.map_err(|error| error.to_string()))
    })
}

/// How many Gaussians a file of these bytes has.
fn read(folder: &Path, format: Format, bytes: &[u8]) -> Result<usize, String> {
    let path = folder.join(format!("cloud{}", format.ending()));
    fs::write(&path, bytes).unwrap();
    format::read(&path).map(|loaded| loaded.cloud.len()).map_err(|error| error.to_string())
}

#[test]
fn a_value_that_can_be_used_is_written_and_read_and_any_other_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (parameter, value) in ALL.into_iter().flat_map(|parameter| VALUES.map(|value| (parameter, value))) {
        let mut cloud = varied(15, 4, 3);
        parameter.set(&mut cloud, 2, value);
        let rows = leave_out_faults(cloud.clone()).0.len();
        assert_eq!(rows, if parameter.can_be(value) { 4 } else { 3 }, "{parameter:?} {value}");
        for (format, bytes) in written(&cloud) {
            // One for all infinities, as converters write them.
            let is_read =
                parameter.can_be(value) || matches!((parameter, value.is_infinite()), (Opacity, true));
            match (format, bytes) {
                (Format::Spz, _) if matches!(parameter, Position) => {}
                (Format::Ply, Ok(bytes)) => {
                    assert_eq!(read(folder.path(), format, &bytes).is_ok(), is_read, "{parameter:?} {value}");
                }
                (_, Ok(bytes)) => {
                    assert!(parameter.can_be(value), "{format:?} was written with {parameter:?} {value}");
                    assert_eq!(
                        read(folder.path(), format, &bytes),
                        Ok(4),
                        "{format:?} {parameter:?} {value}"
                    );
                }
                (_, Err(problem)) => {
                    assert!(!parameter.can_be(value), "{format:?} {parameter:?} {value}: {problem}");
                    assert!(problem.contains("of Gaussian 2"), "{problem}");
                }
            }
        }
    }
}

#[test]
fn a_sentence_says_what_is_beyond_what_can_be_used() {
    let folder = tempfile::tempdir().unwrap();
    for (parameter, value, words) in [
        (LogScale, 89.0, "the log-scale of Gaussian 1 is that of a size beyond 1e9 world units"),
        (LogScale, -1e38, "the log-scale of Gaussian 1 lies beyond 1e9"),
        (Colour, 3e38, "the colour of Gaussian 1 lies beyond 1e9"),
        (Rotation, 1e38, "the rotation of Gaussian 1 lies beyond 1e9"),
        (Opacity, -1e30, "the opacity of Gaussian 1 lies beyond 1e9"),
        (Filter, 1e30, "the filter_3D of Gaussian 1 lies beyond 1e9"),
    ] {
        let mut cloud = varied(19, 3, 1);
        parameter.set(&mut cloud, 1, value);
        let bytes =
            format::to_bytes(Path::new("cloud"), Format::Ply, &cloud, &Options::default(), &()).unwrap();
        let sentence = read(folder.path(), Format::Ply, &bytes).unwrap_err();
        assert!(sentence.contains(words) && sentence.contains("genesplat convert"), "{sentence}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever a cloud holds: without what cannot be shown, every format takes it, and it is read again
    /// whole.
    #[test]
    fn what_is_left_of_any_cloud_is_written_by_every_format_and_read(
        seed in any::<u64>(),
        rows in 1..40usize,
        values in prop::collection::vec((0..ALL.len(), any::<prop::sample::Index>(), 0..VALUES.len()), 0..40),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut cloud = varied(seed, rows, 3);
        for (parameter, row, value) in values {
            ALL[parameter].set(&mut cloud, row.index(rows), VALUES[value]);
        }
        let (sound, faults) = leave_out_faults(cloud);
        prop_assert_eq!(sound.len() + faults.len(), rows);
        // A file of none is no splat.
        prop_assume!(!sound.is_empty());
        for (format, bytes) in written(&sound) {
            let bytes = bytes.map_err(|problem| TestCaseError::fail(format!("{format:?}: {problem}")))?;
            prop_assert_eq!(read(folder.path(), format, &bytes), Ok(sound.len()), "{:?}", format);
        }
    }
}
