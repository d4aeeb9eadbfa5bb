"""A run that is stopped between two steps of its environment goes on as if it had not been."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from pipeline.build import build_run
from pipeline.files.checkpoint import latest_checkpoint, trained_frames
from pipeline.machine.interruption import Interrupted
from pipeline.recipe import Recipe
from pipeline.trainer import Run
from tests.faults.test_footprint import contents
from tests.pipeline.resuming import curve_of
from tests.pipeline.test_resuming import recipe_of
from tests.test_toy import tiny
from tests.toys import reach

STEPS = 10
"""In each portion of the toy's runs: 20 frames of two copies."""
LAST_ONLY = "logging.checkpoint_interval=1000"
PYTHON = "tests.envs.library.toys:Toys"
DRIFTS = (f"task.name='gymnasium:{PYTHON}/Drifts-v0'", "env.horizon=15")
"""An environment of another library that offers its state."""


def stop_in_step(run: Run, number: int) -> None:
    """As by a signal within that step of the collector's environment, counted from 1."""
    environment = run.trainer.collector.env
    step, made = environment._step, []

    def counted(td: Any) -> Any:
        made.append(1)
        if len(made) == number:
            run.stop.make(signal.SIGTERM)
        return step(td)

    environment._step = counted


def cut(recipe: Recipe, run_dir: Path, number: int, *, resume: bool = False) -> Run:
    """A run that is stopped in a step of its environment."""
    run = build_run(recipe, run_dir, resume=resume)
    stop_in_step(run, number)
    with pytest.raises(Interrupted):
        run.train()
    return run


def gone_on(recipe: Recipe, run_dir: Path) -> Run:
    torch.manual_seed(4321)  # whatever was before must not matter
    run = build_run(recipe, run_dir, resume=True)
    run.train()
    return run


def outcome(run_dir: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Every file of the last checkpoint and of the logs, and the curve.

    A buffer that was loaded lists its entries in another order.
    """
    last = latest_checkpoint(run_dir).relative_to(run_dir).as_posix()
    kept = {
        name: json.loads(content) if name.endswith(".json") else content
        for name, content in contents(run_dir).items()
        if name.startswith((f"{last}/", "logs/"))
    }
    return kept, curve_of(run_dir)


def compare(run_dir: Path, whole: Path) -> None:
    (files, curve), (expected, expected_curve) = outcome(run_dir), outcome(whole)
    assert files.keys() == expected.keys()
    assert [name for name in files if files[name] != expected[name]] == []
    assert sum(name.endswith(".memmap") for name in files) > 50
    assert curve == expected_curve


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("toy") / "reach.h5"
    reach.record(path)
    return path


Recipes = Callable[[str], Recipe]


@pytest.fixture(scope="module")
def recipes(tmp_path_factory: pytest.TempPathFactory, recorded: Path) -> Recipes:
    """By name; with random frames, rows of three steps, chunks, a curriculum, processes."""
    folder = tmp_path_factory.mktemp("cache")

    def named(name: str) -> Recipe:
        if name == "sac":
            return recipe_of(LAST_ONLY, "loss.n_step=3", "collector.random_frames=40")
        if name == "workers":
            return recipe_of(LAST_ONLY, *DRIFTS, "env.workers=2")
        return tiny(name, folder, recorded, LAST_ONLY, "env.horizon=19")

    return named


@pytest.fixture(scope="module")
def uninterrupted(
    tmp_path_factory: pytest.TempPathFactory, recipes: Recipes
) -> Callable[[str], Path]:
    made: dict[str, Path] = {}

    def named(name: str) -> Path:
        if name not in made:
            made[name] = tmp_path_factory.mktemp("whole") / "run"
            build_run(recipes(name), made[name]).train()
        return made[name]

    return named


@pytest.mark.parametrize(
    ("name", "number"),
    [
        *(("sac", number) for number in (1, STEPS, STEPS + 4, 4 * STEPS - 1)),
        *((name, 3 * STEPS + 4) for name in ("qc_rlpd", "rfcl", "workers")),
    ],
)
def test_a_run_that_is_stopped_in_any_step_goes_on_as_if_it_had_not_been(
    name: str,
    number: int,
    recipes: Recipes,
    uninterrupted: Callable[[str], Path],
    tmp_path: Path,
):
    run = cut(recipes(name), tmp_path / "run", number)
    complete, steps = divmod(number, STEPS)
    assert run.trainer.collected_frames == complete * 2 * STEPS
    begun = run.trainer.collector.begun
    assert (0 if begun is None else begun.shape[-1]) == steps
    saved = latest_checkpoint(tmp_path / "run")  # without one, all would be made again
    assert trained_frames(saved) == run.trainer.collected_frames
    gone_on(recipes(name), tmp_path / "run")
    compare(tmp_path / "run", uninterrupted(name))


def test_a_portion_may_be_cut_twice_and_be_the_first(
    recipes: Recipes, uninterrupted: Callable[[str], Path], tmp_path: Path
):
    """Its clone was evaluated before it began."""
    assert recipes("best").pretrain
    cut(recipes("best"), tmp_path / "run", 3)
    run = cut(recipes("best"), tmp_path / "run", 4, resume=True)
    assert run.trainer.collector.begun.shape[-1] == 7
    gone_on(recipes("best"), tmp_path / "run")
    compare(tmp_path / "run", uninterrupted("best"))


def test_without_a_state_of_the_environment_the_portion_begins_anew(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    recipe = recipe_of(LAST_ONLY, f"task.name='gymnasium:{PYTHON}/Spaces-v0'", "loss.n_step=1")
    cut(recipe, tmp_path / "run", 2 * STEPS + 4)
    again = build_run(recipe, tmp_path / "run", resume=True)
    assert "goes on with fresh episodes" in caplog.text
    assert again.trainer.collector.begun is None
    assert again.trainer.collected_frames == 40
    again.train()
    assert len(again.trainer._modules["main_buffer"]) == again.trainer.collected_frames == 120
