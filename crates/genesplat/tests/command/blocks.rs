//! `split` and `merge`: a scene in blocks, trained one by one, and put together.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use genesplat::io::read_ply;

use crate::support::{fail, scene, succeed, text};

fn names(folder: &Path) -> BTreeSet<String> {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

/// Bits of the centres of a splat's Gaussians.
fn centres(file: &Path) -> Vec<[u32; 3]> {
    let splat = read_ply(file).unwrap();
    splat.positions.iter().map(|position| position.map(f32::to_bits)).collect()
}

#[test]
fn blocks_are_trained_one_by_one_and_merged() {
    let place = tempfile::tempdir().unwrap();
    let [blocks, merged] = ["blocks", "merged.ply"].map(|name| place.path().join(name));
    let said = succeed(["split", text(scene()), "--blocks", "2x1", "--out", text(&blocks)]);

    // Every photo is in a block, and those held out are those of the whole scene.
    let scenes = ["0-0", "1-0"].map(|name| blocks.join("scenes").join(name));
    let photos: Vec<_> = scenes.iter().map(|scene| names(&scene.join("images"))).collect();
    assert_eq!(&photos[0] | &photos[1], names(&scene().join("images")));
    for (scene, photos) in scenes.iter().zip(&photos) {
        let held_out: BTreeSet<String> =
            fs::read_to_string(scene.join("test.txt")).unwrap().lines().map(str::to_owned).collect();
        let whole = ["gallery_000.png", "gallery_008.png"].map(str::to_owned).into();
        assert_eq!(held_out, photos & &whole);
    }

    // The commands that it prints train them.
    let commands: Vec<Vec<&str>> = said
        .lines()
        .filter_map(|line| line.trim().strip_prefix("genesplat "))
        .map(|words| words.split(' ').collect())
        .collect();
    assert_eq!(commands.len(), 2, "{said}");
    let quick = ["--iterations", "3", "--evolve", "off", "--device", "cpu", "--no-lpips"];
    let merge = ["merge", text(&blocks), "--out", text(&merged)];
    succeed(commands[0].iter().chain(&quick));
    fail(merge, &["no splat is there yet of block 1-0", "genesplat train"]);
    succeed(commands[1].iter().chain(&quick));
    succeed(merge);

    // Every Gaussian is of one block's splat, and each block gives some.
    let runs = ["0-0", "1-0"].map(|name| centres(&blocks.join("runs").join(name).join("point_cloud.ply")));
    let whole = centres(&merged);
    let of = |run: usize| whole.iter().filter(|centre| runs[run].contains(centre)).count();
    assert!(of(0) > 0 && of(1) > 0 && whole.len() <= of(0) + of(1), "{} + {} of {}", of(0), of(1), whole.len());
    assert!(whole.len() < runs[0].len() + runs[1].len(), "what stands on another core is left out");
    succeed(["evaluate", text(&merged), "--data", text(scene()), "--device", "cpu", "--no-lpips"]);
}

#[test]
fn what_cannot_be_split_or_merged_is_a_sentence() {
    let place = tempfile::tempdir().unwrap();
    let (taken, blocks) = (place.path(), place.path().join("blocks"));
    fs::write(taken.join("file"), "").unwrap();
    fail(["split", text(scene()), "--blocks", "2x1", "--out", text(taken)], &["not empty", "new folder"]);
    let many = ["split", text(scene()), "--blocks", "100x100", "--out", text(&blocks)];
    fail(many, &["300 points", "too few to tell 10000 blocks apart"]);
    assert!(!blocks.exists());
    fail(["merge", text(taken), "--out", "a.ply"], &["no folder of blocks", "genesplat split"]);
    fail(["merge", text(taken), "--out", "a.mesh"], &["no format that genesplat writes", ".spz"]);
}
