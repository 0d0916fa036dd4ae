"""Finds cameras of photos whose names say nothing, by pairs that are chosen and by all pairs, and tells what each costs.

    python tools/poses_pairs.py GENESPLAT PHOTOS FOLDER [COUNT [chosen|all|both]]

Of PHOTOS, the first COUNT by name are copied to FOLDER under shuffled names (one seed). A line of CSV is printed for each search:
processor seconds are those of all its processes, so that a busy machine does not matter. GENESPLAT_PYTHON names a Python with
pycolmap. What is in FOLDER already is not done again.
"""

import json
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

genesplat, photos, folder = (Path(name).resolve() for name in sys.argv[1:4])
count, which = (sys.argv[4:] + ["1000000", "both"][len(sys.argv) - 4 :])[:2]
SEARCHES = {"chosen": [], "all": ["--all-pairs"]}
STAGES = ["features", "matches", "cameras"]


def shuffled():
    names = sorted(os.listdir(photos))[: int(count)]
    places = list(range(len(names)))
    random.Random(3).shuffle(places)
    target = folder / f"photos-{len(names)}"
    target.mkdir(parents=True, exist_ok=True)
    for name, place in zip(names, places):
        shutil.copyfile(photos / name, target / f"{place:03}{Path(name).suffix.lower()}")
    return target, len(names)


def search(source, number, name):
    scene = folder / f"{name}-{number}"
    subprocess.run([genesplat, "poses", source, "--out", scene, *SEARCHES[name]], check=True, stdout=subprocess.DEVNULL)
    found = json.loads((scene / "poses/summary.json").read_text())
    figures = [found["compared"]["pairs"], found["registered"], found["points"], f"{found['reprojection_error_px']:.3f}"]
    spent = seconds(scene / "poses/engine.log")
    print(",".join(map(str, [number, name, *figures, *(spent.get(stage, "") for stage in STAGES)])), flush=True)


def seconds(log):
    """Processor seconds of each stage, as the stages have said it."""
    said = (line.partition(": ")[2] for line in log.read_text().splitlines() if "processor_seconds" in line)
    return {line["stage"]: line["processor_seconds"] for line in map(json.loads, said)}


source, number = shuffled()
print("photos,pairs_of,pairs,cameras,points,error_px," + ",".join(f"{stage}_cpu_s" for stage in STAGES), flush=True)
for name in SEARCHES if which == "both" else [which]:
    search(source, number, name)
