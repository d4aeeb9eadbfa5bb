"""This project's side of every comparison, built from its own configuration and factories.

``make_stepper`` and ``Updater`` are the only places here that know how a configuration becomes
networks, buffers and updates; the real run's wiring is ``pipeline/online.py``.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDict

from benchmarks.baselines import finish
from configs import compose
from envs import find_task
from envs.door.task import ACTION_SIZE, OBSERVATION_SIZE
from pipeline.compute import resolve_compute
from pipeline.conversion import make_rows
from pipeline.data.buffers import DemonstrationDistribution, make_buffer, make_core_buffer
from pipeline.data.mixture import DRAWS, BatchPart, Mixture
from pipeline.data.rows import TransitionRows
from pipeline.files.time_use import TimeUse
from pipeline.hooks import DemoUpdateHook
from pipeline.learn.stepper import BCSACStepper
from pipeline.learner import make_learner
from pipeline.machine.products import use_onednn
from pipeline.playing import make_training_env
from pipeline.recipe import Recipe
from pipeline.updates import updates_per_portion

EPISODE = 200
"""Steps of the made-up episodes that fill the buffers."""
CHUNK = 100_000
"""Rows made at a time, so that filling a large buffer does not decide the peak memory."""


PRECISIONS = ("fp32", "bf16")
"""Of the hidden layers; comparisons measure both and name the one they quote."""


def paper_size(variant: str, width: int, batch: int) -> list[str]:
    """Overrides for the paper's networks and rows at another width and batch."""
    return [
        f"variant={variant}",
        "preset=paper",
        f"actor.hidden=[{width},{width}]",
        f"critic.hidden=[{width},{width}]",
        f"sampler.batch_size={batch}",
    ]


def make_stepper(recipe: Recipe) -> BCSACStepper:
    """The step of a run with this (decided) configuration; nothing is cloned first."""
    task = find_task(recipe.task.name)
    env = make_training_env(recipe, task)
    from_nothing = recipe.changed(pretrain=False)
    learner = make_learner(from_nothing, task, env, None, recipe.sampler.batch_size, TimeUse())
    env.close()
    return learner.stepper


def random_rows(count: int, to_rows: TransitionRows) -> TensorDict:
    """Rows [count] of made-up episodes, cut by the run's own conversion."""
    episodes = -(-count // EPISODE)
    shape = (episodes, EPISODE)
    done = torch.zeros(*shape, 1, dtype=torch.bool)
    done[:, -1] = True
    trajectories = TensorDict(
        {
            "observation": torch.randn(*shape, OBSERVATION_SIZE),
            "action": torch.rand(*shape, ACTION_SIZE) * 2 - 1,
            "next": {
                "observation": torch.randn(*shape, OBSERVATION_SIZE),
                "reward": torch.randn(*shape, 1),
                "done": done,
                "terminated": torch.zeros_like(done),
                "truncated": done.clone(),
            },
        },
        batch_size=shape,
    )
    return to_rows(trajectories)[:count]


class Updater:
    """A stepper on batches drawn from filled buffers; a call is some updates, sampling included.

    Args:
        recipe: Of the run.
        replay_rows: Rows in the main buffer.
        demo_rows: Rows of the demonstrations.
        updates: Ordinary updates of a call.
        frame: Whether the whole call counts as one unit, instead of each update.
    """

    def __init__(
        self, recipe: Recipe, *, replay_rows: int, demo_rows: int, updates: int, frame: bool
    ) -> None:
        self.stepper = make_stepper(recipe)
        to_rows = make_rows(recipe)
        main = make_buffer(replay_rows, recipe.device)
        for first in range(0, replay_rows, CHUNK):
            main.extend(random_rows(min(CHUNK, replay_rows - first), to_rows))
        demos = DemonstrationDistribution(
            make_core_buffer(random_rows(demo_rows, to_rows), recipe.device)
        )
        rows = recipe.sampler.batch_size
        self.mixture = Mixture(
            {
                "main": BatchPart(main, rows),
                "demos": BatchPart(demos, round(recipe.sampler.demo_ratio * rows), is_demo=True),
            },
            # As many batches at a time as the run has updates between two portions of frames.
            draws=min(updates_per_portion(recipe), DRAWS),
            device=recipe.device,
        )
        self.updates = updates
        self.demo_update: DemoUpdateHook | None = None
        performed = float(updates)
        period = recipe.sampler.demo_update_period
        if period:
            demo_batches = Mixture(
                {"demos": BatchPart(demos, rows, is_demo=True)}, device=recipe.device
            )
            self.demo_update = DemoUpdateHook(self.stepper, demo_batches, period)
            performed += updates / period
        self.units = 1.0 if frame else performed

    def call(self) -> None:
        """The updates that follow one portion of frames."""
        collected = TensorDict({}, [])
        for _ in range(self.updates):
            self.stepper.step(None, self.mixture(collected))
            if self.demo_update is not None:
                self.demo_update()
        finish(self.mixture.device)


def make_updater(
    overrides: Sequence[str],
    precision: str,
    replay_rows: int,
    demo_rows: int,
    updates: int = 1,
    frame: bool = False,
) -> Updater:
    """An :class:`Updater` for what ``make train`` with these overrides would run.

    Args:
        overrides: Of the run.
        precision: ``fp32``, ``bf16``, or ``auto`` for what the project chooses on this machine.
        replay_rows: As for :class:`Updater`, and so the others.
        demo_rows: Likewise.
        updates: Likewise.
        frame: Likewise.
    """
    torch.manual_seed(0)
    threads = f"torch_threads={torch.get_num_threads()}"
    recipe = resolve_compute(compose(*overrides, f"precision={precision}", threads))
    use_onednn(bool(recipe.onednn))
    return Updater(
        recipe, replay_rows=replay_rows, demo_rows=demo_rows, updates=updates, frame=frame
    )
