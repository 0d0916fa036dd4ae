//! Masks of the photos of a scene, in `masks` or `mask` beside them, or among them: `NAME.jpg.png` as COLMAP
//! names them, `NAME.jpg` or `NAME.png` as nerfstudio does, `NAME.jpg.mask.png` as RealityScan,
//! `NAME_mask.png` as Metashape; in any case, and with any ending of a picture.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::Doubt;
use crate::alike::difference;
use crate::listing::{Listing, base_name};
use crate::similar::{self, PHOTO_ENDINGS, entries, has_ending};
use crate::{names, shown};

/// What masks and transparency mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaskUse {
    /// What masks hide is ignored; what is transparent shows the background.
    #[default]
    Usual,
    /// What masks hide and what is not opaque counts for nothing: neither in training nor in scores.
    Ignore,
    /// What masks hide and what is transparent shows the background, which the splat must reproduce.
    Transparent,
    /// Masks are not looked for; what is transparent shows the background.
    Off,
}

/// Photos that have something to hide.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Found {
    pub(super) photos: usize,
    /// Those with a mask.
    pub(super) masked: usize,
    /// Those that are transparent in parts.
    pub(super) transparent: usize,
}

impl MaskUse {
    /// What was found, and what is made of it.
    pub(super) fn notices(self, found: Found) -> Vec<String> {
        let Found { photos, masked, transparent } = found;
        let mut notices = Vec::new();
        let asked = match self {
            Self::Ignore => Some("ignore"),
            Self::Transparent => Some("transparent"),
            Self::Usual | Self::Off => None,
        };
        if let (0, Some(asked)) = (masked + transparent, asked) {
            notices.push(format!(
                "no photo has a mask or is transparent, so --mask {asked} changes nothing: masks are looked for in `masks`, \
                 under the names of the photos"
            ));
        }
        if masked > 0 {
            notices.push(match self {
                Self::Usual | Self::Ignore | Self::Off => {
                    format!("{masked} of {photos} photos have a mask: what it hides counts for nothing (--mask ignore)")
                }
                Self::Transparent => {
                    format!(
                        "{masked} of {photos} photos have a mask: what it hides must be background (--mask transparent)"
                    )
                }
            });
        }
        if transparent > 0 {
            notices.push(match self {
                Self::Ignore => format!(
                    "{transparent} of {photos} photos are transparent in parts: what is not opaque counts for nothing \
                     (--mask ignore)"
                ),
                Self::Usual | Self::Transparent | Self::Off => format!(
                    "{transparent} of {photos} photos are transparent in parts, which must be background (--mask transparent)"
                ),
            });
        }
        notices
    }
}

/// Gives each photo without a mask the one that lies in a folder of masks in `scene`, if any does; with
/// [`MaskUse::Off`], no photo has any.
pub(super) fn find(listing: &mut Listing, scene: &Path, mask_use: MaskUse) {
    if mask_use == MaskUse::Off {
        return listing.photos.iter_mut().for_each(|photo| photo.mask = None);
    }
    for photo in &mut listing.photos {
        photo.mask = photo.mask.take().or_else(|| mask_beside(&photo.path));
    }
    let folders = ["masks", "mask"].map(|name| similar::folder(&scene.join(name)));
    let Some(folder) = folders.into_iter().find(|folder| folder.is_dir()) else { return };
    let mut masks = Masks::new(folder);
    for photo in &mut listing.photos {
        photo.mask = photo.mask.take().or_else(|| masks.of(&photo.name));
    }
    let Some(first) = listing.photos.first().filter(|_| listing.photos.iter().all(|p| p.mask.is_none()))
    else {
        return;
    };
    let doubt = masks
        .misfit(&first.name)
        .map(|problem| Doubt { problem, remedy: "rename them, or go on without masks by --mask off".into() });
    listing.doubts.extend(doubt);
}

/// The mask of `photo` that lies beside it, as RealityScan has it: under a name that no photo has.
pub fn mask_beside(photo: &Path) -> Option<PathBuf> {
    let name = photo.file_name()?.to_str()?;
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let names = [format!("{name}.mask.png"), format!("{stem}.mask.png"), format!("{stem}_mask.png")];
    names.into_iter().map(|name| photo.with_file_name(name)).find(|mask| mask.is_file())
}

/// A folder of masks.
pub struct Masks {
    folder: PathBuf,
    /// The pictures of each folder that was looked at, by [`key`].
    folders: HashMap<PathBuf, HashMap<String, Vec<PathBuf>>>,
}

impl Masks {
    /// Those in `folder`, of which nothing is read yet.
    pub fn new(folder: PathBuf) -> Self {
        Self { folder, folders: HashMap::new() }
    }

    /// The mask of a photo. `photo` is its name as its scene lists it: below the folder of photos, or with
    /// that folder before it.
    pub fn of(&mut self, photo: &str) -> Option<PathBuf> {
        let name = &*names::below(photo).ok()?;
        let below = name.split_once('/').map(|(_, below)| below);
        let names = [Some(name), below, Some(base_name(name))];
        let exact = names.into_iter().flatten().flat_map(usual_names).map(|name| self.folder.join(name));
        exact.into_iter().find(|path| path.is_file()).or_else(|| {
            let places = names.into_iter().flatten().map(|name| self.folder.join(name));
            places.collect::<Vec<_>>().iter().find_map(|place| self.almost(place))
        })
    }

    /// The only picture in the folder of `place` that is called so but for case, endings and the word mask.
    fn almost(&mut self, place: &Path) -> Option<PathBuf> {
        let folder = place.parent()?;
        let of_folder = self.folders.entry(folder.to_owned()).or_insert_with(|| by_key(folder));
        let [found] = of_folder.get(&similar::key(place))?.as_slice() else { return None };
        Some(found.clone())
    }

    /// What is wrong where no photo has a mask, `photo` among them; `None` where there is none at all.
    pub fn misfit(&self, photo: &str) -> Option<String> {
        let folders = || entries(&self.folder).filter(|entry| entry.is_dir());
        let all =
            entries(&self.folder).chain(folders().flat_map(|folder| entries(&folder).collect::<Vec<_>>()));
        let found = all.filter(|entry| has_ending(entry, &PHOTO_ENDINGS)).min()?;
        let (name, wanted) = (shown(base_name(photo)), format!("{}.png", base_name(photo)));
        let found = found.file_name().unwrap_or_default().to_string_lossy();
        let (folder, differs) = (shown(&self.folder), difference(&wanted, &found));
        Some(format!(
            "{folder} has no mask of any photo: that of {name} would be called {}, and it has names like {}{differs}",
            shown(&wanted),
            shown(&*found)
        ))
    }
}

/// What programs call the mask of the photo `name`.
fn usual_names(name: &str) -> [String; 6] {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    [
        format!("{name}.png"),
        name.to_owned(),
        format!("{stem}.png"),
        format!("{name}.mask.png"),
        format!("{stem}.mask.png"),
        format!("{stem}_mask.png"),
    ]
}

fn by_key(folder: &Path) -> HashMap<String, Vec<PathBuf>> {
    let mut masks: HashMap<String, Vec<PathBuf>> = HashMap::new();
    for mask in entries(folder).filter(|entry| has_ending(entry, &PHOTO_ENDINGS)) {
        masks.entry(key(&mask)).or_default().push(mask);
    }
    masks
}

/// The name of the photo that `mask` hides parts of, as [`similar::key`] has it.
fn key(mask: &Path) -> String {
    const WORDS: [&str; 6] = [".mask", "_mask", "-mask", " mask", ".masks", "_masks"];
    let name = similar::key(mask);
    let photo = WORDS.iter().find_map(|word| name.strip_suffix(word)).unwrap_or(&name);
    similar::key(Path::new(photo))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_mask_is_in_its_folder_whatever_its_photo_is_called() {
        let place = tempfile::tempdir().unwrap();
        let [masks, outside] = ["masks", "outside"].map(|name| place.path().join(name));
        for folder in [&masks, &outside] {
            fs::create_dir(folder).unwrap();
            fs::write(folder.join("1.png"), "a mask").unwrap();
        }
        let outside = outside.to_string_lossy();
        for name in [format!("a/{outside}/2.png"), format!("{outside}/1.png"), "a/../../outside/1.png".into()]
        {
            assert_eq!(Masks::new(masks.clone()).of(&name), None, "{name}");
        }
        fs::write(place.path().join("outside/2.png"), "another").unwrap();
        assert_eq!(Masks::new(masks.clone()).of(&format!("a/{outside}/2.png")), None);
        assert_eq!(
            Masks::new(masks.clone()).of(&format!("a/{outside}/1.png")),
            Some(masks.join("1.png")),
            "by its last part"
        );
        assert_eq!(Masks::new(masks.clone()).of(".//images//1.jpg"), Some(masks.join("1.png")));
    }
}
