//! A splat that another trainer made looks as an independent renderer says that it must.

use genesplat::core::Photo;
use genesplat::io::photos::read_photo;

use crate::support::{real_data, succeed, text};

/// Why `picture` is not `reference`, if it is not: 99.9 % of the values may differ by one step of 255, none
/// by more than two.
fn difference(picture: &Photo, reference: &Photo) -> Result<(), String> {
    if (picture.width, picture.height) != (reference.width, reference.height) {
        return Err(format!("{}x{} pixels", picture.width, picture.height));
    }
    let steps = || picture.rgb.iter().zip(&reference.rgb).map(|(a, b)| a.abs_diff(*b));
    let (worst, beyond_one) = (steps().max().unwrap_or(0), steps().filter(|&step| step > 1).count());
    if worst > 2 || 1000 * beyond_one > picture.rgb.len() {
        return Err(format!("up to {worst} steps, {beyond_one} of {} values beyond one", picture.rgb.len()));
    }
    Ok(())
}

#[test]
fn renders_of_the_peers_splat_match_the_references() {
    let Some(data) = real_data() else { return };
    let (peer, folder) = (data.join("peer"), tempfile::tempdir().unwrap());
    let (splat, scene) = (peer.join("opensplat_fox.ply"), peer.join("scene"));
    succeed(["render", text(&splat), "--data", text(&scene), "--split", "all", "--out", text(folder.path())]);
    let mut compared = 0;
    for entry in std::fs::read_dir(peer.join("reference")).unwrap() {
        let reference = entry.unwrap().path();
        let ours = folder.path().join(reference.file_name().unwrap());
        let difference = difference(&read_photo(&ours).unwrap(), &read_photo(&reference).unwrap());
        assert_eq!(difference, Ok(()), "{}", ours.display());
        compared += 1;
    }
    assert!(compared > 0, "there are references");
}

#[test]
fn a_difference_is_noticed() {
    let grey = Photo { width: 100, height: 100, rgb: vec![100; 30_000] };
    let with = |changed: usize, step: u8| {
        let mut picture = grey.clone();
        picture.rgb[..changed].fill(100 + step);
        picture
    };
    assert_eq!(difference(&grey, &with(30_000, 1)), Ok(()));
    assert_eq!(difference(&grey, &with(30, 2)), Ok(()));
    assert!(difference(&grey, &with(31, 2)).is_err());
    assert!(difference(&grey, &with(1, 3)).is_err());
    assert!(difference(&grey, &Photo { width: 99, ..grey.clone() }).is_err());
}
