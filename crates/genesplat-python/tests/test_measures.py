from __future__ import annotations

import math
import os
import signal
import threading
from pathlib import Path

import genesplat as gs
import numpy as np
import pytest


def test_scores_are_of_the_photos_that_are_asked_for(scene: gs.Scene, splats: gs.Splats) -> None:
    test, train = (gs.evaluate(splats, scene, split=split, device="cpu") for split in ("test", "train"))
    assert (len(test.views), len(train.views)) == (2, 14)
    assert test.psnr == pytest.approx(np.mean([view.psnr for view in test.views]))
    assert 10 < test.psnr and 0 < test.ssim < 1 and test.lpips is None
    assert gs.evaluate(splats, scene.path, device="cpu") == test


def test_scores_of_a_file_are_those_of_its_splats(scene: gs.Scene, splats: gs.Splats, tmp_path: Path) -> None:
    splats.save(tmp_path / "a.ply")
    assert gs.evaluate(tmp_path / "a.ply", scene, device="cpu") == gs.evaluate(splats, scene, device="cpu")


def test_what_cannot_be_scored_is_told(
    folder: Path, scene: gs.Scene, splats: gs.Splats, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match="give a scene"):
        gs.evaluate(splats)
    with pytest.raises(ValueError, match="split is 'both'"):
        gs.evaluate(splats, scene, split="both")
    with pytest.raises(gs.Error, match="no-weights.pth"):
        gs.evaluate(splats, scene, lpips=tmp_path / "no-weights.pth", device="cpu")
    splats.save(tmp_path / "a.ply")
    with pytest.raises(gs.Error, match="which scene it shows"):
        gs.evaluate(tmp_path / "a.ply")
    everything = gs.Scene.load(folder, hold_out="none")
    assert math.isnan(gs.evaluate(splats, everything, device="cpu").psnr)


def test_a_search_makes_splats_of_anybody_better(scene: gs.Scene, splats: gs.Splats) -> None:
    base = splats.copy()
    base.logit_opacities -= 1
    before = base.means.copy()
    found = [gs.genetic_search(base, scene, generations=8, population=8, device="cpu") for _ in range(2)]
    assert found[0].loss_after < found[0].loss_before and found[0].changed > 0
    assert found[0].generations == 9 and len(found[0].splats) == len(base)
    assert np.array_equal(base.means, before)
    assert not np.array_equal(found[0].splats.logit_opacities, base.logit_opacities)
    # What a search does not search stays, and the same seed finds the same.
    assert np.array_equal(found[0].splats.quats, base.quats)
    assert np.array_equal(found[0].splats.means, found[1].splats.means)


def test_wrong_settings_of_a_search_are_told(scene: gs.Scene, splats: gs.Splats) -> None:
    with pytest.raises(ValueError, match="unknown field `generation`"):
        gs.genetic_search(splats, scene, generation=3)
    with pytest.raises(ValueError, match="population"):
        gs.genetic_search(splats, scene, population=0)


def test_ctrl_c_ends_a_search(scene: gs.Scene, splats: gs.Splats) -> None:
    timer = threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        gs.genetic_search(splats, scene, generations=1_000_000, device="cpu")
    timer.join()


def test_who_finds_no_cameras_says_why(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    with pytest.raises(gs.Error, match="photos"):
        gs.poses(tmp_path / "photos", tmp_path / "scene")
