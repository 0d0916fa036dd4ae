from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from typing import Any, Optional, Union

from genesplat import _native
from genesplat._scene import Scene
from genesplat._splats import Splats
from genesplat._types import StrPath


@dataclass(frozen=True)
class ViewScore:
    """How well one photo is reproduced.

    Attributes:
        name: File name of the photo.
        psnr: Peak signal-to-noise ratio, dB; higher is better.
        ssim: Structural similarity, at most 1.
        lpips: Perceptual distance (VGG16), lower is better; None where it was not measured.
    """

    name: str
    psnr: float
    ssim: float
    lpips: Optional[float] = None


@dataclass(frozen=True)
class Scores:
    """Means over photos, and the scores of each; the means of no photos are NaN.

    Attributes:
        psnr: Mean peak signal-to-noise ratio, dB.
        ssim: Mean structural similarity.
        lpips: Mean perceptual distance; None where it was not measured.
        views: One entry a photo.
    """

    psnr: float
    ssim: float
    lpips: Optional[float] = None
    views: list[ViewScore] = field(default_factory=list, repr=False)

    @staticmethod
    def _of(text: str) -> Scores:
        found: dict[str, Any] = json.loads(text)
        views = [ViewScore(**view) for view in found["views"]]
        psnr, ssim = (math.nan if found[name] is None else found[name] for name in ("psnr", "ssim"))
        return Scores(psnr, ssim, found["lpips"], views)


def evaluate(
    what: Union[Splats, StrPath],
    scene: Union[Scene, StrPath, None] = None,
    *,
    split: str = "test",
    lpips: Union[bool, StrPath] = False,
    device: str = "auto",
) -> Scores:
    """Scores of renders against photos, as the field has them: on 8-bit pictures.

    Args:
        what: Splats, a file of splats, or the folder of a run.
        scene: The photos. The folder of a run knows its own; they are loaded as they were for the run.
        split: "test", the photos that training never saw, or "train".
        lpips: True to measure LPIPS with the weights that `genesplat evaluate --install-lpips` has
            installed, or a path of weights.
        device: "auto", "cpu", "gpu" or "gpu:N".

    Raises:
        ValueError: `scene` is missing, or `split` is something else.
        Error: Photos, weights or the device cannot be used.
    """
    if split not in ("test", "train"):
        raise ValueError(f'split is {split!r}; give "test" or "train"')
    weights: Optional[StrPath] = {True: "", False: None}[lpips] if isinstance(lpips, bool) else lpips
    if isinstance(what, Splats):
        if scene is None:
            raise ValueError("splats do not say which scene they show; give a scene")
        loaded = scene if isinstance(scene, Scene) else Scene.load(scene)
        return Scores._of(_native.evaluate(what._cloud(), loaded._native, split, weights, device))
    data = scene.path if isinstance(scene, Scene) else scene
    path = os.fspath(what)
    return Scores._of(_native.evaluate_run(path, data, split, weights, device))
