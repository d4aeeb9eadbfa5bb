"""Hooks by themselves; that a run calls them rightly is in test_runs.py."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from configs import compose
from pipeline.act.metrics import Rollouts, summarise
from pipeline.data.buffers import DemonstrationDistribution, make_buffer, make_core_buffer
from pipeline.data.mixture import BatchPart, Mixture
from pipeline.data.rows import TransitionRows
from pipeline.hooks import (
    ActorAverageHook,
    DemoUpdateHook,
    EpisodeHook,
    EvaluationHook,
    StoreHook,
)
from pipeline.learner import average_decay
from tests.pipeline.toys import tagged_rows, trajectory


class FakeTrainer:
    """Keeps what hooks register; counts frames."""

    def __init__(self) -> None:
        self.modules: dict[str, object] = {}
        self.ops: dict[str, list] = {}
        self.collected_frames, self.total_frames = 0, 1000

    def register_module(self, name: str, module: object) -> None:
        self.modules[name] = module

    def register_op(self, dest: str, op: object) -> None:
        self.ops.setdefault(dest, []).append(op)


@pytest.fixture
def trainer() -> FakeTrainer:
    return FakeTrainer()


def test_store_writes_rows_and_hands_the_batch_on(trainer: FakeTrainer):
    buffer = make_buffer(20)
    hook = StoreHook(buffer, TransitionRows(0.5, n_step=2))
    hook.register(trainer)
    batch = trajectory([1.0, 2.0, 4.0], truncated=[2]).unsqueeze(0)
    assert hook(batch) is batch
    assert buffer[:]["next", "reward"].squeeze(-1).tolist() == [2.0, 4.0, 4.0]
    assert trainer.modules["main_buffer"] is buffer
    # TorchRL skips pre_epoch while actions are random.
    assert trainer.ops == {"batch_process": [hook]}


@pytest.mark.parametrize("period", [1, 2, 3])
def test_every_fth_update_is_followed_by_one_on_the_demonstrations(
    trainer: FakeTrainer, period: int
):
    updates = []
    stepper = SimpleNamespace(step=lambda _trainer, batch: updates.append(batch))
    core = DemonstrationDistribution(make_core_buffer(tagged_rows(7.0, 3)))
    hook = DemoUpdateHook(stepper, Mixture({"demos": BatchPart(core, 4, is_demo=True)}), period)
    hook.register(trainer)
    assert trainer.ops == {"post_optim": [hook]}
    made = []
    for _ in range(6):
        hook()
        made.append(len(updates))
    assert made == [i // period for i in range(1, 7)]
    for batch in updates:
        assert batch.batch_size == (4,)
        assert (batch["observation"] == 7.0).all()
        # Marked rows would be hidden from the RL terms, which are all there is to this update.
        assert "is_demo" not in batch.keys()  # noqa: SIM118


def test_the_count_of_updates_survives(trainer: FakeTrainer):
    updates = []
    stepper = SimpleNamespace(step=lambda _trainer, batch: updates.append(batch))
    demos = SimpleNamespace(sample=lambda: tagged_rows(1.0, 2))
    first = DemoUpdateHook(stepper, demos, 3)
    first()
    first()
    second = DemoUpdateHook(stepper, demos, 3)
    second.load_state_dict(first.state_dict())
    second()
    assert len(updates) == 1


def test_a_period_of_demo_updates_below_one_names_its_key():
    with pytest.raises(ValueError, match=r"sampler\.demo_update_period must be at least 1"):
        DemoUpdateHook(SimpleNamespace(), SimpleNamespace(), 0)


class FakeEvaluator:
    def run(self, policy: object) -> Rollouts:
        success = np.array([[False, True], [False, False]])
        return Rollouts(np.array([10.0, 20.0]), np.array([2, 2]), success)

    def metrics(self, rollouts: Rollouts) -> dict[str, Any]:
        return summarise(rollouts).as_plain()

    def close(self) -> None: ...


def evaluation_hook(trainer: FakeTrainer, path: Path, interval: int) -> EvaluationHook:
    hook = EvaluationHook(FakeEvaluator(), None, interval, path)
    hook.register(trainer)
    return hook


def frames_evaluated(
    hook: EvaluationHook, trainer: FakeTrainer, frames: Iterable[int]
) -> list[int]:
    evaluated = []
    for trainer.collected_frames in frames:
        if hook() is not None:
            evaluated.append(trainer.collected_frames)
    return evaluated


def test_each_evaluation_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    caplog.set_level("INFO", "pipeline.hooks.evaluate")
    told = [lambda: {"wall_s": 75.0}]
    hook = EvaluationHook(FakeEvaluator(), None, 1, tmp_path / "c.jsonl", told, unit="updates")
    hook.evaluate(2000)
    # One of two episodes succeeds; returns 10 and 20.
    assert caplog.messages == ["2,000 of 2,000 updates, 1 min 15 s: success 50 %, return 15"]


def test_evaluations_come_in_step(trainer: FakeTrainer, tmp_path: Path):
    """Batches of 30 frames, an evaluation due every 100: at the first look after each."""
    hook = evaluation_hook(trainer, tmp_path / "curve.jsonl", 100)
    assert frames_evaluated(hook, trainer, range(30, 400, 30)) == [30, 120, 210, 300]


def test_evaluations_that_a_large_batch_skipped_are_not_made_up_for(
    trainer: FakeTrainer, tmp_path: Path
):
    hook = evaluation_hook(trainer, tmp_path / "curve.jsonl", 10)
    assert frames_evaluated(hook, trainer, [35, 36, 38, 41, 75, 76]) == [35, 41, 75]


def test_an_interval_of_zero_is_never(trainer: FakeTrainer, tmp_path: Path):
    hook = evaluation_hook(trainer, tmp_path / "curve.jsonl", 0)
    assert frames_evaluated(hook, trainer, range(0, 400, 30)) == []


def test_every_evaluation_is_a_line_of_the_learning_curve(trainer: FakeTrainer, tmp_path: Path):
    path = tmp_path / "curve.jsonl"
    hook = evaluation_hook(trainer, path, 100)
    frames_evaluated(hook, trainer, range(30, 200, 30))
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["frames"] for line in lines] == [30, 120]
    assert lines[0]["return_mean"] == 15.0
    assert lines[0]["success_once"] == 0.5


def test_what_is_logged_are_numbers_under_eval(trainer: FakeTrainer, tmp_path: Path):
    logged = evaluation_hook(trainer, tmp_path / "curve.jsonl", 100)()
    assert logged is not None
    assert logged.pop("log_pbar") is False
    assert logged["eval/return_mean"] == 15.0
    assert all(key.startswith("eval/") for key in logged)
    assert all(isinstance(value, (int, float)) for value in logged.values())


def test_the_next_evaluation_survives(trainer: FakeTrainer, tmp_path: Path):
    first = evaluation_hook(trainer, tmp_path / "curve.jsonl", 100)
    frames_evaluated(first, trainer, range(30, 150, 30))
    second = evaluation_hook(trainer, tmp_path / "curve.jsonl", 100)
    second.load_state_dict(first.state_dict())
    assert frames_evaluated(second, trainer, range(150, 250, 30)) == [210]


def episode(total: float, angle: float | None) -> object:
    steps = trajectory([total], truncated=[0])
    if angle is not None:
        steps["next", "progress"] = torch.full((1, 1), angle)
        steps["next", "success"] = torch.full((1, 1), angle > 1.35)
    return steps.unsqueeze(0)


def test_running_averages_of_the_training_episodes(trainer: FakeTrainer):
    hook = EpisodeHook()
    hook.register(trainer)
    assert hook.log(episode(0.0, 0.0)) is None
    for i in range(25):
        hook(episode(float(i), 1.4 if i >= 10 else 1.3))
    logged = hook.log(episode(0.0, 0.0))
    # The last 20: returns 5 .. 24, of which those from 10 on opened.
    assert logged == {"train_return": 14.5, "train_success": 0.75, "log_pbar": True}


def test_a_task_that_tells_no_success_has_no_rate_of_it():
    hook = EpisodeHook()
    hook(episode(3.0, None))
    assert hook.log(episode(0.0, None)) == {"train_return": 3.0, "log_pbar": True}


def test_each_episode_is_offered_with_the_frame_it_ended_by(trainer: FakeTrainer):
    offered, counted = [], []
    hook = EpisodeHook(
        lambda done, frame: offered.append((done.episode_return, frame)),
        lambda done, _frame: counted.append(done.length),
    )
    hook.register(trainer)
    steps = trajectory([1.0, 2.0, 3.0, 4.0], truncated=[1, 3]).unsqueeze(0)
    trainer.collected_frames = 100
    assert hook(steps) is steps
    assert offered == [(3.0, 104), (7.0, 104)]
    assert counted == [2, 2]


def test_open_episodes_and_averages_survive(trainer: FakeTrainer):
    offered = []
    steps = trajectory([1.0, 2.0, 3.0, 4.0], truncated=[0, 3]).unsqueeze(0)
    steps["next", "success"] = torch.ones(1, 4, 1, dtype=torch.bool)
    first = EpisodeHook()
    first(steps[:, :3])
    second = EpisodeHook(lambda done, frame: offered.append(done.episode_return))
    second.load_state_dict(first.state_dict())
    assert second.log(steps) == {"train_return": 1.0, "train_success": 1.0, "log_pbar": True}
    second(steps[:, 3:])
    assert offered == [9.0]
    for i in range(30):
        second(episode(float(i), math.nan))
    assert len(second.returns) == 20


@pytest.mark.parametrize(
    ("interval", "last", "evaluated"),
    [(100, 390, [30, 120, 210, 300, 390]), (100, 300, [30, 120, 210, 300]), (0, 390, [])],
)
def test_the_last_policy_is_evaluated_once(
    trainer: FakeTrainer, tmp_path: Path, interval: int, last: int, evaluated: list[int]
):
    path = tmp_path / "curve.jsonl"
    hook = evaluation_hook(trainer, path, interval)
    frames_evaluated(hook, trainer, range(30, last + 1, 30))
    (at_shutdown,) = trainer.ops["shutdown"]
    at_shutdown()
    lines = path.read_text().splitlines() if path.exists() else []
    assert [json.loads(line)["frames"] for line in lines] == evaluated


def test_diagnostics_join_the_curve_and_the_log(trainer: FakeTrainer, tmp_path: Path):
    path = tmp_path / "curve.jsonl"
    hook = EvaluationHook(
        FakeEvaluator(), None, 100, path, [lambda: {"depth": 3.0}, lambda: {"width": 4.0}]
    )
    hook.register(trainer)
    logged = hook()
    assert logged is not None
    assert (logged["diagnostics/depth"], logged["diagnostics/width"]) == (3.0, 4.0)
    line = json.loads(path.read_text())
    assert (line["depth"], line["width"]) == (3.0, 4.0)


class FallingEvaluator(FakeEvaluator):
    """One episode in two succeeds at first, later none."""

    def __init__(self) -> None:
        self.succeeds = True

    def run(self, policy: object) -> Rollouts:
        success = np.array([[False, self.succeeds], [False, False]])
        self.succeeds = False
        return Rollouts(np.array([10.0, 20.0]), np.array([2, 2]), success)


def test_a_policy_that_unlearns_raises_the_alarm_once(
    trainer: FakeTrainer, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    hook = EvaluationHook(
        FallingEvaluator(), None, 100, tmp_path / "curve.jsonl", [lambda: {"actor_updates": 5.0}]
    )
    hook.register(trainer)
    frames_evaluated(hook, trainer, (0, 100, 200))
    (alarm,) = (tmp_path / "alarms.jsonl").read_text().splitlines()
    assert json.loads(alarm)["best_success"] == 0.5
    assert [r.getMessage() for r in caplog.records if "unlearning" in r.getMessage()] != []


def test_the_actor_s_average_moves_by_hand():
    actor = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.constant_(actor.weight, 1.0)
    hook = ActorAverageHook(actor, decay=0.75)
    torch.nn.init.constant_(actor.weight, 5.0)
    hook()
    assert hook.average.weight.item() == pytest.approx(2.0)  # 0.75 x 1 + 0.25 x 5
    hook()
    assert hook.average.weight.item() == pytest.approx(2.75)
    assert actor.weight.item() == 5.0
    assert not hook.average.weight.requires_grad


@pytest.mark.parametrize("decay", [0.0, 1.0, -0.1])
def test_a_decay_out_of_range_names_its_key(decay: float):
    with pytest.raises(ValueError, match=r"optim\.actor_average must be in \(0, 1\)"):
        ActorAverageHook(torch.nn.Linear(1, 1), decay)


AVERAGED = (
    "optim.actor_average=null",
    "optim.updates_per_frame=0.3",
    "collector.frames_per_batch=10",
)


@pytest.mark.parametrize(
    ("frames", "decay"),
    [
        (100_000, 0.9995),  # 2,000 of 30,000 updates
        (10_000, 0.995),  # 200 of 3,000
        (40, None),  # less than one of 12: the actor itself
    ],
)
def test_the_average_spans_a_share_of_the_run(frames: int, decay: float | None):
    config = compose(
        *AVERAGED, f"collector.total_frames={frames}", "optim.actor_average_share=0.066667"
    )
    assert average_decay(config) == decay


def test_the_average_has_one_length():
    config = compose("optim.actor_average=0.9", "optim.actor_average_share=0.1")
    with pytest.raises(ValueError, match=r"actor_average \(0\.9\).*actor_average_share \(0\.1\)"):
        average_decay(config)


@pytest.mark.parametrize("share", [0.0, 1.0, -0.1])
def test_a_share_out_of_range_names_its_key(share: float):
    with pytest.raises(
        ValueError, match=r"optim\.actor_average_share( must be in \(0, 1\)|=-0\.1)"
    ):
        average_decay(compose(*AVERAGED, f"optim.actor_average_share={share}"))
