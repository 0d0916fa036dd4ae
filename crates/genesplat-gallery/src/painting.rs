//! The pictures on the walls, each a function of position: fine texture on purpose.

use glam::Vec3;

use crate::texture::{clouds, hash, mix, noise, paint, smoothstep};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Painting {
    Ridges,
    Arcs,
    Contours,
    Mosaic,
}

impl Painting {
    /// Colour at `(s, t)` in the unit square, t upwards; `aspect` is width over height.
    pub(crate) fn colour(self, [s, t]: [f32; 2], aspect: f32, seed: u32) -> Vec3 {
        let colour = match self {
            Self::Ridges => ridges(s * aspect, t, aspect, seed),
            Self::Arcs => arcs(s * aspect, t, seed),
            Self::Contours => contours(s * aspect, t, seed),
            Self::Mosaic => mosaic(s * aspect, t, seed),
        };
        // Canvas and brush: a few per cent of grain.
        colour * (0.94 + 0.12 * noise(180.0 * s * aspect, 180.0 * t, seed ^ 0xCA))
    }
}

fn ridges(x: f32, y: f32, aspect: f32, seed: u32) -> Vec3 {
    const LAYERS: i32 = 6;
    const WATER: f32 = 0.2;
    // Water mirrors the hills, in ripples.
    let ripple = 0.012 * (noise(9.0 * x, 95.0 * y, seed) - 0.5);
    let (height, in_water) = if y < WATER { (2.0 * WATER - y + ripple * 4.0, true) } else { (y, false) };
    let sun = Vec3::new(0.68 * aspect - x, 0.66 - height, 0.0).length();
    let glow = (-3.5 * sun).exp();
    let mut colour = paint(0x8F_B4_C4).lerp(paint(0xF5_C9_91), smoothstep(0.95, 0.35, height));
    colour = colour.lerp(paint(0xFF_E9_B8), glow);
    colour = colour.lerp(paint(0xFF_F4_DC), smoothstep(0.088, 0.082, sun));
    // From the nearest hill to the farthest: the first that reaches this height hides the others.
    for layer in (0..LAYERS).rev() {
        let near = layer as f32 / (LAYERS - 1) as f32;
        let hills = clouds(mix(2.2, 3.6, near) * x + 13.0 * layer as f32, 0.5, seed ^ layer as u32);
        let below = mix(0.62, 0.24, near) + mix(0.30, 0.24, near) * (hills - 0.40) - height;
        if below > 0.0 {
            let tone = paint(0xA4_B3_CB).lerp(paint(0x14_2C_33), near.sqrt());
            let strokes = 0.8 + 0.4 * noise(24.0 * x + 60.0 * height, 70.0 * height - 20.0 * x, seed ^ 7);
            colour = paint(0xEB_CB_A8).lerp(tone * strokes, mix(0.62, 1.0, smoothstep(0.0, 0.10, below)));
            break;
        }
    }
    if in_water { colour * 0.72 + paint(0x2C_4A_5C) * 0.16 } else { colour }
}

fn arcs(x: f32, y: f32, seed: u32) -> Vec3 {
    const PALETTE: [Vec3; 5] =
        [paint(0xF0_E6_D2), paint(0xC9_3A_28), paint(0x1D_2F_55), paint(0xE3_A8_35), paint(0x2F_7C_76)];
    const TILES: f32 = 6.0;
    let (cx, cy) = ((x * TILES).floor(), (y * TILES).floor());
    let random = |purpose: u32| hash(cx as i32, cy as i32, seed ^ purpose);
    let pick = |purpose: u32| PALETTE[(5.0 * random(purpose)) as usize];
    let (mut a, mut b) = (x * TILES - cx, y * TILES - cy);
    // Which corner the arcs turn around.
    if random(1) < 0.5 {
        a = 1.0 - a;
    }
    if random(2) < 0.5 {
        b = 1.0 - b;
    }
    let radius = (a * a + b * b).sqrt();
    let bands = [(0.25, pick(3)), (0.5, pick(4)), (0.75, pick(5)), (0.97, pick(6))];
    bands.iter().find(|(limit, _)| radius < *limit).map_or(pick(7), |&(_, colour)| colour)
}

fn contours(x: f32, y: f32, seed: u32) -> Vec3 {
    let warp = 0.35 * clouds(2.0 * x, 2.0 * y, seed ^ 0x77);
    let height = clouds(1.4 * x + warp, 1.4 * y - warp, seed);
    let level = 26.0 * height;
    let line = ((level - level.floor()) - 0.5).abs();
    let field = paint(0xEF_E3_C8).lerp(paint(0x5E_8C_7B), smoothstep(0.42, 0.62, height));
    let field = field.lerp(paint(0xD8_71_46), smoothstep(0.42, 0.30, height));
    field.lerp(paint(0x2A_25_22), smoothstep(0.14, 0.06, line))
}

fn mosaic(x: f32, y: f32, seed: u32) -> Vec3 {
    const CELLS: f32 = 9.0;
    const PALETTE: [Vec3; 5] =
        [paint(0x22_54_6E), paint(0x7F_B0_A8), paint(0xE8_D9_A9), paint(0xD9_7A_3C), paint(0x8E_2F_3A)];
    let (px, py) = (CELLS * x, CELLS * y);
    let (mut first, mut second, mut owner) = (f32::MAX, f32::MAX, 0.0);
    for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
        let (cx, cy) = (px.floor() as i32 + dx, py.floor() as i32 + dy);
        let (sx, sy) = (cx as f32 + hash(cx, cy, seed), cy as f32 + hash(cx, cy, seed ^ 9));
        let distance = ((px - sx).powi(2) + (py - sy).powi(2)).sqrt();
        if distance < first {
            (second, first, owner) = (first, distance, hash(cx, cy, seed ^ 31));
        } else {
            second = second.min(distance);
        }
    }
    let tile = PALETTE[(5.0 * owner) as usize] * (0.85 + 0.3 * hash((97.0 * owner) as i32, 3, seed));
    tile.lerp(paint(0x2B_28_26), smoothstep(0.09, 0.04, second - first))
}
