"""The command `genesplat`.

Its body is the native module, so that a wheel holds one library and no second program, and an installation from
sources needs nothing else. Exit status, streams and signals are those of the program: Python's own handler of
Ctrl-C is taken away, since it would wait for the command to end, and the status is passed on as it is.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import sys

from genesplat import _native


def use_this_python() -> None:
    """Has this Python find cameras, where it has pycolmap and nobody has named another."""
    if "GENESPLAT_PYTHON" not in os.environ and sys.executable and importlib.util.find_spec("pycolmap"):
        os.environ["GENESPLAT_PYTHON"] = sys.executable


def main() -> int:
    """Runs the command that this process was called with; returns its exit status."""
    use_this_python()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _native.command(["genesplat", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
