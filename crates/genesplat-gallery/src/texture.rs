//! Colours of surfaces, as functions of a position in metres: any resolution shows the same room.

use glam::Vec3;

use crate::painting::Painting;

#[derive(Clone, Copy, Debug)]
pub(crate) enum Texture {
    Plain(Vec3),
    /// Clouded by a per cent or two.
    Plaster(Vec3),
    /// Of oak, along v.
    Boards,
    /// A woven rug, a card with lines of print, and a picture, of this size in metres.
    Rug([f32; 2]),
    Label([f32; 2]),
    Picture(Painting, [f32; 2]),
}

impl Texture {
    /// Fraction of light that is scattered back, linear RGB, at `(u, v)` metres.
    pub(crate) fn albedo(&self, [u, v]: [f32; 2], seed: u32) -> Vec3 {
        match *self {
            Self::Plain(colour) => colour,
            Self::Plaster(colour) => colour * (1.0 + 0.03 * (clouds(1.3 * u, 1.3 * v, seed) - 0.5)),
            Self::Boards => boards(u, v, seed),
            Self::Rug(size) => rug(u, v, size, seed),
            Self::Label(size) => label(u, v, size, seed),
            Self::Picture(painting, size) => {
                painting.colour([u / size[0], v / size[1]], size[0] / size[1], seed)
            }
        }
    }
}

/// Linear colour of a hexadecimal one, with the display's gamma taken as 2.
pub(crate) const fn paint(hex: u32) -> Vec3 {
    const fn linear(byte: u32) -> f32 {
        let value = (byte & 0xFF) as f32 / 255.0;
        value * value
    }
    Vec3::new(linear(hex >> 16), linear(hex >> 8), linear(hex))
}

/// A random number in `[0, 1)` for a cell of a grid.
pub(crate) fn hash(x: i32, y: i32, seed: u32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ seed;
    // Two rounds of multiply and fold (after Murmur's finaliser) spread every input bit over the word.
    for multiplier in [0x85EB_CA6B, 0xC2B2_AE35u32] {
        h = (h ^ (h >> 15)).wrapping_mul(multiplier);
    }
    ((h ^ (h >> 16)) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// The cell of a grid; without SSE4, `f32::floor` is a call into the C library.
fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    truncated - i32::from(x < truncated as f32)
}

/// Smooth noise in `[0, 1)` with a feature a unit.
pub(crate) fn noise(x: f32, y: f32, seed: u32) -> f32 {
    let (cx, cy) = (floor(x), floor(y));
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (fx, fy) = (ease(x - cx as f32), ease(y - cy as f32));
    let corner = |dx: i32, dy: i32| hash(cx + dx, cy + dy, seed);
    let low = mix(corner(0, 0), corner(1, 0), fx);
    mix(low, mix(corner(0, 1), corner(1, 1), fx), fy)
}

/// Four octaves of [`noise`], in `[0, 1)`.
pub(crate) fn clouds(x: f32, y: f32, seed: u32) -> f32 {
    let octave = |level: u32| {
        let scale = (1 << level) as f32;
        noise(scale * x, scale * y, seed ^ (level * 0x51)) / (2.0 * scale)
    };
    (0..4).map(octave).sum::<f32>() * (16.0 / 15.0)
}

pub(crate) fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// 0 below `from`, 1 above `to`, smooth between.
pub(crate) fn smoothstep(from: f32, to: f32, x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn boards(u: f32, v: f32, seed: u32) -> Vec3 {
    const WIDTH: f32 = 0.16;
    const LENGTH: f32 = 1.5;
    let column = (u / WIDTH).floor();
    let shifted = v / LENGTH + hash(column as i32, 0, seed);
    let board = (column as i32, shifted.floor() as i32);
    let tone = hash(board.0, board.1, seed ^ 0xB0A2);
    let grain = clouds(34.0 * u, 2.2 * v + 17.0 * tone, seed ^ board.0 as u32);
    let fine = noise(160.0 * u, 7.0 * v, seed);
    let colour = paint(0xA9_7F_55).lerp(paint(0xC4_9A_6C), tone) * (0.80 + 0.28 * grain + 0.08 * fine);
    // Dark joints of 3 mm between boards.
    let (across, along) = (fraction(u / WIDTH), fraction(shifted));
    let gap = across.min(1.0 - across) * WIDTH;
    let butt = along.min(1.0 - along) * LENGTH;
    colour * mix(0.45, 1.0, smoothstep(0.001, 0.004, gap.min(butt)))
}

fn rug(u: f32, v: f32, [width, height]: [f32; 2], seed: u32) -> Vec3 {
    const RUST: Vec3 = paint(0xA2_3E_2C);
    const NAVY: Vec3 = paint(0x23_33_5C);
    const CREAM: Vec3 = paint(0xE4_D5_B4);
    const OCHRE: Vec3 = paint(0xCB_93_3A);
    let edge = u.min(width - u).min(v).min(height - v);
    let weave = 0.88 + 0.24 * noise(220.0 * u, 220.0 * v, seed);
    let colour = if edge < 0.04 {
        CREAM
    } else if edge < 0.20 {
        // Border: triangles.
        let (a, b) = (fraction(u / 0.08) - 0.5, (edge - 0.04) / 0.16);
        if a.abs() < 0.5 * b { OCHRE } else { NAVY }
    } else if edge < 0.235 {
        CREAM
    } else {
        // Field: nested diamonds.
        let (a, b) = ((u - 0.5 * width) / 0.42, (v - 0.5 * height) / 0.42);
        let cell = ((a + b).floor() + (a - b).floor()) as i32;
        let ring = ((fraction(a + b) - 0.5).abs().max((fraction(a - b) - 0.5).abs()) * 8.0) as i32;
        match (ring + cell.rem_euclid(2)).rem_euclid(4) {
            0 => OCHRE,
            1 => RUST,
            2 => NAVY,
            _ => RUST.lerp(CREAM, 0.75),
        }
    };
    colour * weave
}

fn label(u: f32, v: f32, [width, height]: [f32; 2], seed: u32) -> Vec3 {
    const LINE: f32 = 0.016;
    let row = (v / LINE).floor();
    let ends = width * (0.55 + 0.35 * hash(row as i32, 1, seed));
    let letters = hash((u / 0.004) as i32, row as i32, seed) > 0.3;
    let inside = u > 0.1 * width && u < ends && v > 0.15 * height && v < 0.85 * height;
    let printed = inside && letters && fraction(v / LINE) < 0.55;
    if printed { paint(0x50_4C_48) } else { paint(0xEE_EC_E6) }
}

/// `x − floor(x)`, which is never negative.
fn fraction(x: f32) -> f32 {
    x - x.floor()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_spread_over_its_range_and_continuous() {
        let values: Vec<f32> = (0..4000).map(|i| hash(i % 63, i / 63, 5)).collect();
        let mean = values.iter().sum::<f32>() / 4000.0;
        // Four standard errors of the mean of uniform numbers.
        assert!((mean - 0.5).abs() < 4.0 * (1.0f32 / 12.0 / 4000.0).sqrt(), "{mean}");
        let jump =
            (0..1000).map(|i| i as f32 * 0.01 - 5.0).map(|x| noise(x + 1e-4, 0.3, 1) - noise(x, 0.3, 1));
        assert!(jump.fold(0.0f32, |most, step| most.max(step.abs())) < 1e-3);
    }
}
