"""Types that several modules name, and how arrays are checked.

NumPy is imported where arrays are made, and not before: the command starts without it.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Optional, Union

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Float32 = npt.NDArray[np.float32]
    Float64 = npt.NDArray[np.float64]
    UInt8 = npt.NDArray[np.uint8]
    ArrayLike = npt.ArrayLike

StrPath = Union[str, "os.PathLike[str]"]


def on_host(values: Any) -> Any:
    """The same in main memory and without gradients, where it is a tensor of torch."""
    return values.detach().cpu() if hasattr(values, "detach") else values


def checked(name: str, values: Any, shape: tuple[Optional[int], ...], dtype: str = "float32") -> Any:
    """`values` as a C-contiguous array; `None` in `shape` stands for any length.

    Raises:
        ValueError: The array has another shape, or holds no numbers.
    """
    import numpy as np

    try:
        array = np.asarray(on_host(values), dtype=dtype, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is no array of numbers: {error}") from None
    fits = array.ndim == len(shape) and all(
        wanted is None or wanted == there for wanted, there in zip(shape, array.shape)
    )
    if not fits:
        raise ValueError(f"{name} has the shape {list(array.shape)}; give {_words(shape)}")
    return array


def _words(shape: tuple[Optional[int], ...]) -> str:
    names = iter("NKL")
    return "[" + ", ".join(next(names) if length is None else str(length) for length in shape) + "]"
