from __future__ import annotations

import contextlib
import hashlib
import math
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import genesplat as gs
import numpy as np
import pytest
from conftest import Command, wait_for_step

SETTINGS: dict[str, Any] = {"method": "3dgs", "iterations": 300, "device": "cpu", "seed": 3}


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def digest_of(splats: gs.Splats, place: Path) -> str:
    splats.save(place / "digest.ply")
    return digest(place / "digest.ply")


@pytest.fixture(scope="module")
def by_command(folder: Path, tmp_path_factory: pytest.TempPathFactory, command: Command) -> Path:
    """The run that the command makes with `SETTINGS`."""
    run = tmp_path_factory.mktemp("command") / "run"
    words = [word for name, value in SETTINGS.items() for word in (f"--{name}", value)]
    done = command("train", folder, "--out", run, *words)
    assert done.returncode == 0, done.stderr
    return run


def is_training() -> bool:
    """Whether a thread trains."""
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):
            if (task / "comm").read_text().strip() == "genesplat-run":
                return True
    return False


def is_left_alone() -> bool:
    """Whether no thread trains any more; the system lists one for a moment after its end."""
    for _ in range(1000):
        if not is_training():
            return True
        time.sleep(0.01)
    return False


def test_same_seed_same_bytes_as_the_command(scene: gs.Scene, by_command: Path, tmp_path: Path) -> None:
    expected = digest(by_command / "point_cloud.ply")
    alone = gs.Trainer(scene, **SETTINGS)
    steps = list(alone)
    alone.save(tmp_path / "alone.ply")
    assert digest(tmp_path / "alone.ply") == expected
    assert [step.iteration for step in steps] == list(range(10, 301, 10))
    assert all(math.isfinite(step.loss) and step.gaussians > 0 for step in steps)
    assert list(alone) == [] and alone.metrics is None

    with_folder = gs.Trainer(scene, **SETTINGS, out=tmp_path / "run")
    assert len(list(with_folder)) == 30 and "14 training photos" in repr(with_folder)
    assert digest(tmp_path / "run" / "point_cloud.ply") == expected
    assert (tmp_path / "run" / "report.html").exists() and is_left_alone()
    metrics = with_folder.metrics
    assert metrics is not None and metrics["iterations"] == 300
    of_splats, of_run = with_folder.evaluate(), gs.evaluate(by_command, device="cpu")
    assert of_splats.psnr == of_run.psnr == metrics["test"]["psnr"]


def test_every_step_can_be_looked_at_without_changing_the_result(
    scene: gs.Scene, by_command: Path, tmp_path: Path
) -> None:
    trainer, seen = gs.Trainer(scene, **SETTINGS, every=1), 0
    for step in trainer:
        seen += 1
        assert step.iteration == seen and math.isfinite(step.loss)
        if step.iteration in (1, 7, 150):
            assert trainer.evaluate().psnr > 3
            assert len(trainer.splats) > 0
    assert seen == 300
    assert digest_of(trainer.splats, tmp_path) == digest(by_command / "point_cloud.ply")


def test_who_leaves_the_loop_can_go_on(scene: gs.Scene, by_command: Path, tmp_path: Path) -> None:
    trainer = gs.Trainer(scene, **SETTINGS)
    for step in trainer:
        if step.iteration == 120:
            break
    assert is_left_alone()
    in_between = trainer.splats
    assert step.iteration == 120 and len(in_between) > 0
    assert next(step.iteration for step in trainer) == 130
    assert [step.iteration for step in trainer] == list(range(140, 301, 10))
    assert digest_of(trainer.splats, tmp_path) == digest(by_command / "point_cloud.ply")


def test_as_many_iterations_as_fit_into_minutes(scene: gs.Scene, tmp_path: Path) -> None:
    """Into a week fit as many as there ever are, and a training that goes on keeps their number."""
    trainer = gs.Trainer(scene, minutes=10_000, device="cpu", out=tmp_path / "run", every=1)
    for _ in range(2):
        for step in trainer:
            break
        assert step.iterations == 30_000
    assert "iterations = 30000" in (tmp_path / "run" / "config.toml").read_text()
    assert next(iter(gs.Trainer.resume(tmp_path / "run", scene, every=1))).iterations == 30_000


@pytest.mark.parametrize(
    "settings, sentence",
    [
        ({"minutes": 5, "iterations": 300}, "takes the place of iterations"),
        ({"minutes": 5, "steps_scale": 0.5}, "takes the place of iterations"),
        ({"minutes": 5, "method": "3dgs"}, "give --iterations instead"),
        ({"minutes": 0}, "between 0.1 and 10000"),
    ],
)
def test_minutes_that_cannot_be_are_refused(
    scene: gs.Scene, settings: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        gs.Trainer(scene, **settings)


def test_a_run_goes_on_from_its_folder(
    scene: gs.Scene, by_command: Path, tmp_path: Path, command: Command
) -> None:
    for name in ["python", "command"]:
        run = tmp_path / name
        for step in gs.Trainer(scene, **SETTINGS, out=run):
            if step.iteration == 120:
                break
        assert (run / "checkpoint" / "latest.checkpoint").exists() and is_left_alone()
        with pytest.raises(gs.Error, match="was interrupted; add --resume"):
            list(gs.Trainer(scene, **SETTINGS, out=run))
        if name == "python":
            trainer = gs.Trainer.resume(run)
            assert [step.iteration for step in trainer] == list(range(130, 301, 10))
            assert len(trainer.splats) > 0
        else:
            assert command("train", scene.path, "--out", run, "--resume").returncode == 0
        assert digest(run / "point_cloud.ply") == digest(by_command / "point_cloud.ply")
    with pytest.raises(gs.Error, match="nothing to resume"):
        list(gs.Trainer.resume(tmp_path / "python"))
    with pytest.raises(gs.Error, match="not the folder of a run"):
        gs.Trainer.resume(tmp_path)


def test_no_thread_is_left_after_an_exception(scene: gs.Scene) -> None:
    trainer = gs.Trainer(scene, **SETTINGS)
    with pytest.raises(ZeroDivisionError):
        for step in trainer:
            assert is_training()
            _ = 1 / (step.iteration - 50)
    assert is_left_alone()
    assert len(trainer.splats) > 0
    iterator = iter(gs.Trainer(scene, **SETTINGS))
    next(iterator)
    assert is_training()
    del iterator
    assert is_left_alone()

    def refuse(step: gs.Step) -> None:
        raise LookupError(step.iteration)

    with pytest.raises(LookupError, match="10"):
        gs.train(scene, callback=refuse, **SETTINGS)
    assert is_left_alone()


def test_ctrl_c_ends_a_step_and_saves_what_there_is(scene: gs.Scene, tmp_path: Path) -> None:
    trainer = gs.Trainer(scene, **{**SETTINGS, "iterations": 1_000_000}, out=tmp_path / "run", every=500_000)

    def press_ctrl_c() -> None:
        wait_for_step(tmp_path / "run")
        os.kill(os.getpid(), signal.SIGINT)

    presser = threading.Thread(target=press_ctrl_c)
    presser.start()
    with pytest.raises(KeyboardInterrupt):
        list(trainer)
    presser.join()
    assert is_left_alone()
    assert (tmp_path / "run" / "checkpoint" / "latest.checkpoint").exists()
    assert len(trainer.splats) > 0


def test_other_threads_run_while_training_does(scene: gs.Scene) -> None:
    counted, is_over = 0, threading.Event()

    def count() -> None:
        nonlocal counted
        while not is_over.wait(0.001):
            counted += 1

    trainer = gs.Trainer(scene, **SETTINGS, every=300)
    counter = threading.Thread(target=count)
    counter.start()
    before = counted
    assert [step.iteration for step in trainer] == [300]
    during = counted - before
    is_over.set()
    counter.join()
    assert during > 5


def test_training_begins_with_other_splats(scene: gs.Scene, splats: gs.Splats) -> None:
    before = gs.evaluate(splats, scene, device="cpu").psnr
    trainer = gs.Trainer(scene, "3dgs", 100, device="cpu", splats=splats)
    assert next(step.gaussians for step in trainer) == len(splats)
    list(trainer)
    assert trainer.evaluate("train").psnr > 10 and before > 10


def test_settings_are_those_of_the_file(scene: gs.Scene, tmp_path: Path) -> None:
    method = {"name": "mcmc", "growth": 0.1}
    settings: dict[str, Any] = {"max_gaussians": np.int64(500), "sh_degree": 1, "genetic": False}
    settings["antialiasing"] = True
    trainer = gs.Trainer(scene, method, 30, "cpu", out=tmp_path / "run", **settings)
    list(trainer)
    text = (tmp_path / "run" / "config.toml").read_text()
    parts = ['name = "mcmc"', "growth = 0.1", "max_gaussians = 500", "sh_degree = 1", "antialiasing = true"]
    assert all(part in text for part in parts) and "[genetic]" not in text
    assert (trainer.splats.sh_degree, trainer.splats.rasterize_mode) == (1, "antialiased")


def test_the_filter_of_mip_splatting_is_kept(scene: gs.Scene, tmp_path: Path) -> None:
    trainer = gs.Trainer(scene, "mip-splatting", 60, "cpu")
    list(trainer)
    splats = trainer.splats
    assert splats.rasterize_mode == "mip" and splats.filter_3d is not None and (splats.filter_3d > 0).all()
    trainer.save(tmp_path / "a.ply")
    back = gs.Splats.load(tmp_path / "a.ply")
    assert back.filter_3d is not None and np.array_equal(back.filter_3d, splats.filter_3d)
    assert gs.evaluate(back, scene, device="cpu") == trainer.evaluate()
    assert gs.genetic_search(back, scene, generations=1, population=2, device="cpu").generations == 2
    back.filter_3d = None
    with pytest.raises(ValueError, match="3D filter baked in"):
        gs.genetic_search(back, scene)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"iteration": 7}, "unknown field `iteration`"),
        ({"method": "2dgs"}, "2dgs"),
        ({"method": {"name": "3dgs", "noise": 1.0}}, "`noise` is no setting of 3dgs"),
        ({"iterations": 0}, "iterations"),
        ({"device": "cuda"}, "cuda is no device"),
        ({"every": 0}, "every is 0"),
        ({"threads": 2}, "use_threads"),
        ({"dataset": {}}, "Scene.load"),
        ({"background": "white"}, "loaded on another background"),
        ({"sh_degree": object()}, "no setting"),
    ],
)
def test_wrong_settings_are_told_before_training(
    scene: gs.Scene, settings: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        gs.Trainer(scene, **{**SETTINGS, **settings})


def test_results_are_not_written_over(scene: gs.Scene, by_command: Path) -> None:
    before = digest(by_command / "point_cloud.ply")
    with pytest.raises(gs.Error, match="holds the results of a run"):
        list(gs.Trainer(scene, **SETTINGS, out=by_command))
    assert digest(by_command / "point_cloud.ply") == before and is_left_alone()


def test_there_are_no_splats_before_the_first_step(scene: gs.Scene) -> None:
    with pytest.raises(gs.Error, match="nothing is trained yet"):
        gs.Trainer(scene, **SETTINGS).splats  # noqa: B018


def test_a_trainer_has_one_loop_at_a_time(scene: gs.Scene) -> None:
    trainer = gs.Trainer(scene, **SETTINGS)
    for _ in trainer:
        with pytest.raises(ValueError, match="under way already"):
            next(iter(trainer))
        break
    assert is_left_alone()


def test_train_tells_a_callback_and_returns_splats(scene: gs.Scene) -> None:
    heard: list[int] = []
    trained = gs.train(scene, callback=lambda step: heard.append(step.iteration), **SETTINGS)
    assert heard == list(range(10, 301, 10)) and len(trained) > 0
