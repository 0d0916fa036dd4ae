"""A room whose walls and boxes wear real photos, and photos of it from known places, for tools/poses_pairs.py.

    python tools/room.py photos DATA FOLDER [COUNT [NUMBER,...]]    # 800x600 pixels in FOLDER/photos, 178 of them
    python tools/room.py compare FOLDER SPARSE                      # cameras that were found, of names as poses_pairs.py shuffles them

DATA holds castle, fern, plush, flowerpot and fox. A set of so many photos is not there; this one has as many features as real
photos of this size, look-alikes (each texture is worn by four things), noise and blur. Two rounds are walked about a table.
Needs numpy and pillow; `compare` needs pycolmap.
"""

import os
import random
import sys
from pathlib import Path

import numpy as np

WIDTH, HEIGHT, FOCAL_PX = 800, 600, 640.0
SCENES = ["castle", "fern", "plush", "flowerpot", "fox"]
NEAR = 0.05
# The room is 8 x 7 m, y from -2 to 1.2 m, which is down.
CORNER, SIDES = np.array([-4.0, -2.0, -3.5]), np.array([8.0, 3.2, 7.0])
# Of so many quads of walls and floor, three of five are out of focus.
OF_WALLS = 46


class Room:
    def __init__(self, data):
        from PIL import Image

        self.rng = np.random.default_rng(11)
        photos = []
        for scene in SCENES:
            names = sorted(os.listdir(data / scene / "images"))
            photos += [data / scene / "images" / name for name in names[:: max(1, len(names) // 8)][:8]]
        pyramids = [halved(Image.open(photo).convert("RGB")) for photo in photos]
        self.quads = []
        order = self.walls(len(pyramids))
        self.textures = [pyramids[i] for i in order]
        self.furnish()

    def quad(self, corner, u, v):
        number = len(self.quads)
        self.quads.append((corner, u, v, number % len(SCENES * 8), int(self.rng.integers(0, 4))))

    def wall(self, corner, u, v, columns, rows):
        for i in range(columns):
            for j in range(rows):
                self.quad(corner + u * i / columns + v * j / rows, u / columns, v / rows)

    def walls(self, textures):
        order = self.rng.permutation(textures)
        x, y, z = np.diag(SIDES)
        self.wall(CORNER, x, y, 5, 2)
        self.wall(CORNER + z, x, y, 5, 2)
        self.wall(CORNER, z, y, 4, 2)
        self.wall(CORNER + x, z, y, 4, 2)
        self.wall(CORNER + y, x, z, 5, 4)
        return order

    def furnish(self):
        rng = self.rng
        self.box((0, 1.2, 0), np.array([2.0, 0.75, 1.1]), 0.2)
        for k in range(9):
            place = (-0.8 + 0.4 * (k % 5) + rng.normal(0, 0.05), 0.45, (-0.25 if k < 5 else 0.25) + rng.normal(0, 0.04))
            self.box(place, rng.uniform(0.15, 0.32, 3) * [1, 1.4, 1], rng.uniform(0, 3))
        for k in range(12):
            angle, radius = 2 * np.pi * k / 12 + rng.normal(0, 0.1), rng.uniform(2.6, 3.1)
            place = (radius * np.cos(angle) * 1.15, 1.2, radius * np.sin(angle))
            self.box(place, rng.uniform(0.3, 0.8, 3) * [1, 1.6, 1], rng.uniform(0, 3))

    def box(self, bottom, size, angle):
        sin, cos = np.sin(angle), np.cos(angle)
        x, y, z = size[0] * np.array([cos, 0, -sin]), np.array([0, size[1], 0]), size[2] * np.array([sin, 0, cos])
        corner = np.array(bottom, float) - x / 2 - z / 2 - y
        for origin, u, v in [(corner, x, z), (corner, x, y), (corner + z, x, y), (corner, z, y), (corner + x, z, y)]:
            self.quad(origin, u, v)

    def pose(self, i, count):
        """Rows of the camera's axes in the world, and its centre."""
        rng, is_high = self.rng, i >= count // 2
        angle = 4 * np.pi * i / count + rng.normal(0, 0.01)
        radius = (2.15 if is_high else 1.75) + 0.15 * np.sin(5 * angle)
        height = (-0.75 if is_high else 0.1) + rng.normal(0, 0.05)
        centre = np.array([radius * np.cos(angle) * 1.1, height, radius * np.sin(angle) * 0.95])
        z = np.array([rng.normal(0, 0.25), 0.35 + rng.normal(0, 0.12), rng.normal(0, 0.25)]) - centre
        z /= np.linalg.norm(z)
        x = np.cross([0, 1.0, 0], z)
        x /= np.linalg.norm(x)
        y, roll = np.cross(z, x), rng.normal(0, 0.04)
        return np.stack([x * np.cos(roll) + y * np.sin(roll), y * np.cos(roll) - x * np.sin(roll), z]), centre

    def picture(self, axes, centre):
        """[HEIGHT, WIDTH, 3], 0 to 255."""
        x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
        rays = np.stack([x / FOCAL_PX, y / FOCAL_PX, np.ones_like(x)], -1).reshape(-1, 3)
        rays = rays.astype(np.float32) @ axes.astype(np.float32)
        depth, owner = np.full(len(rays), 1e9, np.float32), np.full(len(rays), -1)
        at = np.zeros((len(rays), 2), np.float32)
        for number, (corner, u, v, *_) in enumerate(self.quads):
            hit(rays, (corner, u, v), axes, centre, number, depth, owner, at)
        picture = np.zeros((len(rays), 3), np.float32)
        for number in np.unique(owner[owner >= 0]):
            seen = np.nonzero(owner == number)[0]
            picture[seen] = self.colours(number, rays[seen], depth[seen], at[seen])
        return picture.reshape(HEIGHT, WIDTH, 3)

    def colours(self, number, rays, depth, at):
        _, u, v, texture, turned = self.quads[number]
        levels = self.textures[texture]
        height, width = levels[0].shape[:2]
        normal = np.cross(u, v)
        normal /= np.linalg.norm(normal)
        slant = np.abs(rays @ normal.astype(np.float32)) / np.linalg.norm(rays, axis=1)
        texels = max(width / np.linalg.norm(u), height / np.linalg.norm(v)) * depth / FOCAL_PX / np.sqrt(np.maximum(slant, 0.05))
        level = np.rint(np.clip(np.log2(np.maximum(texels, 1)), 0, len(levels) - 1)).astype(int)
        level = np.maximum(level, 5 if number < OF_WALLS and number % 5 < 3 else 0)
        a, b = (1 - at[:, k] if turned >> k & 1 else at[:, k] for k in (0, 1))
        colours = np.zeros((len(rays), 3), np.float32)
        for which in np.unique(level):
            of_level = level == which
            colours[of_level] = between(levels[which], a[of_level], b[of_level])
        return colours * (0.55 + 0.45 * abs(normal @ [0.3, 0.8, 0.5]))


def hit(rays, quad, axes, centre, number, depth, owner, at):
    """Where the quad is what a ray meets first."""
    corner, u, v = quad
    corners = (np.array([corner, corner + u, corner + v, corner + u + v]) - centre) @ axes.T
    if (corners[:, 2] < NEAR).all():
        return
    some = np.arange(len(rays))
    if (corners[:, 2] > NEAR).all():
        pixels = corners[:, :2] / corners[:, 2:] * FOCAL_PX + [WIDTH / 2, HEIGHT / 2]
        (x0, y0) = np.maximum(0, pixels.min(0).astype(int) - 1)
        (x1, y1) = np.minimum((WIDTH, HEIGHT), pixels.max(0).astype(int) + 2)
        if x0 >= x1 or y0 >= y1:
            return
        some = (np.arange(y0, y1)[:, None] * WIDTH + np.arange(x0, x1)).ravel()
    normal = np.cross(u, v)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.float32(normal @ (corner - centre)) / (rays[some] @ normal.astype(np.float32))
        place = rays[some] * away[:, None] + (centre - corner).astype(np.float32)
        a, b = (place @ (side / (side @ side)).astype(np.float32) for side in (u, v))
        first = (away > NEAR) & (away < depth[some]) & (a >= 0) & (a < 1) & (b >= 0) & (b < 1)
    met = some[first]
    depth[met], owner[met], at[met] = away[first], number, np.stack([a, b], 1)[first]


def halved(photo):
    levels = [np.asarray(photo, np.float32)]
    while min(photo.size) > 8:
        photo = photo.resize([side // 2 for side in photo.size], 4)
        levels.append(np.asarray(photo, np.float32))
    return levels


def between(texture, a, b):
    height, width = texture.shape[:2]
    x, y = np.clip(a * width - 0.5, 0, width - 1.001), np.clip(b * height - 0.5, 0, height - 1.001)
    left, top = x.astype(int), y.astype(int)
    right, low = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    x, y = (x - left)[:, None], (y - top)[:, None]
    upper, lower = (texture[row, left] * (1 - x) + texture[row, right] * x for row in (top, low))
    return upper * (1 - y) + lower * y


def photos(data, folder, count=178, numbers=None):
    from PIL import Image, ImageFilter

    room = Room(Path(data))
    poses = [room.pose(i, int(count)) for i in range(int(count))]
    folder = Path(folder) / "photos"
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder.with_name("poses.npz"), axes=[axes for axes, _ in poses], centres=[centre for _, centre in poses])
    for i in range(len(poses)) if numbers is None else map(int, numbers.split(",")):
        rng = np.random.default_rng(i)
        sharp = Image.fromarray(np.clip(room.picture(*poses[i]), 0, 255).astype(np.uint8))
        seen = np.asarray(sharp.filter(ImageFilter.GaussianBlur(0.9)), np.float32)
        seen = seen * (1 + rng.normal(0, 0.04)) + rng.normal(0, 1.5, seen.shape)
        Image.fromarray(np.clip(seen, 0, 255).astype(np.uint8)).save(folder / f"{i:03}.jpg", quality=92)


def compare(folder, sparse):
    import pycolmap

    centres = np.load(Path(folder) / "poses.npz")["centres"]
    places = list(range(len(centres)))
    random.Random(3).shuffle(places)
    number = {f"{place:03}.jpg": i for i, place in enumerate(places)}
    model = pycolmap.Reconstruction(sparse)
    images = [image for image in model.images.values() if image.has_pose]
    found = np.array([image.projection_center() for image in images])
    true = centres[[number[image.name] for image in images]]
    a, b = found - found.mean(0), true - true.mean(0)
    u, s, v = np.linalg.svd(b.T @ a)
    turn = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    off = np.linalg.norm((s * np.diag(turn)).sum() / (a**2).sum() * a @ (u @ turn @ v).T - b, axis=1)
    print(f"{len(off)} of {len(centres)} cameras; they are off by {1e3 * np.median(off):.2f} mm, at most {1e3 * off.max():.2f}")


{"photos": photos, "compare": compare}[sys.argv[1]](*sys.argv[2:])
