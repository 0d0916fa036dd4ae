"""Render a test view as an array, and measure it: python render_to_numpy.py SCENE [ITERATIONS]."""

import sys

import genesplat as gs
import numpy as np

scene = gs.Scene.load(sys.argv[1])
splats = gs.train(scene, iterations=int(sys.argv[2]) if len(sys.argv) > 2 else 500)

view = scene.test[0]
picture = gs.render(splats, view.viewmat, view.K, view.width, view.height)[0]
error = np.mean((picture.clip(0, 1) - view.image / 255) ** 2)
print(f"{view.name}: {picture.shape}, {-10 * np.log10(error):.2f} dB")
