"""A differentiable rasteriser with gsplat's arguments, shapes and results, without CUDA and without a
compiler.

>>> from genesplat.torch import rasterization
>>> image, alpha, meta = rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height)

It works by the kernels of `genesplat train`, on the CPU unless `device` is a graphics card, which then
sorts and blends, forward and backward. Tensors on another device are brought to the CPU, and results to the
device of `means`. Code that was written for gsplat runs unchanged as long as it asks for what is supported:
pinhole cameras, any number of cameras and of channels, harmonics up to degree 3, backgrounds, depth, both
rasterize_modes, absgrad, packed or not; gradients by everything but `Ks`. What is not supported is refused.

Numbers are gsplat's up to rounding but for one thing: alpha ends at 0.99, as in 3DGS, and not at 0.999.
"""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Tuple, Union

import numpy as np

try:
    import torch
except ImportError as error:
    raise ImportError("genesplat.torch needs PyTorch 1.13 or newer: pip install torch") from error

from torch import Tensor
from torch.autograd.function import once_differentiable

from genesplat._native import RasterizedView

__all__ = ["rasterization"]

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")
RASTERIZE_MODES = ("classic", "antialiased")

# Variance that is added to each splat on the screen, px²: the only one that the kernels know.
_EPS2D = 0.3
# Side of the kernels' tiles, px.
_TILE = 16
# Channels that are drawn at once.
_CHANNELS = 3


def rasterization(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: Optional[int] = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Optional[Tensor] = None,
    render_mode: str = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: str = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: str = "pinhole",
    segmented: bool = False,
    covars: Optional[Tensor] = None,
    device: str = "cpu",
    **others: Any,
) -> Tuple[Tensor, Tensor, Dict[str, Any]]:
    """Renders N Gaussians as C cameras see them.

    Args:
        means: centres, world units [N, 3].
        quats: rotations, wxyz, not necessarily of length 1 [N, 4].
        scales: standard deviations along the own axes, world units, after the exponential [N, 3].
        opacities: between 0 and 1, after the sigmoid [N].
        colors: with `sh_degree`, coefficients of spherical harmonics [N, K, 3] or [C, N, K, 3]; without,
            colours or any other features [N, D] or [C, N, D], which are drawn as they are.
        viewmats: camera from world; x right, y down, z forward [C, 4, 4].
        Ks: focal lengths and principal point, px; the corner of the first pixel is at (0, 0) [C, 3, 3].
        width, height: of the pictures, px.
        near_plane, far_plane: what lies outside is not drawn, depth in world units.
        radius_clip: splats that reach no further are not drawn, px.
        eps2d: variance added to each splat on the screen, px²; 0.3 alone.
        sh_degree: degree of the harmonics that are used, 0 to 3.
        packed: `meta` has a row for each splat that is drawn, or else for each Gaussian and camera.
        backgrounds: what is behind all splats, for each channel but depth [C, D].
        render_mode: "RGB", accumulated depth "D", expected depth "ED", or both.
        absgrad: `meta["means2d"].absgrad` is made by the backward pass.
        rasterize_mode: "classic", or "antialiased".
        tile_size, channel_chunk, segmented: accepted; they change no number in gsplat either.
        device: "cpu", whose results are the same bytes for any number of threads; "gpu", the best graphics
            device with a Vulkan, Metal or DX12 driver; "gpu:N", that of this number in `genesplat devices`;
            "auto", a card where there is one.

    Returns:
        Pictures [C, H, W, D], alphas [C, H, W, 1], and a dictionary with `means2d` (its gradient is in
        `.grad` after the backward pass; a loss of its values reaches no parameter), `radii`, `depths`,
        `conics`, `opacities`, `camera_ids`, `gaussian_ids`, `width`, `height`, `n_cameras`, `n_batches`,
        `tile_size`, `tile_width`, `tile_height`.

    Raises:
        TypeError: something is no tensor.
        ValueError: a shape or a value is wrong.
        NotImplementedError: gsplat has it, and this rasteriser has not.
        Error: there is no such `device`, or it cannot be used.
    """
    refused = {"sparse_grad": sparse_grad, "distributed": distributed, "covars": covars, **others}
    _refuse(refused, eps2d, camera_model)
    if render_mode not in RENDER_MODES:
        raise ValueError(f"render_mode is {render_mode!r}, but must be one of {', '.join(RENDER_MODES)}")
    if rasterize_mode not in RASTERIZE_MODES:
        raise ValueError(
            f"rasterize_mode is {rasterize_mode!r}, but must be one of {', '.join(RASTERIZE_MODES)}"
        )
    given = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors}
    _check_tensors({**given, "viewmats": viewmats, "Ks": Ks, "backgrounds": backgrounds})
    if torch.is_grad_enabled() and Ks.requires_grad:
        raise NotImplementedError("there are no gradients by Ks; pass Ks.detach()")
    _check_shapes(means, quats, scales, opacities, viewmats, Ks)
    cloud = [_on_cpu(tensor) for tensor in (means, quats, scales, opacities)]
    is_antialiased = rasterize_mode == "antialiased"
    limits = (float(near_plane), min(float(far_plane), 3e38), float(radius_clip), is_antialiased, device)
    cameras = _Cameras(viewmats, Ks, (int(width), int(height)), limits)
    channels = _Channels(_on_cpu(colors), sh_degree, len(means), len(cameras), render_mode)
    views = [_views_of_camera(cloud, cameras, channels, camera) for camera in range(len(cameras))]
    meta = _meta(views, cloud, cameras, packed, absgrad, means.device)
    drawn = [_draw(of_camera, meta["means2d"], cloud) for of_camera in views]
    colours, alpha = (torch.stack(of_cameras) for of_cameras in zip(*drawn))
    if backgrounds is not None:
        colours = colours + (1.0 - alpha) * channels.backgrounds(_on_cpu(backgrounds), len(cameras))
    if render_mode.endswith("ED"):
        depth = colours[..., -1:] / alpha.clamp(min=1e-10)
        colours = torch.cat([colours[..., :-1], depth], dim=-1)
    return colours.to(means), alpha.to(means), meta


def _refuse(others: Dict[str, Any], eps2d: float, camera_model: str) -> None:
    for name, value in others.items():
        if value is not None and value is not False:
            raise NotImplementedError(f"genesplat.torch.rasterization has no {name}; leave it out")
    if eps2d != _EPS2D:
        raise NotImplementedError(f"eps2d is {eps2d}, but genesplat's kernels know {_EPS2D} alone")
    if camera_model != "pinhole":
        raise NotImplementedError(
            f"camera_model is {camera_model!r}, but genesplat's kernels know pinhole cameras alone"
        )


def _check_tensors(given: Dict[str, Any]) -> None:
    for name, value in given.items():
        if value is not None and not isinstance(value, Tensor):
            kind = type(value).__name__
            raise TypeError(f"{name} is of type {kind}, not a tensor; torch.from_numpy makes one of an array")


def _check_shapes(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, viewmats: Tensor, Ks: Tensor
) -> None:
    count = len(means) if means.dim() == 2 else "N"
    cameras = len(viewmats) if viewmats.dim() == 3 else "C"
    wanted = {
        "means": (means, (count, 3)),
        "quats": (quats, (count, 4)),
        "scales": (scales, (count, 3)),
        "opacities": (opacities, (count,)),
        "viewmats": (viewmats, (cameras, 4, 4)),
        "Ks": (Ks, (cameras, 3, 3)),
    }
    for name, (tensor, shape) in wanted.items():
        if tuple(tensor.shape) != shape:
            words = ", ".join(map(str, shape))
            raise ValueError(
                f"{name} has the shape {list(tensor.shape)}, not [{words}]; batches of clouds need a loop"
            )
    if cameras == 0:
        raise ValueError("viewmats has no camera")


def _on_cpu(tensor: Tensor) -> Tensor:
    return tensor.to("cpu", torch.float32).contiguous()


def _array(tensor: Tensor) -> Any:
    return np.ascontiguousarray(tensor.detach().numpy())


class _Cameras:
    """The cameras of one call, what they draw of depths and sizes, whether antialiased, and on what."""

    def __init__(
        self,
        viewmats: Tensor,
        Ks: Tensor,
        size: Tuple[int, int],
        limits: Tuple[float, float, float, bool, str],
    ) -> None:
        if min(size) < 1:
            raise ValueError(f"pictures of {size[0]} x {size[1]} px have no pixels")
        self.viewmats, self.Ks = _on_cpu(viewmats), _on_cpu(Ks)
        self.size, self.limits = size, limits

    def __len__(self) -> int:
        return len(self.viewmats)


class _Channels:
    """What is drawn of each Gaussian: colours or harmonics, and depth."""

    def __init__(self, colors: Tensor, sh_degree: Optional[int], count: int, cameras: int, mode: str) -> None:
        self.sh_degree = sh_degree
        self.has_depth = mode != "RGB"
        self.has_colors = mode not in ("D", "ED")
        self.colors = colors
        trailing = 2 if sh_degree is not None else 1
        wanted = "N, K, 3" if sh_degree is not None else "N, D"
        leading = tuple(colors.shape[: colors.dim() - trailing])
        self.by_camera = leading == (cameras, count)
        if leading != (count,) and not self.by_camera:
            shape = list(colors.shape)
            raise ValueError(
                f"colors has the shape {shape}, not [{wanted}] or [C, {wanted}], with {count} Gaussians"
            )
        if sh_degree is not None and not 0 <= sh_degree <= 3:
            raise NotImplementedError(f"sh_degree is {sh_degree}, but genesplat's kernels know 0 to 3 alone")

    def parts(self, camera: int, depths: Tensor) -> List[Tuple[Tensor, int]]:
        """Colours of at most three channels, which are drawn together, and how many of these there are."""
        of_camera = self.colors[camera] if self.by_camera else self.colors
        parts: List[Tuple[Tensor, int]] = []
        if self.has_colors and self.sh_degree is not None:
            parts.append((of_camera.contiguous(), _CHANNELS))
            rest = depths.unsqueeze(-1)[:, : int(self.has_depth)]
        else:
            features = [of_camera] * self.has_colors + [depths.unsqueeze(-1)] * self.has_depth
            rest = torch.cat(features, dim=-1)
        for part in rest.split(_CHANNELS, dim=-1):
            missing = _CHANNELS - part.shape[-1]
            if missing < _CHANNELS:
                parts.append((torch.nn.functional.pad(part, (0, missing)).contiguous(), _CHANNELS - missing))
        return parts

    def backgrounds(self, backgrounds: Tensor, cameras: int) -> Tensor:
        """Of each camera and channel, 0 for depth [C, 1, 1, D]."""
        drawn = 0
        if self.has_colors:
            drawn = _CHANNELS if self.sh_degree is not None else int(self.colors.shape[-1])
            if tuple(backgrounds.shape) != (cameras, drawn):
                raise ValueError(
                    f"backgrounds has the shape {list(backgrounds.shape)}, not [{cameras}, {drawn}]"
                )
        behind = backgrounds[:, :drawn]
        return torch.nn.functional.pad(behind, (0, int(self.has_depth)))[:, None, None, :]


class _View:
    """At most three channels of what one camera sees."""

    def __init__(
        self, native: RasterizedView, colors: Tensor, viewmat: Tensor, channels: int, is_sh: bool
    ) -> None:
        self.native, self.channels, self.is_sh = native, channels, is_sh
        self.colors, self.viewmat = colors, viewmat
        # Where the means of its splats are in `means2d`, and the rows that these are of; all where there
        # are none.
        self.part: Union[int, slice] = 0
        self.rows: Optional[Tensor] = None
        # The tensor that gets an attribute `absgrad`.
        self.marked: Optional[Tensor] = None


def _views_of_camera(cloud: List[Tensor], cameras: _Cameras, channels: _Channels, camera: int) -> List[_View]:
    viewmat = cameras.viewmats[camera]
    depths = cloud[0] @ viewmat[2, :3] + viewmat[2, 3]
    means, quats, scales, opacities = (_array(tensor) for tensor in cloud)
    views = []
    for place, (colors, count) in enumerate(channels.parts(camera, depths)):
        degree = channels.sh_degree if channels.has_colors and place == 0 else None
        given = _array(colors)
        native = RasterizedView(
            means,
            quats,
            scales,
            opacities,
            None if degree is None else given,
            given if degree is None else None,
            degree or 0,
            _array(viewmat),
            _array(cameras.Ks[camera]),
            cameras.size,
            *cameras.limits,
        )
        views.append(_View(native, colors, viewmat, count, degree is not None))
    if not views:
        raise ValueError("colors has no channels")
    return views


def _meta(
    views: List[List[_View]],
    cloud: List[Tensor],
    cameras: _Cameras,
    packed: bool,
    absgrad: bool,
    device: torch.device,
) -> Dict[str, Any]:
    """What gsplat tells beside the pictures; every view learns where the means of its splats are."""
    names = ("rows", "means2d", "radii", "depths", "conics", "opacities")
    splats = [[torch.from_numpy(array) for array in of_camera[0].native.splats()] for of_camera in views]
    rows = [of_camera[0] for of_camera in splats]
    if packed:
        columns = {name: torch.cat(column) for name, column in zip(names, zip(*splats))}
        ends = np.cumsum([len(of_camera) for of_camera in rows]).tolist()
        parts: List[Union[int, slice]] = [
            slice(end - len(of_camera), end) for end, of_camera in zip(ends, rows)
        ]
        ids = torch.cat([torch.full_like(of_camera, camera) for camera, of_camera in enumerate(rows)])
        columns["camera_ids"], columns["gaussian_ids"] = ids, columns["rows"]
    else:
        dense = [
            [_dense(column, of_camera[0], len(cloud[0])) for column in of_camera] for of_camera in splats
        ]
        columns = {name: torch.stack(column) for name, column in zip(names, zip(*dense))}
        parts = list(range(len(views)))
    columns.pop("rows")
    meta: Dict[str, Any] = {"batch_ids": None, "camera_ids": None, "gaussian_ids": None}
    meta.update({name: column.to(device) for name, column in columns.items()})
    # A leaf of the graph, whose gradient the backward pass of each view adds to.
    meta["means2d"].requires_grad_(_has_gradient(cloud, views))
    for part, of_camera_rows, of_camera in zip(parts, rows, views):
        for view in of_camera:
            view.part, view.rows = part, of_camera_rows if packed else None
            view.marked = meta["means2d"] if absgrad else None
    width, height = cameras.size
    meta.update(width=width, height=height, n_cameras=len(views), n_batches=1, tile_size=_TILE)
    meta.update(tile_width=-(-width // _TILE), tile_height=-(-height // _TILE))
    return meta


def _dense(column: Tensor, rows: Tensor, count: int) -> Tensor:
    """A row for each Gaussian; zeros for those that are not drawn."""
    return column.new_zeros((count, *column.shape[1:])).index_copy_(0, rows, column)


def _has_gradient(cloud: List[Tensor], views: List[List[_View]]) -> bool:
    of_views = [(view.colors, view.viewmat) for of_camera in views for view in of_camera]
    inputs = cloud + [tensor for of_view in of_views for tensor in of_view]
    return torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs)


def _draw(views: List[_View], means2d: Tensor, cloud: List[Tensor]) -> Tuple[Tensor, Tensor]:
    """All channels of a camera on black [H, W, D], and alpha [H, W, 1]."""
    drawn = []
    for view in views:
        means_of_view = means2d[view.part].to("cpu")
        image, left = _Rasterize.apply(view, means_of_view, *cloud, view.colors, view.viewmat)
        drawn.append((image[..., : view.channels], left))
    return torch.cat([image for image, _ in drawn], dim=-1), 1.0 - drawn[0][1].unsqueeze(-1)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, view: _View, *inputs: Tensor) -> Tuple[Tensor, Tensor]:
        ctx.view = view
        image, left = view.native.draw()
        return torch.from_numpy(image).permute(1, 2, 0).contiguous(), torch.from_numpy(left)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, by_image: Tensor, by_left: Tensor) -> Tuple[Optional[Tensor], ...]:
        view: _View = ctx.view
        arrays = view.native.backward(_array(by_image.permute(2, 0, 1)), _array(by_left))
        *by_cloud, by_sh, by_rgb, by_means2d, absolute, by_viewmat = map(torch.from_numpy, arrays)
        if view.rows is not None:
            by_means2d, absolute = by_means2d[view.rows], absolute[view.rows]
        if view.marked is not None:
            _mark(view.marked, view.part, absolute)
        if view.is_sh:
            bands = view.colors.shape[1]
            by_colors = torch.nn.functional.pad(by_sh[:, :bands], (0, 0, 0, max(0, bands - by_sh.shape[1])))
        else:
            by_colors = by_rgb
        return (None, by_means2d, *by_cloud, by_colors, by_viewmat)


def _mark(means2d: Any, part: Union[int, slice], absolute: Tensor) -> None:
    """Adds to `means2d.absgrad`, which is where gsplat has these sums."""
    if getattr(means2d, "absgrad", None) is None:
        means2d.absgrad = torch.zeros_like(means2d, requires_grad=False)
    means2d.absgrad[part] += absolute.to(means2d.device)
