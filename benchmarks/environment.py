"""Environment steps per second: N doors, against one door's bare physics and gymnasium-robotics.

All get uniformly random actions and start again after 200 steps. One environment step is five
steps of the physics; "raw" does these with ``mj_step`` and builds the observation, nothing else.
"""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from benchmarks.effort import Effort
from benchmarks.raw_door import RawDoor
from benchmarks.statistics import rounded, spread
from benchmarks.worker import Entry, available_cores, race
from envs import EnvOptions, find_task
from envs.door.hand import build_scene
from envs.door.task import ACTION_SIZE, HORIZON

CALL_STEPS = 20
"""Steps of one call, so that the loop around it costs nothing."""

RECORDED = 8
"""Doors whose episodes are recorded for states to begin with."""


class Doors:
    """``make_env("door")`` with automatic resets, as the collector steps it; or another hand task.

    Doors stand in all phases of an episode from the start: the first steps after a reset, before
    anything is touched, cost less than the others, and a block of many doors is but a few steps.
    """

    def __init__(self, count: int, threads: int, task: str = "door") -> None:
        self.env = find_task(task).make_env(EnvOptions(num_envs=count, seed=0, num_threads=threads))
        self.td: TensorDictBase = self.env.reset()
        self.env.set_extra_state(_states_in_all_phases(task, count))
        self.steps = max(1, CALL_STEPS // count)
        self.units = float(self.steps * count)
        self.actions = _random_actions(self.env)
        self.step = 0

    def call(self) -> None:
        """Some steps of all doors."""
        for _ in range(self.steps):
            self.td["action"] = self.actions[self.step % len(self.actions)]
            _, self.td = self.env.step_and_maybe_reset(self.td)
            self.step += 1


def _random_actions(env: EnvBase) -> torch.Tensor:
    """For every step of an episode, in [-1, 1]."""
    horizon: int = env.horizon
    return torch.rand(horizon, *env.action_spec.shape) * 2 - 1


def _states_in_all_phases(task: str, count: int) -> dict[str, torch.Tensor]:
    """What ``HandEnv.set_extra_state`` takes: copies taken evenly from those of some episodes."""
    env = find_task(task).make_env(EnvOptions(num_envs=RECORDED, seed=0))
    td = env.reset()
    states = []
    for action in _random_actions(env):
        states.append(env.get_extra_state())
        td = env.step_mdp(env.step(td.set("action", action)))
    env.close()
    evenly = torch.linspace(0, RECORDED * len(states) - 1, count).long()
    joined = {
        key: torch.cat([state[key] for state in states]) for key in states[0] if key != "seed"
    }
    return {key: values[evenly] for key, values in joined.items()} | {"seed": states[0]["seed"]}


class RawStepping:
    """``mj_step`` and the observation of one door of the same model."""

    units = float(CALL_STEPS)

    def __init__(self) -> None:
        scene = build_scene()
        self.door = RawDoor(scene)
        actions = np.random.default_rng(0).uniform(-1, 1, (HORIZON, ACTION_SIZE))
        self.controls = scene.control_middle + scene.control_half_range * actions
        self.step = 0

    def call(self) -> None:
        """Some steps."""
        for _ in range(CALL_STEPS):
            if self.step % HORIZON == 0:
                self.door.reset()
            self.door.step(self.controls[self.step % HORIZON])
            self.door.observation()
            self.step += 1


class GymnasiumRobotics:
    """The package's own door environment: one door, 39 observations, its own reward."""

    units = float(CALL_STEPS)

    def __init__(self) -> None:
        # Importing it prints advice about tasks that are not used here.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            from gymnasium_robotics.envs.adroit_hand.adroit_door import (  # noqa: PLC0415
                AdroitHandDoorEnv,
            )
        self.env = AdroitHandDoorEnv()
        self.actions = np.random.default_rng(0).uniform(-1, 1, (HORIZON, ACTION_SIZE))
        self.step = 0

    def call(self) -> None:
        """Some steps."""
        for _ in range(CALL_STEPS):
            if self.step % HORIZON == 0:
                self.env.reset(seed=0)
            self.env.step(self.actions[self.step % HORIZON])
            self.step += 1


def run(effort: Effort) -> dict[str, Any]:
    """Keys ``env_steps_per_s`` (medians) and ``env_steps_detail``."""
    thread_counts = sorted({1, min(2, available_cores())})
    here = "benchmarks.environment"
    entries = [
        Entry(
            f"doors_{count}_threads_{threads}",
            f"{here}:Doors",
            {"count": count, "threads": threads},
            threads,
        )
        for count in effort.env_counts
        for threads in thread_counts
    ]
    entries.append(Entry("raw_threads_1", f"{here}:RawStepping"))
    entries.append(Entry("gymnasium_robotics_threads_1", f"{here}:GymnasiumRobotics"))
    timings = race(entries, rounds=max(2, effort.rounds // 2), block_s=effort.env_block_s)
    detail = {}
    for name, timing in timings.items():
        per_second = spread([1.0 / seconds for seconds in timing.seconds_per_unit])
        detail[name] = {**per_second.as_json("steps/s"), "peak_mib": rounded(timing.peak_mib)}
    medians = {name: values["median"] for name, values in detail.items()}
    return {
        "env_steps_per_s": medians,
        "env_steps_detail": effort.as_json(threads=thread_counts, contestants=detail),
    }
