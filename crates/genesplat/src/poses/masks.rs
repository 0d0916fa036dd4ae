//! Masks beside the photos: they go into the scene, and no features are looked for where they hide.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use genesplat::io::Masks;
use genesplat::io::photos::photo_size;
use genesplat::run::output;

/// Beside the photos, and in the scene.
pub(super) const FOLDER: &str = "masks";

/// The mask of each photo that has one in these folders, by the photo's name.
///
/// Fails where there are masks and none of any photo: cameras would be found on what they hide, and a splat
/// would show it.
pub(super) fn of_photos(photos: &[String], folders: &[PathBuf]) -> Result<Vec<(String, PathBuf)>> {
    let mut folders: Vec<Masks> = folders.iter().cloned().map(Masks::new).collect();
    let mut mask = |name: &String| folders.iter_mut().find_map(|folder| folder.of(name));
    let masks: Vec<_> = photos.iter().filter_map(|name| Some((name.clone(), mask(name)?))).collect();
    let first = photos.first().filter(|_| masks.is_empty());
    match first.and_then(|photo| folders.iter().find_map(|folder| folder.misfit(photo))) {
        Some(problem) => bail!("{problem}; rename them, or move that folder away"),
        None => Ok(masks),
    }
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
