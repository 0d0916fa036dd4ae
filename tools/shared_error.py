"""How much of the error on test photos is the same in all runs, and how much is each run's own.

    python tools/shared_error.py RUN RUN [RUN...]

The runs differ in their seed, or in little else, and have the same test photos. Pictures of many runs can be averaged; what
error is left then no choice among what such runs find can take away. Needs numpy and Pillow.
"""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

runs = [Path(name) for name in sys.argv[1:]]
if len(runs) < 2:
    sys.exit(__doc__)
errors, own = [], []
for photo in json.loads((runs[0] / "metrics.json").read_text())["test"]["views"]:
    name, renders = photo["name"], []
    for run in runs:
        views = json.loads((run / "metrics.json").read_text())["test"]["views"]
        psnr = next(view["psnr"] for view in views if view["name"] == name)
        errors.append(10 ** (-psnr / 10))
        picture = Image.open((run / "test" / name).with_suffix(".png")).convert("RGB")
        renders.append(np.asarray(picture, float) / 255)
    # Unbiased, so that it does not depend on the number of runs.
    own.append(np.var(renders, axis=0, ddof=1).mean())
in_db = lambda error: -10 * np.log10(error)
one, apart = np.mean(errors), np.mean(own)
print(f"one run                        {in_db(one):.2f} dB (of the mean squared error)")
print(f"mean picture of {len(runs):<3} runs       {in_db(one - apart * (1 - 1 / len(runs))):.2f} dB")
print(f"mean picture of all such runs  {in_db(one - apart):.2f} dB")
print(f"own part of a run's error      {apart / one:.0%}")
