"""What an evaluation tells on request: of a task that has no hand, and from rollouts by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule

from configs import compose
from envs.strategies import Ways
from envs.task import MissingCapabilityError
from pipeline.act.evaluation import Evaluator
from pipeline.act.metrics import Rollouts
from pipeline.act.recorder import ColumnRecorder
from pipeline.commands.extras import Subject
from pipeline.commands.extras.strategies import StrategiesAsked, StrategiesTold, figures_of
from pipeline.results.evaluation import Evaluation
from tests.toys import reach


@dataclass(frozen=True)
class Sides:
    """On which side of its goal a point ends: told from where it is after each step."""

    words: Mapping[str, str]
    columns: tuple[str, ...] = ("observation",)

    def told(self, seen: Mapping[str, NDArray[Any]], progress: Any, success: Any) -> Ways:
        (where,) = seen.values()
        assert where.shape[:2] == progress.shape == success.shape
        last = np.isfinite(progress).sum(axis=1) - 1
        ends = np.take_along_axis(where, last[:, None, None], axis=1)[:, 0]
        right = (ends[:, 0] > ends[:, 2]).tolist()
        return Ways(
            ["right" if one else "left" for one in right], columns={"x": ends[:, 0].tolist()}
        )

    def now(self, seen: TensorDictBase) -> str:
        return f"at {float(seen['observation'][0, 0]):g}"


SIDES = Sides({"left": "left of the goal", "right": "right of it"})
TASK = replace(reach.TASK, strategies=SIDES)
#: Always to the right, by 0.15 a step, until the episode is over.
RIGHT = TensorDictModule(lambda seen: torch.ones_like(seen[:, :2]), ["observation"], ["action"])


def subject(task: Any) -> Subject:
    return Subject(compose("variant=sac", "preset=smoke"), task, RIGHT)


def test_a_task_without_a_hand_tells_how_its_episodes_were_done():
    """20 steps of 0.15 are 3: from anywhere in [-1, 1] to the right of any goal there."""
    extra = StrategiesAsked()(subject(TASK))
    assert extra is not None
    evaluator = Evaluator(task=TASK, episodes=5, seed=3, batch=2)  # the third wave plays one beside
    found = extra.findings(evaluator.run(RIGHT, extra.recorder))
    told = found.metrics["strategies"]
    assert told["shares"] == {"left": 0.0, "right": 1.0}
    assert told["words"] == SIDES.words
    assert found.columns["strategy"] == ["right"] * 5
    started = [float(reach.numbered(3, i)[0]) for i in range(5)]
    assert found.columns["x"] == pytest.approx([x + 20 * 0.15 for x in started], abs=1e-5)
    read = Evaluation.of(
        {"episodes": 5, "made_from": {"run": "r", "variant": "v", "seed": 0}} | found.metrics
    )
    assert read.strategies is not None
    assert read.strategies.thresholds == {}


def test_who_asks_for_strategies_of_a_task_that_tells_none_is_told_what_is_missing():
    assert StrategiesAsked()(subject(reach.TASK)) is None
    assert StrategiesAsked(asked=False)(subject(TASK)) is None
    with pytest.raises(
        MissingCapabilityError, match=r"STRATEGIES=1 needs a task that tells how .* `strategies`"
    ):
        StrategiesAsked(asked=True)(subject(reach.TASK))


def test_an_episode_that_succeeded_and_did_not_stay_so_is_lost_whatever_its_way():
    """Over after three steps, shut; after four, open to the end; after two, never open."""
    success = np.array([[False, True, False, False], [True, False, False, True], [False] * 4])
    played = Rollouts(np.zeros(3), np.array([3, 4, 2]), success)
    ways = Ways(["held", "held", "short"], figures={"of_the_task": 7})
    figures = figures_of(ways, {"held": "", "short": "", "flung": ""}, played)
    assert figures["shares"] == {"held": 2 / 3, "short": 1 / 3, "flung": 0.0}
    # Wilson's intervals of 1 and of 0 in 3.
    assert figures["shares_ci95"]["short"] == pytest.approx([0.0615, 0.7923], abs=1e-3)
    assert figures["shares_ci95"]["flung"] == pytest.approx([0.0, 0.5615], abs=1e-3)
    assert figures["kept_at_end"] == {"held": 0.5, "short": 0.0, "flung": None}
    assert figures["lost_at_end"] == pytest.approx(1 / 3)
    assert figures["lost_at_end_ci95"] == pytest.approx([0.0615, 0.7923], abs=1e-3)
    assert figures["of_the_task"] == 7
    silent = figures_of(ways, {"held": "", "short": ""}, replace(played, success=None))
    assert "lost_at_end" not in silent


def test_columns_are_kept_as_long_as_an_episode_plays():
    recorder = ColumnRecorder(["seen"])
    for wave in ([[True, True], [True, False]], [[True, True]]):
        for step, active in enumerate(wave, 1):
            after = {"next": {"seen": torch.tensor([[1.0], [2.0]]) * 10**step}}
            recorder(after, torch.tensor(active)[:, None])  # type: ignore[arg-type]
        recorder.finish_wave()
    assert recorder.joined(3)["seen"][..., 0].tolist() == [[10, 100], [20, 0], [10, 0]]


def test_its_environments_are_made_to_write_what_it_is_told_from():
    assert StrategiesTold(SIDES).env_options == {"strategies": True}
