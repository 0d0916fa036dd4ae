"""What tests share: a small scene, and the command of the installed wheel."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import genesplat as gs
import pytest

# Whoever starts programs in the background has them ignore Ctrl-C, which tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)

Command = Callable[..., "subprocess.CompletedProcess[str]"]


def wait_for_step(run: Path) -> None:
    """Returns once the run in this folder has made a step; fails where it never does."""
    log = run / "log.jsonl"
    for _ in range(30_000):
        if log.exists() and '"step"' in log.read_text():
            return
        time.sleep(0.02)
    raise AssertionError(f"no step in {log}")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a scene of 16 small photos."""
    folder = tmp_path_factory.mktemp("scene") / "gallery"
    gs.gallery(folder, views=16, width=64, height=48, points=400)
    return folder


@pytest.fixture(scope="session")
def scene(folder: Path) -> gs.Scene:
    return gs.Scene.load(folder)


@pytest.fixture(scope="session")
def splats(scene: gs.Scene) -> gs.Splats:
    """Trained for a moment."""
    return gs.train(scene, "3dgs", 200, device="cpu")


@pytest.fixture(scope="session")
def program() -> str:
    """The command that pip has installed beside this Python."""
    found = shutil.which("genesplat", path=str(Path(sys.executable).parent))
    assert found is not None
    return found


@pytest.fixture(scope="session")
def command(program: str) -> Command:
    def run(*words: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run([program, *map(str, words)], capture_output=True, text=True, check=False)

    return run
