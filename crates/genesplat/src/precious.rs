//! Files that `--out FILE` and `--json` do not write over, however they were mistyped: inputs, pictures, parts of scenes and of runs.

use std::ffi::OsStr;
use std::path::Path;

use anyhow::{Result, bail};

use crate::files::check_writable;
use crate::run_folder::RunFolder;

/// Fails now, rather than after an hour, where the file `path` cannot be written from `inputs`, or would cost what cannot be made again.
pub fn check_output(path: &Path, inputs: &[&Path]) -> Result<()> {
    check_writable(path)?;
    let Ok(there) = path.canonicalize() else { return Ok(()) };
    let is_input = inputs.iter().any(|input| input.canonicalize().is_ok_and(|input| input == there));
    let what = if is_input { Some("an input of this command") } else { precious(&there) };
    what.map_or(Ok(()), |what| {
        bail!("{} is {what}, and would be overwritten; give the name of another file", path.display())
    })
}

/// What a file is that no command writes on its own, if it is one.
fn precious(path: &Path) -> Option<&'static str> {
    let part = |part: Option<&OsStr>| part.unwrap_or_default().to_string_lossy().to_lowercase();
    let (stem, end) = (part(path.file_stem()), part(path.extension()));
    match (stem.as_str(), end.as_str()) {
        (_, "png" | "jpg" | "jpeg") => Some("a picture"),
        ("cameras" | "images" | "points3d", "bin" | "txt") => Some("part of a scene"),
        (stem, "json") if stem.starts_with("transforms") => Some("part of a scene"),
        _ => RunFolder::is_part(path).then_some("part of a run"),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn what_is_precious_is_not_written_over() {
        let place = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = place.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, "x").unwrap();
            path
        };
        let run = place.path().join("run");
        drop(RunFolder::create(&run, "").unwrap());
        let cases = [
            ("a.ply", Some("an input")),
            ("images/0001.JPG", Some("a picture")),
            ("sparse/0/points3D.bin", Some("part of a scene")),
            ("transforms_train.json", Some("part of a scene")),
            ("run/metrics.json", Some("part of a run")),
            ("run/point_cloud.ply", Some("part of a run")),
            ("run/refined.ply", None),
            ("metrics.json", None),
        ];
        let input = file("a.ply");
        for (name, what) in cases {
            let refusal = check_output(&file(name), &[&input]).err().map(|error| error.to_string());
            assert_eq!(refusal.is_some(), what.is_some(), "{name}");
            assert!(refusal.is_none_or(|sentence| sentence.contains(what.unwrap())), "{name}");
        }
        let config = check_output(&RunFolder::config_in(&run), &[]);
        assert!(config.unwrap_err().to_string().contains("part of a run"));
        assert!(check_output(&place.path().join("images/0002.jpg"), &[]).is_ok(), "nothing is there");
    }
}
