"""Density control for other people's trainers: genesplat's, with the interface of gsplat's strategies.

>>> strategy = ImprovedStrategy(cap_max=100_000, iterations=7000)
>>> strategy.check_sanity(params, optimizers)
>>> state = strategy.initialize_state()
>>> for step in range(7000):
...     image, alpha, info = rasterization(..., absgrad=True)
...     strategy.step_pre_backward(params, optimizers, state, step, info)
...     loss(image).backward()
...     for optimizer in optimizers.values():
...         optimizer.step()
...         optimizer.zero_grad()
...     strategy.step_post_backward(params, optimizers, state, step, info)

It works with `genesplat.torch.rasterization` and with gsplat's own, on any device: what it reads of a cloud
is copied to the CPU when it densifies, every hundred steps or so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Union

import numpy as np

try:
    import torch
except ImportError as error:
    raise ImportError("genesplat.strategy needs PyTorch 1.13 or newer: pip install torch") from error

from torch import Tensor

from genesplat._native import DensityControl, Rows

__all__ = ["ImprovedStrategy"]

Params = Union[Dict[str, torch.nn.Parameter], torch.nn.ParameterDict]
Optimizers = Mapping[str, torch.optim.Optimizer]

_REQUIRED = ("means", "scales", "quats", "opacities")


@dataclass
class ImprovedStrategy:
    """Splits where gradients are large, along the longest axis, up to a cap; prunes what is faint, and what
    recovers slowly from a reset of opacities (Improved-GS: Deng et al. 2025; what "genesplat" changes:
    docs/methods.md).

    Args:
        cap_max: Gaussians that the cloud grows to.
        iterations: length of the run; the schedule of "genesplat" fits into any, that of "improved-gs" is
            of 30,000.
        method: "genesplat" or "improved-gs".
        refine_every: steps between two densifications; more in a run of more than 30,000.
        photos: number of training photos, unless `initialize_state` is given them: where each is looked at
            often, the cloud of "genesplat" grows more slowly at first.
        seed: of the draws; the same seed decides the same.
        verbose: prints a line for each densification.

    Parameters are those of gsplat: `means` [N, 3], `scales` [N, 3] before the exponential, `quats` [N, 4] and
    `opacities` [N] before the sigmoid; whatever else there is (`sh0`, `shN`, `colors`) has N rows, too.
    """

    cap_max: int = 1_000_000
    iterations: int = 30_000
    method: str = "genesplat"
    refine_every: int = 100
    photos: int = 100
    seed: int = 0
    verbose: bool = False

    def check_sanity(self, params: Params, optimizers: Optimizers) -> None:
        """Raises ValueError unless each optimizer has one group, of the one parameter of its name."""
        for name in _REQUIRED:
            if name not in params:
                raise ValueError(f"params has no {name!r}")
        for name, parameter in params.items():
            if len(parameter) != len(params["means"]):
                raise ValueError(
                    f"params[{name!r}] has {len(parameter)} rows, but means has {len(params['means'])}"
                )
            if name not in optimizers and parameter.requires_grad:
                raise ValueError(
                    f"params[{name!r}] has no optimizer; one of its name is needed for its rows to be moved"
                )
        for name, optimizer in optimizers.items():
            groups = optimizer.param_groups
            if (
                name not in params
                or len(groups) != 1
                or [id(p) for p in groups[0]["params"]] != [id(params[name])]
            ):
                raise ValueError(f"optimizers[{name!r}] must have one group, with params[{name!r}] alone")

    def initialize_state(
        self,
        scene_scale: float = 1.0,
        images: Optional[Sequence[Any]] = None,
        viewmats: Optional[Any] = None,
        Ks: Optional[Any] = None,
        near_plane: float = 0.01,
    ) -> Dict[str, Any]:
        """The running state of one run.

        With the training photos (of each [H, W, 3], bytes, or numbers from 0 to 1) and their cameras
        ([V, 4, 4] and [V, 3, 3]) Gaussians are split in proportion to the photos' edges that they stand for,
        as published; without them, in proportion to their gradients. `scene_scale` is accepted, and has no
        effect: no rule depends on it.
        """
        views = None
        if images is not None:
            if viewmats is None or Ks is None or not len(images) == len(viewmats) == len(Ks):
                raise ValueError("images needs viewmats and Ks, one for each photo")
            cameras = (_numbers(viewmats), _numbers(Ks))
            views = ([_bytes(image) for image in images], *cameras, near_plane)
        photos = self.photos if views is None else len(views[0])
        control = DensityControl(
            self.method, self.iterations, self.refine_every, photos, self.cap_max, self.seed
        )
        return {
            "control": control,
            "views": views,
            "gradient_sum": None,
            "weight_sum": None,
            "scene_scale": scene_scale,
        }

    def step_pre_backward(
        self, params: Params, optimizers: Optimizers, state: Dict[str, Any], step: int, info: Dict[str, Any]
    ) -> None:
        """To be called before `loss.backward()`."""
        if step + 1 < state["control"].until():
            info["means2d"].retain_grad()

    def step_post_backward(
        self,
        params: Params,
        optimizers: Optimizers,
        state: Dict[str, Any],
        step: int,
        info: Dict[str, Any],
        packed: Optional[bool] = None,
    ) -> None:
        """To be called after `loss.backward()`; changes the rows of params and of the optimizers' state
        when it is time.

        `packed` need not be said. `info["means2d"]` must have an `absgrad`: call `rasterization` with
        `absgrad=True`.
        """
        control, iteration = state["control"], step + 1
        if iteration < control.until():
            self._measure(params, state, info)
        if control.densifies(iteration):
            self._densify(params, optimizers, state, iteration)
        ceiling = control.reset(iteration)
        if ceiling is not None:
            _limit_opacities(params, optimizers, ceiling)

    @torch.no_grad()
    def _measure(self, params: Params, state: Dict[str, Any], info: Dict[str, Any]) -> None:
        """Adds this step's gradients by normalised device coordinate."""
        gradient = getattr(info["means2d"], "absgrad", None)
        if gradient is None:
            raise ValueError(
                'info["means2d"] has no absgrad; call rasterization with absgrad=True, and backward() first'
            )
        to_device_coordinates = (
            gradient.new_tensor([info["width"] / 2.0, info["height"] / 2.0]) * info["n_cameras"]
        )
        lengths = (gradient * to_device_coordinates).norm(dim=-1)
        if gradient.dim() == 2:
            rows = info["gaussian_ids"]
        else:
            radii = info["radii"]
            is_seen = (radii > 0).all(dim=-1) if radii.dim() == gradient.dim() else radii > 0
            rows, lengths = torch.where(is_seen)[-1], lengths[is_seen]
        if state["gradient_sum"] is None:
            state["gradient_sum"] = lengths.new_zeros(len(params["means"]))
            state["weight_sum"] = torch.zeros_like(state["gradient_sum"])
        state["gradient_sum"].index_add_(0, rows, lengths)
        state["weight_sum"].index_add_(0, rows, torch.ones_like(lengths))

    @torch.no_grad()
    def _densify(self, params: Params, optimizers: Optimizers, state: Dict[str, Any], iteration: int) -> None:
        if state["gradient_sum"] is None:
            return
        control: DensityControl = state["control"]
        means, scales, quats, opacities = (_array(params[name]) for name in _REQUIRED)
        cloud = Rows(means, scales, quats, opacities.reshape(-1))
        scores = _edge_scores(cloud, control, state["views"], iteration)
        sums = (_array(state["gradient_sum"]), _array(state["weight_sum"]))
        sources, kept, means, scales, opacities, counts = control.decide(iteration, *sums, cloud, scores)
        new = {"means": means, "scales": scales, "opacities": opacities}
        rows, is_kept = torch.from_numpy(sources), torch.from_numpy(kept)
        for name in list(params):
            _replace(params, optimizers, name, rows, is_kept, new.get(name))
        state["gradient_sum"] = state["weight_sum"] = None
        if self.verbose:
            split, pruned, refused = counts
            left = f"{refused} more found no room" if refused else f"room for {control.budget(iteration)}"
            print(f"step {iteration - 1}: {len(rows)} Gaussians; {split} were split, {pruned} pruned; {left}")


def _edge_scores(cloud: Rows, control: DensityControl, views: Any, iteration: int) -> Optional[Any]:
    if views is None:
        return None
    images, viewmats, Ks, near_plane = views
    shown = control.score_views(iteration, len(images))
    if not shown:
        return None
    return cloud.edge_scores([images[view] for view in shown], viewmats[shown], Ks[shown], near_plane)


def _replace(
    params: Params, optimizers: Optimizers, name: str, rows: Tensor, is_kept: Tensor, values: Optional[Any]
) -> None:
    """New rows of a parameter, and of what its optimizer has of each: that of rows that are not new."""
    old = params[name]
    rows, is_kept = rows.to(old.device), is_kept.to(old.device)
    data = old.detach()[rows]
    if values is not None:
        changed = torch.from_numpy(values).to(old.device, old.dtype).reshape(data.shape)
        # Rows that stay keep all digits.
        data = torch.where(is_kept.reshape(-1, *[1] * (data.dim() - 1)), data, changed)
    new = torch.nn.Parameter(data, requires_grad=old.requires_grad)
    params[name] = new

    def moved(value: Tensor) -> Tensor:
        gathered = value[rows]
        gathered[~is_kept] = 0
        return gathered

    if name in optimizers:
        _change_optimizer(optimizers[name], old, new, moved)


def _change_optimizer(
    optimizer: torch.optim.Optimizer,
    old: torch.nn.Parameter,
    new: torch.nn.Parameter,
    of_rows: Callable[[Tensor], Tensor],
) -> None:
    of_parameter = optimizer.state.pop(old, {})
    for key, value in of_parameter.items():
        if torch.is_tensor(value) and value.dim() > 0 and len(value) == len(old):
            of_parameter[key] = of_rows(value)
    optimizer.param_groups[0]["params"] = [new]
    if of_parameter:
        optimizer.state[new] = of_parameter


@torch.no_grad()
def _limit_opacities(params: Params, optimizers: Optimizers, ceiling: float) -> None:
    logit = float(np.log(ceiling) - np.log1p(-ceiling))
    old = params["opacities"]
    new = torch.nn.Parameter(old.detach().clamp(max=logit), requires_grad=old.requires_grad)
    params["opacities"] = new
    if "opacities" in optimizers:
        _change_optimizer(optimizers["opacities"], old, new, torch.zeros_like)


def _array(tensor: Tensor) -> Any:
    return np.ascontiguousarray(tensor.detach().to("cpu", torch.float32).numpy())


def _numbers(values: Any) -> Any:
    values = values.detach().cpu().numpy() if torch.is_tensor(values) else values
    return np.asarray(values, dtype=np.float64)


def _bytes(image: Any) -> Any:
    array = image.detach().cpu().numpy() if torch.is_tensor(image) else np.asarray(image)
    if array.dtype != np.uint8:
        array = (np.clip(array, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    return np.ascontiguousarray(array)
