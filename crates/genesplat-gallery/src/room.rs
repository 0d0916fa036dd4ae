//! The gallery itself: shell, lamps, pictures, and the places of the exhibits.
//!
//! Chosen for what splats find hard: plain walls, fine prints, thin rods and wires, metal and glaze.

use glam::Vec3;

use crate::exhibits::{branches, chair, mobile, plinth, screen, vase};
use crate::geometry::Shape;
use crate::light::{Lamps, Skylight, Spot};
use crate::painting::Painting;
use crate::texture::{Texture, paint};
use crate::world::{Finish, Surface, World};

/// Corners of the room, metres.
const LOW: Vec3 = Vec3::new(-3.0, -2.7, 0.0);
const HIGH: Vec3 = Vec3::new(3.0, 2.6, 3.0);

const WHITE: Vec3 = paint(0xE3_DF_D6);
const SAGE: Vec3 = paint(0x9A_AE_A0);
pub(crate) const WALNUT: Vec3 = paint(0x5E_40_2B);
const BRASS: Vec3 = paint(0xF2_CF_8E);
pub(crate) const BLACK: Vec3 = paint(0x32_30_30);

/// A wall as pictures see it: its lower left corner and the direction to the right.
#[derive(Clone, Copy)]
struct Wall {
    corner: Vec3,
    right: Vec3,
    length: f32,
}

const BACK: Wall = Wall { corner: Vec3::new(LOW.x, HIGH.y, 0.0), right: Vec3::X, length: HIGH.x - LOW.x };
const LEFT: Wall = Wall { corner: LOW, right: Vec3::Y, length: HIGH.y - LOW.y };
const RIGHT: Wall =
    Wall { corner: Vec3::new(HIGH.x, HIGH.y, 0.0), right: Vec3::NEG_Y, length: HIGH.y - LOW.y };
const FRONT: Wall =
    Wall { corner: Vec3::new(HIGH.x, LOW.y, 0.0), right: Vec3::NEG_X, length: HIGH.x - LOW.x };

pub(crate) fn build(seed: u32) -> (World, Lamps) {
    let lamps = lamps();
    let mut parts = shell();
    parts.extend(fittings(&lamps));
    for (wall, centre, size, painting) in [
        (BACK, [2.2, 1.62], [1.75, 1.15], Painting::Ridges),
        (BACK, [4.35, 1.62], [0.98, 0.98], Painting::Arcs),
        (LEFT, [3.1, 1.60], [0.85, 1.25], Painting::Contours),
        (RIGHT, [0.95, 1.60], [0.52, 0.70], Painting::Mosaic),
        (RIGHT, [1.85, 1.60], [0.52, 0.70], Painting::Contours),
        (RIGHT, [2.75, 1.60], [0.52, 0.70], Painting::Arcs),
    ] {
        parts.extend(wall.picture(centre, size, painting));
    }
    parts.push(matte(
        Shape::rectangle(Vec3::new(-1.45, -0.1, 0.008), Vec3::X, Vec3::Y, [2.7, 1.9]),
        Texture::Rug([2.7, 1.9]),
    ));
    parts.extend(plinth(Vec3::new(0.62, 1.42, 0.0), [0.42, 0.42, 0.92]));
    let ball = ellipsoid(Vec3::new(0.62, 1.42, 1.13), Vec3::splat(0.21), BRASS);
    parts.push(Surface { finish: Finish::Metal(BRASS), ..ball });
    parts.extend(plinth(Vec3::new(1.62, 0.95, 0.0), [0.38, 0.38, 0.66]));
    parts.extend(vase(Vec3::new(1.62, 0.95, 0.66)));
    parts.extend(branches(Vec3::new(1.62, 0.95, 1.02), seed));
    parts.extend(chair(Vec3::new(-0.85, 0.72, 0.0)));
    parts.extend(screen());
    parts.extend(mobile(Vec3::new(-0.35, 1.0, HIGH.z)));
    (World::new(parts), lamps)
}

fn lamps() -> Lamps {
    let spot = |x: f32, y: f32, target: [f32; 3], strength: f32| Spot {
        position: Vec3::new(x, y, 2.82),
        target: target.into(),
        intensity: strength * Vec3::new(1.0, 0.90, 0.76),
    };
    Lamps {
        skylight: Skylight {
            corner: Vec3::new(-1.5, -1.2, HIGH.z),
            size: [3.0, 2.2],
            radiance: Vec3::new(2.3, 2.4, 2.55),
        },
        spots: vec![
            spot(-1.15, 1.35, [-0.95, 2.6, 1.6], 4.6),
            spot(1.35, 1.35, [1.35, 2.6, 1.6], 4.2),
            spot(-1.9, 0.5, [-3.0, 0.4, 1.6], 4.0),
            spot(1.9, 0.75, [3.0, 0.75, 1.6], 4.0),
            spot(0.5, 0.3, [0.62, 1.42, 0.9], 4.5),
            spot(0.9, -0.1, [1.62, 0.95, 0.8], 4.0),
        ],
    }
}

pub(crate) fn matte(shape: Shape, texture: Texture) -> Surface {
    Surface { shape, texture, finish: Finish::Matte }
}

pub(crate) fn ellipsoid(centre: Vec3, radii: Vec3, colour: Vec3) -> Surface {
    matte(Shape::Ellipsoid { centre, radii }, Texture::Plain(colour))
}

pub(crate) fn rod(from: Vec3, to: Vec3, radius: f32, colour: Vec3) -> Surface {
    matte(Shape::Rod { from, to, radius }, Texture::Plain(colour))
}

/// Floor, ceiling and walls, seen from inside.
fn shell() -> Vec<Surface> {
    let (width, depth) = (HIGH.x - LOW.x, HIGH.y - LOW.y);
    let floor = Shape::rectangle(LOW, Vec3::X, Vec3::Y, [width, depth]);
    let ceiling_corner = Vec3::new(LOW.x, HIGH.y, HIGH.z);
    let ceiling = Shape::rectangle(ceiling_corner, Vec3::X, Vec3::NEG_Y, [width, depth]);
    let wall = |Wall { corner, right, length }, colour| {
        matte(Shape::rectangle(corner, right, Vec3::Z, [length, HIGH.z]), Texture::Plaster(colour))
    };
    vec![
        Surface { shape: floor, texture: Texture::Boards, finish: Finish::Coated { specular: 0.6 } },
        matte(ceiling, Texture::Plaster(WHITE)),
        wall(BACK, WHITE),
        wall(LEFT, SAGE),
        wall(RIGHT, WHITE),
        wall(FRONT, WHITE),
    ]
}

/// Skirting boards, the skylight and the lamps on their rail.
fn fittings(lamps: &Lamps) -> Vec<Surface> {
    let mut parts = Vec::new();
    for wall in [BACK, LEFT, RIGHT, FRONT] {
        parts.extend(wall.block([0.0, 0.0], [wall.length, 0.09], 0.015, Texture::Plain(paint(0xF1_EE_E8))));
    }
    let Skylight { corner, size, radiance } = lamps.skylight;
    let corner = corner + Vec3::new(0.0, size[1], -0.01);
    let sky = matte(Shape::rectangle(corner, Vec3::X, Vec3::NEG_Y, size), Texture::Plain(WHITE));
    parts.push(Surface { finish: Finish::Lamp(radiance), ..sky });
    for spot in &lamps.spots {
        parts.push(rod(spot.position + Vec3::Z * 0.05, spot.position + Vec3::Z * 0.2, 0.012, BLACK));
        let finish = Finish::Lamp(Vec3::new(14.0, 12.6, 10.6));
        parts.push(Surface { finish, ..ellipsoid(spot.position, Vec3::splat(0.05), WHITE) });
    }
    parts
}

impl Wall {
    fn at(self, [along, up]: [f32; 2], out: f32) -> Vec3 {
        let outwards = self.right.cross(Vec3::Z);
        self.corner + along * self.right + up * Vec3::Z + out * outwards
    }

    fn sheet(self, from: [f32; 2], size: [f32; 2], out: f32, texture: Texture) -> Surface {
        matte(Shape::rectangle(self.at(from, out), self.right, Vec3::Z, size), texture)
    }

    fn block(self, from: [f32; 2], to: [f32; 2], out: f32, texture: Texture) -> Vec<Surface> {
        let (a, b) = (self.at(from, 0.0), self.at(to, out));
        block(a.min(b), a.max(b), texture)
    }

    /// A framed picture with a mount around it and a label to its right; `size` is that of the picture.
    fn picture(self, [x, y]: [f32; 2], [width, height]: [f32; 2], painting: Painting) -> Vec<Surface> {
        const MOUNT: f32 = 0.06;
        const FRAME: f32 = 0.035;
        const DEPTH: f32 = 0.04;
        let corner = |margin: f32| [x - 0.5 * width - margin, y - 0.5 * height - margin];
        let far = |margin: f32| [x + 0.5 * width + margin, y + 0.5 * height + margin];
        let wood = Texture::Plain(if painting == Painting::Arcs { BLACK } else { WALNUT });
        let (inner, outer) = (MOUNT, MOUNT + FRAME);
        let mount = Texture::Plain(paint(0xF4_F1_EA));
        let card = [0.12, 0.085];
        let mut parts = vec![
            self.sheet(corner(0.0), [width, height], 0.018, Texture::Picture(painting, [width, height])),
            self.sheet(corner(inner), [width + 2.0 * inner, height + 2.0 * inner], 0.015, mount),
            self.sheet([far(outer)[0] + 0.1, y - 0.4], card, 0.006, Texture::Label(card)),
        ];
        let bars = [
            (corner(outer), [far(outer)[0], corner(inner)[1]]),
            ([corner(outer)[0], far(inner)[1]], far(outer)),
            ([corner(outer)[0], corner(inner)[1]], [corner(inner)[0], far(inner)[1]]),
            ([far(inner)[0], corner(inner)[1]], [far(outer)[0], far(inner)[1]]),
        ];
        parts.extend(bars.into_iter().flat_map(|(from, to)| self.block(from, to, DEPTH, wood)));
        parts
    }
}

pub(crate) fn block(low: Vec3, high: Vec3, texture: Texture) -> Vec<Surface> {
    let size = high - low;
    let face = |x: f32, y: f32, z: f32, u: Vec3, v: Vec3| {
        let sides = [u.abs().dot(size), v.abs().dot(size)];
        matte(Shape::rectangle(Vec3::new(x, y, z), u, v, sides), texture)
    };
    vec![
        face(high.x, low.y, low.z, Vec3::Y, Vec3::Z),
        face(low.x, high.y, low.z, Vec3::NEG_Y, Vec3::Z),
        face(high.x, high.y, low.z, Vec3::NEG_X, Vec3::Z),
        face(low.x, low.y, low.z, Vec3::X, Vec3::Z),
        face(low.x, low.y, high.z, Vec3::X, Vec3::Y),
        face(low.x, high.y, low.z, Vec3::X, Vec3::NEG_Y),
    ]
}
