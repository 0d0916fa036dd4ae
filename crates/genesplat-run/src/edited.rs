//! What pages have edited, as a file of its own: never over the splat that was opened, nor over an earlier
//! edit.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Result;
use genesplat_core::CloudRenderer;
use genesplat_io::{Offset, PlyOptions, ply, shown};

use crate::files::write_file;
use crate::numbers::thousands;
use crate::splat::write_offset;

/// Where an edited splat is saved.
#[derive(Clone, Debug, PartialEq)]
pub struct EditedFile {
    folder: PathBuf,
    /// Without its ending.
    stem: OsString,
    offset: Option<Offset>,
}

impl EditedFile {
    /// Of a run, `RUN/edited.ply`; of `FILE.ply` or another splat, `FILE-edited.ply` beside it.
    pub fn beside(splat: &Path, offset: Option<Offset>) -> Self {
        if splat.is_dir() {
            return Self { folder: splat.to_owned(), stem: "edited".into(), offset };
        }
        let mut stem = splat.file_stem().unwrap_or_default().to_owned();
        stem.push("-edited");
        Self { folder: splat.parent().unwrap_or(Path::new("")).to_owned(), stem, offset }
    }

    /// Saves what `renderer` holds; where it is, in a sentence.
    pub(crate) fn save(&self, renderer: &mut CloudRenderer<'_>) -> Result<String> {
        let path = self.free_path();
        let options = PlyOptions { screen_filter: renderer.settings().filter, ..PlyOptions::default() };
        let cloud = renderer.cloud()?;
        write_file(&path, |out| ply::write_to(out, &cloud, &options))?;
        write_offset(&path, self.offset)?;
        Ok(format!("saved as {}: {} Gaussians", shown(&path), thousands(cloud.len())))
    }

    /// The first name that nothing has.
    fn free_path(&self) -> PathBuf {
        let named = |number: u32| {
            let mut name = self.stem.clone();
            name.push(if number == 1 { ".ply".to_owned() } else { format!("-{number}.ply") });
            self.folder.join(name)
        };
        let is_free = |path: &PathBuf| path.symlink_metadata().is_err();
        (1..u32::MAX).map(named).find(is_free).unwrap_or_else(|| named(u32::MAX))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use genesplat_core::{Device, Gaussians, RenderSettings};
    use genesplat_io::offset;
    use genesplat_kernels::cpu::CpuBackend;

    use super::*;

    #[test]
    fn each_edit_is_a_new_file_beside_what_was_opened() {
        let place = tempfile::tempdir().unwrap();
        let splat = place.path().join("my splat.ply");
        fs::write(&splat, "x").unwrap();
        let mut device = CpuBackend::new();
        device.upload(Gaussians::zeros(3).into()).unwrap();
        let mut renderer = CloudRenderer::new(&mut device, RenderSettings::default());
        let by = [500_000.0, 0.0, 0.0];
        for name in ["my splat-edited.ply", "my splat-edited-2.ply"] {
            let said = EditedFile::beside(&splat, Some(by)).save(&mut renderer).unwrap();
            assert!(said.contains(name) && said.contains("3 Gaussians"), "{said}");
            assert_eq!(crate::splat::open(&place.path().join(name)).unwrap().cloud.len(), 3);
            assert_eq!(offset::read_beside(&place.path().join(name)), Ok(Some(by)));
        }
        EditedFile::beside(place.path(), None).save(&mut renderer).unwrap();
        assert!(place.path().join("edited.ply").exists());
        assert_eq!(fs::read_to_string(&splat).unwrap(), "x");
        let in_a_file = EditedFile::beside(&splat.join("a.ply"), None);
        let said = in_a_file.save(&mut renderer).unwrap_err().to_string();
        assert!(said.starts_with("cannot write"), "{said}");
    }
}
