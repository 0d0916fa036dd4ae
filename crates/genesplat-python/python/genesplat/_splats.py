from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any, Optional

from genesplat import _native
from genesplat._types import StrPath, checked

if TYPE_CHECKING:
    from genesplat._types import ArrayLike, Float32

#: The value of the first spherical harmonic: a colour is ``0.5 + SH_C0 * sh0``.
SH_C0 = 0.28209479177387814


class Splats:
    """A cloud of ``N`` Gaussians as NumPy arrays (float32), named and shaped as gsplat's trainer has them.

    Arrays are raw parameters, before activation, and say so in their names. They can be changed in place or
    replaced; they are checked where they are used.

    Attributes:
        means: Centres, world units ``[N, 3]``.
        quats: Rotations ``(w, x, y, z)``, of any length ``[N, 4]``.
        log_scales: Logarithms of the standard deviations along the own axes, world units ``[N, 3]``.
        logit_opacities: Opacities before the sigmoid ``[N]``.
        sh0: Base colours as spherical harmonics ``[N, 1, 3]``; the colour is ``0.5 + 0.2821 * sh0``.
        shN: View-dependent colours ``[N, K, 3]``, with K of 0, 3, 8 or 15 (degrees 0 to 3).
        rasterize_mode: How small Gaussians are drawn: "classic", "antialiased" (as gsplat calls them), or
            "mip" for those of Mip-Splatting.
        filter_3d: Mip-Splatting's 3D filter, standard deviations in world units ``[N]``; else None.
        offset: What has been subtracted from the coordinates of the scene's source, where it lies far from
            its origin; else None.
    """

    means: Float32
    quats: Float32
    log_scales: Float32
    logit_opacities: Float32
    sh0: Float32
    shN: Float32
    rasterize_mode: str
    filter_3d: Optional[Float32]
    offset: Optional[tuple[float, float, float]]

    def __init__(
        self,
        means: ArrayLike,
        quats: ArrayLike,
        log_scales: ArrayLike,
        logit_opacities: ArrayLike,
        sh0: ArrayLike,
        shN: Optional[ArrayLike] = None,
        *,
        rasterize_mode: str = "classic",
        filter_3d: Optional[ArrayLike] = None,
        offset: Optional[tuple[float, float, float]] = None,
    ) -> None:
        """Splats of raw parameters; tensors of torch are copied from wherever they are.

        Raises:
            ValueError: An array has another shape than the class says, or another number of rows.
        """
        import numpy as np

        self.means = means  # type: ignore[assignment]
        self.quats = quats  # type: ignore[assignment]
        self.log_scales = log_scales  # type: ignore[assignment]
        self.logit_opacities = logit_opacities  # type: ignore[assignment]
        self.sh0 = sh0  # type: ignore[assignment]
        self.shN = np.zeros((len(self), 0, 3), np.float32) if shN is None else shN  # type: ignore[assignment]
        self.rasterize_mode = rasterize_mode
        self.filter_3d = filter_3d  # type: ignore[assignment]
        self.offset = offset
        self._check()

    @classmethod
    def from_activated(
        cls,
        means: ArrayLike,
        quats: ArrayLike,
        scales: ArrayLike,
        opacities: ArrayLike,
        colors: ArrayLike,
        *,
        rasterize_mode: str = "classic",
    ) -> Splats:
        """Splats of what `gsplat.rasterization` takes: activated parameters.

        Args:
            means: World units ``[N, 3]``.
            quats: ``(w, x, y, z)`` ``[N, 4]``.
            scales: Standard deviations, world units, above 0 ``[N, 3]``.
            opacities: 0 to 1 ``[N]``.
            colors: RGB from 0 to 1 ``[N, 3]``, or spherical harmonics ``[N, 1 + K, 3]``.
            rasterize_mode: "classic" or "antialiased".

        Raises:
            ValueError: A shape or a value cannot be.
        """
        import numpy as np

        sizes = checked("scales", scales, (None, 3))
        alphas = checked("opacities", opacities, (None,), "float64")
        if not np.all(sizes > 0):
            raise ValueError("scales have to be above 0")
        if not np.all((alphas >= 0) & (alphas <= 1)):
            raise ValueError("opacities have to be from 0 to 1")
        # Nearest to opaque and transparent that a finite logit can be.
        alphas = np.clip(alphas, 1e-7, 1 - 1e-7)
        if np.ndim(colors) == 2:
            colors = ((checked("colors", colors, (None, 3)) - 0.5) / SH_C0)[:, None, :]
        sh = checked("colors", colors, (None, None, 3))
        log_scales, logits = np.log(sizes), np.log(alphas / (1 - alphas))
        return cls(means, quats, log_scales, logits, sh[:, :1], sh[:, 1:], rasterize_mode=rasterize_mode)

    @classmethod
    def load(cls, path: StrPath) -> Splats:
        """The splat in a file of any format, known by its content, or that of the run in a folder.

        Raises:
            Error: The file cannot be read, or is damaged.
        """
        return cls._of(_native.Cloud.open(path, None))

    @classmethod
    def from_ply(cls, path: StrPath) -> Splats:
        """As `load`, of a ``.ply`` as the authors of 3DGS write it."""
        return cls._of(_native.Cloud.open(path, ".ply"))

    @classmethod
    def from_spz(cls, path: StrPath) -> Splats:
        """As `load`, of a ``.spz``."""
        return cls._of(_native.Cloud.open(path, ".spz"))

    @classmethod
    def from_sog(cls, path: StrPath) -> Splats:
        """As `load`, of a ``.sog``."""
        return cls._of(_native.Cloud.open(path, ".sog"))

    @classmethod
    def from_glb(cls, path: StrPath) -> Splats:
        """As `load`, of a ``.glb`` with KHR_gaussian_splatting."""
        return cls._of(_native.Cloud.open(path, ".glb"))

    def save(self, path: StrPath) -> None:
        """Write a file, whole or not at all, in the format that its name ends in: ``.ply``,
        ``.compressed.ply``, ``.splat``, ``.spz``, ``.sog`` or ``.glb``.

        Raises:
            ValueError: An array was given a shape or a value that cannot be.
            Error: The name ends in something else, or the file cannot be written.
        """
        self._cloud().save(path, None)

    def to_ply(self, path: StrPath) -> None:
        """As `save`, as ``.ply``: everything, in full precision."""
        self._cloud().save(path, ".ply")

    def to_spz(self, path: StrPath) -> None:
        """As `save`, as ``.spz``: about a tenth of the size of a ``.ply``."""
        self._cloud().save(path, ".spz")

    def to_sog(self, path: StrPath) -> None:
        """As `save`, as ``.sog``: smallest; rows change their order."""
        self._cloud().save(path, ".sog")

    def to_glb(self, path: StrPath) -> None:
        """As `save`, as ``.glb``, with KHR_gaussian_splatting."""
        self._cloud().save(path, ".glb")

    @property
    def scales(self) -> Float32:
        """Standard deviations along the own axes, world units ``[N, 3]``: a copy, ``exp(log_scales)``."""
        import numpy as np

        return np.exp(self.log_scales)

    @property
    def opacities(self) -> Float32:
        """Opacities from 0 to 1 ``[N]``: a copy, ``sigmoid(logit_opacities)``."""
        import numpy as np

        return (1 / (1 + np.exp(-self.logit_opacities))).astype(np.float32)

    @property
    def colors(self) -> Float32:
        """All spherical harmonics ``[N, 1 + K, 3]``, as `gsplat.rasterization` takes them: a copy."""
        import numpy as np

        return np.concatenate([self.sh0, self.shN], axis=1)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return {0: 0, 3: 1, 8: 2, 15: 3}[self.shN.shape[1]]

    def copy(self) -> Splats:
        """The same with arrays of its own."""
        return self[:]

    def __len__(self) -> int:
        return len(self.means)

    def __getitem__(self, rows: Any) -> Splats:
        """The Gaussians of these rows: a slice, a mask ``[N]`` or indices."""
        import numpy as np

        if np.ndim(rows) == 0 and not isinstance(rows, slice):
            raise TypeError("give a slice, a mask or indices")
        self._check()
        return Splats(
            *(array[rows].copy() for array in self._arrays()),
            rasterize_mode=self.rasterize_mode,
            filter_3d=None if self.filter_3d is None else self.filter_3d[rows].copy(),
            offset=self.offset,
        )

    def __repr__(self) -> str:
        return f"<Splats: {len(self):,} Gaussians, sh_degree {self.sh_degree}, {self.rasterize_mode}>"

    def to_html(self, title: str = "splats") -> str:
        """The page that `genesplat export` makes: the splat and a viewer in one text, for any browser."""
        return self._cloud().page(title)

    def _repr_html_(self) -> str:
        """What a notebook shows: `to_html` in a frame."""
        page = html.escape(self.to_html(), quote=True)
        style = "width: 100%; height: 480px; border: 0"
        return f'<iframe srcdoc="{page}" style="{style}" title="{html.escape(repr(self))}"></iframe>'

    def _arrays(self) -> list[Float32]:
        return [self.means, self.quats, self.log_scales, self.logit_opacities, self.sh0, self.shN]

    def _check(self) -> None:
        """Brings arrays to float32, and fails where their shapes cannot be."""
        self.means = checked("means", self.means, (None, 3))
        self.quats = checked("quats", self.quats, (None, 4))
        self.log_scales = checked("log_scales", self.log_scales, (None, 3))
        self.logit_opacities = checked("logit_opacities", self.logit_opacities, (None,))
        self.sh0 = checked("sh0", self.sh0, (None, 1, 3))
        self.shN = checked("shN", self.shN, (None, None, 3))
        if self.filter_3d is not None:
            self.filter_3d = checked("filter_3d", self.filter_3d, (None,))
        names = ["quats", "log_scales", "logit_opacities", "sh0", "shN", "filter_3d"]
        for name in names:
            array = getattr(self, name)
            if array is not None and len(array) != len(self.means):
                raise ValueError(f"{name} has {len(array)} rows, and means has {len(self.means)}")
        if self.shN.shape[1] not in (0, 3, 8, 15):
            raise ValueError(f"shN has {self.shN.shape[1]} coefficients; give 0, 3, 8 or 15")

    def _cloud(self) -> _native.Cloud:
        self._check()
        return _native.Cloud.from_arrays(self, self.rasterize_mode, self.offset)

    @classmethod
    def _of(cls, cloud: _native.Cloud) -> Splats:
        return cls(**cloud.arrays())
