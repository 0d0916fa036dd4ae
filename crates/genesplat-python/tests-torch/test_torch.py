"""The differentiable rasteriser: gsplat's shapes, and gradients against finite differences."""

import math
import os

import numpy as np
import pytest
import torch

import genesplat
import reference
from genesplat.torch import rasterization

WIDTH, HEIGHT = 48, 36
COUNT = 24


def cloud(seed=0, count=COUNT):
    """Gaussians in front of the camera, every one of them several pixels wide."""
    numbers = torch.Generator().manual_seed(seed)
    uniform = lambda *shape: torch.rand(*shape, generator=numbers)
    return {
        "means": (uniform(count, 3) - 0.5) * torch.tensor([2.4, 1.8, 2.0]) + torch.tensor([0.0, 0.0, 4.0]),
        "quats": uniform(count, 4) * 2 - 1,
        "scales": 0.15 + 0.3 * uniform(count, 3),
        "opacities": 0.15 + 0.7 * uniform(count),
        "colors": 0.1 + 0.8 * uniform(count, 3),
    }


def cameras(count=1):
    viewmats = torch.eye(4).repeat(count, 1, 1)
    for camera in range(count):
        angle = 0.15 * camera
        viewmats[camera, 0, 0] = viewmats[camera, 2, 2] = math.cos(angle)
        viewmats[camera, 0, 2], viewmats[camera, 2, 0] = math.sin(angle), -math.sin(angle)
        viewmats[camera, :3, 3] = torch.tensor([-0.5, 0.1, 0.2]) * camera
    Ks = torch.tensor([[50.0, 0.0, 25.0], [0.0, 48.0, 17.0], [0.0, 0.0, 1.0]]).repeat(count, 1, 1)
    return viewmats, Ks


def rendered(parameters, count=1, **settings):
    viewmats, Ks = cameras(count)
    parameters = {"viewmats": viewmats, **parameters}
    return rasterization(**parameters, Ks=Ks, width=WIDTH, height=HEIGHT, **settings)


def weights(shape, seed=9):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.3


def loss_of(colours, alphas):
    """Of pictures [C, H, W, D] and alphas [C, H, W, 1], in double precision."""
    of_colours = (weights(colours.shape) * colours.double()).sum()
    return of_colours + (weights(alphas.shape, 10) * alphas.double() ** 2).sum()


SH = weights((COUNT, 16, 3), 11).float()
CASES = {
    "colours": ({}, {}),
    "two cameras, packed or not": ({}, {"count": 2, "packed": False}),
    "colours of each camera": ({"colors": torch.stack([SH[:, 0] + 0.5, SH[:, 1] + 0.5])}, {"count": 2}),
    "harmonics": ({"colors": SH * 0.4}, {"sh_degree": 3}),
    "harmonics of a lower degree": ({"colors": SH[:, :9] * 0.4}, {"sh_degree": 1}),
    "antialiased": ({}, {"rasterize_mode": "antialiased"}),
    "five channels": ({"colors": weights((COUNT, 5), 12).float() + 0.5}, {}),
    "colours and depth": ({}, {"render_mode": "RGB+D"}),
    "harmonics and expected depth": ({"colors": SH * 0.4}, {"render_mode": "RGB+ED", "sh_degree": 2}),
    "depth": ({}, {"render_mode": "D"}),
}


def formulas(parameters, settings, cuts=None):
    """The same loss of the same pictures by plain formulas, and where Gaussians are cut in each picture."""
    settings = dict(settings)
    count, mode = settings.pop("count", 1), settings.pop("render_mode", "RGB")
    settings.pop("packed", None)
    antialiased = settings.pop("rasterize_mode", "classic") == "antialiased"
    (_, Ks), viewmats = cameras(count), parameters["viewmats"].double()
    pictures, alphas, made = [], [], []
    for camera in range(count):
        of_camera = {name: tensor for name, tensor in parameters.items() if name != "viewmats"}
        if mode in ("D", "ED"):
            of_camera["colors"] = of_camera["colors"][:, :0]
        elif of_camera["colors"].dim() == 3 and "sh_degree" not in settings:
            of_camera["colors"] = of_camera["colors"][camera]
        more = {
            "depth": mode != "RGB",
            "antialiased": antialiased,
            "cuts": cuts[camera] if cuts else None,
            **settings,
        }
        picture, alpha, cut = reference.rasterization(
            **of_camera, viewmat=viewmats[camera], K=Ks[camera].double(), width=WIDTH, height=HEIGHT, **more
        )
        if mode.endswith("ED"):
            picture = torch.cat(
                [picture[..., :-1], picture[..., -1:] / alpha.unsqueeze(-1).clamp(min=1e-10)], -1
            )
        pictures.append(picture)
        alphas.append(alpha.unsqueeze(-1))
        made.append(cut)
    return loss_of(torch.stack(pictures), torch.stack(alphas)), made


def doubles(parameters):
    return {name: tensor.detach().double() for name, tensor in parameters.items()}


NAMES = ["means", "quats", "scales", "opacities", "colors", "viewmats"]
# Depth alone has no colour.
PAIRS = [(case, name) for case in CASES for name in NAMES if (case, name) != ("depth", "colors")]


@pytest.mark.parametrize("case, name", PAIRS)
def test_gradients_are_those_of_finite_differences(case, name):
    changed, settings = CASES[case]
    parameters = {**cloud(), "viewmats": cameras(settings.get("count", 1))[0], **changed}
    leaf = parameters[name].clone().requires_grad_()
    colours, alphas, _ = rendered({**parameters, name: leaf}, **settings)
    loss = loss_of(colours, alphas)
    loss.backward()
    # In float64, and with Gaussians cut at 1/255 where they are now: that the place moves is in no
    # gradient, nor in gsplat's.
    exact, cuts = formulas(doubles(parameters), settings)
    assert loss.item() == pytest.approx(exact.item(), rel=1e-4, abs=0.05)
    for seed in range(3):
        direction = weights(leaf.shape, 100 + seed)
        if name == "viewmats":
            direction[:, 3] = 0
        ends = [
            formulas(
                {**doubles(parameters), name: leaf.detach().double() + sign * 1e-5 * direction},
                settings,
                cuts,
            )[0]
            for sign in (1, -1)
        ]
        expected = ((ends[0] - ends[1]) / 2e-5).item()
        actual, size = (
            (leaf.grad.double() * direction).sum().item(),
            (leaf.grad.double() * direction).abs().sum().item(),
        )
        assert abs(actual - expected) < 1e-3 * size, (actual, expected, size)
        assert (
            abs(1.1 * actual - expected) > 1e-3 * size or abs(actual) < 0.02 * size
        ), "a planted error is seen"
        assert size > 0.1, "the test sees nothing"


def double_leaves(parameters):
    return {name: tensor.double().requires_grad_() for name, tensor in parameters.items()}


def crowd():
    """So many opaque Gaussians that pixels are finished before the last of them."""
    parameters = cloud(3, 60)
    return {**parameters, "opacities": parameters["opacities"] * 0.2 + 0.8}


@pytest.mark.parametrize("antialiased", [False, True], ids=["classic", "antialiased"])
@pytest.mark.parametrize("make", [cloud, crowd], ids=["cloud", "crowd"])
def test_pictures_and_gradients_are_those_of_plain_formulas(make, antialiased):
    (viewmats, Ks), leaves, expected = cameras(2), double_leaves(make()), double_leaves(make())
    settings = {"rasterize_mode": "antialiased" if antialiased else "classic"}
    colours, alphas, _ = rasterization(
        **leaves, viewmats=viewmats, Ks=Ks, width=WIDTH, height=HEIGHT, **settings
    )
    camera = (viewmats[1].double(), Ks[1].double(), WIDTH, HEIGHT)
    picture, alpha, _ = reference.rasterization(*expected.values(), *camera, antialiased=antialiased)
    assert alpha.max() > 0.8
    assert (colours[1] - picture).abs().max() < 2e-4 and (alphas[1, ..., 0] - alpha).abs().max() < 2e-4
    for image, opacity in [(colours[1], alphas[1, ..., 0]), (picture, alpha)]:
        ((weights(image.shape) * image).sum() + (weights(opacity.shape, 10) * opacity).sum()).backward()
    for name, leaf in leaves.items():
        off = (leaf.grad - expected[name].grad).norm() / expected[name].grad.norm()
        assert off < 1e-3, f"{name}: {off}"
    planted = leaves["means"].grad * torch.tensor([1.0, 1.0, 1.01])
    assert (planted - expected["means"].grad).norm() / expected["means"].grad.norm() > 1e-3


def test_the_peers_splat_looks_as_an_independent_renderer_says():
    """By shared photos of a splat of OpenSplat's, where they are (see the command's test of the same)."""
    data = os.environ.get("GENESPLAT_DATA")
    if not data or not os.path.isdir(os.path.join(data, "peer")):
        pytest.skip("GENESPLAT_DATA has no folder `peer`")
    from PIL import Image

    peer = os.path.join(data, "peer")
    splats = genesplat.Splats.from_ply(os.path.join(peer, "opensplat_fox.ply"))
    scene = genesplat.Scene.load(os.path.join(peer, "scene"))
    views = {os.path.splitext(view.name)[0]: view for view in [*scene.train, *scene.test]}
    cloud_of_peer = [splats.means, splats.quats, splats.scales, splats.opacities, splats.colors]
    tensors = [torch.from_numpy(np.ascontiguousarray(array)) for array in cloud_of_peer]
    for name in sorted(os.listdir(os.path.join(peer, "reference"))):
        view = views[os.path.splitext(name)[0]]
        expected = np.asarray(Image.open(os.path.join(peer, "reference", name)).convert("RGB")).astype(int)
        camera = [torch.from_numpy(np.asarray(array, np.float32))[None] for array in (view.viewmat, view.K)]
        with torch.no_grad():
            picture, _, _ = rasterization(
                *tensors, *camera, view.width, view.height, near_plane=0.2, sh_degree=3
            )
        steps = np.abs((picture[0].clamp(0, 1).numpy() * 255 + 0.5).astype(int) - expected)
        assert steps.max() <= 2 and (steps > 1).mean() <= 1e-3, f"{name}: {steps.max()}, {(steps > 1).mean()}"


def test_backgrounds_have_gradients_and_lie_behind():
    backgrounds = torch.tensor([[0.2, 0.5, 0.9], [1.0, 0.0, 0.3]], requires_grad=True)
    colours, alphas, _ = rendered(cloud(), 2, backgrounds=backgrounds)
    on_black, same_alphas, _ = rendered(cloud(), 2)
    assert torch.equal(alphas, same_alphas)
    expected = on_black + (1 - alphas) * backgrounds.detach()[:, None, None]
    assert torch.allclose(colours, expected, atol=1e-6)
    colours.sum().backward()
    assert torch.allclose(backgrounds.grad, (1 - alphas).sum(dim=(1, 2)).expand(2, 3), rtol=1e-4)
    with_depth, _, _ = rendered(cloud(), 2, backgrounds=backgrounds, render_mode="RGB+D")
    assert torch.allclose(with_depth[..., :3], colours, atol=1e-6) and with_depth.shape[-1] == 4


def test_one_gaussian_is_where_and_as_bright_as_by_hand():
    """In the middle of a pixel, round, so wide that its neighbour is known."""
    one = {
        "means": torch.tensor([[0.02, -0.06, 2.0]]),
        "quats": torch.tensor([[2.0, 0.0, 0.0, 0.0]]),
        "scales": torch.full((1, 3), 0.1),
        "opacities": torch.tensor([0.8]),
        "colors": torch.tensor([[1.0, 0.5, -0.25]]),
    }
    viewmats, Ks = torch.eye(4)[None], torch.tensor([[[100.0, 0, 24.5], [0, 100.0, 20.5], [0, 0, 1]]])
    colours, alphas, meta = rasterization(**one, viewmats=viewmats, Ks=Ks, width=WIDTH, height=HEIGHT)
    assert meta["means2d"].tolist() == [[25.5, 17.5]], "the first pixel's centre is at 0.5"
    # The Jacobian is taken at the mean: its third column adds 1 + (x/z)² to the variance along x.
    variances = [25.0 * (1 + slope**2) + 0.3 for slope in (0.01, 0.03)]
    assert alphas[0, 17, 25, 0].item() == pytest.approx(0.8, rel=1e-5)
    assert alphas[0, 17, 29, 0].item() == pytest.approx(0.8 * math.exp(-16 / (2 * variances[0])), rel=1e-4)
    assert alphas[0, 20, 25, 0].item() == pytest.approx(0.8 * math.exp(-9 / (2 * variances[1])), rel=1e-4)
    assert torch.allclose(colours[0, 17, 25], 0.8 * one["colors"][0], rtol=1e-5), "colours are not clamped"
    assert meta["depths"].tolist() == [2.0]
    assert meta["conics"][0].tolist() == pytest.approx([1 / variances[0], 0.0, 1 / variances[1]], abs=1e-4)


@pytest.mark.parametrize("packed", [True, False])
def test_the_means_on_the_screen_have_gradients_for_strategies(packed):
    parameters = {name: tensor.requires_grad_() for name, tensor in cloud().items()}
    colours, _, meta = rendered(parameters, 2, packed=packed, absgrad=True)
    meta["means2d"].retain_grad()
    (weights(colours.shape).float() * colours).sum().backward()
    means2d = meta["means2d"]
    assert means2d.grad.shape == means2d.absgrad.shape == means2d.shape
    assert (means2d.absgrad >= means2d.grad.abs() * 0.999 - 1e-4).all() and means2d.absgrad.sum() > 1
    if packed:
        assert means2d.shape == (len(meta["gaussian_ids"]), 2) and meta["radii"].shape == means2d.shape
        assert set(meta["camera_ids"].tolist()) == {0, 1}
    else:
        assert means2d.shape == (2, COUNT, 2) and (meta["radii"] > 0).all(dim=-1).any()
    assert (meta["width"], meta["height"], meta["n_cameras"]) == (WIDTH, HEIGHT, 2)


def test_the_gradients_of_means_on_the_screen_are_those_of_plain_formulas(monkeypatch):
    leaves, expected = doubles(cloud()), doubles(cloud())
    leaves["colors"].requires_grad_()
    viewmats, Ks = cameras()
    colours, _, meta = rasterization(
        **leaves, viewmats=viewmats, Ks=Ks, width=WIDTH, height=HEIGHT, packed=False
    )
    (weights(colours.shape) * colours).sum().backward()
    means2d, raw, depths = reference.project(
        *list(expected.values())[:3], viewmats[0].double(), Ks[0].double(), WIDTH, HEIGHT
    )
    assert torch.allclose(meta["means2d"][0].double(), means2d, atol=1e-3)
    means2d.requires_grad_()
    monkeypatch.setattr(reference, "project", lambda *_: (means2d, raw, depths))
    picture, _, _ = reference.rasterization(
        *expected.values(), viewmats[0].double(), Ks[0].double(), WIDTH, HEIGHT
    )
    (weights(colours.shape)[0] * picture).sum().backward()
    off = (meta["means2d"].grad[0] - means2d.grad).norm() / means2d.grad.norm()
    assert off < 1e-3, off


def test_packed_or_not_is_the_same_picture_and_the_same_gradient():
    gradients = []
    for packed in (True, False):
        parameters = {name: tensor.requires_grad_() for name, tensor in cloud().items()}
        colours, alphas, _ = rendered(parameters, 2, packed=packed)
        (colours.square().sum() + alphas.sum()).backward()
        gradients.append([colours, *(tensor.grad for tensor in parameters.values())])
    assert all(torch.equal(*pair) for pair in zip(*gradients))


def test_doubles_come_back_as_doubles_and_nothing_is_kept_without_gradients():
    leaves = double_leaves(cloud())
    colours, alphas, _ = rendered(leaves)
    assert colours.dtype == alphas.dtype == torch.float64
    colours.sum().backward()
    assert all(tensor.grad.dtype == torch.float64 for tensor in leaves.values())
    with torch.no_grad():
        colours, _, meta = rendered(leaves)
    assert not colours.requires_grad and not meta["means2d"].requires_grad


def test_planes_and_small_splats_are_clipped():
    depths = cloud()["means"][:, 2]
    near, far = depths.sort().values[[5, 15]].tolist()
    _, _, meta = rendered(cloud(), near_plane=near + 1e-4, far_plane=far - 1e-4)
    drawn = depths[meta["gaussian_ids"]]
    assert len(drawn) > 0 and drawn.min() > near and drawn.max() < far
    _, _, everything = rendered(cloud())
    clip = everything["radii"].max(dim=-1).values.sort().values[10].item()
    _, _, clipped = rendered(cloud(), radius_clip=clip)
    assert 0 < len(clipped["radii"]) < len(everything["radii"])
    assert clipped["radii"].max(dim=-1).values.min() > clip


def test_nothing_in_front_of_the_camera_is_a_black_picture():
    behind = cloud()
    behind["means"] = (behind["means"] * torch.tensor([1.0, 1.0, -1.0])).requires_grad_()
    colours, alphas, _ = rendered(behind)
    assert colours.abs().sum() == 0 and alphas.abs().sum() == 0
    colours.sum().backward()
    assert behind["means"].grad.abs().sum() == 0
    colours, _, _ = rendered({name: tensor[:0] for name, tensor in cloud().items()})
    assert colours.shape == (1, HEIGHT, WIDTH, 3)


WRONG = [
    ({"opacities": torch.full((COUNT,), 1.5)}, {}, ValueError, "after the sigmoid"),
    ({"means": np.ones((COUNT, 3), np.float32)}, {}, TypeError, "from_numpy"),
    ({"scales": torch.ones(COUNT, 2)}, {}, ValueError, "scales has the shape"),
    ({"colors": torch.ones(COUNT + 1, 3)}, {}, ValueError, "colors has the shape"),
    ({"colors": torch.ones(COUNT, 4, 3)}, {"sh_degree": 2}, ValueError, "at least 9"),
    ({"colors": torch.ones(COUNT, 25, 3)}, {"sh_degree": 4}, NotImplementedError, "0 to 3"),
    ({}, {"eps2d": 0.1}, NotImplementedError, "eps2d"),
    ({}, {"camera_model": "fisheye"}, NotImplementedError, "pinhole"),
    ({}, {"sparse_grad": True}, NotImplementedError, "no sparse_grad"),
    ({}, {"with_ut": True}, NotImplementedError, "no with_ut"),
    ({}, {"render_mode": "N"}, ValueError, "render_mode"),
    ({}, {"rasterize_mode": "blurred"}, ValueError, "rasterize_mode"),
    ({}, {"backgrounds": torch.ones(3)}, ValueError, "backgrounds has the shape"),
    ({}, {"device": "cuda"}, ValueError, "cuda is no device"),
    ({}, {"device": "gpu:200"}, genesplat.Error, "no graphics device gpu:200"),
]


@pytest.mark.parametrize("changed, settings, kind, words", WRONG, ids=[words for *_, words in WRONG])
def test_what_is_wrong_or_not_there_is_a_sentence(changed, settings, kind, words):
    with pytest.raises(kind, match=words):
        rendered({**cloud(), **changed}, **settings)


def test_lenses_have_no_gradients():
    viewmats, Ks = cameras()
    with pytest.raises(NotImplementedError, match="detach"):
        rasterization(**cloud(), viewmats=viewmats, Ks=Ks.requires_grad_(), width=WIDTH, height=HEIGHT)


def test_a_camera_that_is_off_finds_its_place():
    """By gradients of `viewmats` alone, as trainers that refine poses do."""
    viewmats, Ks = cameras()
    settings = {"Ks": Ks, "width": WIDTH, "height": HEIGHT}
    with torch.no_grad():
        photo, _, _ = rasterization(**cloud(), viewmats=viewmats, **settings)
    off = torch.tensor([0.15, -0.1, 0.2]).requires_grad_()
    optimizer = torch.optim.Adam([off], lr=0.01)
    for _ in range(80):
        moved = viewmats + torch.nn.functional.pad(off[None, :, None], (3, 0, 0, 1))
        image, _, _ = rasterization(**cloud(), viewmats=moved, **settings)
        optimizer.zero_grad()
        (image - photo).square().mean().backward()
        optimizer.step()
    assert off.abs().max() < 0.02


@pytest.mark.parametrize("case", CASES)
def test_a_graphics_device_has_the_numbers_of_the_cpu(case):
    changed, settings = CASES[case]
    found = []
    for device in ("cpu", "gpu"):
        parameters = {**cloud(), "viewmats": cameras(settings.get("count", 1))[0], **changed}
        leaves = {name: tensor.clone().requires_grad_() for name, tensor in parameters.items()}
        try:
            colours, alphas, meta = rendered(leaves, absgrad=True, device=device, **settings)
        except genesplat.Error as error:
            assert "GENESPLAT_REQUIRE_GPU" not in os.environ, error
            pytest.skip(str(error))
        loss_of(colours, alphas).backward()
        gradients = {name: tensor.grad for name, tensor in leaves.items() if tensor.grad is not None}
        means2d = meta["means2d"]
        found.append({"picture": colours, "means2d": means2d.grad, "absgrad": means2d.absgrad, **gradients})
    assert found[0].keys() == found[1].keys() and len(found[0]) >= 8
    for name, expected in found[0].items():
        off = (found[1][name] - expected).norm() / expected.norm()
        assert off < 1e-4, f"{name}: {off}"


def test_the_same_call_gives_the_same_bytes():
    first, second = (rendered(cloud(), 2)[0].numpy().tobytes() for _ in range(2))
    assert first == second and np.frombuffer(first, dtype=np.float32).max() > 0.2
