from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Optional, Union

from genesplat import _native
from genesplat._evaluate import Scores, evaluate
from genesplat._scene import Scene
from genesplat._splats import Splats
from genesplat._types import StrPath


@dataclass(frozen=True)
class Step:
    """Where training is.

    Attributes:
        iteration: The one that was just done, counted from 1.
        iterations: The last one.
        loss: Of its photo: 0.8 L1 + 0.2 (1 - SSIM).
        gaussians: How many there were in it.
        sh_degree: Degree of the spherical harmonics that it used.
    """

    iteration: int
    iterations: int
    loss: float
    gaussians: int
    sh_degree: int


class Trainer:
    """Training as a loop: each turn goes on until the next step that is wanted.

    ::

        trainer = Trainer(scene, iterations=2000)
        for step in trainer:
            if step.iteration % 500 == 0:
                print(step.loss, trainer.evaluate().psnr)
        trainer.save("scene.ply")

    Training waits while the body of the loop runs, and `splats` are those after the step. Whoever leaves the
    loop early, by ``break`` or by an exception, can iterate again: training goes on there, to the same bytes.
    With a folder `out`, it goes on in another process too (`Trainer.resume`), or with `genesplat train`.

    A thread trains while a loop is under way, and none is left after it. Same seed, same bytes as the
    command, on the CPU.
    """

    def __init__(
        self,
        scene: Scene,
        method: Union[str, Mapping[str, Any]] = "genesplat",
        iterations: Optional[int] = None,
        device: str = "auto",
        seed: int = 0,
        out: Optional[StrPath] = None,
        *,
        minutes: Optional[float] = None,
        splats: Optional[Splats] = None,
        every: int = 10,
        **settings: Any,
    ) -> None:
        """Prepare a training; nothing is done before the first turn of the loop.

        Args:
            scene: What to train on.
            method: "genesplat", "3dgs", "mcmc", "mip-splatting", "pixel-gs" or "improved-gs"; or a table with
                its ``name`` and settings (docs/settings.md).
            iterations: Training steps, one photo each; 7000 where neither they nor `minutes` are given.
            device: "auto", "cpu", "gpu" or "gpu:N".
            seed: Of all random numbers.
            out: A folder for all that `genesplat train` leaves: the splat, figures, a page, checkpoints.
            minutes: As many iterations as fit into them on this machine, at most 30000: the first turn tries
                a few steps. What the body of the loop takes comes on top. Of method "genesplat" alone.
            splats: Begin with these, and not with the points of the scene (without `out`).
            every: Iterations between two turns of the loop; the last iteration is one too. On a card, each
                turn waits for the device.
            settings: All other settings of docs/settings.md by their names: ``max_gaussians=100_000``,
                ``sh_degree=2``, ``antialiasing=True``, ``steps_scale=0.1``, ``checkpoint_every=500``;
                ``genetic=True``, or a table, for the published search after each opacity reset.

        Raises:
            ValueError: A setting is unknown, or cannot be: which, and what it may be.
        """
        self._open(scene, out, every)
        if minutes is not None and (iterations is not None or "steps_scale" in settings):
            raise ValueError("minutes takes the place of iterations and of steps_scale; leave these out")
        length = 7000 if iterations is None else iterations
        table = {**settings, "method": method, "iterations": length, "device": device, "seed": seed}
        cloud = None if splats is None else splats._cloud()
        text = _text(table, scene.background)
        self._device = device
        self._training = _native.Training(scene._native, text, minutes, out, cloud, every)

    @classmethod
    def resume(cls, out: StrPath, scene: Optional[Scene] = None, *, every: int = 10) -> Trainer:
        """Go on with the run in the folder `out`, which was interrupted, with the settings that it has.

        Args:
            out: The folder of a run, of Python or of `genesplat train`.
            scene: What it was trained on, if that is loaded already.
            every: As of `Trainer`.

        Raises:
            Error: The folder holds no run, or one that is finished, or the scene has changed.
        """
        trainer = cls.__new__(cls)
        scene = Scene(_native.Scene.of_run(out)) if scene is None else scene
        trainer._open(scene, out, every)
        trainer._device = "auto"
        trainer._training = _native.Training.resume(scene._native, out, every)
        return trainer

    def _open(self, scene: Scene, out: Optional[StrPath], every: int) -> None:
        if every < 1:
            raise ValueError(f"every is {every}, and has to be at least 1")
        self.scene = scene
        self.out = None if out is None else os.fspath(out)

    def __repr__(self) -> str:
        folder = "" if self.out is None else f", into {self.out!r}"
        return f"<Trainer of {self.scene!r}{folder}>"

    def __iter__(self) -> Iterator[Step]:
        """Train, and yield every so many iterations.

        Raises:
            Error: Training cannot go on: why, and what is left.
            KeyboardInterrupt: After Ctrl-C, once what there is has been saved.
        """
        self._training.begin()
        try:
            while True:
                found = self._training.next()
                if found is None:
                    return
                iteration, iterations, gaussians, sh_degree, loss = found
                yield Step(iteration, iterations, loss, gaussians, sh_degree)
        finally:
            self._training.stop()

    @property
    def splats(self) -> Splats:
        """A copy of the splats as they are now.

        Raises:
            Error: Nothing is trained yet.
        """
        return Splats._of(self._training.cloud())

    @property
    def metrics(self) -> Optional[dict[str, Any]]:
        """``metrics.json`` of a run with a folder, once it has ended; else None."""
        text = self._training.metrics()
        found: Optional[dict[str, Any]] = None if text is None else json.loads(text)
        return found

    def evaluate(self, split: str = "test", *, lpips: Union[bool, StrPath] = False) -> Scores:
        """Scores of the splats as they are now, on photos of the scene; arguments as of `evaluate`."""
        return evaluate(self.splats, self.scene, split=split, lpips=lpips, device=self._device)

    def save(self, path: StrPath) -> None:
        """Write the splats as they are now, in the format that the name ends in (`Splats.save`)."""
        self.splats.save(path)


def train(
    scene: Scene,
    method: Union[str, Mapping[str, Any]] = "genesplat",
    iterations: Optional[int] = None,
    *,
    callback: Optional[Callable[[Step], object]] = None,
    **settings: Any,
) -> Splats:
    """Train to the end; returns the splats.

    Args:
        scene: What to train on.
        method: As of `Trainer`.
        iterations: As of `Trainer`.
        callback: Is called after every tenth iteration (``every``), while training waits; what it raises ends
            training.
        settings: As of `Trainer`, with ``minutes``, ``device``, ``seed``, ``out``.

    Raises:
        ValueError, Error, KeyboardInterrupt: As `Trainer`.
    """
    trainer = Trainer(scene, method, iterations, **settings)
    for step in trainer:
        if callback is not None:
            callback(step)
    return trainer.splats


def _text(settings: dict[str, Any], background: str) -> str:
    """Settings as JSON, in the shape of `config.toml`."""
    for name, instead in [("dataset", "Scene.load"), ("threads", "genesplat.use_threads")]:
        if name in settings:
            raise ValueError(f"{name} is no setting of a training; see {instead}")
    settings.setdefault("background", background)
    if isinstance(settings["method"], str):
        settings["method"] = {"name": settings["method"]}
    if isinstance(settings.get("genetic"), bool):
        settings["genetic"] = {} if settings["genetic"] else None
    named = {name: value for name, value in settings.items() if value is not None}
    return json.dumps(named, default=_plain)


def _plain(value: Any) -> Any:
    """A mapping, or a number of NumPy, as JSON knows it."""
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "item"):
        return value.item()
    raise ValueError(f"{value!r} is no setting")
