//! What no command writes over, however its `--out` or `--json` was mistyped: inputs, splats, parts of scenes
//! and of runs. A picture may be rendered again, and a splat refined again.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use genesplat_io::{Format, PHOTO_ENDINGS, Scene, ending, is_transforms, offset, shown};

use crate::files::check_writable;
use crate::session::is_part_of_run;

/// What is about to be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Figures, or a page.
    Figures,
    /// A splat.
    Splat,
    /// A picture.
    Picture,
}

/// Fails now, rather than after an hour, where the file `path` cannot be written from `inputs`, or must not
/// be.
pub fn check_file(path: &Path, content: Content, inputs: &[Option<&Path>]) -> Result<()> {
    check_writable(path)?;
    check_offset_beside(path)?;
    check_existing(path, content, inputs)
}

/// What is read as the offset of the file must be one, whoever has written it.
fn check_offset_beside(path: &Path) -> Result<()> {
    offset::read_beside(path).map(drop).map_err(|error| {
        anyhow!(
            "{} is there already and holds no offset ({error}), and would be read as that of {}; move it away, or give the \
             name of another file",
            shown(offset::file_beside(path)),
            shown(path)
        )
    })
}

/// The same of a file that is known to be writable.
pub fn check_existing(path: &Path, content: Content, inputs: &[Option<&Path>]) -> Result<()> {
    let Ok(there) = path.canonicalize() else { return Ok(()) };
    let is_input =
        inputs.iter().flatten().any(|input| input.canonicalize().is_ok_and(|input| input == there));
    let what = if is_input { Some("an input of this command") } else { protected(&there, content) };
    what.map_or(Ok(()), |what| {
        bail!("{} is {what}, and would be overwritten; give the name of another file", shown(path))
    })
}

/// What a file is that is not replaced by this content, if it is one.
fn protected(path: &Path, content: Content) -> Option<&'static str> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    let end = ending(path);
    let is_picture = PHOTO_ENDINGS.contains(&end.as_str());
    match (stem.as_str(), end.as_str()) {
        _ if is_part_of_run(path) => Some("part of a run"),
        _ if is_picture && content != Content::Picture => Some("a picture"),
        _ if is_picture && is_photo_of_scene(path) => Some("one of the photos of the scene around it"),
        ("cameras" | "images" | "points3d", "bin" | "txt" | "ply") => Some("part of a scene"),
        (stem, end) if is_transforms(&format!("{stem}.{end}")) => Some("part of a scene"),
        _ if content != Content::Splat && Format::of(path).is_some() => Some("a splat"),
        _ => None,
    }
}

/// Beside the description of a scene, or in a folder with one of the usual names.
fn is_photo_of_scene(picture: &Path) -> bool {
    let Some(folder) = picture.parent() else { return false };
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let is_usual = name.starts_with("images") || ["train", "test", "val", "input"].contains(&&*name);
    is_scene(folder) || (is_usual && folder.parent().is_some_and(is_scene))
}

fn is_scene(folder: &Path) -> bool {
    let is_description = |name: &str| name == "sparse" || is_transforms(name);
    let mut entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.any(|entry| is_description(&entry.file_name().to_string_lossy()))
}

/// Fails where results would go into the scene's own folder, among names that both may have (`test/`, for
/// one), or among its photos, masks or models.
pub fn check_apart(data: &Path, out: &Path) -> Result<()> {
    let (Ok(data), Some(out_whole)) = (data.canonicalize(), whole(out)) else { return Ok(()) };
    let Ok(inside) = out_whole.strip_prefix(&data) else { return Ok(()) };
    let first = inside.components().next().map(|part| part.as_os_str().to_string_lossy().into_owned());
    match first {
        None => bail!("{} is the folder of the scene; choose another folder for the results", shown(out)),
        Some(first) if ["images", "masks", "sparse"].contains(&first.split('_').next().unwrap_or("")) => {
            bail!("{} lies in {first}/ of the scene; choose another folder for the results", shown(out))
        }
        Some(_) => Ok(()),
    }
}

/// The whole path without links, of what may not exist yet.
fn whole(path: &Path) -> Option<PathBuf> {
    let path = std::path::absolute(path).ok()?;
    let (there, ancestor) =
        path.ancestors().find_map(|ancestor| Some((ancestor.canonicalize().ok()?, ancestor)))?;
    Some(there.join(path.strip_prefix(ancestor).ok()?))
}

/// Fails where `out` is a photo of `scene`, or a folder that holds some: pictures that we write may have
/// their names.
pub fn check_photos(scene: &Scene, out: &Path) -> Result<()> {
    let Ok(taken) = out.canonicalize() else { return Ok(()) };
    let is_hit = |photo: &Path| photo == taken || photo.parent() == Some(&taken);
    if scene.photos.iter().filter_map(|photo| photo.canonicalize().ok()).any(|photo| is_hit(&photo)) {
        bail!("results in {} would overwrite photos of the scene; choose another --out", shown(out));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CONFIG;
    use crate::session::{Caller, RunSession};

    #[test]
    fn what_is_protected_is_not_written_over() {
        let place = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = place.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            if !path.exists() {
                fs::write(&path, "x").unwrap();
            }
            path
        };
        let run = place.path().join("run");
        RunSession::claim(&run, Caller::Train, false).unwrap().begin("").unwrap();
        let input = file("a.ply");
        // Why figures, a splat and a picture do not go there.
        let (any, [run_part, scene_part]) = (|what| [Some(what); 3], ["part of a run", "part of a scene"]);
        let picture = [Some("a picture"), Some("a picture"), None];
        let photo = [picture[0], picture[1], Some("one of the photos of the scene")];
        let splat = [Some("a splat"), None, Some("a splat")];
        let cases = [
            ("a.ply", any("an input")),
            ("b.ply", splat),
            ("b.splat", splat),
            ("b.SPZ", splat),
            ("b.sog", splat),
            ("b.glb", splat),
            ("scene/sparse/0/points3D.bin", any(scene_part)),
            ("scene/sparse/0/points3D.ply", any(scene_part)),
            ("scene/images_4/0001.JPG", photo),
            ("scene/renders/0001.png", picture),
            ("blender/transforms_train.json", any(scene_part)),
            ("blender/test/r_0.png", photo),
            ("blender/r_0.png", photo),
            ("images/0001.jpg", picture),
            ("images/0001.WebP", picture),
            ("run/config.toml", any(run_part)),
            ("run/metrics.json", any(run_part)),
            ("run/point_cloud.ply", any(run_part)),
            ("run/test/0001.png", any(run_part)),
            ("run/checkpoint/latest.checkpoint", any(run_part)),
            ("run/refined.ply", splat),
            ("metrics.json", [None; 3]),
        ];
        cases.iter().for_each(|(name, _)| drop(file(name)));
        for (name, expected) in cases {
            for (content, what) in
                [Content::Figures, Content::Splat, Content::Picture].into_iter().zip(expected)
            {
                let refusal =
                    check_file(&file(name), content, &[Some(&input)]).err().map(|error| error.to_string());
                assert_eq!(refusal.is_some(), what.is_some(), "{name}, {content:?}: {refusal:?}");
                assert!(refusal.is_none_or(|sentence| sentence.contains(what.unwrap())), "{name}");
            }
        }
        assert!(run.join(CONFIG).exists());
        let absent = place.path().join("scene/images/0002.jpg");
        assert!(check_file(&absent, Content::Picture, &[]).is_ok(), "nothing is there");
    }

    /// Whoever reads the splat would read the file beside it.
    #[test]
    fn a_file_that_would_be_taken_for_an_offset_stops_a_command_before_its_work() {
        let place = tempfile::tempdir().unwrap();
        let splat = place.path().join("new.ply");
        let beside = offset::file_beside(&splat);
        for (content, is_offset) in [("mine", false), (offset::to_json([5e5, 0.0, 0.0]).as_str(), true)] {
            fs::write(&beside, content).unwrap();
            let checked = check_file(&splat, Content::Splat, &[]).map_err(|error| error.to_string());
            assert_eq!(checked.is_ok(), is_offset, "{checked:?}");
            assert!(checked.is_ok() || checked.unwrap_err().contains("new.ply.offset.json is there already"));
            assert_eq!(fs::read_to_string(&beside).unwrap(), content);
        }
        assert!(!splat.exists());
    }
}
