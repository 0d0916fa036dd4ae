from __future__ import annotations

from pathlib import Path
from typing import Any

import genesplat as gs
import numpy as np
import pytest


def some(count: int = 5, others: int = 3) -> gs.Splats:
    random = np.random.default_rng(1)
    shapes = [(count, 3), (count, 4), (count, 3), (count,), (count, 1, 3), (count, others, 3)]
    return gs.Splats(*(random.normal(size=shape).astype(np.float32) for shape in shapes))


class Tensor:
    """What torch has on a card: NumPy can have it once it is detached and in main memory."""

    def __init__(self, values: object) -> None:
        self.values = np.asarray(values)

    def detach(self) -> Tensor:
        return self

    def cpu(self) -> Any:
        return self.values


def test_arrays_have_the_names_and_shapes_of_gsplat(splats: gs.Splats) -> None:
    count = len(splats)
    assert splats.means.shape == splats.log_scales.shape == splats.scales.shape == (count, 3)
    assert splats.quats.shape == (count, 4)
    assert splats.logit_opacities.shape == splats.opacities.shape == (count,)
    assert (splats.sh0.shape, splats.shN.shape, splats.sh_degree) == ((count, 1, 3), (count, 15, 3), 3)
    assert splats.colors.shape == (count, 16, 3)
    assert splats.means.dtype == splats.shN.dtype == np.float32
    assert np.allclose(np.log(splats.scales), splats.log_scales, atol=1e-5)
    assert repr(splats) == f"<Splats: {count:,} Gaussians, sh_degree 3, classic>"


@pytest.mark.parametrize("ending", [".ply", ".compressed.ply", ".splat", ".spz", ".sog", ".glb"])
def test_a_splat_comes_back_from_every_format(splats: gs.Splats, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    splats.save(path)
    back = gs.Splats.load(path)
    assert len(back) == len(splats)
    # Some formats change the order of rows.
    for before, after in zip(splats.means.T, back.means.T):
        assert np.allclose(np.sort(before), np.sort(after), atol=0.01 * np.ptp(splats.means))


def test_ply_keeps_every_bit(tmp_path: Path) -> None:
    splats = some(others=15)
    splats.to_ply(tmp_path / "a.ply")
    back = gs.Splats.from_ply(tmp_path / "a.ply")
    for name in ["means", "quats", "log_scales", "logit_opacities", "sh0", "shN"]:
        assert np.array_equal(getattr(splats, name), getattr(back, name)), name


def test_a_format_is_what_the_method_says(splats: gs.Splats, tmp_path: Path) -> None:
    for name in ["ply", "spz", "sog", "glb"]:
        getattr(splats, f"to_{name}")(tmp_path / "any.name")
        assert len(getattr(gs.Splats, f"from_{name}")(tmp_path / "any.name")) == len(splats)
    with pytest.raises(gs.Error, match=r"is \.glb, and not \.spz"):
        gs.Splats.from_spz(tmp_path / "any.name")
    with pytest.raises(gs.Error, match="names no format"):
        splats.save(tmp_path / "any.name")


def test_a_missing_or_damaged_file_is_told_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(gs.Error, match="does not exist"):
        gs.Splats.load(tmp_path / "missing.ply")
    with pytest.raises(gs.Error, match="missing.spz"):
        gs.Splats.from_spz(tmp_path / "missing.spz")
    (tmp_path / "bad.ply").write_text("ply\nnothing")
    with pytest.raises(gs.Error, match="bad.ply"):
        gs.Splats.load(tmp_path / "bad.ply")


@pytest.mark.parametrize(
    ("name", "shape", "sentence"),
    [
        ("means", (5, 4), r"means has the shape \[5, 4\]; give \[N, 3\]"),
        ("quats", (5, 3), r"quats has the shape \[5, 3\]; give \[N, 4\]"),
        ("log_scales", (5,), r"log_scales has the shape \[5\]; give \[N, 3\]"),
        ("logit_opacities", (5, 1), r"logit_opacities has the shape \[5, 1\]; give \[N\]"),
        ("logit_opacities", (), r"logit_opacities has the shape \[\]; give \[N\]"),
        ("sh0", (5, 3), r"sh0 has the shape \[5, 3\]; give \[N, 1, 3\]"),
        ("shN", (5, 4, 3), "shN has 4 coefficients; give 0, 3, 8 or 15"),
        ("quats", (6, 4), "quats has 6 rows, and means has 5"),
        ("shN", (4, 3, 3), "shN has 4 rows, and means has 5"),
        ("filter_3d", (4,), "filter_3d has 4 rows, and means has 5"),
    ],
)
def test_a_wrong_shape_is_told_before_anything_is_written(
    tmp_path: Path, name: str, shape: tuple[int, ...], sentence: str
) -> None:
    splats = some()
    setattr(splats, name, np.zeros(shape, np.float32))
    with pytest.raises(ValueError, match=sentence):
        splats.save(tmp_path / "a.ply")
    assert not (tmp_path / "a.ply").exists()


def test_values_that_cannot_be_are_told(tmp_path: Path) -> None:
    splats = some()
    splats.quats[3, 1] = np.nan
    with pytest.raises(ValueError, match="the rotation of Gaussian 3 is not finite"):
        splats.save(tmp_path / "a.ply")
    with pytest.raises(ValueError, match="no array of numbers"):
        gs.Splats(["a"], [], [], [], [])
    with pytest.raises(ValueError, match='there is no rasterize_mode "smooth"'):
        gs.Splats(*some()._arrays(), rasterize_mode="smooth").save(tmp_path / "a.ply")


def test_arrays_of_other_types_are_converted(tmp_path: Path) -> None:
    splats = some()
    splats.means = splats.means.astype(np.float64)[:, ::-1].tolist()
    splats.save(tmp_path / "a.ply")
    assert splats.means.dtype == np.float32
    assert np.array_equal(gs.Splats.load(tmp_path / "a.ply").means, splats.means)


def test_activated_parameters_come_back() -> None:
    scales, opacities = [[0.1, 0.2, 0.3]] * 3, [0.0, 0.25, 1.0]
    colors = [[0.0, 0.5, 1.0]] * 3
    splats = gs.Splats.from_activated(np.zeros((3, 3)), [[1, 0, 0, 0]] * 3, scales, opacities, colors)
    assert np.allclose(splats.scales, scales)
    assert np.allclose(splats.opacities, opacities, atol=1e-6)
    assert np.allclose(0.5 + 0.28209479177387814 * splats.sh0[:, 0], colors, atol=1e-6)
    with pytest.raises(ValueError, match="scales have to be above 0"):
        gs.Splats.from_activated(np.zeros((3, 3)), [[1, 0, 0, 0]] * 3, [[0.1, 0, 1]] * 3, opacities, colors)
    with pytest.raises(ValueError, match="opacities have to be from 0 to 1"):
        gs.Splats.from_activated(np.zeros((3, 3)), [[1, 0, 0, 0]] * 3, scales, [0.1, 0.2, 1.5], colors)


def test_rows_are_picked_by_mask_slice_and_index() -> None:
    splats = some()
    mask = np.array([True, False, True, False, False])
    for rows, expected in [(mask, [0, 2]), (slice(1, 3), [1, 2]), ([4, 0], [4, 0])]:
        picked = splats[rows]
        assert np.array_equal(picked.means, splats.means[expected])
        assert np.array_equal(picked.shN, splats.shN[expected])
    with pytest.raises(TypeError, match="slice"):
        splats[0]
    copy = splats.copy()
    copy.means[:] = 7
    assert not np.any(splats.means == 7)


def test_what_antialiases_is_kept(tmp_path: Path) -> None:
    splats = some()
    splats.rasterize_mode = "antialiased"
    splats.save(tmp_path / "a.ply")
    assert gs.Splats.load(tmp_path / "a.ply").rasterize_mode == "antialiased"


def test_a_tensor_is_copied_from_its_device() -> None:
    plain = some()
    tensors: list[Any] = [Tensor(array) for array in plain._arrays()]
    assert np.array_equal(gs.Splats(*tensors).means, plain.means)
    pose: Any = Tensor(np.eye(4))
    lens: Any = Tensor([np.diag([9.0, 9, 1])])
    assert gs.render(plain, pose, lens, 8, 8).shape == (1, 8, 8, 3)


def test_a_notebook_shows_the_page_that_export_makes(splats: gs.Splats) -> None:
    page = splats.to_html("a title of mine")
    assert page.lower().startswith("<!doctype html>") and "a title of mine" in page
    shown = splats._repr_html_()
    assert shown.startswith('<iframe srcdoc="&lt;!') and "<!doctype" not in shown.lower()
