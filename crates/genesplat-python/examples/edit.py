"""Load a splat, edit its arrays, and save it: python edit.py SCENE [ITERATIONS]."""

import sys

import genesplat as gs

scene = gs.Scene.load(sys.argv[1])
splats = gs.train(scene, iterations=int(sys.argv[2]) if len(sys.argv) > 2 else 500)
splats.save("before.ply")

splats = gs.Splats.load("before.ply")
splats = splats[splats.opacities > 0.05]
splats.means += [0, 0, 1]
splats.log_scales -= 0.1
splats.shN[:] = 0
splats.save("after.spz")
