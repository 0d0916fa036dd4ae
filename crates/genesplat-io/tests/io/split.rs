//! Which photos are held out, where somebody says so.

use std::num::NonZeroU32;
use std::path::Path;

use crate::common::{tiny_model, write_scene};
use genesplat_core::View;
use genesplat_io::colmap::Form;
use genesplat_io::{HoldOut, LoadOptions, list_scene, load_scene};

fn names(views: &[View]) -> Vec<&str> {
    views.iter().map(|view| view.name.as_str()).collect()
}

/// The names of the photos that are tested and trained on, or the sentence.
fn split(scene: &Path, hold_out: HoldOut) -> Result<[Vec<String>; 2], String> {
    let options = LoadOptions { hold_out, ..LoadOptions::default() };
    let scene = load_scene(scene, &options, &()).map_err(|error| error.to_string())?;
    Ok([&scene.test, &scene.train].map(|views| names(views).into_iter().map(str::to_owned).collect()))
}

fn listed(names: &[&str]) -> HoldOut {
    HoldOut::Photos(names.iter().map(|name| (*name).to_owned()).collect())
}

#[test]
fn any_interval_and_any_list_can_be_held_out() {
    let folder = tempfile::tempdir().unwrap();
    write_scene(folder.path(), Form::Binary, &tiny_model(7));
    let held_out = |hold_out: HoldOut| {
        let [test, train] = split(folder.path(), hold_out).unwrap();
        assert!(test.len() + train.len() == 7 && !train.iter().any(|name| test.contains(name)));
        test
    };
    assert_eq!(held_out(HoldOut::Every(NonZeroU32::new(3).unwrap())), ["000.png", "003.png", "006.png"]);
    // In the order of the scene, whatever the order of the list.
    assert_eq!(
        held_out(listed(&["005.png", "001", "a b/004.png", "001.png"])),
        ["001.png", "004.png", "005.png"]
    );
    assert_eq!(held_out(HoldOut::None), [""; 0]);
}

/// Whole names would have the hyphen before the dot.
#[test]
fn names_are_sorted_without_their_endings() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(2);
    (model.images[0].name, model.images[1].name) = ("a-1.png".into(), "a.png".into());
    write_scene(folder.path(), Form::Binary, &model);
    assert_eq!(split(folder.path(), HoldOut::EveryEighth).unwrap(), [["a.png"], ["a-1.png"]]);
}

#[test]
fn a_listed_photo_is_one_photo_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = tiny_model(3);
    model.images[0].name = "left/1.png".into();
    model.images[1].name = "right/1.png".into();
    write_scene(folder.path(), Form::Binary, &model);
    assert_eq!(split(folder.path(), listed(&["right/1.png"])).unwrap()[0], ["right_1.png"]);
    let unknown = split(folder.path(), listed(&["left/1.png", "3.png"])).unwrap_err();
    assert!(
        unknown.contains("no photo called 3.png") && unknown.contains("names like left/1.png"),
        "{unknown}"
    );
    let ambiguous = split(folder.path(), listed(&["1.png"])).unwrap_err();
    assert!(ambiguous.contains("has 2 photos called 1.png"), "{ambiguous}");
    assert_eq!(split(folder.path(), listed(&["left/1"])).unwrap()[0], ["left_1.png"], "without its ending");
    let list = list_scene(folder.path(), &LoadOptions::default()).unwrap();
    assert_eq!(
        ["right_1.png", "right/1", "1.png"].map(|name| list.view_name(name, folder.path()).ok()),
        [Some("right_1.png".to_owned()), Some("right_1.png".to_owned()), None]
    );
}
