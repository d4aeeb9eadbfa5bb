"""The reward that a task pays: its own, or success - 1 at every step."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from torchrl.envs import EnvBase

from envs.demonstrations.episode import Episode
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.schema import DemoSchema, Floats, Measure
from envs.demonstrations.variation import Player, Variation
from envs.options import EnvOptions
from envs.task import Resimulate, Task

SPARSE: Final = "sparse"


def rewarded(task: Task, kind: str | None) -> Task:
    """The task with this reward, in its environments and its demonstrations alike.

    Args:
        task: any.
        kind: one of the task's `rewards`; None is its own, the first of them.

    Raises:
        ValueError: it has no such reward.
    """
    if kind is None or kind in task.rewards[:1]:
        return task
    if kind not in task.rewards:
        raise ValueError(
            f"env.reward={kind} needs a task that offers it, and task {task.name} pays its own "
            "reward only: leave it out (env.reward=null)"
        )
    return dataclasses.replace(
        task,
        make_env=_MakeEnv(task, kind),
        demos=None if task.demos is None else _schema(task.demos),
        resimulate=None if task.resimulate is None else _Resimulate(task.resimulate),
        vary=None if task.vary is None else _Vary(task.vary),
    )


@dataclass(frozen=True)
class _MakeEnv:
    task: Task
    kind: str

    def __call__(self, options: EnvOptions) -> EnvBase:
        return self.task.make_env(dataclasses.replace(options, reward=self.kind))


@dataclass(frozen=True)
class _Measured:
    success: Measure

    def __call__(self, observations: Floats) -> NDArray[np.float32]:
        return np.asarray(self.success(observations), dtype=np.float32) - 1


def _schema(schema: DemoSchema) -> DemoSchema:
    assert schema.success is not None, "a task that offers a sparse reward knows its success"
    return dataclasses.replace(
        schema, reward=_Measured(schema.success), step_reward=None, reward_tolerance=0.0
    )


def _paid(episode: Episode) -> Episode:
    assert episode.success is not None
    rewards = episode.success[1:].astype(np.float32) - 1
    return dataclasses.replace(episode, rewards=rewards)


@dataclass(frozen=True)
class _Resimulate:
    own: Resimulate

    def __call__(
        self, episodes: Sequence[Episode], *, num_threads: int | None = None
    ) -> list[Episode]:
        return [_paid(episode) for episode in self.own(episodes, num_threads=num_threads)]


@dataclass(frozen=True)
class _Vary:
    own: Variation

    @property
    def schema(self) -> DemoSchema:
        return _schema(self.own.schema)

    @property
    def identity(self) -> str:
        return f"{SPARSE}: {self.own.identity}"

    @contextmanager
    def open(
        self, episodes: Sequence[Episode], settings: MultiplyConfig, num_threads: int | None
    ) -> Iterator[Player[Any]]:
        with self.own.open(episodes, settings, num_threads) as player:
            yield _Player(player)


@dataclass(frozen=True)
class _Player:
    own: Player[Any]

    def draw(
        self, index: int, weights: NDArray[np.float64], speeds: NDArray[np.float64] | None = None
    ) -> Any:
        return self.own.draw(index, weights, speeds)

    def play(self, attempts: Sequence[Any]) -> Iterator[Episode | None]:
        for episode in self.own.play(attempts):
            yield None if episode is None else _paid(episode)
