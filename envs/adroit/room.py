"""A hand task's capabilities that are the same for every one: environment, starts, films."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from envs.adroit.hand import HandTask
from envs.adroit.render import HandRenderer, View
from envs.adroit.resimulation import QPOS, QVEL
from envs.adroit.scene import STEPS_PER_SECOND
from envs.adroit.simulator import HandSimulator
from envs.adroit.starts import placement_of
from envs.adroit.torchrl_env import HandEnv
from envs.adroit.window import HandWindow, open_window
from envs.demonstrations.episode import Episode
from envs.options import EnvOptions
from envs.pictures import Picture, Render
from envs.rewards import SPARSE

REWARDS: Final = ("dense", SPARSE)
"""Of `Task.rewards`: the task's own, and success - 1."""


@dataclass(frozen=True)
class MakeEnv:
    """Makes N copies on all cores."""

    task: HandTask

    def __call__(self, options: EnvOptions) -> HandEnv:
        """The batched environment."""
        return HandEnv(
            HandSimulator(self.task, options.num_envs, options.num_threads),
            horizon=options.horizon,
            success_steps=options.success_steps,
            sparse=options.reward == SPARSE,
            contacts=options.strategies,
            seed=options.seed,
            device=options.device,
        )


@dataclass(frozen=True)
class Starts:
    """The list of evaluation episodes: the first episode of copy ``first``, ``first + 1``, ..."""

    task: HandTask

    def __call__(self, seed: int, first: int, count: int) -> TensorDict:
        """Where things stand in ``count`` episodes of the list with this seed, [count, k] each."""
        drawn = [placement_of(self.task, seed, first + i, 0) for i in range(count)]
        names = drawn[0]
        return TensorDict(
            {name: torch.as_tensor(np.stack([one[name] for one in drawn])) for name in names},
            [count],
        )


@dataclass(frozen=True)
class Pictures:
    """Pictures and a window of a task, from a view that keeps hand and target in sight."""

    view: View

    def render(self) -> Render:
        """The task's capability."""
        return Render(self.open, STEPS_PER_SECOND, begin, self.window)

    @contextmanager
    def open(self, env: EnvBase, picture: Picture) -> Iterator[HandRenderer]:
        """The renderer of an environment's copies."""
        assert isinstance(env, HandEnv)
        camera = picture.camera or self.view
        renderer = HandRenderer(env.simulator, picture.width, picture.height, camera)
        try:
            yield renderer
        finally:
            renderer.close()

    @contextmanager
    def window(self, env: EnvBase) -> Iterator[HandWindow]:
        """MuJoCo's viewer of the first copy."""
        assert isinstance(env, HandEnv)
        with open_window(env.simulator, self.view.camera()) as window:
            yield window


def begin(env: EnvBase, episode: Episode) -> TensorDictBase:
    """Puts the only copy of ``env`` where a recorded episode begins, as a reset does.

    Raises:
        ValueError: The episode does not say where things stand.
    """
    assert isinstance(env, HandEnv)
    simulator = env.simulator
    missing = sorted(simulator.placement.keys() - episode.start.keys())
    if missing:
        raise ValueError(f"{episode.provenance} has no {' and no '.join(missing)}")
    given = {name: values[None] for name, values in episode.start.items()}
    where = {name: given[name] for name in simulator.placement}
    return env.place(where, given.get(QPOS), given.get(QVEL))
