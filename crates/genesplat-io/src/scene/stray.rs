//! Cameras that stand so far from all others that the size of the scene is theirs.

use genesplat_core::median;
use glam::DVec3;

use crate::listing::Listing;
use crate::{plural, shown};

/// A camera is told of where it is so many times as far from the middle as half of the cameras are: on fox
/// one camera in fifty costs nothing at 80 times, 0.5 dB at 250 and 17 dB at 8,000.
const FAR: f64 = 50.0;

/// What the user should know of such cameras, if there are any.
pub(super) fn notice(listing: &Listing) -> Option<String> {
    let centres: Vec<DVec3> = listing.photos.iter().map(|photo| photo.camera.centre_in_world()).collect();
    let middle = [0, 1, 2].map(|axis| median(centres.iter().map(|centre| centre[axis])).unwrap_or(0.0));
    let distances: Vec<f64> = centres.iter().map(|centre| centre.distance(middle.into())).collect();
    let usual = median(distances.iter().copied()).filter(|usual| *usual > 0.0)?;
    let is_far = |distance: &f64| *distance > FAR * usual;
    let count = distances.iter().filter(|distance| is_far(distance)).count();
    let (photo, distance) = listing.photos.iter().zip(&distances).max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    (count > 0).then(|| {
        format!(
            "{count} {} far from the others, {} {:.0} times as far from their middle as half of them are: sizes and steps are \
             parts of that distance, so remove the photo if its pose is wrong",
            plural(count, "camera stands", "cameras stand"),
            shown(&photo.name),
            distance / usual
        )
    })
}
