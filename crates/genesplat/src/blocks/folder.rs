//! The folder of the blocks: how the scene was cut, the scenes of the blocks, and their runs.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use genesplat::io::blocks::{Block, Grid};
use genesplat::io::names::is_file_name;
use genesplat::io::{command_line, input, shown};
use genesplat::run::files::write_own_json;
use genesplat::run::scene::PHOTOS_MIN;
use serde::{Deserialize, Serialize};

const BLOCKS: &str = "blocks.json";
pub(super) const SCENES: &str = "scenes";
const RUNS: &str = "runs";
/// The list of held-out photos, in the folder of a block's scene that has some.
pub(super) const TEST_LIST: &str = "test.txt";

/// How a scene was cut.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Cut {
    /// The scene that was cut, for whoever wonders.
    pub(super) scene: String,
    pub(super) grid: Grid,
}

impl Cut {
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(BLOCKS);
        ensure!(
            path.exists(),
            "{} has no {BLOCKS}, so it is no folder of blocks; give the --out of `genesplat split`",
            shown(folder)
        );
        let text =
            input::read_text(&path).map_err(|error| anyhow!("cannot read {}: {error}", shown(&path)))?;
        let damaged = || format!("{} is damaged; split the scene again", shown(&path));
        let cut: Self = serde_json::from_str(&text).with_context(damaged)?;
        let blocks = cut.grid.blocks();
        ensure!(!blocks.is_empty(), "{}: it has no blocks", damaged());
        if let Some(block) = blocks.iter().find(|block| !is_file_name(&block.name)) {
            bail!("{}: {} is the name of no block", damaged(), shown(&block.name));
        }
        let names: HashSet<&str> = blocks.iter().map(|block| &*block.name).collect();
        ensure!(names.len() == blocks.len(), "{}: two blocks have one name", damaged());
        Ok(cut)
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        write_own_json(folder, BLOCKS, self)
    }
}

pub(super) fn scene_of(block: &Block, folder: &Path) -> PathBuf {
    folder.join(SCENES).join(&block.name)
}

pub(super) fn run_of(block: &Block, folder: &Path) -> PathBuf {
    folder.join(RUNS).join(&block.name)
}

/// The command that trains a block, whose scene is there.
pub(super) fn command(block: &Block, folder: &Path) -> String {
    let (scene, run) = (scene_of(block, folder), shown(run_of(block, folder)));
    let anyway: &[&str] = if has_few_photos(&scene) { &["--anyway"] } else { &[] };
    let list = scene.join(TEST_LIST);
    let (scene, path) = (shown(&scene), shown(&list));
    let held_out: &[&str] = if list.exists() { &["--test-list", &path] } else { &["--train-on-all"] };
    command_line([&["genesplat", "train", &scene], held_out, anyway, &["--out", &run]].concat())
}

/// A block may have fewer photos than a scene should have.
fn has_few_photos(scene: &Path) -> bool {
    let photos = fs::read_dir(scene.join("images")).map_or(PHOTOS_MIN, Iterator::count);
    photos < PHOTOS_MIN
}

#[cfg(test)]
mod tests {
    use genesplat::core::Camera;
    use glam::DVec3;

    use super::*;

    fn points() -> Vec<DVec3> {
        (0..12).map(|nth| DVec3::new(f64::from(nth) / 7.0, 0.0, f64::from(nth % 3))).collect()
    }

    fn cut() -> Cut {
        Cut { scene: "scene".into(), grid: Grid::cut(&[Camera::at_origin(10, 10, 10.0)], &points(), [2, 2]) }
    }

    #[test]
    fn a_cut_is_written_and_read_back_and_what_is_none_is_a_sentence() {
        let (place, cut) = (tempfile::tempdir().unwrap(), cut());
        let error = |folder: &Path| format!("{:#}", Cut::read(folder).err().unwrap());
        assert!(error(place.path()).contains("no folder of blocks"));
        cut.write(place.path()).unwrap();
        let read = Cut::read(place.path()).unwrap();
        assert_eq!((read.scene, read.grid.blocks().len()), (cut.scene, 4));
        for (block, again) in cut.grid.blocks().iter().zip(read.grid.blocks()) {
            assert_eq!(block.name, again.name);
            assert!(
                points().into_iter().all(|point| cut.grid.owns(block, point) == read.grid.owns(again, point))
            );
        }
        let file = place.path().join(BLOCKS);
        let axes = r#"{"axes": [[1, 0, 0], [0, 0, 1]]}"#;
        let of_blocks = |names: &[&str]| {
            let blocks = names
                .iter()
                .map(|name| format!(r#"{{"name": "{name}", "core": [[null, null], [null, null]]}}"#));
            let blocks = blocks.collect::<Vec<_>>().join(", ");
            format!(r#"{{"scene": "", "grid": {{"ground": {axes}, "blocks": [{blocks}]}}}}"#)
        };
        let outside = [&["0-0", "../elsewhere"][..], &["/etc"], &[".."], &[""], &["0-0", "0-0"], &[]];
        for damaged in outside.map(of_blocks).into_iter().chain(["{}".to_owned()]) {
            fs::write(&file, &damaged).unwrap();
            assert!(error(place.path()).contains("split the scene again"), "{}", error(place.path()));
        }
        fs::write(&file, of_blocks(&["0-0", "0-1"])).unwrap();
        assert!(Cut::read(place.path()).is_ok());
    }

    #[test]
    fn commands_name_a_list_where_there_is_one() {
        let (place, cut) = (tempfile::tempdir().unwrap(), cut());
        let folder = place.path().join("bl ocks");
        let block = &cut.grid.blocks()[0];
        let scene = scene_of(block, &folder);
        fs::create_dir_all(&scene).unwrap();
        let [shown_scene, run] =
            [&scene, &run_of(block, &folder)].map(|path| format!("'{}'", path.display()));
        assert_eq!(
            command(block, &folder),
            format!("genesplat train {shown_scene} --train-on-all --out {run}")
        );
        fs::write(scene.join(TEST_LIST), "a.png\n").unwrap();
        let list = scene.join(TEST_LIST);
        let expected = format!("genesplat train {shown_scene} --test-list '{}' --out {run}", list.display());
        assert_eq!(command(block, &folder), expected);
    }
}
