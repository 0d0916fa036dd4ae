//! Which photos `poses` compares: the choice among planted features, and what a database then holds.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use genesplat::io::photos::{read_photo, resize, write_png};
use serde_json::Value;

use crate::poses::{said, small_photos, with_python};
use crate::support::{command, json, number, python_with, real_data, text};

/// The functions that choose, and photos with planted features: each shares its own 30 with the next photo of
/// a round, and has 10 that all others have too.
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
        let photo = resize(&read_photo(name).unwrap(), 210, 140);
        // 154 = 2 * 7 * 11, so that multiples of 37 come to each place.
        write_png(&photos.join(format!("photo {:03}.png", index * 37 % PHOTOS)), &photo).unwrap();
    }
    Some(photos)
}

/// What a script says whose arguments follow; it fails where the script does.
fn told(python: &Path, script: &str, arguments: &[&str]) -> Output {
    let ran = Command::new(python).args(["-c", script]).args(arguments).output().unwrap();
    assert!(ran.status.success(), "{}", said(&ran));
    ran
}

/// What statements change in a database that nobody has opened, and what the last counts there.
fn counted(python: &Path, database: &Path, statements: &[&str]) -> f64 {
    let script = "import sqlite3, sys\nwith sqlite3.connect(sys.argv[1]) as database:\n  \
                  for statement in sys.argv[2:]: found = database.execute(statement).fetchone()\nprint(found[0])";
    let ran = told(python, script, &[&[text(database)], statements].concat());
    String::from_utf8_lossy(&ran.stdout).trim().parse().unwrap_or_else(|_| panic!("{}", said(&ran)))
}

/// Of these photos at 210x140 pixels.
const FOCAL_PX: f64 = 496.2 * 210.0 / 480.0;

/// What the search for cameras has begun with.
fn focal_px_to_begin_with(python: &Path, database: &Path) -> f64 {
    let script = "import pycolmap, sys\nwith pycolmap.Database.open(sys.argv[1]) as database:\n  \
                  print(database.read_all_cameras()[0].params[0])";
    let ran = told(python, script, &[text(database)]);
    String::from_utf8_lossy(&ran.stdout).trim().parse().unwrap_or_else(|_| panic!("{}", said(&ran)))
}

/// How many pairs were compared at first; photos without a camera are tried again with more.
fn chosen_pairs(said: &str) -> f64 {
    let (_, after) = said.split_once("matches: 100 % (").expect("pairs are counted");
    let (count, _) = after.split_once(" of ").unwrap();
    count.replace(',', "").parse().unwrap()
}

/// By order alone a third of them had no camera. COLMAP's guess of the focal length is 252 px.
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
    assert_eq!(pairs, counted(&python, &database, &["SELECT COUNT(*) FROM matches"]));
    assert!(said(&poses).contains("of 11,781 pairs of photos, chosen by looks"), "{}", said(&poses));
    assert!(chosen_pairs(&said(&poses)) < of / 4.0, "{}", said(&poses));
    let focal_px = focal_px_to_begin_with(&python, &database);
    assert!((focal_px / FOCAL_PX - 1.0).abs() < 0.1, "{focal_px} px instead of {FOCAL_PX}");
    let named = ["SELECT COUNT(*) FROM images WHERE name LIKE 'photo ___.png'"];
    assert_eq!(counted(&python, &database, &named), 154.0, "names of the list of pairs stay in the database");
}

/// As where the pairs that were chosen do not tell where a photo belongs.
#[test]
fn photos_without_a_camera_are_tried_again_with_all_that_have_one() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = python_with("pycolmap") else { return };
    let Some(photos) = small_photos(folder.path()) else { return };
    let found = folder.path().join("scene");
    let poses = || with_python(&python, &["poses", text(&photos), "--out", text(&found)]);
    let first = poses();
    assert!(first.status.success(), "{}", said(&first));
    let (summary, database) = (found.join("poses/summary.json"), found.join("poses/database.db"));
    let registered = number(&json(&summary)["registered"]);
    // A pair is the smaller number times 2147483647 and the larger one.
    let of_photo =
        "(SELECT image_id FROM images WHERE name = '05.png') IN (pair_id / 2147483647, pair_id % 2147483647)";
    let forget =
        ["matches", "two_view_geometries"].map(|table| format!("DELETE FROM {table} WHERE {of_photo}"));
    let [matches, geometries] = forget.each_ref().map(String::as_str);
    let left = counted(&python, &database, &[matches, geometries, "SELECT COUNT(*) FROM matches"]);
    assert_eq!(left, 66.0 - 11.0);
    fs::remove_file(&summary).unwrap();
    let again = poses();
    assert!(again.status.success(), "{}", said(&again));
    assert!(said(&again).contains("no camera so far"), "{}", said(&again));
    let summary = json(&summary);
    assert_eq!(number(&summary["registered"]), registered, "{summary}");
    assert_eq!(summary["compared"]["left_out_with_all"], true, "{summary}");
    assert!(number(&summary["compared"]["pairs"]) >= left + registered - 1.0, "{summary}");
}

/// COLMAP numbers photos as threads get done with them, if it is left to it, and finds other cameras each
/// time.
#[test]
fn photos_have_numbers_by_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = python_with("pycolmap") else { return };
    let Some(photos) = small_photos(folder.path()) else { return };
    // A thread that has the first photo is done with it long after the others are with theirs.
    let first = photos.join("00.png");
    write_png(&first, &resize(&read_photo(&first).unwrap(), 1080, 1920)).unwrap();
    let out = folder.path().join("scene");
    let poses = with_python(&python, &["poses", text(&photos), "--out", text(&out), "--threads", "3"]);
    assert!(poses.status.success(), "{}", said(&poses));
    let in_order =
        "SELECT COUNT(*) FROM images AS a, images AS b WHERE a.image_id < b.image_id AND a.name < b.name";
    assert_eq!(counted(&python, &out.join("poses/database.db"), &[in_order]), 66.0);
}

/// COLMAP begins another camera each time that it is started.
#[test]
fn a_search_goes_on_with_the_camera_that_it_began_with() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = python_with("pycolmap") else { return };
    let Some(photos) = small_photos(folder.path()) else { return };
    let found = folder.path().join("scene");
    let database = found.join("poses/database.db");
    fs::create_dir_all(found.join("poses")).unwrap();
    let begin = "import pycolmap, sys\npycolmap.extract_features(*sys.argv[1:], image_names=['03.png', '04.png'], \
                 camera_mode=pycolmap.CameraMode.SINGLE, device=pycolmap.Device.cpu)";
    told(&python, begin, &[text(&database), text(&photos)]);
    let poses = with_python(&python, &["poses", text(&photos), "--out", text(&found)]);
    assert!(poses.status.success(), "{}", said(&poses));
    assert_eq!(counted(&python, &database, &["SELECT COUNT(*) FROM cameras"]), 1.0);
    assert!(said(&poses).contains("compared all 66 pairs of photos"), "{}", said(&poses));
}

/// A group of photos that is moved, as one is that look-alikes hold in a wrong place.
#[test]
fn a_group_that_most_matches_contradict_is_doubted() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = python_with("pycolmap") else { return };
    let script = format!(
        "{}\n{}",
        include_str!("../../src/poses/sides.py"),
        r#"
import sys
options = pycolmap.SyntheticDatasetOptions()
options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 1, 24, 400
path, shift = sys.argv[1], np.array([0.7, 0, 0])
pycolmap.set_random_seed(0)
with pycolmap.Database.open(path) as database:
    true = pycolmap.synthesize_dataset(options, database)
moved = set(sorted(true.reg_image_ids())[:9])
wrong = pycolmap.Reconstruction()
for camera in true.cameras.values():
    wrong.add_camera_with_trivial_rig(camera)
for number, image in true.images.items():
    pose = image.cam_from_world()
    if number in moved:
        pose = pose * pycolmap.Rigid3d(pycolmap.Rotation3d(), -shift)
    points = np.array([point.xy for point in image.points2D])
    photo = pycolmap.Image(name=image.name, keypoints=points, camera_id=image.camera_id, image_id=number)
    wrong.add_image_with_trivial_frame(photo, pose)
for index, point in enumerate(true.points3D.values()):
    sides = [], []
    for element in point.track.elements:
        sides[element.image_id in moved and index % 20 > 0].append(element)
    for side, place in zip(sides, (point.xyz, point.xyz + shift)):
        if side:
            wrong.add_point3D(place, pycolmap.Track(elements=side), point.color)
assert doubted(true, path) is None
assert all_agreeing(true, path) > all_agreeing(wrong, path) > 0
photos, holding = doubted(wrong, path)
assert photos == 9, photos
before = sqlite3.connect(path).execute("SELECT SUM(rows) FROM two_view_geometries").fetchone()
pairs = [(a, b) for a in sorted(moved) for b in sorted(set(true.images) - moved)][:5]
rows = leave_out(path, pairs)
after = sqlite3.connect(path).execute("SELECT SUM(rows) FROM two_view_geometries").fetchone()
assert after < before and len(rows) == 5
bring_back(path, rows)
assert sqlite3.connect(path).execute("SELECT SUM(rows) FROM two_view_geometries").fetchone() == before
"#
    );
    told(&python, &script, &[text(&folder.path().join("database.db"))]);
}

/// COLMAP stops at the first scale at which it has enough.
#[test]
fn features_are_bounded_and_the_largest_stay() {
    let folder = tempfile::tempdir().unwrap();
    let Some(python) = python_with("pycolmap") else { return };
    let script = format!(
        "{}\n{}\n{}",
        include_str!("../../src/poses/pairs.py"),
        include_str!("../../src/poses/matching.py"),
        r"
import sys
path, scales = sys.argv[1], np.random.default_rng(5).permutation(50).astype(np.float32)
keypoints = np.stack([scales + 0.5, scales, scales, 0 * scales, 0 * scales, scales], axis=1)
descriptors = np.repeat(scales.astype(np.uint8)[:, None], 128, axis=1)
with sqlite3.connect(path) as database:
    for table, values in ('keypoints', keypoints), ('descriptors', descriptors):
        database.execute(f'CREATE TABLE {table} (image_id, rows, cols, data)')
        for photo, count in (1, 50), (2, 20):
            row = [photo, count, values.shape[1], values[:count].tobytes()]
            database.execute(f'INSERT INTO {table} VALUES (?, ?, ?, ?)', row)
database.close()
bound_features(path, 20)
with sqlite3.connect(path) as database:
    assert all(rows == 20 for (rows,) in database.execute('SELECT rows FROM keypoints UNION SELECT rows FROM descriptors'))
    kept = of_photo(database, 'keypoints', 1)
    assert sorted(kept[:, 1]) == list(range(30, 50)), kept
    assert (of_photo(database, 'descriptors', 1)[:, 0] == kept[:, 1]).all()
    assert (of_photo(database, 'keypoints', 2) == keypoints[:20]).all()
"
    );
    told(&python, &script, &[text(&folder.path().join("database.db"))]);
}
