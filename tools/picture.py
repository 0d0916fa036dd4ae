#!/usr/bin/env python3
"""Makes README's picture: a held-out photo, a published method and ours, and crops of where they differ most.

    genesplat train plush --out PUBLISHED --method 3dgs --iterations 7000 --max-side 480 --corrections off
    genesplat train plush --out OURS --iterations 7000 --max-side 480 --corrections off
    tools/picture.py plush/images PUBLISHED OURS docs/images/plush.jpg [NAME]

NAME is the photo, without its ending; without it the one on which ours gains most is taken. Needs pillow and numpy.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

# Size of a crop in the render, px, and how many there are.
CROP, CROPS = (80, 60), 2
GAP, BAR = 6, 26
LABELS = ["photo that training never saw", "3DGS, as published", "genesplat"]
COLOURS = ["#e8b000", "#00a8e8"]


def main() -> None:
    if len(sys.argv) not in (5, 6):
        sys.exit(__doc__)
    photos, published, ours, out = map(Path, sys.argv[1:5])
    names = sys.argv[5:] or [path.stem for path in sorted((ours / "test").glob("*.png"))]
    triples = {name: load(photos, published, ours, name) for name in names}
    gains = {name: psnr(truth, b) - psnr(truth, a) for name, (truth, a, b) in triples.items()}
    for name, gain in sorted(gains.items(), key=lambda pair: pair[1]):
        print(f"{name}: {gain:+.2f} dB")
    picture(triples[max(gains, key=gains.get)]).save(out, quality=90)
    print(f"{out}: {out.stat().st_size:,} bytes")


def load(photos: Path, published: Path, ours: Path, name: str):
    """Truth, published and ours, of one size."""
    renders = [Image.open(run / f"test/{name}.png").convert("RGB") for run in (published, ours)]
    photo = next(path for path in photos.iterdir() if name in (path.stem, path.name))
    return [Image.open(photo).convert("RGB").resize(renders[0].size, Image.Resampling.BICUBIC), *renders]


def squares(a, b):
    return ((np.asarray(a, float) - np.asarray(b, float)) ** 2).mean(axis=2)


def psnr(a, b) -> float:
    return 10 * np.log10(255**2 / squares(a, b).mean())


def places(triple) -> list[tuple[int, int]]:
    """Corners of the crops in which ours gains most, which do not overlap."""
    truth, published, ours = triple
    gain = np.pad(squares(truth, published) - squares(truth, ours), ((1, 0), (1, 0))).cumsum(0).cumsum(1)
    width, height = CROP
    sums = gain[height:, width:] - gain[:-height, width:] - gain[height:, :-width] + gain[:-height, :-width]
    found = []
    for _ in range(CROPS):
        y, x = np.unravel_index(sums.argmax(), sums.shape)
        found.append((int(x), int(y)))
        sums[max(0, y - height) : y + height, max(0, x - width) : x + width] = -np.inf
    return found


def picture(triple) -> Image.Image:
    """Three columns: a label, the picture, its crops below."""
    width, height = triple[0].size
    crop_width = (width - GAP * (CROPS - 1)) // CROPS
    crop_height = crop_width * CROP[1] // CROP[0]
    sheet = Image.new("RGB", (3 * width + 2 * GAP, BAR + height + GAP + crop_height), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=17)
    corners = places(triple)
    for column, (label, image) in enumerate(zip(LABELS, triple)):
        left = column * (width + GAP)
        draw.text((left + 2, 2), label, fill="black", font=font)
        sheet.paste(image, (left, BAR))
        for nth, (x, y) in enumerate(corners):
            box = (x, y, x + CROP[0], y + CROP[1])
            crop = image.crop(box).resize((crop_width, crop_height), Image.Resampling.LANCZOS)
            at = (left + nth * (crop_width + GAP), BAR + height + GAP)
            sheet.paste(crop, at)
            frame = (*at, at[0] + crop_width - 1, at[1] + crop_height - 1)
            draw.rectangle(frame, outline=COLOURS[nth], width=3)
            draw.rectangle((left + x, BAR + y, left + box[2], BAR + box[3]), outline=COLOURS[nth], width=2)
    return sheet


if __name__ == "__main__":
    main()
