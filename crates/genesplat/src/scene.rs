//! Scenes, as the command loads them.

use std::path::Path;

use anyhow::{Result, bail};
use genesplat::core::View;
use genesplat::io::{LoadOptions, PhotoSize, Scene, load_scene};
use genesplat::train::initialise::ColouredPoint;

use crate::output;
use crate::progress::LoadBar;

/// Loads a scene to train on with a progress bar, and passes its notices on.
pub fn load(path: &Path, size: PhotoSize, background: [f32; 3], seed: u64) -> Result<Scene> {
    load_with(path, background, LoadOptions { size, seed, ..LoadOptions::default() })
}

/// The same to look at a finished splat, for which no points are needed, with both sides of the size divided by the second number.
pub fn load_to_look(path: &Path, (size, divisor): (PhotoSize, u32), background: [f32; 3]) -> Result<Scene> {
    load_with(path, background, LoadOptions { size, divisor, with_points: false, ..LoadOptions::default() })
}

fn load_with(path: &Path, background: [f32; 3], options: LoadOptions) -> Result<Scene> {
    let background = background.map(|value| (255.0 * value).round() as u8);
    let scene = load_scene(path, &LoadOptions { background, ..options }, &LoadBar::default())?;
    scene.notices.iter().for_each(|notice| output::tell(&format!("notice: {notice}")));
    Ok(scene)
}

/// Fails where results would go into the scene's own folder, among names that both may have (`test/`, for one).
pub fn check_apart(data: &Path, out: &Path) -> Result<()> {
    match (data.canonicalize(), out.canonicalize()) {
        (Ok(data), Ok(here)) if data == here => {
            bail!("{} is the folder of the scene; choose another folder for the results", out.display())
        }
        _ => Ok(()),
    }
}

/// Fails where `out` is a photo of the scene, or a folder that holds some: pictures that we write may have their names.
pub fn check_spared(scene: &Scene, out: &Path) -> Result<()> {
    let Ok(taken) = out.canonicalize() else { return Ok(()) };
    let is_hit = |photo: &Path| photo == taken || photo.parent() == Some(&taken);
    if scene.photos.iter().filter_map(|photo| photo.canonicalize().ok()).any(|photo| is_hit(&photo)) {
        bail!("results in {} would overwrite photos of the scene; choose another --out", out.display());
    }
    Ok(())
}

/// The points that training starts from.
pub fn points(scene: &Scene) -> Vec<ColouredPoint> {
    scene.points.iter().map(|point| (point.position, point.rgb)).collect()
}

/// File names for pictures of `views`.
pub fn picture_names(views: &[View]) -> Vec<String> {
    names_of_pictures(&views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>())
}

/// The same for photos of these names: `0001.jpg` becomes `0001.png`. Where two photos differ in their ending only, all names keep
/// theirs (`0001.jpg.png`).
pub fn names_of_pictures(photos: &[&str]) -> Vec<String> {
    let mut stems: Vec<&str> = photos.iter().map(|name| stem(name)).collect();
    let short: Vec<String> = stems.iter().map(|stem| format!("{stem}.png")).collect();
    stems.sort_unstable();
    if stems.windows(2).all(|pair| pair[0] != pair[1]) {
        return short;
    }
    photos.iter().map(|name| format!("{name}.png")).collect()
}

/// A photo's name without the ending of a picture format.
pub fn stem(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, end)) if ["png", "jpg", "jpeg"].iter().any(|known| end.eq_ignore_ascii_case(known)) => {
            stem
        }
        _ => name,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat::core::{Camera, Photo};
    use glam::{DQuat, DVec3};

    use super::*;

    fn view(name: &str) -> View {
        let camera = Camera {
            width: 1,
            height: 1,
            focal_px: [1.0; 2],
            principal_px: [0.5; 2],
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::ZERO,
        };
        View { name: name.into(), camera, photo: Arc::new(Photo { width: 1, height: 1, rgb: vec![0; 3] }) }
    }

    #[test]
    fn pictures_are_named_after_photos_and_never_share_a_name() {
        assert_eq!(
            picture_names(&[view("a.JPG"), view("b.c.png"), view("r_0.5")]),
            ["a.png", "b.c.png", "r_0.5.png"]
        );
        assert_eq!(picture_names(&[view("a.jpg"), view("a.png")]), ["a.jpg.png", "a.png.png"]);
    }
}
