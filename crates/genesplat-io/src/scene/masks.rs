//! Masks beside the photos of a scene, in `masks` or `mask`: `NAME.jpg.png` as COLMAP names them, `NAME.jpg`
//! or `NAME.png` as nerfstudio does, `NAME.mask.png` as others.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::listing::{Listing, base_name};
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
        if masked > 0 {
            notices.push(match self {
                Self::Usual | Self::Ignore => {
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
                Self::Usual | Self::Transparent => format!(
                    "{transparent} of {photos} photos are transparent in parts, which must be background (--mask transparent)"
                ),
            });
        }
        notices
    }
}

/// Gives each photo without a mask the one that lies in a folder of masks in `scene`, if any does.
pub(super) fn find(listing: &mut Listing, scene: &Path) {
    let folders = ["masks", "mask"].map(|name| scene.join(name));
    let Some(folder) = folders.into_iter().find(|folder| folder.is_dir()) else { return };
    for photo in &mut listing.photos {
        photo.mask = photo.mask.take().or_else(|| mask_of(&folder, &photo.name));
    }
    if listing.photos.iter().all(|photo| photo.mask.is_none()) {
        let example = listing.photos.first().map_or("", |photo| base_name(&photo.name));
        let (folder, name) = (shown(&folder), shown(example));
        listing
            .notices
            .push(format!("{folder} has no mask of any photo: that of {name} would be called {name}.png"));
    }
}

/// The mask of a photo in a folder of masks. `name` is that of the photo as its scene lists it: below the
/// folder of photos, or with that folder before it.
pub fn mask_of(folder: &Path, name: &str) -> Option<PathBuf> {
    let name = &*names::below(name).ok()?;
    let below = name.split_once('/').map(|(_, below)| below);
    let stem = |name: &str| name.rsplit_once('.').map_or(name.to_owned(), |(stem, _)| stem.to_owned());
    let names = [Some(name), below, Some(base_name(name))].into_iter().flatten();
    let candidates = names.flat_map(|name| {
        [
            format!("{name}.png"),
            name.to_owned(),
            format!("{}.png", stem(name)),
            format!("{}.mask.png", stem(name)),
        ]
    });
    candidates.map(|name| folder.join(name)).find(|path| path.is_file())
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
            assert_eq!(mask_of(&masks, &name), None, "{name}");
        }
        fs::write(place.path().join("outside/2.png"), "another").unwrap();
        assert_eq!(mask_of(&masks, &format!("a/{outside}/2.png")), None);
        assert_eq!(
            mask_of(&masks, &format!("a/{outside}/1.png")),
            Some(masks.join("1.png")),
            "by its last part"
        );
        assert_eq!(mask_of(&masks, ".//images//1.jpg"), Some(masks.join("1.png")));
    }
}
