//! Which photos `poses` compares: the choice among planted features, and what a database then holds.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use genesplat::io::photos::{read_photo, resize, write_png};
use serde_json::Value;

use crate::poses::said;
use crate::support::{command, json, number, python_with, real_data, text};

/// The functions that choose, and photos with planted features: each shares its own 30 with the next photo of a round, and
/// has 10 that all others have too.
const PLANTED: &str = r"
import json
rng = np.random.default_rng(5)
def planted(count):
    whole = rng.gamma(0.3, 1, (count * 30 + 10, 128))
    whole = np.rint(512 * whole / np.linalg.norm(whole, axis=1, keepdims=True)).clip(0, 255).astype(np.uint8)
    common = whole[-10:]
    def photo(i):
        own, next_ones = whole[30 * i : 30 * i + 30], whole[30 * ((i + 1) % count) :][:30]
        return np.concatenate([common, own, next_ones])
    return np.stack([photo(i) for i in range(count)])
def show(pairs):
    print(json.dumps(sorted(pairs)))
";

/// What a script with the functions of `pairs.py` prints; `None` where no Python has numpy.
fn python_says(script: &str) -> Option<Value> {
    let python = python_with("numpy")?;
    let script = format!("{}\n{PLANTED}\n{script}", include_str!("../../src/poses/pairs.py"));
    let ran = Command::new(python).args(["-c", &script]).output().unwrap();
    assert!(ran.status.success(), "{}", said(&ran));
    Some(serde_json::from_slice(&ran.stdout).unwrap())
}

#[test]
fn photos_that_look_alike_are_compared_in_any_order() {
    let Some(found) = python_says(
        "features, order = planted(12), rng.permutation(12)\n\
         alike = likeness(features[order])\n\
         print(json.dumps([[int(order[i]), int(order[j])] for i, j in nearest(alike, 2)]))",
    ) else {
        return;
    };
    let mut pairs: Vec<[u64; 2]> = serde_json::from_value(found).unwrap();
    pairs.iter_mut().for_each(|pair| pair.sort_unstable());
    pairs.sort_unstable();
    let mut round: Vec<[u64; 2]> = (0..12).map(|i| [i.min((i + 1) % 12), i.max((i + 1) % 12)]).collect();
    round.sort_unstable();
    assert_eq!(pairs, round);
}

#[test]
fn an_order_counts_where_it_is_that_of_a_walk() {
    let Some(found) = python_says(
        "features = planted(40)\n\
         print(json.dumps([bool(is_walk(likeness(photos), 3)) for photos in (features, features[rng.permutation(40)])]))",
    ) else {
        return;
    };
    assert_eq!(found, serde_json::json!([true, false]));
}

#[test]
fn frames_are_compared_with_their_neighbours_and_at_powers_of_two() {
    let Some(found) =
        python_says("show([len(pairs_in_order(9, 3)), len(pairs_in_order(20, 10)), len(all_pairs(50))])")
    else {
        return;
    };
    // Of nine photos at the distances 1, 2, 3, 4 and 8; of twenty at 1 to 10 and 16.
    assert_eq!(found, serde_json::json!([8 + 7 + 6 + 5 + 1, 145 + 4, 1225]));
}

#[test]
fn photos_taken_near_each_other_are_compared_if_all_say_where() {
    let Some(found) = python_says(
        "degrees = np.array([[47.0, 8.0], [47.0, 8.01], [47.0, 8.0001], [47.0, 8.0102], [47.0, 8.005]])\n\
         places = closeness_of_places(degrees)\n\
         unknown = degrees.copy()\nunknown[2] = np.nan\n\
         indoors = 47 + (degrees - 47) / 1e5\n\
         silent = closeness_of_places(unknown) is None and closeness_of_places(indoors) is None\n\
         print(json.dumps([sorted(nearest(places, 1)), bool(silent)]))",
    ) else {
        return;
    };
    assert_eq!(found, serde_json::json!([[[0, 2], [1, 3], [2, 4]], true]));
}

#[test]
fn photos_without_a_camera_are_compared_with_those_that_have_one() {
    let Some(found) = python_says(
        "closeness = -np.abs(np.subtract.outer(np.arange(6), np.arange(6)))\n\
         show(pairs_with(closeness, {0, 5}, [1, 2, 3, 4], 2))",
    ) else {
        return;
    };
    assert_eq!(found, serde_json::json!([[0, 1], [0, 2], [3, 5], [4, 5]]));
}

/// Photos of a walk under names that say nothing of it, with a blank in each.
fn shuffled(folder: &Path) -> Option<PathBuf> {
    const PHOTOS: usize = 154;
    let images = real_data()?.join("bonsai/images");
    let mut names: Vec<PathBuf> = fs::read_dir(images).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.sort();
    let photos = folder.join("photos");
    for (index, name) in names.iter().take(PHOTOS).enumerate() {
        let photo = resize(&read_photo(name).unwrap(), 240, 160);
        // 154 = 2 * 7 * 11, so that multiples of 37 come to each place.
        write_png(&photos.join(format!("photo {:03}.png", index * 37 % PHOTOS)), &photo).unwrap();
    }
    Some(photos)
}

/// What `query` counts in a database that nobody has opened.
fn counted(python: &Path, database: &Path, query: &str) -> f64 {
    let script =
        "import sqlite3, sys; print(sqlite3.connect(sys.argv[1]).execute(sys.argv[2]).fetchone()[0])";
    let ran = Command::new(python).args(["-c", script, text(database), query]).output().unwrap();
    String::from_utf8_lossy(&ran.stdout).trim().parse().unwrap_or_else(|_| panic!("{}", said(&ran)))
}

/// By order alone a third of them had no camera.
#[test]
fn many_photos_get_cameras_whatever_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = python_with("pycolmap") else { return };
    let Some(photos) = shuffled(folder.path()) else { return };
    let found = folder.path().join("scene");
    let poses = command(["poses", text(&photos), "--out", text(&found)])
        .env("GENESPLAT_PYTHON", &python)
        .output()
        .unwrap();
    assert!(poses.status.success(), "{}", said(&poses));
    let (summary, database) = (json(&found.join("poses/summary.json")), found.join("poses/database.db"));
    assert!(number(&summary["registered"]) >= 150.0, "{summary}");
    let (compared, of) = (&summary["compared"], number(&summary["compared"]["of"]));
    assert_eq!((of, &compared["chosen_by"]), (154.0 * 153.0 / 2.0, &serde_json::json!(["looks"])));
    let pairs = number(&compared["pairs"]);
    assert_eq!(pairs, counted(&python, &database, "SELECT COUNT(*) FROM matches"));
    assert!(
        pairs < of / 3.0 && said(&poses).contains("of 11,781 pairs of photos, chosen by looks"),
        "{}",
        said(&poses)
    );
    let named = counted(&python, &database, "SELECT COUNT(*) FROM images WHERE name LIKE 'photo ___.png'");
    assert_eq!((named, counted(&python, &database, "SELECT COUNT(*) FROM cameras")), (154.0, 1.0));
}
