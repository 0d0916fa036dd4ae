"""A COLMAP scene whose photos are hidden in their right half, and one whose photos are cut there: both say the same.

    python tools/half_masks.py SCENE FOLDER

writes FOLDER/masked and FOLDER/cropped. What is hidden is painted magenta, so that a pixel that counts by mistake shows.
Needs Pillow, and a binary model whose cameras are PINHOLE.
"""

import shutil
import struct
import sys
from pathlib import Path

from PIL import Image, ImageDraw

PINHOLE = 1
CAMERA = struct.Struct("<IiQQ4d")  # identity, model, width, height, fx, fy, cx, cy


def halved(model: bytes) -> bytes:
    """cameras.bin with every camera's picture cut to its left half; the principal point stays where it is."""
    halves = [model[:8]]
    for camera in CAMERA.iter_unpack(model[8:]):
        identity, kind, width, *rest = camera
        if kind != PINHOLE:
            sys.exit(f"camera {identity} is no PINHOLE camera")
        halves.append(CAMERA.pack(identity, kind, width // 2, *rest))
    return b"".join(halves)


scene, masked, cropped = Path(sys.argv[1]), Path(sys.argv[2], "masked"), Path(sys.argv[2], "cropped")
for folder in [masked, cropped]:
    shutil.copytree(scene / "sparse", folder / "sparse")
    (folder / "images").mkdir()
(masked / "masks").mkdir()
cameras = next(cropped.glob("sparse/**/cameras.bin"))
cameras.write_bytes(halved(cameras.read_bytes()))

for photo in sorted((scene / "images").iterdir()):
    picture = Image.open(photo).convert("RGB")
    width, height = picture.size
    # Without loss, whatever the name says: a JPEG would bleed over the border.
    picture.crop([0, 0, width // 2, height]).save(cropped / "images" / photo.name, format="PNG")
    mask = Image.new("L", picture.size, 255)
    right = [width // 2, 0, width, height]
    ImageDraw.Draw(mask).rectangle(right, fill=0)
    ImageDraw.Draw(picture).rectangle(right, fill="magenta")
    mask.save(masked / "masks" / f"{photo.name}.png")
    picture.save(masked / "images" / photo.name, format="PNG")
