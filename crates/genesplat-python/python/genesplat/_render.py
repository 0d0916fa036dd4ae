from __future__ import annotations

from typing import TYPE_CHECKING, Any, Optional

from genesplat._splats import Splats
from genesplat._types import checked, on_host

if TYPE_CHECKING:
    from genesplat._types import ArrayLike, Float32, Float64


def render(
    splats: Splats,
    viewmats: ArrayLike,
    Ks: ArrayLike,
    width: int,
    height: int,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sh_degree: Optional[int] = None,
    near_plane: float = 0.2,
    device: str = "cpu",
) -> Float32:
    """Pictures of splats from ``C`` cameras.

    Args:
        splats: What is drawn.
        viewmats: Camera from world ``[C, 4, 4]``, or ``[4, 4]`` for one camera; x right, y down, z forward.
        Ks: Pinhole intrinsics in pixels ``[C, 3, 3]``, or ``[3, 3]``:
            ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.
        background: RGB behind the splats, 0 to 1.
        sh_degree: Highest degree of the spherical harmonics that are used; all of them by default.
        near_plane: What lies at or before this depth is not drawn, world units. (`gsplat` has 0.01.)
        device: "cpu"; or "gpu", "gpu:N", "auto", for a card by Vulkan, Metal or DX12.

    Returns:
        RGB, float32 ``[C, height, width, 3]``; may exceed 1 where colours do.

    Raises:
        ValueError: A shape or a matrix cannot be.
        Error: The device cannot be used.
    """
    poses, lenses = _matrices("viewmats", viewmats, 4), _matrices("Ks", Ks, 3)
    if len(poses) != len(lenses):
        raise ValueError(f"there are {len(poses)} viewmats and {len(lenses)} Ks; give one each for a camera")
    if width < 1 or height < 1:
        raise ValueError(f"a picture cannot have {width} x {height} pixels")
    degree = splats.sh_degree if sh_degree is None else sh_degree
    if not 0 <= degree <= 3:
        raise ValueError(f"sh_degree is {degree}, and has to be from 0 to 3")
    cloud = splats._cloud()
    red, green, blue = background
    return cloud.render(poses, lenses, (width, height), near_plane, (red, green, blue), degree, device)


def _matrices(name: str, values: Any, side: int) -> Float64:
    """`[C, side, side]` of many matrices, or of one."""
    import numpy as np

    values = on_host(values)
    if np.ndim(values) == 2:
        values = np.asarray(values)[None]
    found: Float64 = checked(name, values, (None, side, side), "float64")
    return found
