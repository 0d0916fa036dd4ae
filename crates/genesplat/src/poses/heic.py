"""Writes HEIC photos as JPEG, upright, with their EXIF data. The only argument is a JSON file of pairs: from where, to where."""

import json
import os
import sys

import pillow_heif
from PIL import Image

pillow_heif.register_heif_opener()
with open(sys.argv[1], encoding="utf-8") as pairs:
    jobs = json.load(pairs)


def write_jpeg(source, place, number):
    os.makedirs(os.path.dirname(place), exist_ok=True)
    photo = Image.open(source)
    exif = photo.info.get("exif") or b""
    upright = photo.convert("RGB")
    # Of a name that nothing has: no link is followed, and what is left by a process that was killed is known as ours.
    part = os.path.join(os.path.dirname(place), f".genesplat-{os.getpid()}-{number}.tmp")
    if os.path.lexists(part):
        os.remove(part)
    with open(part, "xb") as file:
        upright.save(file, "JPEG", quality=97, subsampling=0, exif=exif)
    os.replace(part, place)


for done, (source, place) in enumerate(jobs, 1):
    if not os.path.exists(place):
        try:
            write_jpeg(source, place, done)
        except (Image.UnidentifiedImageError, EOFError, RuntimeError, SyntaxError, ValueError) as error:
            # The photo is damaged; what the disk refuses is another matter, and ends this.
            print(json.dumps({"damaged": source, "why": str(error)}), flush=True)
    print(done, flush=True)
