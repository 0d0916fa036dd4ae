"""Reconstruct a scene from photos as 3D Gaussian splats, without CUDA, torch or a compiler.

::

    import genesplat as gs

    scene = gs.Scene.load("fox")               # COLMAP, nerfstudio, instant-ngp or Blender
    trainer = gs.Trainer(scene, iterations=2000)
    for step in trainer:
        print(step.iteration, step.loss, step.gaussians)
    print(trainer.evaluate().psnr)
    trainer.save("fox.spz")

=====================  ======================================================================
`Scene`                photos with cameras, loaded from a folder or from pycolmap
`gallery`              the bundled scene, for who has no photos at hand
`poses`                cameras of photos that have none (extra ``poses``)
`Trainer`, `train`     training as a loop, or in one call
`Splats`               Gaussians as NumPy arrays, with gsplat's names and shapes; every file format
`render`               pictures of splats as NumPy arrays
`evaluate`             PSNR, SSIM and LPIPS on photos
`genetic_search`       the genetic search of "An Evolutionary Boost to Gaussian Splatting
                       Optimization", on splats of any trainer
`genesplat.torch`      a differentiable rasteriser with gsplat's arguments, for PyTorch
`genesplat.strategy`   density control with the interface of gsplat's strategies, for PyTorch
`use_threads`          how many processor threads all of this takes
`Error`                what is raised where something goes wrong: one sentence with what to do
=====================  ======================================================================

**Frames.**  World coordinates are those of the scene (COLMAP's: y down, z forward in a camera);
``viewmats`` are camera from world, ``Ks`` in pixels with the first pixel's centre at (0.5, 0.5), as
gsplat has them. Lengths are world units.

**Errors.**  Arguments that cannot be are `ValueError`; all else is `genesplat.Error`. Notices go to the
logger ``genesplat`` of `logging`: those that matter as warnings, others at the level ``INFO``.

**Ctrl-C** ends training, searches and scores, and is raised as `KeyboardInterrupt` once what there is has
been saved. Work runs without the interpreter's lock.
"""

from __future__ import annotations

from genesplat._evaluate import Scores, ViewScore, evaluate
from genesplat._native import Error, __version__
from genesplat._poses import Poses, poses
from genesplat._render import render
from genesplat._scene import Scene, View, gallery
from genesplat._search import SearchResult, genetic_search
from genesplat._splats import Splats
from genesplat._threads import use_threads
from genesplat._trainer import Step, Trainer, train

__all__ = [
    "Error",
    "Poses",
    "Scene",
    "Scores",
    "SearchResult",
    "Splats",
    "Step",
    "Trainer",
    "View",
    "ViewScore",
    "__version__",
    "evaluate",
    "gallery",
    "genetic_search",
    "poses",
    "render",
    "train",
    "use_threads",
]

# Where help, errors and pickles say that they are.
for _name in __all__:
    if _name != "__version__":
        globals()[_name].__module__ = "genesplat"
del _name
