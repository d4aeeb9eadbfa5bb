"""Steps per second of somebody's environment: our batch of copies against torchrl's and bare loops.

``python -m benchmarks.library`` prints two ratios of medians, measured in turns on one core each:
eight Pendulums against torchrl's ``SerialEnv`` of eight with the transforms that a run needs, and
gymnasium-robotics' door through the collector with an actor of 256 x 256 against its own loop,
which plays the actions of the same actor: contacts make one step cost several times another.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from typing import Any, Final

import gymnasium
import torch
from tensordict import TensorDictBase
from torchrl.envs import (
    ActionScaling,
    Compose,
    DoubleToFloat,
    EnvBase,
    GymEnv,
    SerialEnv,
    TransformedEnv,
)

from benchmarks.statistics import spread
from benchmarks.worker import Entry, race
from envs import EnvOptions, find_task
from envs.library.vector_env import episode_seed
from pipeline.learn.networks import make_actor
from pipeline.machine.threads import OneThreadCollector

COPIES: Final = 8
STEPS: Final = 50
"""Steps of one call, so that the loop around it costs nothing."""
EPISODE: Final = 200
"""Steps of an episode of the door; it never ends earlier."""
CHEAP: Final = "Pendulum-v1"
ADROIT: Final = "gymnasium_robotics:AdroitHandDoor-v1"
HERE: Final = "benchmarks.library"


class Stepping:
    """Uniform actions through ``step_and_maybe_reset``, as the collector steps."""

    units = float(STEPS * COPIES)

    def __init__(self, env: EnvBase) -> None:
        self.env = env
        self.td = env.reset()
        self.actions = torch.rand(STEPS, *env.action_spec.shape) * 2 - 1

    def call(self) -> None:
        """Some steps of all copies."""
        for action in self.actions:
            _, self.td = self.env.step_and_maybe_reset(self.td.set("action", action))


def ours(workers: int = 0) -> Stepping:
    """Eight copies as a task has them."""
    options = EnvOptions(num_envs=COPIES, seed=0, workers=workers)
    return Stepping(find_task(f"gymnasium:{CHEAP}").make_env(options))


def serial() -> Stepping:
    """Eight copies in torchrl's ``SerialEnv``."""
    env = SerialEnv(COPIES, partial(GymEnv, CHEAP))
    return Stepping(TransformedEnv(env, Compose(DoubleToFloat(), ActionScaling())))


class Collecting:
    """Our batch of one environment's copies in the collector, with an actor."""

    units = float(STEPS * COPIES)

    def __init__(self, copies: int = COPIES) -> None:
        torch.manual_seed(0)
        env = find_task(f"gymnasium:{ADROIT}").make_env(
            EnvOptions(num_envs=copies, seed=0, workers=0)
        )
        observed, acted = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
        actor = make_actor(observed, acted, [256, 256])
        collector = OneThreadCollector(
            env,
            actor,
            frames_per_batch=STEPS * copies,
            total_frames=-1,
            track_traj_ids=False,
            auto_register_policy_transforms=False,
        )
        self.batches = iter(collector)

    def call(self) -> TensorDictBase:
        """One collected batch."""
        return next(self.batches)


class Bare:
    """One copy in a loop of Python, with gymnasium and nothing else."""

    units = float(STEPS)

    def __init__(self) -> None:
        # As many episodes as the collector has copies, from the same starts.
        batches = Collecting(copies=1)
        episodes = COPIES * EPISODE // STEPS
        played = torch.cat([batches.call()["action"] for _ in range(episodes)], dim=-2)
        self.actions = played.reshape(-1, played.shape[-1]).double().numpy()
        self.env = gymnasium.make(ADROIT, disable_env_checker=True)
        self.step = 0

    def call(self) -> None:
        """Some steps."""
        for _ in range(STEPS):
            if self.step % EPISODE == 0:
                self.env.reset(seed=episode_seed(0, 0, self.step // EPISODE))
            self.env.step(self.actions[self.step])
            self.step = (self.step + 1) % len(self.actions)


ENTRIES: Final = {
    "pendulum_ours": "ours",
    "pendulum_serial": "serial",
    "adroit_collected": "Collecting",
    "adroit_bare": "Bare",
}


def run(rounds: int, block_s: float) -> dict[str, Any]:
    """Medians by contestant, steps per second, and their two ratios."""
    entries = [Entry(name, f"{HERE}:{made}") for name, made in ENTRIES.items()]
    timings = race(entries, rounds=rounds, block_s=block_s)
    medians = {
        name: spread([1.0 / seconds for seconds in timing.seconds_per_unit]).median
        for name, timing in timings.items()
    }
    return {
        "steps_per_s": {name: round(value) for name, value in medians.items()},
        "pendulum_over_serial": round(medians["pendulum_ours"] / medians["pendulum_serial"], 2),
        "adroit_over_bare": round(medians["adroit_collected"] / medians["adroit_bare"], 2),
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(run(rounds=10, block_s=1.0), indent=2) + "\n")
