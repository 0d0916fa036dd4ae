"""Writes HEIC photos as JPEG, upright, with their EXIF data. The only argument is a JSON file of pairs: from where, to where."""

import json
import os
import sys

import pillow_heif
from PIL import Image

pillow_heif.register_heif_opener()
with open(sys.argv[1], encoding="utf-8") as pairs:
    jobs = json.load(pairs)
for done, (source, place) in enumerate(jobs, 1):
    if not os.path.exists(place):
        os.makedirs(os.path.dirname(place), exist_ok=True)
        photo = Image.open(source)
        exif = photo.info.get("exif") or b""
        # Of a name that nothing has: no link is followed, and what is left by a process that was killed is known as ours.
        part = os.path.join(os.path.dirname(place), f".genesplat-{os.getpid()}-{done}.tmp")
        if os.path.lexists(part):
            os.remove(part)
        with open(part, "xb") as file:
            photo.convert("RGB").save(file, "JPEG", quality=97, subsampling=0, exif=exif)
        os.replace(part, place)
    print(done, flush=True)
