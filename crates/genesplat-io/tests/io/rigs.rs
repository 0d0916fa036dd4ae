//! Rigs of several lenses: COLMAP's frames in both forms.

use std::fs;
use std::path::Path;

use genesplat_io::colmap::Form;
use genesplat_io::{HoldOut, LoadOptions, load_scene};

use crate::common::{tiny_model, write_scene};

/// Nine moments of two lenses each, the second of which took the photos from the tenth on; and a sensor that
/// takes none.
fn frames(form: Form) -> Vec<u8> {
    let frame = |moment: u32| {
        let entries = [(0, 1, moment), (0, 2, moment + 9), (1, 3, moment)];
        if form == Form::Text {
            let kinds = ["CAMERA", "IMU"];
            let entries = entries.map(|(kind, sensor, id)| format!(" {} {sensor} {id}", kinds[kind]));
            return format!("{moment} 1 1 0 0 0 0.5 0 1 3{}\n", entries.concat()).into_bytes();
        }
        let pose = [1.0f64, 0.0, 0.0, 0.0, 0.5, 0.0, 1.0].map(f64::to_le_bytes).concat();
        let entry = |(kind, sensor, id): (usize, u32, u32)| {
            [&(kind as i32).to_le_bytes()[..], &sensor.to_le_bytes(), &u64::from(id).to_le_bytes()].concat()
        };
        [
            &moment.to_le_bytes()[..],
            &1u32.to_le_bytes(),
            &pose,
            &3u32.to_le_bytes(),
            &entries.map(entry).concat(),
        ]
        .concat()
    };
    let count = if form == Form::Text { b"# a comment\n".to_vec() } else { 9u64.to_le_bytes().to_vec() };
    [count, (1..=9).map(frame).collect::<Vec<_>>().concat()].concat()
}

/// Names of the photos that are held out.
fn held_out(scene: &Path, hold_out: HoldOut) -> Vec<String> {
    let options = LoadOptions { hold_out, ..LoadOptions::default() };
    load_scene(scene, &options, &()).unwrap().test.into_iter().map(|view| view.name).collect()
}

#[test]
fn photos_of_one_moment_are_held_out_together() {
    for (form, name) in [(Form::Binary, "frames.bin"), (Form::Text, "frames.txt")] {
        let folder = tempfile::tempdir().unwrap();
        write_scene(folder.path(), form, &tiny_model(18));
        assert_eq!(held_out(folder.path(), HoldOut::EveryEighth), ["000.png", "008.png", "016.png"]);
        let file = folder.path().join("sparse/0").join(name);
        fs::write(&file, frames(form)).unwrap();
        let together = ["000.png", "008.png", "009.png", "017.png"];
        assert_eq!(held_out(folder.path(), HoldOut::EveryEighth), together, "{name}");
        let named = HoldOut::Photos(vec!["003".into()]);
        assert_eq!(held_out(folder.path(), named), ["003.png"], "who names photos means these");
        let whole = frames(form);
        fs::write(&file, &whole[..whole.len() - 4]).unwrap();
        let refused = load_scene(folder.path(), &LoadOptions::default(), &()).unwrap_err().to_string();
        let why = if form == Form::Text { "line 10: expected FRAME_ID" } else { "cut off" };
        assert!(refused.contains(name) && refused.contains(why), "{refused}");
    }
}
