//! The photos of one `transforms.json`, as far as they are found and can be used.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::schema::{OptionalIntrinsics, PhotoEntry};
use super::{ENDS, Found, camera, with_end};
use crate::error::SceneError;
use crate::listing::{
    ListedDepth, ListedPhoto, Purpose, Wanted, absent_notice, base_name, inside, lost_poses, path_inside,
    similar_notice, unusable_notice,
};
use crate::photos::PhotoError;
use crate::shown;
use crate::similar::{self, Similar};

/// What is read, and what was found so far.
pub(super) struct Reading<'a> {
    pub(super) list: &'a Path,
    pub(super) folder: &'a Path,
    pub(super) wanted: Wanted<'a>,
    /// [`camera::common_scale`]
    pub(super) scale: f64,
    /// World units of what depth maps hold.
    pub(super) depth_unit: f64,
    shared: Arc<Path>,
    photos: Vec<ListedPhoto>,
    /// Where photos should be that do not exist.
    missing: Vec<PathBuf>,
    /// Those whose size only they could tell.
    damaged: Vec<PhotoError>,
    /// Those with a pose that is not finite.
    lost: Vec<String>,
    similar: Similar,
    similar_masks: Similar,
}

impl<'a> Reading<'a> {
    /// Nothing so far, of the file `list` in `folder`.
    pub(super) fn of(
        list: &'a Path,
        folder: &'a Path,
        wanted: Wanted<'a>,
        scale: f64,
        depth_unit: f64,
    ) -> Self {
        Self {
            list,
            folder,
            wanted,
            scale,
            depth_unit,
            shared: list.into(),
            photos: Vec::new(),
            missing: Vec::new(),
            damaged: Vec::new(),
            lost: Vec::new(),
            similar: Similar::default(),
            similar_masks: Similar::default(),
        }
    }

    pub(super) fn add(
        &mut self,
        entry: &PhotoEntry,
        intrinsics: &OptionalIntrinsics,
        purpose: Purpose,
    ) -> Result<(), SceneError> {
        let relative = inside(&entry.file_path, self.list)?;
        if !camera::is_known(entry) {
            self.lost.push(entry.file_path.clone());
            return Ok(());
        }
        let Some((name, path)) = self.find_photo(&relative, &entry.file_path) else {
            self.missing.push(self.place(&relative));
            return Ok(());
        };
        let (camera, lens) = match camera::camera(self.list, entry, intrinsics, &path, self.scale) {
            Err(SceneError::Photo(error @ PhotoError::Decode { .. })) => {
                self.damaged.push(error);
                return Ok(());
            }
            known => known?,
        };
        let mask = entry.mask_path.as_deref().filter(|name| self.wanted.masks && !name.is_empty());
        let mask = mask.map(|name| self.find_mask(name)).transpose()?;
        let depth = entry.depth_file_path.as_deref().filter(|name| self.wanted.depth && !name.is_empty());
        let depth = depth.map(|name| self.depth(name));
        let list = self.shared.clone();
        let (seen, moment) = (Vec::new(), None);
        self.photos.push(ListedPhoto { name, path, list, camera, lens, purpose, mask, depth, seen, moment });
        Ok(())
    }

    /// The photo as it is named, or with the extension that Blender's script leaves out; or almost so.
    fn find_photo(&mut self, relative: &Path, name: &str) -> Option<(String, PathBuf)> {
        let exact = |place: &PathBuf| {
            let candidates = ENDS.map(|end| (format!("{name}{end}"), with_end(place, end)));
            candidates.into_iter().find(|(_, path)| path.is_file())
        };
        let listed = self.place(relative);
        exact(&listed).or_else(|| {
            let places: Vec<PathBuf> = self.other_place(relative).into_iter().chain([listed]).collect();
            let almost = |place: &PathBuf| self.similar.find(place).map(|path| (name.to_owned(), path));
            places.iter().find_map(exact).or_else(|| places.iter().find_map(almost))
        })
    }

    /// Where a photo is as its list has it; in the folder that is asked for in the place of the list's.
    fn place(&self, relative: &Path) -> PathBuf {
        let Some(images) = self.wanted.images else { return self.folder.join(relative) };
        let mut below = relative.components();
        if below.clone().count() > 1 {
            below.next();
        }
        self.folder.join(images).join(below)
    }

    /// Where else it may be: in a folder whose name differs in case, or among the usual photos where the list has
    /// no folder.
    fn other_place(&self, relative: &Path) -> Option<PathBuf> {
        if self.wanted.images.is_some() {
            return None;
        }
        let parent = relative.parent().filter(|parent| !parent.as_os_str().is_empty());
        let folder = self.folder.join(parent.unwrap_or(Path::new("images")));
        Some(similar::folder(&folder).join(relative.file_name()?))
    }

    /// The mask that a photo's entry names, or almost so.
    fn find_mask(&mut self, name: &str) -> Result<PathBuf, SceneError> {
        let place = path_inside(name).map(|relative| self.folder.join(relative));
        let exact = place.clone().filter(|path| path.is_file());
        exact.or_else(|| self.similar_masks.find(&place?)).ok_or_else(|| {
            let problem =
                "which is no file in the scene's folder; put it there, or go on without masks by --mask off";
            SceneError::invalid(self.list, format!("names the mask {name:?}, {problem}"))
        })
    }

    /// The depth map that a photo's entry names, whether it is there or not. One outside of the scene's folder
    /// is not there.
    fn depth(&self, name: &str) -> ListedDepth {
        let relative =
            path_inside(name).or_else(|| Some(Path::new("depths").join(path_inside(base_name(name))?)));
        let relative = relative.unwrap_or_else(|| "depths".into());
        ListedDepth { path: self.folder.join(relative), unit: self.depth_unit }
    }

    /// What was found, with the cloud of `points` that the file names.
    pub(super) fn finish(mut self, points: Option<String>) -> Result<Found, SceneError> {
        let all = self.photos.len() + self.missing.len() + self.damaged.len() + self.lost.len();
        if self.photos.is_empty() && self.missing.is_empty() && !self.damaged.is_empty() {
            return Err(self.damaged.swap_remove(0).into());
        }
        let lost = lost_poses(&self.lost, all, self.list)?;
        let unused = self.unused(all);
        let notices = [
            self.scaled(),
            similar_notice(self.similar, self.list),
            absent_notice(&self.missing, all, self.list),
            unusable_notice(&self.damaged, all),
            lost,
            unused,
        ];
        let notices = notices.into_iter().flatten().collect();
        let Self { list, photos, missing, .. } = self;
        Ok(Found { list: list.to_owned(), photos, missing, points, notices })
    }

    fn scaled(&self) -> Option<String> {
        (self.scale != 1.0).then(|| {
            let list = shown(self.list);
            format!("all poses of {list} are scaled by {:.4}, which is divided out", self.scale)
        })
    }

    /// A photo may be in no list by mistake.
    fn unused(&self, all: usize) -> Option<String> {
        let unused = self.photos.iter().filter(|photo| photo.purpose == Purpose::Unused).count();
        (unused > 0).then(|| {
            format!(
                "{unused} of the {all} photos that {} lists are neither trained nor tested on, as its train_filenames, \
                 val_filenames and test_filenames have it",
                shown(self.list)
            )
        })
    }
}
