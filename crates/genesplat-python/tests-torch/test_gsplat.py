"""The rasteriser beside gsplat itself: its formulas in PyTorch, and its strategy on our pictures."""

import pytest
import torch

import reference
import test_strategy
import test_torch
from genesplat.torch import rasterization

# A checker of other people's code may want to leave it out; `check-torch` installs it.
pytest.importorskip("gsplat")

from gsplat.cuda._torch_impl import _fully_fused_projection, _quat_scale_to_covar_preci, _spherical_harmonics
from gsplat.strategy import DefaultStrategy


@pytest.mark.parametrize("packed", [True, False])
def test_what_is_projected_has_gsplats_numbers(packed):
    cloud, (viewmats, Ks) = test_torch.cloud(), test_torch.cameras(2)
    size = (test_torch.WIDTH, test_torch.HEIGHT)
    covariances, _ = _quat_scale_to_covar_preci(cloud["quats"], cloud["scales"], True, False, triu=False)
    radii, *expected, _ = _fully_fused_projection(cloud["means"], covariances, viewmats, Ks, *size)
    _, _, meta = rasterization(**cloud, viewmats=viewmats, Ks=Ks, width=size[0], height=size[1], packed=packed)
    is_seen = (radii > 0).all(dim=-1)
    for name, of_gsplat in zip(["means2d", "depths", "conics"], expected):
        ours = meta[name]
        if packed:
            of_gsplat = of_gsplat[meta["camera_ids"], meta["gaussian_ids"]]
            assert len(ours) == is_seen.sum()
        else:
            assert torch.equal((meta["radii"] > 0).all(dim=-1), is_seen)
            ours, of_gsplat = ours[is_seen], of_gsplat[is_seen]
        assert ours.dtype == of_gsplat.dtype and ours.shape == of_gsplat.shape
        assert torch.allclose(ours, of_gsplat, rtol=1e-5, atol=1e-6), name


def test_the_harmonics_of_the_formulas_that_we_are_compared_with_are_gsplats():
    coefficients = test_torch.weights((20, 16, 3)).float()
    directions = torch.nn.functional.normalize(test_torch.weights((20, 3), 2).float(), dim=-1)
    for degree in range(4):
        of_gsplat = (_spherical_harmonics(degree, directions, coefficients) + 0.5).clamp(min=0)
        assert torch.allclose(reference.harmonics(coefficients, directions, degree), of_gsplat, atol=1e-5)


@pytest.mark.parametrize("absgrad", [False, True])
def test_gsplats_strategy_trains_on_our_pictures(absgrad):
    """Code that was written for gsplat, but for the import of `rasterization`."""
    photos, (viewmats, Ks) = test_strategy.target(), test_strategy.cameras()
    params, optimizers = test_strategy.start()
    threshold = 0.0008 if absgrad else 0.0002
    strategy = DefaultStrategy(absgrad=absgrad, grow_grad2d=threshold, refine_start_iter=50, refine_every=50)
    strategy.check_sanity(params, optimizers)
    state, before = strategy.initialize_state(), test_strategy.psnr(params, photos)
    for step in range(1, 181):
        view = step % test_strategy.VIEWS
        image, _, info = test_strategy.render(params, viewmats[view : view + 1], Ks[view : view + 1])
        strategy.step_pre_backward(params, optimizers, state, step, info)
        (image[0] - photos[view]).abs().mean().backward()
        for optimizer in optimizers.values():
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
        strategy.step_post_backward(params, optimizers, state, step, info, packed=True)
    assert len(params["means"]) > 150
    assert test_strategy.psnr(params, photos) > before + 8
