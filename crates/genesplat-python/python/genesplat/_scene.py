from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Optional, Union

from genesplat import _native
from genesplat._types import StrPath

if TYPE_CHECKING:
    from genesplat._types import Float64, UInt8


@dataclass(frozen=True, eq=False)
class View:
    """A photo and its camera, as training sees them: undistorted, and reduced where the photo was too large.

    Attributes:
        name: File name of the photo.
        viewmat: Camera from world ``[4, 4]`` (float64); x right, y down, z forward.
        K: Pinhole intrinsics in pixels ``[3, 3]`` (float64).
        width: Pixels.
        height: Pixels.
    """

    name: str
    viewmat: Float64 = field(repr=False)
    K: Float64 = field(repr=False)
    width: int
    height: int
    _place: tuple[_native.Scene, str, int] = field(repr=False)

    @property
    def image(self) -> UInt8:
        """The photo, RGB ``[height, width, 3]`` (uint8); read anew each time."""
        scene, split, index = self._place
        return scene.photo(split, index)


class Scene:
    """Photos with cameras, split for training and testing, and the points to start from.

    Load one with `Scene.load` or `Scene.from_pycolmap`.

    Attributes:
        name: Of the scene's folder.
        path: The scene's folder.
        background: Colour behind transparent photos: "black" or "white".
    """

    name: str
    path: str
    background: str

    def __init__(self, native: _native.Scene) -> None:
        self._native = native
        self.name = native.name
        self.path = native.path
        self.background = native.background

    @classmethod
    def load(
        cls,
        path: StrPath,
        *,
        images: Optional[StrPath] = None,
        max_side: Optional[int] = None,
        downscale: Optional[int] = None,
        hold_out: Union[int, str, Sequence[str], None] = None,
        mask: str = "usual",
        near: Optional[float] = None,
        corrections: str = "auto",
        depth: str = "auto",
        background: str = "black",
        seed: int = 0,
    ) -> Scene:
        """Load a scene: a folder of COLMAP, nerfstudio, instant-ngp or Blender.

        Photos above 1 GiB in all are kept in a file without a name in the folder of temporary files.

        Args:
            path: The scene's folder.
            images: Folder of a COLMAP scene's photos, below `path` or anywhere; ``images`` by default.
            max_side: Photos are reduced to this longest side, pixels. By default only widths above 1600 are
                reduced, to 1600.
            downscale: Or both sides are divided by this.
            hold_out: Which photos are for testing. By default those that the scene names, or every eighth; a
                number for another interval, a list of names, or "none".
            mask: What masks and transparency mean: "usual", "ignore", "transparent" or "off".
            near: Near plane of all cameras, world units.
            corrections: "on" brings photos to one exposure before training (COLMAP scenes), "auto" where that is
                worth it and the training has a folder, "off" never.
            depth: Whether depth maps train shapes, where the scene has them: "on", "off", or "auto" for where
                the method is ours.
            background: Behind transparent photos: "black" or "white".
            seed: Of the random points that a scene without points starts from.

        Raises:
            ValueError: An argument cannot be.
            Error: The scene cannot be read: which file, why, what to do.
        """
        dataset = {
            "path": os.fspath(path),
            "images": None if images is None else os.fspath(images),
            "max_side": max_side,
            "downscale": downscale,
            "near": near,
            "mask": mask,
            "corrections": corrections,
            "depth": depth,
            "hold_out": _hold_out(hold_out),
        }
        named = {name: value for name, value in dataset.items() if value is not None}
        return cls(_native.Scene.load(json.dumps({"dataset": named, "background": background, "seed": seed})))

    @classmethod
    def from_pycolmap(
        cls, reconstruction: Any, images: StrPath, *, folder: Optional[StrPath] = None, **options: Any
    ) -> Scene:
        """Load the scene of a `pycolmap.Reconstruction`.

        Args:
            reconstruction: Cameras, poses and points, with any camera model that `Scene.load` reads.
            images: Folder of the photos.
            folder: Where the model is kept, in ``sparse/0``, so that a run on it can be resumed and looked at
                later; by default it is kept no longer than it takes to load.
            options: As of `Scene.load`.

        Raises:
            Error: As `Scene.load`.
        """
        photos = os.path.abspath(images)
        if folder is not None:
            return cls._of_model(reconstruction, os.fspath(folder), photos, options)
        place = tempfile.mkdtemp(prefix="genesplat-")
        try:
            # A scene is called as its folder is.
            name = os.path.basename(os.path.dirname(photos)) or "scene"
            return cls._of_model(reconstruction, os.path.join(place, name), photos, options)
        finally:
            shutil.rmtree(place, ignore_errors=True)

    @classmethod
    def _of_model(cls, reconstruction: Any, folder: str, photos: str, options: dict[str, Any]) -> Scene:
        model = os.path.join(folder, "sparse", "0")
        os.makedirs(model, exist_ok=True)
        reconstruction.write(model)
        return cls.load(folder, images=photos, **options)

    @property
    def train(self) -> list[View]:
        """The views to train on, sorted by name."""
        return self._views("train")

    @property
    def test(self) -> list[View]:
        """The views that training never sees, sorted by name."""
        return self._views("test")

    @property
    def points(self) -> tuple[Float64, UInt8]:
        """Positions, world units ``[P, 3]`` (float64), and colours ``[P, 3]`` (uint8)."""
        return self._native.points()

    def __repr__(self) -> str:
        train, test = self._native.count("train"), self._native.count("test")
        return f"<Scene {self.name!r}: {train} training photos, {test} test photos>"

    def _views(self, split: str) -> list[View]:
        return [self._view(split, index) for index in range(self._native.count(split))]

    def _view(self, split: str, index: int) -> View:
        name, (width, height), viewmat, K = self._native.view(split, index)
        return View(name, viewmat, K, width, height, (self._native, split, index))


def gallery(
    folder: StrPath,
    *,
    views: int = 48,
    width: int = 320,
    height: int = 214,
    points: int = 3500,
    seed: int = 0,
) -> Scene:
    """Write the bundled scene, a small room with pictures, as a COLMAP scene into `folder`, and load it.

    Args:
        folder: For ``images/`` and ``sparse/0/``.
        views: Photos, at least 2; every eighth is for testing.
        width: Of the photos, pixels, at least 16.
        height: Of the photos, pixels, at least 16.
        points: How many points there are to start from, at most.
        seed: Of patterns and points.

    Raises:
        ValueError: Photos would be too few or too small.
        Error: The folder cannot be written to.
    """
    _native.write_gallery(folder, views, (width, height), points, seed)
    return Scene.load(folder)


def _hold_out(asked: Union[int, str, Sequence[str], None]) -> Any:
    if asked is None or isinstance(asked, str):
        if asked not in (None, "none", "every-eighth"):
            raise ValueError(f'hold_out is {asked!r}; give an interval, a list of names, or "none"')
        return asked
    if isinstance(asked, int):
        if asked < 2:
            raise ValueError(f"hold_out is {asked}; an interval is at least 2")
        return {"every": asked}
    return {"photos": list(asked)}
