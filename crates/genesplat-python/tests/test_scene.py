from __future__ import annotations

import logging
import shutil
from pathlib import Path

import genesplat as gs
import numpy as np
import pytest


def test_views_have_photos_and_cameras(scene: gs.Scene) -> None:
    assert repr(scene) == "<Scene 'gallery': 14 training photos, 2 test photos>"
    view = scene.train[0]
    assert (view.width, view.height, view.image.shape) == (64, 48, (48, 64, 3))
    assert view.image.dtype == np.uint8
    assert view.image.std() > 1
    assert view.viewmat.shape == (4, 4) and view.K.shape == (3, 3)
    rotation = view.viewmat[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3)) and np.array_equal(view.viewmat[3], [0, 0, 0, 1])
    assert np.allclose(view.K[:2, 2], [32, 24])
    assert view.name in repr(view)


def test_points_lie_where_cameras_see_them(scene: gs.Scene) -> None:
    positions, colours = scene.points
    assert positions.shape == colours.shape and len(positions) > 100
    view = scene.train[0]
    in_camera = positions @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
    ahead = in_camera[in_camera[:, 2] > 0.2] @ view.K.T
    pixels = ahead[:, :2] / ahead[:, 2:]
    assert np.mean((pixels > 0).all(axis=1) & (pixels < [64, 48]).all(axis=1)) > 0.2


def test_photos_are_chosen_and_reduced(folder: Path) -> None:
    assert len(gs.Scene.load(folder, hold_out=4).test) == 4
    assert len(gs.Scene.load(folder, hold_out="none").test) == 0
    named = gs.Scene.load(folder, hold_out=["gallery_003.png"])
    assert [view.name for view in named.test] == ["gallery_003.png"]
    assert gs.Scene.load(folder, downscale=2).train[0].image.shape == (24, 32, 3)
    assert gs.Scene.load(folder, max_side=32).train[0].width == 32


def test_wrong_arguments_and_missing_scenes_are_told(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="hold_out is 1"):
        gs.Scene.load(folder, hold_out=1)
    with pytest.raises(ValueError, match="hold_out is 'all'"):
        gs.Scene.load(folder, hold_out="all")
    with pytest.raises(ValueError, match="max_side"):
        gs.Scene.load(folder, max_side=2)
    with pytest.raises(ValueError, match="unknown variant `some`"):
        gs.Scene.load(folder, mask="some")
    with pytest.raises(gs.Error, match="missing"):
        gs.Scene.load(tmp_path / "missing")
    with pytest.raises(ValueError, match="at least 2 views"):
        gs.gallery(tmp_path, views=1)


def test_a_reconstruction_of_pycolmap_is_a_scene(folder: Path, tmp_path: Path) -> None:
    class Reconstruction:
        def write(self, model: str) -> None:
            for file in (folder / "sparse" / "0").iterdir():
                shutil.copy(file, model)

    scene = gs.Scene.from_pycolmap(Reconstruction(), folder / "images", hold_out=4)
    assert (scene.name, len(scene.test)) == ("gallery", 4) and not Path(scene.path).exists()
    kept = gs.Scene.from_pycolmap(Reconstruction(), folder / "images", folder=tmp_path / "kept")
    assert len(kept.train) == 14 and (tmp_path / "kept" / "sparse" / "0").is_dir()


def test_notices_go_to_the_logger(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    few = gs.gallery(tmp_path, views=8, width=32, height=32)
    with caplog.at_level(logging.INFO, "genesplat"):
        gs.train(few, "3dgs", 10, device="cpu")
    levels = {record.levelname: record.getMessage() for record in caplog.records}
    assert "fewer than 10" in levels["WARNING"] and "Gaussians, 7 training photos" in caplog.text
