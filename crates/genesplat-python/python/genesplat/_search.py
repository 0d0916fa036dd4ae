from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Optional

from genesplat import _native
from genesplat._scene import Scene
from genesplat._splats import Splats


@dataclass(frozen=True)
class SearchResult:
    """What a genetic search has found.

    Attributes:
        splats: The best splats; those that were given where nothing was better.
        loss_before: Mean loss on the views of the search before it.
        loss_after: The same after it; never higher.
        changed: How many Gaussians were changed.
        generations: How many were bred, the first population included.
        seconds: Wall-clock time.
    """

    splats: Splats
    loss_before: float
    loss_after: float
    changed: int
    generations: int
    seconds: float


def genetic_search(
    splats: Splats,
    scene: Scene,
    *,
    generations: int = 100,
    population: int = 100,
    seed: int = 0,
    device: str = "auto",
    **settings: Any,
) -> SearchResult:
    """Search positions, scales and opacities with the genetic algorithm of "An Evolutionary Boost to Gaussian
    Splatting Optimization" (its Algorithm 1), on splats of any trainer, without gradient steps.

    Args:
        splats: The base; it is left as it is. It has to be in the scene's frame.
        scene: Training photos, on some of which fitness is measured (``views``, 6 by default).
        generations: Bred after the first population; time grows in proportion.
        population: Individuals a generation; time grows in proportion.
        seed: Of all random numbers: same seed, same bytes, on the CPU.
        device: "auto", "cpu", "gpu" or "gpu:N".
        settings: Others of the table ``genetic`` of docs/settings.md: ``views=12``, ``intensity=0.2``,
            ``crossover={"kind": "uniform"}``.

    Raises:
        ValueError: A setting is unknown or cannot be.
        Error: The splats cannot be rendered, or the device cannot be used.
        KeyboardInterrupt: After Ctrl-C, at the end of a generation.
    """
    genetic = {"tournament": min(10, population), **settings}
    genetic.update(generations=generations, population=population)
    text = json.dumps({"genetic": genetic, "seed": seed, "background": scene.background})
    cloud, found = _native.genetic_search(splats._cloud(), scene._native, text, device)
    record: Optional[dict[str, Any]] = json.loads(found)
    if record is None:
        raise _native.Error("the search was stopped before it began")
    return SearchResult(
        splats=Splats._of(cloud),
        loss_before=record["fitness_before"],
        loss_after=record["fitness_after"],
        changed=record["changed"],
        generations=record["generations"],
        seconds=record["seconds"],
    )
