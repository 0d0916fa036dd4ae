"""A COLMAP scene whose photos are hidden in their right half, for training beside the whole one: both are scored on what is left.

    python tools/half_masks.py SCENE FOLDER

What is hidden is painted magenta, so that a pixel that counts by mistake shows. Needs Pillow.
"""

import shutil
import sys
from pathlib import Path

from PIL import Image, ImageDraw

scene, folder = map(Path, sys.argv[1:])
shutil.copytree(scene / "sparse", folder / "sparse")
for name in ["images", "masks"]:
    (folder / name).mkdir()
for photo in sorted((scene / "images").iterdir()):
    picture = Image.open(photo).convert("RGB")
    width, height = picture.size
    right = [width // 2, 0, width, height]
    mask = Image.new("L", picture.size, 255)
    ImageDraw.Draw(mask).rectangle(right, fill=0)
    ImageDraw.Draw(picture).rectangle(right, fill="magenta")
    mask.save(folder / "masks" / f"{photo.name}.png")
    # Without loss, whatever the name says: a JPEG would bleed over the border.
    picture.save(folder / "images" / photo.name, format="PNG")
