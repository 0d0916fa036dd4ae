//! Cameras whose intrinsics may not be those of their photos.

use crate::listing::{ListedPhoto, Listing};
use crate::{plural, shown};

/// No pinhole shows more than this, degrees.
const WIDEST: f64 = 170.0;

/// What the user should know of such cameras.
pub(super) fn notices(listing: &Listing) -> Vec<String> {
    let off = told(listing, is_off_centre, |count, first, list| {
        let have = plural(count, "photo has its principal point", "photos have their principal points");
        let them = plural(count, "it", "them");
        format!(
            "{count} {have} outside of {them}, first {first}: {list} may be of photos of another size, or of cut ones"
        )
    });
    let wide = told(listing, is_too_wide, |count, first, list| {
        let photos = plural(count, "photo is", "photos are");
        format!(
            "{count} {photos} more than {WIDEST} degrees across, first {first}: the focal lengths of {list} may not be in pixels"
        )
    });
    [off, wide].into_iter().flatten().collect()
}

/// Of how many photos something is true, the first of them, and its list.
fn told(
    listing: &Listing,
    is: fn(&ListedPhoto) -> bool,
    sentence: impl FnOnce(usize, &str, &str) -> String,
) -> Option<String> {
    let first = listing.photos.iter().find(|photo| is(photo))?;
    let count = listing.photos.iter().filter(|photo| is(photo)).count();
    Some(sentence(count, &shown(&first.name).to_string(), &shown(&*first.list).to_string()))
}

fn is_off_centre(photo: &ListedPhoto) -> bool {
    let (camera, [x, y]) = (&photo.camera, photo.camera.principal_px);
    !(0.0..=f64::from(camera.width)).contains(&x) || !(0.0..=f64::from(camera.height)).contains(&y)
}

fn is_too_wide(photo: &ListedPhoto) -> bool {
    let half = 0.5 * f64::from(photo.camera.width) / photo.camera.focal_px[0];
    photo.lens.is_none() && half > (0.5 * WIDEST).to_radians().tan()
}
