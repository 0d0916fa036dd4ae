//! What people give where a splat or a run is wanted: said as what it is, with what to do.

use std::path::Path;

use anyhow::{Result, bail};
use genesplat_io::colmap::find_model;
use genesplat_io::{
    Format, PHOTO_ENDINGS, UNREAD, VIDEO_ENDINGS, command_line, ending, is_part_of_scene, is_transforms,
    shown,
};

use crate::session::{is_part_of_run, is_run};

const PAGES: [&str; 2] = ["html", "htm"];
const MESHES: [&str; 8] = ["obj", "stl", "fbx", "dae", "usdz", "usd", "3ds", "gltf"];

/// Fails where `path` is known to be neither a splat nor a run.
pub(super) fn check(path: &Path) -> Result<()> {
    if path.is_dir() {
        return check_folder(path);
    }
    // What cannot be opened is told of by who reads it.
    if Format::of_file(path).is_ok_and(|format| format.is_none()) { check_file(path) } else { Ok(()) }
}

/// Neither its first bytes nor its name say that it is a splat.
fn check_file(path: &Path) -> Result<()> {
    let end = ending(path);
    let is = |endings: &[&str]| endings.contains(&&*end);
    let what = match () {
        () if is_part_of_run(path) => "is a part of a run and no splat; give the folder of the run",
        () if is(&PHOTO_ENDINGS) || is(&UNREAD) => "is a photo; give a splat, or the folder of a run",
        () if is(&VIDEO_ENDINGS) => "is a video; give a splat, or the folder of a run",
        () if is(&PAGES) => {
            "is a page, which a browser opens; give the splat that it was made of, or the run"
        }
        () if is_part_of_scene(path) => "is a part of a scene; give a splat, or the folder of a run",
        () if is(&MESHES) => "is a mesh, which has no Gaussians; give a splat, or the folder of a run",
        () => {
            let endings = Format::ALL.map(Format::ending).join(", ");
            bail!("{} is no splat ({endings}) and no folder of a run; give one of these", shown(path));
        }
    };
    bail!("{} {what}", shown(path))
}

/// The folder of a scene is no run yet.
fn check_folder(path: &Path) -> Result<()> {
    let entries = path.read_dir().into_iter().flatten().flatten();
    let mut names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    if is_run(path) || !(find_model(path).is_some() || names.any(|name| is_transforms(&name))) {
        return Ok(());
    }
    let train = command_line(["genesplat", "train", &shown(path), "--out", "RUN"]);
    bail!("{} is a scene, of which there is no splat yet; make one with `{train}`, and give RUN", shown(path))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use crate::splat::open;

    #[test]
    fn what_is_no_splat_is_told_as_what_it_is() {
        let place = tempfile::tempdir().unwrap();
        let told = |name: &str, content: &str| {
            let file = place.path().join(name);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(&file, content).unwrap();
            open(&file).err().unwrap().to_string()
        };
        for (name, what) in [
            ("a.JPG", "a.JPG is a photo;"),
            ("a.heic", "is a photo;"),
            ("a.mp4", "is a video;"),
            ("scene.html", "is a page,"),
            ("mesh.obj", "is a mesh,"),
            ("thesis.pdf", "thesis.pdf is no splat (.ply, "),
            ("noending", "noending is no splat (.ply, "),
        ] {
            let sentence = told(name, "plain text");
            assert!(sentence.contains(what), "{sentence}");
        }
        // It is a PLY by its content, and by its name.
        for (name, content) in [("noending", "ply\n"), ("a.ply", "plain text")] {
            assert!(told(name, content).contains("PLY"), "{name}");
        }
        told("scene/transforms.json", "{}");
        let sentence = open(&place.path().join("scene")).err().unwrap().to_string();
        assert!(sentence.contains("is a scene") && sentence.contains("genesplat train"), "{sentence}");
    }
}
