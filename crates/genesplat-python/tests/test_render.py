from __future__ import annotations

from typing import Any

import genesplat as gs
import numpy as np
import pytest

K = np.array([[50.0, 0, 16], [0, 50, 12], [0, 0, 1]])


def ball(*places: tuple[float, float, float], colors: Any = ((1, 0, 0),)) -> gs.Splats:
    """Opaque balls at `places`."""
    count = len(places)
    return gs.Splats.from_activated(
        places, [[1, 0, 0, 0]] * count, [[0.2] * 3] * count, [1.0] * count, list(colors)
    )


def test_a_ball_ahead_is_in_the_middle_and_the_background_around_it() -> None:
    picture = gs.render(ball((0, 0, 2)), np.eye(4), K, 32, 24, background=(0, 0.25, 0))
    assert picture.shape == (1, 24, 32, 3) and picture.dtype == np.float32
    # The middle of the picture lies between four pixels.
    assert np.allclose(picture[0, 12, 16], [0.99, 0.0025, 0], atol=0.01)
    assert np.allclose(picture[0, 0, 0], [0, 0.25, 0])
    assert np.allclose(picture[0], picture[0, ::-1, ::-1], atol=1e-5)


def test_cameras_stand_where_viewmats_say() -> None:
    right = np.eye(4)
    right[0, 3] = 0.4
    turned = np.diag([-1.0, -1, 1, 1])
    splats = ball((0.4, 0, 2))
    pictures = gs.render(splats, [np.eye(4), right, turned], [K, K, K], 32, 24)
    columns = [int(picture[12, :, 0].argmax()) for picture in pictures]
    # 50 px focal length: 0.4 to the right at depth 2 is 10 pixels.
    assert columns[0] in (25, 26) and columns[1] >= 30 and columns[2] in (5, 6)


def test_what_is_near_hides_what_is_far() -> None:
    splats = ball((0, 0, 3), (0, 0, 2), colors=[(1, 0, 0), (0, 0, 1)])
    assert np.allclose(gs.render(splats, np.eye(4), K, 32, 24)[0, 12, 16], [0.01, 0, 0.99], atol=0.02)
    assert np.allclose(gs.render(splats, np.eye(4), K, 32, 24, near_plane=2.5)[0, 12, 16, 0], 0.99, atol=0.02)


def test_view_dependent_colour_is_left_out_where_that_is_asked_for() -> None:
    splats = ball((0, 0, 2))
    splats.shN = np.zeros((1, 3, 3), np.float32)
    splats.shN[0, 1, 1] = 1
    with_it, without = (gs.render(splats, np.eye(4), K, 32, 24, sh_degree=degree) for degree in (1, 0))
    assert with_it[0, 12, 16, 1] > 0.4 and without[0, 12, 16, 1] < 0.01


@pytest.mark.parametrize(
    ("viewmats", "lenses", "more", "sentence"),
    [
        (np.eye(3), K, {}, r"viewmats has the shape \[1, 3, 3\]; give \[N, 4, 4\]"),
        (np.eye(4), np.eye(4), {}, r"Ks has the shape \[1, 4, 4\]; give \[N, 3, 3\]"),
        ([np.eye(4)] * 2, K, {}, "there are 2 viewmats and 1 Ks"),
        (2 * np.eye(4), K, {}, r"viewmats\[0\] is no rigid motion"),
        (np.diag([1.0, 1, -1, 1]), K, {}, r"viewmats\[0\] is no rigid motion"),
        (np.full((4, 4), np.nan), K, {}, r"viewmats\[0\] is no rigid motion"),
        ([np.eye(4)] * 2, [K, -K], {}, r"Ks\[1\] is no pinhole camera"),
        (np.eye(4), K, {"width": 0}, "a picture cannot have 0 x 24 pixels"),
        (np.eye(4), K, {"sh_degree": 4}, "sh_degree is 4, and has to be from 0 to 3"),
        (np.eye(4), K, {"device": "cuda"}, "cuda is no device"),
    ],
)
def test_wrong_cameras_are_told(viewmats: Any, lenses: Any, more: dict[str, Any], sentence: str) -> None:
    arguments: dict[str, Any] = {"width": 32, "height": 24, **more}
    with pytest.raises(ValueError, match=sentence):
        gs.render(ball((0, 0, 2)), viewmats, lenses, **arguments)


def test_renders_photos_and_scores_agree(scene: gs.Scene, splats: gs.Splats) -> None:
    scores = gs.evaluate(splats, scene, device="cpu")
    assert [score.name for score in scores.views] == [view.name for view in scene.test]
    for score, view in zip(scores.views, scene.test):
        picture = gs.render(splats, view.viewmat, view.K, view.width, view.height)[0]
        rounded = np.round(255 * picture.clip(0, 1))
        error = np.mean((rounded - view.image) ** 2) / 255**2
        assert abs(score.psnr - -10 * np.log10(error)) < 0.01
