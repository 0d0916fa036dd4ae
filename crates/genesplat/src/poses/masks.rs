//! Masks beside the photos: they go into the scene, and no features are looked for where they hide.

use std::path::{Path, PathBuf};

use anyhow::Result;
use genesplat::io::mask_of;
use genesplat::io::photos::photo_size;
use genesplat::run::output;

/// Beside the photos, and in the scene.
pub(super) const FOLDER: &str = "masks";

/// The mask of each photo that has one in these folders, by the photo's name.
pub(super) fn of_photos(photos: &[String], folders: &[PathBuf]) -> Vec<(String, PathBuf)> {
    let mask = |name: &String| folders.iter().find_map(|folder| mask_of(folder, name));
    photos.iter().filter_map(|name| Some((name.clone(), mask(name)?))).collect()
}

/// As COLMAP calls the mask of a photo.
pub(super) fn place(masks: &Path, photo: &str) -> PathBuf {
    masks.join(format!("{photo}.png"))
}

/// The folder of masks of a scene, where COLMAP can use them: it looks pixels up without regard to sizes.
pub(super) fn usable(scene: &Path, images: &Path, names: &[String]) -> Result<Option<PathBuf>> {
    let folder = scene.join(FOLDER);
    let masked: Vec<&String> = names.iter().filter(|name| place(&folder, name).is_file()).collect();
    if masked.is_empty() {
        return Ok(None);
    }
    let (count, photos) = (masked.len(), names.len());
    for name in masked {
        if photo_size(&place(&folder, name))? != photo_size(&images.join(name))? {
            output::tell(&format!(
                "notice: {count} of {photos} photos have a mask; that of {name} has another size than it, so cameras are found without masks"
            ));
            return Ok(None);
        }
    }
    output::tell(&format!("{count} of {photos} photos have a mask; cameras are found without what it hides"));
    Ok(Some(folder))
}
