"""The stand-in for sparse manipulation, and that the defaults serve it."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torchrl.envs import check_env_specs

from configs import compose
from envs import EnvOptions
from envs.demonstrations import load_demonstrations
from envs.demonstrations.loading import DemoOptions
from envs.intervals import wilson
from pipeline.build import build_run
from pipeline.playing import make_evaluator
from tests.toys import pick

FILE = str(Path(pick.__file__))


def test_it_is_an_environment():
    check_env_specs(pick.Pick(EnvOptions(num_envs=3, seed=0)))


def state(**columns: object) -> torch.Tensor:
    """One state [1, 16]: the hand at the block, aligned, its gripper open."""
    made = torch.zeros(1, 16)
    made[:, pick.APERTURE] = 1.0
    for column, value in columns.items():
        made[:, getattr(pick, column)] = torch.tensor(value)
    return made


def closed(before: torch.Tensor) -> torch.Tensor:
    """The state after two steps that close the gripper: from 1 to 0.4."""
    close = torch.tensor([[0.0, 0.0, 0.0, 0.0, -1.0]])
    return pick.moved(pick.moved(before, close), close)


@pytest.mark.parametrize(
    ("before", "holds"),
    [
        (state(), True),
        (state(HAND=[0.009, 0.0, 0.0]), True),
        (state(HAND=[0.011, 0.0, 0.0]), False),
        (state(YAW=0.14), True),
        (state(YAW=0.16), False),
        (state(APERTURE=0.4), False),  # closed already: it must open first
    ],
)
def test_a_gripper_holds_what_it_closes_around(before: torch.Tensor, holds: bool):
    assert bool(closed(before)[0, pick.HELD]) == holds


def test_a_held_block_goes_along_and_falls_when_let_go():
    held = closed(state())
    up = torch.tensor([[0.0, 0.0, 1.0, 0.0, -1.0]])
    lifted = pick.moved(pick.moved(held, up), up)
    # 0.6 of 0.02, then 0.6 of it and 0.4 of the motion before.
    assert lifted[0, pick.BLOCK].tolist() == pytest.approx([0.0, 0.0, 0.012 + 0.0168])
    open_ = torch.tensor([[0.0, 0.0, 0.0, 0.0, 1.0]])
    let_go = pick.moved(pick.moved(lifted, open_), open_)
    assert let_go[0, pick.HELD] == 0
    assert let_go[0, pick.BLOCK].tolist() == [0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pick") / "pick.h5"
    pick.record(path)
    return path


def test_its_demonstrations_are_those_of_a_trial(recorded: Path):
    """25 successful episodes of 45 steps; a third of the entries at a bound; paid for success."""
    loaded = load_demonstrations(recorded, pick.TASK, DemoOptions(resimulate=False))
    assert [episode.length for episode in loaded.episodes] == [45] * 25
    assert all(episode.succeeds for episode in loaded.episodes)
    assert loaded.saturated_share == pytest.approx(1 / 3, abs=0.05)
    for episode in loaded.episodes:
        assert episode.rewards.tolist() == episode.success[1:].tolist()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_default_clone_succeeds(seed: int, recorded: Path, tmp_path: Path):
    """In no fewer than 60 % of 500 episodes, but for the luck of the draw."""
    recipe = compose(
        "variant=bc", f"task.name='{FILE}'", f"demos.source='{recorded}'", f"seed={seed}",
        f"cache_dir='{tmp_path / 'cache'}'", "evaluation.interval=0", "logging.progress=false",
    )  # fmt: skip
    run = build_run(recipe, tmp_path / "run")
    run.train()
    found = make_evaluator(recipe, pick.TASK, episodes=500).run(run.actor)
    assert found.success is not None
    assert wilson(found.success.any(axis=1))[1] >= 0.6
