from __future__ import annotations

from genesplat import _native


def use_threads(threads: int) -> None:
    """Take so many processor threads for all that follows, instead of one for each core.

    Results do not depend on it. Call it once, before anything else.

    Raises:
        Error: Threads have been started already.
    """
    _native.use_threads(threads)
