//! The cloud and its moments as they were before a row edit on trial: its old columns, which are not copied. They stay on the
//! device, unless a checkpoint asks for them.

use genesplat_core::Snapshot;

use crate::Result;
use crate::device::Engine;
use crate::state::layout::GRADIENT_FLOATS;
use crate::state::statistics::DeviceStatistics;
use crate::state::{ColourSteps, Column, Parameters, State, download_moments, upload_moments, windows};

/// Whoever rolls back has taken a snapshot.
const NO_SNAPSHOT: &str = "there is a snapshot to go back to";

pub(crate) struct DeviceSnapshot {
    rows: u64,
    cloud: Parameters,
    first: Parameters,
    second: Parameters,
    pending: Option<Parameters>,
    has_filter: bool,
}

/// Puts back what [`download`] gave, of this backend or another.
pub(super) fn upload(engine: &Engine, given: &Snapshot) -> Result<DeviceSnapshot> {
    let rows = given.cloud.len() as u64;
    let cloud = Parameters::upload(engine, "the snapshot", &given.cloud)?;
    let (first, second, pending) = upload_moments(engine, rows, &given.moments)?;
    Ok(DeviceSnapshot { rows, cloud, first, second, pending, has_filter: given.cloud.filter_3d.is_some() })
}

pub(super) fn download(engine: &Engine, held: &DeviceSnapshot) -> Result<Snapshot> {
    let DeviceSnapshot { rows, cloud, first, second, pending, has_filter } = held;
    let moments = download_moments(engine, *rows, [first, second], pending.as_ref())?;
    Ok(Snapshot { cloud: cloud.download(engine, *rows, *has_filter)?, moments })
}

impl State {
    /// What can be gone back to; colours must have made their steps.
    pub(crate) fn into_snapshot(self) -> DeviceSnapshot {
        let Self { rows, cloud, first, second, pending, has_filter, .. } = self;
        DeviceSnapshot { rows, cloud, first, second, pending, has_filter }
    }

    /// The snapshot takes the place of all that is held, without a copy.
    pub(crate) fn roll_back(&mut self, engine: &Engine) -> Result<()> {
        let rows = self.snapshot.as_ref().expect(NO_SNAPSHOT).rows;
        let (windows, colour_steps) = (windows(engine, rows)?, ColourSteps::new(engine, rows)?);
        let gradients = Column::zeros(engine, "gradients", 0, GRADIENT_FLOATS)?;
        let statistics = DeviceStatistics::zeros(engine, rows)?;
        let snapshot = self.snapshot.take().expect(NO_SNAPSHOT);
        let DeviceSnapshot { cloud, first, second, pending, has_filter, .. } = snapshot;
        let (mean, snapshot) = (None, None);
        *self = Self {
            rows,
            windows,
            cloud,
            first,
            second,
            colour_steps,
            pending,
            gradients,
            statistics,
            has_filter,
            mean,
            snapshot,
        };
        Ok(())
    }
}
