from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any, Optional

from genesplat import _native
from genesplat._command import use_this_python
from genesplat._types import StrPath


@dataclass(frozen=True)
class Poses:
    """Cameras that were found.

    Attributes:
        path: The scene, for `Scene.load`.
        photos: How many were given.
        registered: How many have a camera.
        points: Points of the sparse reconstruction.
        reprojection_error_px: Mean error of the points, pixels.
        left_out: Names of the photos without a camera.
    """

    path: str
    photos: int
    registered: int
    points: int
    reprojection_error_px: Optional[float]
    left_out: list[str] = field(repr=False)


def poses(photos: StrPath, out: StrPath, *, frames: Optional[int] = None, all_pairs: bool = False) -> Poses:
    """Find the cameras of photos that have none, by pycolmap (the extra ``poses``).

    Args:
        photos: A folder of photos, a video, or a ZIP of one.
        out: A folder for the scene. A search that was stopped goes on there.
        frames: How many photos are taken from a video; 120 by default.
        all_pairs: Compare each photo with each other, however many there are; by default, of up to 150.

    Raises:
        Error: Nobody on this machine finds cameras, or none are found: why, and what to do.
        KeyboardInterrupt: After Ctrl-C.
    """
    use_this_python()
    found: dict[str, Any] = json.loads(_native.poses(photos, out, frames, all_pairs))
    names = ["photos", "registered", "points", "reprojection_error_px", "left_out"]
    return Poses(os.fspath(out), **{name: found[name] for name in names})
