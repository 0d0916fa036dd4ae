"""genesplat's density control in a plain PyTorch loop."""

import functools
import math

import pytest
import torch

from genesplat.strategy import ImprovedStrategy
from genesplat.torch import rasterization

SIZE = 40
VIEWS = 6
STEPS = 600


def cameras():
    """On an arc around the origin, all of which look at it."""
    viewmats = []
    for view in range(VIEWS):
        angle = (view - (VIEWS - 1) / 2) * 0.25
        viewmat = torch.eye(4)
        viewmat[0, 0] = viewmat[2, 2] = math.cos(angle)
        viewmat[0, 2], viewmat[2, 0] = math.sin(angle), -math.sin(angle)
        viewmat[2, 3] = 4.0
        viewmats.append(viewmat)
    Ks = torch.tensor([[44.0, 0, SIZE / 2], [0, 44.0, SIZE / 2], [0, 0, 1]]).repeat(VIEWS, 1, 1)
    return torch.stack(viewmats), Ks


def target():
    """Many small Gaussians of all colours, and photos of them."""
    numbers = torch.Generator().manual_seed(5)
    count = 300
    uniform = lambda *shape: torch.rand(*shape, generator=numbers)
    viewmats, Ks = cameras()
    with torch.no_grad():
        photos, _, _ = rasterization(
            (uniform(count, 3) - 0.5) * 2.4,
            uniform(count, 4) * 2 - 1,
            0.05 + 0.1 * uniform(count, 3),
            0.6 + 0.4 * uniform(count),
            uniform(count, 3),
            viewmats,
            Ks,
            SIZE,
            SIZE,
        )
    return photos.clamp(0, 1)


def start(count=40, seed=1):
    numbers = torch.Generator().manual_seed(seed)
    values = {
        "means": (torch.rand(count, 3, generator=numbers) - 0.5) * 2.4,
        "scales": torch.full((count, 3), math.log(0.2)),
        "quats": torch.rand(count, 4, generator=numbers) * 2 - 1,
        "opacities": torch.zeros(count),
        "colors": torch.zeros(count, 3),
    }
    rates = {"means": 5e-3, "scales": 1e-2, "quats": 5e-3, "opacities": 5e-2, "colors": 2e-2}
    params = torch.nn.ParameterDict({name: torch.nn.Parameter(value) for name, value in values.items()})
    return params, {name: torch.optim.Adam([params[name]], lr=rates[name], eps=1e-15) for name in values}


def render(params, viewmat, K):
    colors = torch.sigmoid(params["colors"])
    opacities, scales = torch.sigmoid(params["opacities"]), torch.exp(params["scales"])
    return rasterization(
        params["means"], params["quats"], scales, opacities, colors, viewmat, K, SIZE, SIZE, absgrad=True
    )


def psnr(params, photos):
    viewmats, Ks = cameras()
    with torch.no_grad():
        error = (render(params, viewmats, Ks)[0] - photos).square().mean()
    return -10 * math.log10(error.item())


def train(strategy, with_photos, steps=STEPS):
    photos, (viewmats, Ks) = target(), cameras()
    params, optimizers = start()
    strategy.check_sanity(params, optimizers)
    state = strategy.initialize_state(
        **({"images": photos, "viewmats": viewmats, "Ks": Ks} if with_photos else {})
    )
    counts, before = [len(params["means"])], psnr(params, photos)
    for step in range(steps):
        view = step % VIEWS
        image, _, info = render(params, viewmats[view : view + 1], Ks[view : view + 1])
        strategy.step_pre_backward(params, optimizers, state, step, info)
        (image[0] - photos[view]).abs().mean().backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        strategy.step_post_backward(params, optimizers, state, step, info)
        counts.append(len(params["means"]))
        assert all(len(parameter) == counts[-1] for parameter in params.values())
    return params, optimizers, counts, before, psnr(params, photos)


@functools.lru_cache(maxsize=None)
def trained(cap, with_photos):
    return train(ImprovedStrategy(cap_max=cap, iterations=STEPS, refine_every=10), with_photos)


@pytest.mark.parametrize("with_photos", [True, False], ids=["edges of photos", "gradients alone"])
def test_the_cloud_grows_to_its_cap_and_the_pictures_become_better(with_photos):
    params, optimizers, counts, before, after = trained(150, with_photos)
    assert counts[0] == 40 and max(counts) == 150 and counts[-1] > 120, counts[:: STEPS // 20]
    assert after > before + 6 and after > 20, (before, after)
    for name, optimizer in optimizers.items():
        assert optimizer.param_groups[0]["params"] == [params[name]]
        assert optimizer.state[params[name]]["exp_avg"].shape == params[name].shape


def test_growing_is_better_than_not_growing():
    grown, alone = trained(150, True)[-1], trained(40, True)[-1]
    assert grown > alone + 1, (grown, alone)


def test_the_same_seed_makes_the_same_cloud():
    clouds = [
        train(ImprovedStrategy(cap_max=100, iterations=STEPS, refine_every=10, seed=seed), True, 160)[0]
        for seed in (3, 3, 4)
    ]
    assert torch.equal(clouds[0]["means"], clouds[1]["means"])
    assert clouds[0]["means"].shape != clouds[2]["means"].shape or not torch.equal(
        clouds[0]["means"], clouds[2]["means"]
    )


def one_step(strategy, iteration, gradients, opacities):
    """A densification by hand: rows far from each other, of these gradients and opacities."""
    count = len(gradients)
    params, optimizers = start(count)
    for name, optimizer in optimizers.items():
        params[name].grad = torch.ones_like(params[name])
        optimizer.step()
    with torch.no_grad():
        params["opacities"].copy_(torch.logit(torch.tensor(opacities)))
        params["scales"].copy_(torch.tensor([[0.4, 0.1, 0.2]]).log().expand(count, 3))
        params["quats"].copy_(torch.tensor([[1.0, 0, 0, 0]]).expand(count, 4))
    state = strategy.initialize_state()
    state["gradient_sum"], state["weight_sum"] = torch.tensor(gradients), torch.ones(count)
    old = {name: parameter.detach().clone() for name, parameter in params.items()}
    strategy._densify(params, optimizers, state, iteration)
    return old, params, optimizers


def test_children_part_along_the_longest_axis_and_moments_go_with_their_rows():
    strategy = ImprovedStrategy(cap_max=100, iterations=3000)
    control = strategy.initialize_state()["control"]
    iteration = next(i for i in range(1, 3000) if control.densifies(i))
    old, new, optimizers = one_step(strategy, iteration, [0.0, 1.0, 0.0], [0.5, 0.5, 0.001])
    assert len(new["means"]) == 3, "one is kept, one is split, one is pruned"
    assert all(torch.equal(new[name][0], old[name][0]) for name in old), "a row that is kept keeps all digits"
    children = new["means"][1:] - old["means"][1]
    scales = old["scales"][1].exp()
    assert torch.allclose(
        children.abs(), torch.tensor([1.35 * scales[0].item(), 0, 0]).expand(2, 3), atol=1e-5
    )
    assert torch.allclose(children[0], -children[1], atol=1e-5)
    shrink = torch.tensor([0.55, math.sqrt(1 - 0.45**2), math.sqrt(1 - 0.45**2)])
    assert torch.allclose(new["scales"][1].exp(), scales * shrink, rtol=1e-4)
    opacity = torch.sigmoid(old["opacities"][1]) * 0.6
    assert torch.allclose(torch.sigmoid(new["opacities"][1:]), opacity.expand(2), rtol=1e-4)
    for name, optimizer in optimizers.items():
        moment = optimizer.state[new[name]]["exp_avg"]
        assert moment[0].abs().min() > 0 and moment[1:].abs().max() == 0, "children start without momentum"
        assert optimizer.state[new[name]]["step"] == 1


def test_resets_limit_opacities_and_forget_their_moments():
    strategy = ImprovedStrategy(cap_max=100, iterations=3000, photos=20)
    state = strategy.initialize_state()
    iteration = next(i for i in range(1, 3000) if state["control"].reset(i) is not None)
    params, optimizers = start(4)
    params["opacities"].grad = torch.ones(4)
    optimizers["opacities"].step()
    with torch.no_grad():
        params["opacities"].copy_(torch.tensor([5.0, 1.0, -4.0, 0.0]))
    means2d = torch.zeros(1, 4, 2)
    means2d.absgrad = torch.zeros(1, 4, 2)
    info = {"means2d": means2d, "radii": torch.ones(1, 4), "width": 9, "height": 9, "n_cameras": 1}
    strategy.step_post_backward(params, optimizers, state, iteration - 1, info)
    ceiling = math.log(0.05 / 0.95)
    assert params["opacities"].tolist() == pytest.approx([ceiling, ceiling, -4.0, ceiling])
    assert optimizers["opacities"].state[params["opacities"]]["exp_avg"].abs().max() == 0


def test_where_photos_are_seldom_looked_at_nothing_is_reset():
    control = ImprovedStrategy(cap_max=100, iterations=3000, photos=100).initialize_state()["control"]
    assert all(control.reset(i) is None for i in range(1, 3000))


def test_what_is_wrong_is_a_sentence():
    strategy = ImprovedStrategy()
    params, optimizers = start(5)
    with pytest.raises(ValueError, match="no optimizer"):
        strategy.check_sanity(params, {name: of for name, of in optimizers.items() if name != "colors"})
    with pytest.raises(ValueError, match="one group"):
        strategy.check_sanity(params, {**optimizers, "means": optimizers["quats"]})
    with pytest.raises(ValueError, match="no 'quats'"):
        strategy.check_sanity({name: of for name, of in params.items() if name != "quats"}, optimizers)
    with pytest.raises(ValueError, match="improved-gs"):
        ImprovedStrategy(method="mcmc").initialize_state()
    with pytest.raises(ValueError, match="iterations"):
        ImprovedStrategy(iterations=0).initialize_state()
    with pytest.raises(ValueError, match="viewmats and Ks"):
        strategy.initialize_state(images=[torch.zeros(4, 4, 3)])
    viewmats, Ks = cameras()
    _, _, info = rasterization(
        *(params[name].detach() for name in ("means", "quats")),
        params["scales"].detach().exp(),
        torch.full((5,), 0.5),
        params["colors"].detach(),
        viewmats,
        Ks,
        SIZE,
        SIZE,
    )
    with pytest.raises(ValueError, match="absgrad=True"):
        strategy.step_post_backward(params, optimizers, strategy.initialize_state(), 0, info)
