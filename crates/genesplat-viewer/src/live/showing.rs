//! A cloud that nothing trains: pictures of it, files of it, and edits of it.

use genesplat_core::memory::ensure_memory;
use genesplat_core::{BackendError, CloudRenderer, Device, Gaussians, RenderSettings};

use super::{LiveView, Phase, SNAPSHOT_EVERY, WAIT, snapshot_wait};
use crate::downloads::Download;
use crate::edit::{Edit, Edits};

/// Makes files of what a page shows.
pub trait Keeper {
    /// A file to download, of what the renderer holds; a sentence where it cannot be made.
    fn make(&mut self, download: Download, renderer: &mut CloudRenderer<'_>) -> Result<Vec<u8>, String>;
    /// Saves what pages have edited as a file that was not there; says in a sentence what has become of it.
    fn save(&mut self, renderer: &mut CloudRenderer<'_>) -> Result<String, String>;
}

/// What is held besides the page while a cloud is shown.
struct Shown<'a> {
    device: &'a mut dyn Device,
    settings: RenderSettings,
    /// Since the first edit.
    edits: Option<Edits>,
    /// Something was edited, and neither saved nor downloaded since.
    is_unsaved: bool,
}

impl Shown<'_> {
    fn renderer(&mut self) -> CloudRenderer<'_> {
        CloudRenderer::new(self.device, self.settings)
    }

    /// The cloud as it was before the first edit is kept, so that all can be undone.
    fn edits(&mut self) -> Result<&mut Edits, BackendError> {
        if self.edits.is_none() {
            let cloud = self.device.download()?;
            ensure_memory(2 * cloud.len() * Gaussians::BYTES_PER_ROW, "a copy to edit")?;
            self.edits = Some(Edits::of(cloud.into_owned()));
        }
        Ok(self.edits.as_mut().expect("it was made above"))
    }

    /// The device gets what the edits leave.
    fn upload(&mut self) -> Result<(), BackendError> {
        let Some(edits) = &self.edits else { return Ok(()) };
        self.device.upload(edits.cloud().into())
    }
}

impl LiveView {
    /// Shows a cloud that nothing trains, makes files of it, and edits it as pages want, until `is_over`,
    /// which hears whether anybody looks. Whether edits are lost that were neither saved nor downloaded.
    ///
    /// The cloud of a run under way cannot be edited: the next one would take its place.
    pub fn serve_until(
        &mut self,
        device: &mut dyn Device,
        settings: RenderSettings,
        keeper: &mut dyn Keeper,
        mut is_over: impl FnMut(bool) -> bool,
    ) -> bool {
        let mut shown = Shown { device, settings, edits: None, is_unsaved: false };
        self.hub().cloud_has_changed();
        self.open(self.state.gaussians > 0);
        while !is_over(self.is_watched()) {
            if let Some(edit) = self.hub().next_edit() {
                self.edit(edit, &mut shown, keeper);
            } else if let Some(download) = self.server.shared.downloads.wanted() {
                self.make(download, &mut shown, keeper);
            } else if !self.serve(&mut shown.renderer(), true) {
                self.hub().wait(WAIT);
            }
        }
        self.open(false);
        shown.is_unsaved
    }

    /// A page is open, or was a moment ago, or a file is on its way.
    fn is_watched(&self) -> bool {
        !self.hub().is_deserted() || self.server.shared.downloads.is_busy()
    }

    fn open(&mut self, is_open: bool) {
        self.server.shared.downloads.set_open(is_open);
        self.state.can_download = is_open;
        self.state.can_edit = is_open && self.state.phase == Phase::Viewing;
        self.hub().take_edits(self.state.can_edit);
        self.post(true);
    }

    fn make(&self, download: Download, shown: &mut Shown<'_>, keeper: &mut dyn Keeper) {
        let made = keeper.make(download, &mut shown.renderer());
        match &made {
            Err(sentence) => self.notice(sentence),
            Ok(_) if download == Download::Splat => shown.is_unsaved = false,
            Ok(_) => {}
        }
        self.server.shared.downloads.answer(download, made.ok());
    }

    fn edit(&mut self, edit: Edit, shown: &mut Shown<'_>, keeper: &mut dyn Keeper) {
        let told = match edit {
            Edit::Undo => self.undo(shown),
            Edit::Save => self.save(shown, keeper),
            edit => self.remove(&edit, shown),
        };
        match told {
            Ok(sentence) => self.notice(&sentence),
            Err(error) => self.notice(&format!("nothing was changed: {error}")),
        }
    }

    fn remove(&mut self, edit: &Edit, shown: &mut Shown<'_>) -> Result<String, BackendError> {
        let rows = self.rows(edit, shown)?;
        let count = shown.device.gaussian_count();
        match rows.len() {
            0 => return Ok("no Gaussian is there, so nothing was removed".into()),
            all if all == count => return Ok("that would remove everything, so nothing was removed".into()),
            _ => {}
        }
        shown.edits()?.remove(&rows);
        if let Err(error) = shown.upload() {
            shown.edits()?.undo();
            return Err(error);
        }
        self.edited(shown);
        Ok(format!("{} of {count} Gaussians removed; Undo gives them back", rows.len()))
    }

    /// Those that go.
    fn rows(&self, edit: &Edit, shown: &mut Shown<'_>) -> Result<Vec<u32>, BackendError> {
        let cloud = shown.device.download()?;
        Ok(match edit {
            Edit::Crop(crop) => crop.rows(&cloud),
            Edit::Erase(stroke) => {
                let camera = self.camera(&stroke.pose, stroke.camera, [stroke.width, stroke.height]);
                stroke.rows(&cloud, &camera)
            }
            Edit::Undo | Edit::Save => Vec::new(),
        })
    }

    fn undo(&mut self, shown: &mut Shown<'_>) -> Result<String, BackendError> {
        let Some(back) = shown.edits()?.undo() else { return Ok("there is nothing to undo".into()) };
        let sentence = format!("{} Gaussians are back", back.len());
        if let Err(error) = shown.upload() {
            shown.edits()?.redo(back);
            return Err(error);
        }
        self.edited(shown);
        Ok(sentence)
    }

    /// What is shown is another cloud now.
    fn edited(&mut self, shown: &mut Shown<'_>) {
        let [edits, removed] = shown.edits.as_ref().map_or([0; 2], |edits| [edits.count(), edits.gone()]);
        (self.state.edits, self.state.removed) = (edits, removed);
        self.state.gaussians = shown.device.gaussian_count();
        shown.is_unsaved = edits > 0;
        self.hub().cloud_has_changed();
        // What was made before is of an older cloud.
        self.server.shared.downloads.set_open(true);
        self.post(true);
    }

    /// A page could ask for one after each edit, and fill the disk.
    fn save(&mut self, shown: &mut Shown<'_>, keeper: &mut dyn Keeper) -> Result<String, BackendError> {
        if self.state.edits == 0 {
            return Ok("nothing was edited, so there is nothing to save".into());
        }
        let wait = snapshot_wait(self.saved, self.clock.seconds());
        if wait > 0 {
            return Ok(format!(
                "not saved yet: one file in {SNAPSHOT_EVERY} seconds at most; try again in {wait}"
            ));
        }
        let saved = keeper.save(&mut shown.renderer());
        self.saved = Some(self.clock.seconds());
        shown.is_unsaved &= saved.is_err();
        self.post(true);
        Ok(saved.unwrap_or_else(|sentence| sentence))
    }
}
