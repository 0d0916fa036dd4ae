//! Which reader a folder is for, and what all listings have in common.

use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use super::split::HoldOut;
use super::{LoadOptions, MaskUse, bare, depths, digests, masks, odd_lenses, place, precision, stray};
use crate::colmap::{self, ModelFolder, PhotoFolder};
use crate::error::SceneError;
use crate::listing::{Frame, Listing, Wanted};
use crate::{offset, shown, transforms};

/// Least number of points that training starts from: initial scales are distances to the three nearest
/// others.
const POINTS_MIN: usize = 4;

/// The photos and points of the scene in the folder `path`.
pub(super) fn list(path: &Path, options: &LoadOptions) -> Result<Listing, SceneError> {
    if !path.exists() {
        return Err(SceneError::Missing(path.to_owned()));
    }
    match list_known(path, options) {
        Err(error @ (SceneError::Unrecognised(_) | SceneError::AllPhotosMissing { .. })) => {
            list_elsewhere(path, options, error)
        }
        known => checked(known?, path, options),
    }
}

/// What `path` is a part of, or holds somewhere; `error` where it is and holds nothing that is known.
fn list_elsewhere(path: &Path, options: &LoadOptions, error: SceneError) -> Result<Listing, SceneError> {
    // What is not to be read looks as if it were not there.
    check_readable([path, &path.join("sparse"), &path.join("sparse/0"), &path.join(&options.image_folder)])?;
    if let Some(scene) = place::of(path).filter(|scene| scene != path) {
        return list_part(path, &scene, options);
    }
    if !matches!(error, SceneError::Unrecognised(_)) {
        return Err(error);
    }
    if let Some(model) = place::model_below(path)? {
        let mut listing = checked(of_model(&model, path, options)?, path, options)?;
        listing
            .notices
            .insert(0, format!("the cameras are those of the COLMAP model in {}", shown(&model.path)));
        return Ok(listing);
    }
    let known = [bare::run, bare::part_of_model, bare::other_cameras, bare::without_cameras, bare::file];
    Err(known.into_iter().find_map(|known| known(path)).unwrap_or(error))
}

/// The scene that `path` is a part of; one of several reconstructions may have been given.
fn list_part(path: &Path, scene: &Path, options: &LoadOptions) -> Result<Listing, SceneError> {
    let mut listing = match colmap::model_in(path) {
        Some(model) => of_model(&model, scene, options)?,
        None => list_known(scene, options)?,
    };
    if colmap::model_in(path).is_some() {
        // Whoever names a model means the photos that it has.
        listing.doubts.clear();
    }
    let mut listing = checked(listing, scene, options)?;
    listing.notices.insert(0, format!("the scene is {}, of which a part was given", shown(scene)));
    Ok(listing)
}

fn of_model(model: &ModelFolder, scene: &Path, options: &LoadOptions) -> Result<Listing, SceneError> {
    let is_usual = options.asked_images().is_none();
    let photos = PhotoFolder { path: scene.join(&options.image_folder), is_usual };
    colmap::list(model, &photos, wanted(scene, options)?)
}

/// What is wanted of the scene in this folder.
fn wanted<'a>(scene: &Path, options: &'a LoadOptions) -> Result<Wanted<'a>, SceneError> {
    let already = offset::of_scene(scene)?;
    let frame = Frame { asked: options.offset, already };
    // COLMAP's own maps are judged by the points that each photo sees.
    let has_dense = options.with_depth && scene.join(depths::DENSE).is_dir();
    let tracks = options.with_points && (options.with_tracks || has_dense);
    let (points, masks, depth) = (options.with_points, options.mask != MaskUse::Off, options.with_depth);
    let (images, splits) = (options.asked_images(), options.hold_out == HoldOut::EveryEighth);
    Ok(Wanted { points, tracks, masks, depth, images, splits, frame })
}

/// Fails where one of these folders is there and must not be read.
fn check_readable(folders: [&Path; 4]) -> Result<(), SceneError> {
    folders.into_iter().try_for_each(|folder| match fs::read_dir(folder) {
        Err(source) if source.kind() == ErrorKind::PermissionDenied => {
            Err(SceneError::Read { file: folder.to_owned(), source })
        }
        _ => Ok(()),
    })
}

/// `listing` with the names of its views, and points to start from: random ones where it has too few.
fn checked(mut listing: Listing, scene: &Path, options: &LoadOptions) -> Result<Listing, SceneError> {
    masks::find(&mut listing, scene, options.mask);
    if options.with_depth {
        depths::find(&mut listing, scene);
    }
    listing.notices.extend(precision::check(&listing)?);
    listing.notices.extend(odd_lenses::notices(&listing));
    listing.set_near(options.near);
    listing.check_not_shared()?;
    listing.name_views()?;
    listing.notices.extend(stray::notice(&listing));
    let has_enough = listing.points.len() >= POINTS_MIN;
    let own = if has_enough { &listing.points[..] } else { &[] };
    listing.points_digest = options.with_points.then(|| digests::of_points(own));
    if options.with_points && !has_enough {
        listing.photos.iter_mut().for_each(|photo| photo.seen.clear());
        listing.draw_points(options.seed);
    }
    Ok(listing)
}

fn list_known(path: &Path, options: &LoadOptions) -> Result<Listing, SceneError> {
    const BLENDER: &str = "transforms_train.json";
    let list = [BLENDER, "transforms.json"].into_iter().find(|name| path.join(name).is_file());
    if let Some(model) = colmap::find_model(path) {
        let mut listing = of_model(&model, path, options)?;
        let notice = |list| format!("cameras are those of {}, and {list} is not read", shown(&model.path));
        listing.notices.extend(list.map(notice));
        return Ok(listing);
    }
    match list {
        Some(BLENDER) => transforms::list_blender(path, wanted(path, options)?),
        Some(_) => transforms::list_nerfstudio(path, wanted(path, options)?),
        None => {
            let nested = colmap::find_nested_model(path);
            of_model(&nested.ok_or_else(|| SceneError::Unrecognised(path.to_owned()))?, path, options)
        }
    }
}
