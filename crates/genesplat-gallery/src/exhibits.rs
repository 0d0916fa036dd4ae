//! What stands on the floor and hangs from the ceiling.

use glam::{Quat, Vec3};

use crate::room::{BLACK, WALNUT, block, ellipsoid, rod};
use crate::texture::{Texture, hash, paint};
use crate::world::{Finish, Surface};

/// A white block for something to stand on.
pub(crate) fn plinth(foot: Vec3, [width, depth, height]: [f32; 3]) -> Vec<Surface> {
    let half = Vec3::new(0.5 * width, 0.5 * depth, 0.0);
    block(foot - half, foot + half + Vec3::Z * height, Texture::Plaster(paint(0xEC_E9_E2)))
}

/// A glazed bottle: belly, neck and lip.
pub(crate) fn vase(foot: Vec3) -> Vec<Surface> {
    const BLUE: Vec3 = paint(0x1C_4F_86);
    let up = |height: f32| foot + Vec3::Z * height;
    let parts = [
        ellipsoid(up(0.15), Vec3::new(0.125, 0.125, 0.155), BLUE),
        rod(up(0.22), up(0.35), 0.036, BLUE),
        ellipsoid(up(0.375), Vec3::new(0.058, 0.058, 0.014), BLUE),
    ];
    parts.map(|part| Surface { finish: Finish::Coated { specular: 1.0 }, ..part }).into()
}

pub(crate) fn branches(foot: Vec3, seed: u32) -> Vec<Surface> {
    const TWIG: Vec3 = paint(0x4A_36_2A);
    const BUD: Vec3 = paint(0xE8_A9_AE);
    let mut parts = Vec::new();
    let mut open: Vec<(Vec3, Vec3, f32, i32)> = (0..4)
        .map(|stem| {
            let angle = 1.57 * stem as f32 + 0.6 * hash(stem, 0, seed);
            (foot, Vec3::new(0.35 * angle.cos(), 0.35 * angle.sin(), 1.0).normalize(), 0.26, 0)
        })
        .collect();
    while let Some((from, direction, length, level)) = open.pop() {
        let to = from + length * direction;
        parts.push(rod(from, to, 0.0065 / (1.0 + 0.5 * level as f32), TWIG));
        if level == 2 {
            parts.push(ellipsoid(to, Vec3::splat(0.015), BUD));
            continue;
        }
        for fork in 0..2 {
            let number = parts.len() as i32 * 2 + fork;
            let random = |axis: u32| hash(number, level, seed ^ (axis * 0x9E37)) - 0.5;
            let lean = 1.1 * Vec3::new(random(1), random(2), 0.35 * random(3));
            open.push((to, (direction + lean).normalize(), 0.72 * length, level + 1));
        }
    }
    parts
}

/// A chair of turned rods with a round seat.
pub(crate) fn chair(foot: Vec3) -> Vec<Surface> {
    let turn = Quat::from_rotation_z(-0.55);
    let place = |x: f32, y: f32, z: f32| foot + turn * Vec3::new(x, y, z);
    let oak = paint(0x8A_5A_34);
    let mut parts = vec![ellipsoid(place(0.0, 0.0, 0.45), Vec3::new(0.225, 0.225, 0.022), oak)];
    for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        parts.push(rod(place(0.13 * x, 0.13 * y, 0.44), place(0.20 * x, 0.20 * y, 0.01), 0.013, oak));
        let mid = |x: f32, y: f32| place(0.172 * x, 0.172 * y, 0.18);
        parts.push(rod(mid(x, y), if x == y { mid(-x, y) } else { mid(x, -y) }, 0.008, oak));
    }
    for spindle in -3..=3i32 {
        let x = spindle as f32;
        let thick = if spindle.abs() == 3 { 0.012 } else { 0.006 };
        let bow = 0.03 * (1.0 - x * x / 9.0);
        parts.push(rod(place(0.05 * x, 0.17 + bow, 0.45), place(0.07 * x, 0.27 + bow, 0.95), thick, oak));
        if spindle < 3 {
            let next = 0.03 * (1.0 - (x + 1.0) * (x + 1.0) / 9.0);
            let (from, to) = (place(0.07 * x, 0.27 + bow, 0.95), place(0.07 * x + 0.07, 0.27 + next, 0.95));
            parts.push(rod(from, to, 0.017, oak));
        }
    }
    parts
}

/// A folding screen of slats in the corner.
pub(crate) fn screen() -> Vec<Surface> {
    let at =
        |along: f32, height: f32| Vec3::new(-2.85, 1.35, height).lerp(Vec3::new(-2.2, 2.38, height), along);
    let slats = (0..=10).map(|slat| {
        let along = slat as f32 / 10.0;
        rod(at(along, 0.02), at(along, 1.65), if slat % 10 == 0 { 0.02 } else { 0.009 }, WALNUT)
    });
    let rails = [0.15, 0.6, 1.1, 1.6].map(|height| rod(at(0.0, height), at(1.0, height), 0.011, WALNUT));
    slats.chain(rails).collect()
}

/// Discs on wires, balanced on thin beams.
pub(crate) fn mobile(hook: Vec3) -> Vec<Surface> {
    const WIRE: f32 = 0.004;
    let below = |x: f32, y: f32, drop: f32| hook + Vec3::new(x, y, -drop);
    let disc = |centre: Vec3, radius: f32, colour: Vec3| {
        ellipsoid(centre, Vec3::new(radius, 0.012, 0.8 * radius), colour)
    };
    let wire = |from: Vec3, to: Vec3| rod(from, to, WIRE, BLACK);
    let (left, right) = (below(-0.62, 0.12, 0.52), below(0.42, -0.08, 0.48));
    let (inner, outer) = (below(0.16, 0.16, 0.80), below(0.74, -0.30, 0.76));
    let pivot = below(0.42, -0.08, 0.78);
    let hung = |from: Vec3, drop: f32| from - Vec3::Z * drop;
    vec![
        wire(hook, below(0.0, 0.02, 0.50)),
        wire(left, right),
        wire(left, hung(left, 0.22)),
        disc(hung(left, 0.34), 0.15, paint(0xC7_35_2B)),
        wire(right, pivot),
        wire(inner, outer),
        wire(inner, hung(inner, 0.10)),
        disc(hung(inner, 0.17), 0.09, paint(0xE2_A9_2F)),
        wire(outer, hung(outer, 0.08)),
        disc(hung(outer, 0.17), 0.11, paint(0x22_3A_66)),
    ]
}
