from __future__ import annotations

import os
import pydoc
import signal
import subprocess
import sys
from pathlib import Path

import genesplat as gs
import pytest
from conftest import Command, wait_for_step
from genesplat import _command

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_the_command_is_on_the_path(command: Command) -> None:
    done = command("--version")
    assert (done.returncode, done.stdout) == (0, f"genesplat {gs.__version__}\n")
    words = [sys.executable, "-m", "genesplat", "--version"]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == done.stdout


def test_exit_status_and_streams_are_the_command_s(command: Command, tmp_path: Path) -> None:
    wrong, failed = command("trian"), command("inspect", tmp_path / "x.ply")
    helped = command("train", "--help")
    assert (wrong.returncode, wrong.stdout) == (2, "") and "train" in wrong.stderr
    assert (failed.returncode, failed.stdout) == (1, "") and failed.stderr.startswith("error: ")
    assert (helped.returncode, helped.stderr) == (0, "") and "--iterations" in helped.stdout


def test_a_closed_pipe_is_no_traceback(program: str) -> None:
    shell = f'"{program}" train --help | true'
    done = subprocess.run(shell, shell=True, capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_ctrl_c_saves_what_there_is(program: str, folder: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    words = [program, "train", str(folder), "--out", str(run), "--iterations", "1000000", "--device", "cpu"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    wait_for_step(run)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate()
    assert process.returncode == 130, errors
    assert "--resume goes on from there" in output and "Traceback" not in errors
    assert (run / "checkpoint" / "latest.checkpoint").exists()


def test_the_python_that_has_pycolmap_finds_cameras(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GENESPLAT_PYTHON", "mine")
    _command.use_this_python()
    assert os.environ["GENESPLAT_PYTHON"] == "mine"
    monkeypatch.delenv("GENESPLAT_PYTHON")
    (tmp_path / "pycolmap.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    _command.use_this_python()
    assert os.environ["GENESPLAT_PYTHON"] == sys.executable
    monkeypatch.setattr(sys, "path", [str(tmp_path / "nothing")])
    monkeypatch.setattr(sys, "path_importer_cache", {})
    monkeypatch.delenv("GENESPLAT_PYTHON")
    _command.use_this_python()
    assert "GENESPLAT_PYTHON" not in os.environ


def test_the_command_starts_without_numpy() -> None:
    code = "import sys, genesplat; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_everything_public_is_documented() -> None:
    for name in gs.__all__:
        if name == "__version__":
            continue
        what = getattr(gs, name)
        assert len(what.__doc__ or "") > 30, name
        members = vars(what).items() if isinstance(what, type) else ()
        for member, value in members:
            if not member.startswith("_") and (callable(value) or isinstance(value, (property, classmethod))):
                assert getattr(value, "__doc__", None), f"{name}.{member}"
    text = pydoc.plain(pydoc.render_doc(gs))
    assert all(name in text for name in gs.__all__ if name != "__version__")


# Those with PyTorch are run by `check-torch`.
WITHOUT_TORCH = sorted(path for path in EXAMPLES.glob("*.py") if "torch" not in path.read_text())


@pytest.mark.parametrize("example", WITHOUT_TORCH, ids=lambda path: path.stem)
def test_examples_run_and_are_short(example: Path, folder: Path, tmp_path: Path) -> None:
    assert len(example.read_text().splitlines()) <= 20
    words = [sys.executable, str(example), str(folder), "100"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
