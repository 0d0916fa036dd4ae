//! The splats of a run, and what was subtracted from their coordinates.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use genesplat_core::{CloudRenderer, Gaussians, RowOwners, ScreenFilter};
use genesplat_io::{PlyOptions, offset, ply};
use genesplat_train::checkpoint::JointWriter;

use super::{RunSession, SPLAT_ROWS};
use crate::files::write_own;
use crate::{CLOUD, FUSED_CLOUD, SNAPSHOTS};

impl RunSession {
    /// Writes the splat, so that viewers know its screen filter, and without its 3D filter, if it has one.
    pub(crate) fn write_cloud(
        &self,
        cloud: &Gaussians,
        filter: ScreenFilter,
        owners: &dyn RowOwners,
    ) -> Result<()> {
        let options = PlyOptions { screen_filter: filter, ..PlyOptions::default() };
        if cloud.filter_3d.is_some() {
            self.write_splat(FUSED_CLOUD, &cloud.fused(), &options, owners)?;
        }
        self.write_splat(CLOUD, cloud, &options, owners)
    }

    fn write_splat(
        &self,
        name: &str,
        cloud: &Gaussians,
        options: &PlyOptions,
        owners: &dyn RowOwners,
    ) -> Result<()> {
        self.write_together(name, |out| {
            let mut out = JointWriter::new(out, owners);
            let counts = out.counts(cloud.len())?;
            out.bytes(&ply::header_bytes(counts.iter().sum(), cloud.filter_3d.is_some(), options));
            out.rows(&counts, SPLAT_ROWS, |rows| ply::row_bytes(cloud, rows, options))?;
            out.finish().map(drop)
        })?;
        self.write_offset(name.as_ref())
    }

    /// Beside the splat of this name.
    fn write_offset(&self, splat: &Path) -> Result<()> {
        let Some(by) = self.offset.filter(|_| self.writes) else { return Ok(()) };
        write_own(&self.path, offset::file_beside(splat), |out| out.write_all(offset::to_json(by).as_bytes()))
    }

    /// Writes the cloud of a run under way beside its results; returns where it is.
    pub(crate) fn write_snapshot(&self, iteration: u32, renderer: &mut CloudRenderer<'_>) -> Result<PathBuf> {
        self.hold()?;
        let name = Path::new(SNAPSHOTS).join(format!("iteration-{iteration:06}.ply"));
        let options = PlyOptions { screen_filter: renderer.settings().filter, ..PlyOptions::default() };
        let cloud = renderer.cloud()?;
        write_own(&self.path, &name, |out| ply::write_to(out, &cloud, &options))?;
        self.write_offset(&name)?;
        Ok(self.path.join(name))
    }
}
