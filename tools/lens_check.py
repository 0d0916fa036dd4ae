"""Trains on photos with a lens, and on what COLMAP's undistorter makes of them: the scores should be the same.

    python tools/lens_check.py GENESPLAT DATA FOLDER [SIDE [ITERATIONS [SEED...]]]

DATA holds fox_transforms, whose photos have an OPENCV lens, and fox, whose points start all runs. The photos of the fisheye
are made from the undistorted ones. Needs pycolmap and numpy; what is in FOLDER already is not done again.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap

pycolmap.logging.minloglevel = pycolmap.logging.Level.WARNING

genesplat, data, folder = (Path(name).resolve() for name in sys.argv[1:4])
side, iterations, *seeds = sys.argv[4:] or ["480", "2000"]
seeds = seeds or ["1", "2"]
LENS = ["fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"]
# As of a strong phone lens: radians to radians, by powers of the angle.
FISHEYE = [0.05, -0.03, 0.02, -0.01]
# So much longer than the pinhole's is the fisheye's focal length: its photos then show nothing but the pinhole's.
LONGER = 1.25


def read_list():
    """The transforms.json of the photos that exist."""
    source = data / "fox_transforms"
    transforms = json.loads((source / "transforms.json").read_text())
    frames = [frame for frame in transforms["frames"] if (source / frame["file_path"]).exists()]
    return dict(transforms, frames=frames)


def points_of(frames):
    """The points of fox in the frame of these cameras, by the similarity that brings the centres together (Umeyama)."""
    model = pycolmap.Reconstruction(data / "fox/sparse/0")
    centres = {image.name: image.projection_center() for image in model.images.values()}
    pairs = [(centres[Path(frame["file_path"]).name], np.array(frame["transform_matrix"])[:3, 3]) for frame in frames]
    theirs, ours = (np.array(side) for side in zip(*pairs))
    a, b = theirs - theirs.mean(0), ours - ours.mean(0)
    u, sizes, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    scale = sizes.sum() / (a**2).sum()
    print(f"centres agree to {np.abs(scale * a @ rotation.T - b).max() / np.abs(b).max():.1%} of their extent")
    place = lambda xyz: scale * rotation @ (xyz - theirs.mean(0)) + ours.mean(0)
    return [(place(point.xyz), point.color) for point in model.points3D.values()]


def write_colmap(transforms, points, target):
    """COLMAP's text, and the photos as PNG: the undistorter writes photos as it finds them, and a JPEG would lose by that."""
    (target / "sparse/0").mkdir(parents=True, exist_ok=True)
    (target / "images").mkdir(exist_ok=True)
    lens = " ".join(repr(transforms[key]) for key in LENS)
    (target / "sparse/0/cameras.txt").write_text(f"1 OPENCV {transforms['w']:.0f} {transforms['h']:.0f} {lens}\n")
    lines = []
    for number, frame in enumerate(transforms["frames"], 1):
        # OpenGL's axes: y up, z back.
        matrix = np.array(frame["transform_matrix"])[:3] * [1, -1, -1, 1]
        pose = pycolmap.Rigid3d(matrix).inverse()
        x, y, z, w = pose.rotation.quat
        name = Path(frame["file_path"]).stem + ".png"
        numbers = " ".join(repr(float(n)) for n in [w, x, y, z, *pose.translation])
        lines.append(f"{number} {numbers} 1 {name}\n\n")
        if not (target / "images" / name).exists():
            photo = pycolmap.Bitmap.read(str(data / "fox_transforms" / frame["file_path"]), True)
            photo.write(str(target / "images" / name))
    (target / "sparse/0/images.txt").write_text("".join(lines))
    rows = (f"{n} {x} {y} {z} {r} {g} {b} 0\n" for n, ((x, y, z), (r, g, b)) in enumerate(points, 1))
    (target / "sparse/0/points3D.txt").write_text("".join(rows))


def write_transforms(transforms, points, target):
    """The same with the lens as fox_transforms has it, and the points as a PLY."""
    target.mkdir(exist_ok=True)
    if not (target / "images").exists():
        os.symlink("../opencv/images", target / "images")
    frames = [dict(frame, file_path=Path(frame["file_path"]).with_suffix(".png").as_posix()) for frame in transforms["frames"]]
    (target / "transforms.json").write_text(json.dumps(dict(transforms, frames=frames, ply_file_path="points.ply")))
    names = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"]
    header = "".join(f"property {name}\n" for name in names)
    rows = "".join(f"{x} {y} {z} {r} {g} {b}\n" for (x, y, z), (r, g, b) in points)
    ply = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{header}end_header\n{rows}"
    (target / "points.ply").write_text(ply)


def undistort(scene, target):
    if not target.exists():
        new = target.with_name(target.name + "-new")
        pycolmap.undistort_images(str(new), str(scene / "sparse/0"), str(scene / "images"))
        new.rename(target)


def cubic(t):
    return np.stack([-t * (1 - t) ** 2, (3 * t - 5) * t * t + 2, (3 * (1 - t) - 5) * (1 - t) ** 2 + 2, -(1 - t) * t * t]) / 2


def sample(picture, x, y):
    """The picture between its pixels, whose centres are at whole numbers."""
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    total = 0
    for down, weight_y in enumerate(cubic(y - top)):
        for across, weight_x in enumerate(cubic(x - left)):
            row = np.clip(top + down - 1, 0, picture.shape[0] - 1)
            column = np.clip(left + across - 1, 0, picture.shape[1] - 1)
            total += (weight_x * weight_y)[..., None] * picture[row, column]
    return np.clip(total + 0.5, 0, 255).astype(np.uint8)


def write_fisheye(scene, target):
    """The photos of a pinhole as a fisheye takes them."""
    if target.exists():
        return
    new = target.with_name(target.name + "-new")
    (new / "sparse/0").mkdir(parents=True, exist_ok=True)
    (new / "images").mkdir(exist_ok=True)
    model = pycolmap.Reconstruction(scene / "sparse")
    (camera,) = model.cameras.values()
    fx, fy, cx, cy = camera.params
    focal = LONGER * fx
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    x, y = (u - cx) / focal, (v - cy) / focal
    bent = np.hypot(x, y)
    angle = bent.copy()
    for _ in range(20):
        series = sum(k * angle ** (2 * power) for power, k in enumerate(FISHEYE, 1))
        angle = bent / (1 + series)
    scale = np.tan(angle) / np.maximum(bent, 1e-12)
    at_x, at_y = scale * x * fx + cx - 0.5, scale * y * fy + cy - 0.5
    assert at_x.min() > 0 and at_y.min() > 0 and at_x.max() < camera.width - 1 and at_y.max() < camera.height - 1
    for photo in sorted((scene / "images").iterdir()):
        picture = pycolmap.Bitmap.read(str(photo), True).to_array()
        pycolmap.Bitmap.from_array(sample(picture, at_x, at_y)).write(str(new / "images" / photo.name))
    model.write_text(new / "sparse/0")
    numbers = " ".join(map(repr, [float(n) for n in [focal, focal, cx, cy, *FISHEYE]]))
    line = f"{camera.camera_id} OPENCV_FISHEYE {camera.width} {camera.height} {numbers}\n"
    (new / "sparse/0/cameras.txt").write_text(line)
    new.rename(target)


def psnr(scene, seed):
    out = folder / "runs" / f"{scene}-{side}-{iterations}-{seed}"
    if not (out / "metrics.json").exists():
        size = ["--max-side", side, "--iterations", iterations, "--seed", seed]
        options = [*size, "--method", "3dgs", "--device", "cpu", "--no-lpips", "--quiet"]
        subprocess.run([genesplat, "train", folder / scene, "--out", out, *options], check=True, stdout=subprocess.DEVNULL)
    return json.loads((out / "metrics.json").read_text())["test"]["psnr"]


folder.mkdir(parents=True, exist_ok=True)
transforms = read_list()
points = points_of(transforms["frames"])
write_colmap(transforms, points, folder / "opencv")
write_transforms(transforms, points, folder / "transforms")
undistort(folder / "opencv", folder / "opencv-undistorted")
write_fisheye(folder / "opencv-undistorted", folder / "fisheye")
undistort(folder / "fisheye", folder / "fisheye-undistorted")
print("| photos | seed | with the lens, dB | undistorted by COLMAP, dB | difference |\n|---|---|---|---|---|")
for seed in seeds:
    for lens, pinhole in [("opencv", "opencv"), ("transforms", "opencv"), ("fisheye", "fisheye")]:
        bent, straight = psnr(lens, seed), psnr(f"{pinhole}-undistorted", seed)
        print(f"| {lens} | {seed} | {bent:.2f} | {straight:.2f} | {bent - straight:+.2f} |", flush=True)
