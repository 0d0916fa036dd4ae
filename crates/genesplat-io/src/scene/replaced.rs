//! Photos of a loaded scene, replaced by others of their size.

use genesplat_core::{Photo, PhotoLost, View};
use rayon::prelude::*;

use super::Spill;
use super::view::PhotoStorage;
use crate::error::SceneError;

/// Replaces the photos of `views` by what `change` makes of each, in parallel; where any is in a file, all go
/// into a new one.
pub fn replace_photos(
    views: &mut [View],
    spill: Option<&Spill>,
    change: impl Fn(&View) -> Result<Photo, PhotoLost> + Sync,
) -> Result<(), SceneError> {
    let is_in_file = views.iter().any(|view| view.photo.held_bytes() < 3 * view.photo.pixels());
    let storage = PhotoStorage::in_file(spill.filter(|_| is_in_file))?;
    views.par_iter_mut().try_for_each(|view| {
        view.photo = storage.keep(change(view)?)?;
        Ok(())
    })
}
