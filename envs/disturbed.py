"""An environment whose episodes are disturbed, for training (drawn anew) and for tests of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.envs import EnvBase

from envs.batched import chosen_copies, fresh_seed
from envs.disturbing import Box, Disturb, Disturbance, Range
from envs.options import EnvOptions
from envs.task import Starts, Task

Floats = NDArray[np.float32]
_STREAM: Final = 0x6E6F6973
"""Tells these draws from those of the starts, which have addresses of the same seed."""


def disturbed(task: Task, disturbance: Disturbance) -> Task:
    """The task with its episodes disturbed; its demonstrations and everything else stay.

    Raises:
        ValueError: see `Disturbance.require`.
    """
    if not disturbance:
        return task
    disturbance.require(task.disturb, task.name, "")
    return dataclasses.replace(task, make_env=MakeDisturbed(task, disturbance))


def moved(task: Task, name: str, distance: float) -> Task:
    """The task with every start of its list at a distance from the box that they are drawn from.

    Args:
        task: That says where its things stand.
        name: Of an axis of `Disturb.boxes`.
        distance: Above the upper edge, or if negative below the lower one.

    Raises:
        ValueError: The task has no such place, or numbers no starts; no policy could solve it.
    """
    Disturbance(outside={name: (distance, distance)}).require(task.disturb, task.name, "")
    starts = task.require("starts", f"outside.{name}={distance:g}")
    box, axis = task.require("disturb", f"outside.{name}={distance:g}").axis(name)
    return dataclasses.replace(task, starts=_Moved(starts, box, axis, distance))


@dataclass(frozen=True)
class _Moved:
    starts: Starts
    box: Box
    axis: int
    distance: float

    def __call__(self, seed: int, first: int, count: int) -> TensorDict:
        found = self.starts(seed, first, count)
        edge = self.box.high[self.axis] if self.distance > 0 else self.box.low[self.axis]
        places = found[self.box.key].cpu().numpy().copy()
        numbers = places if self.box.numbers is None else self.box.numbers(places)
        numbers[:, self.axis] = edge + self.distance
        places = numbers if self.box.placed is None else self.box.placed(numbers)
        return found.set(self.box.key, torch.from_numpy(places))


@dataclass(frozen=True)
class MakeDisturbed:
    """Makes a task's environment and disturbs it."""

    task: Task
    disturbance: Disturbance

    def __call__(self, options: EnvOptions) -> EnvBase:
        """The batched environment."""
        env = self.task.make_env(options)
        return DisturbedEnv(env, self.disturbance, self.task.disturb, seed=options.seed)


@dataclass
class _Episode:
    """What disturbs one copy now."""

    rng: np.random.Generator
    observation_noise: float
    action_noise: float
    delay: int
    factors: dict[str, float]
    places: dict[str, NDArray[np.float64]]


class DisturbedEnv(EnvBase):
    """N copies of an environment, each episode with a disturbance of its own.

    Noise is added to what is observed, the root of a new episode included; rewards, success and
    progress are of what is. An action is what was asked for; what is played is an older one, with
    noise. Episode e of copy i is disturbed by stream e * N + i of the seed, so that neither other
    copies nor resuming change it, and an evaluation's episodes do not depend on its batch.

    Args:
        env: Of N copies; it is closed with this one.
        disturbance: What of, and how much.
        disturb: The task's part of it.
        seed: Of the draws; None is fresh entropy, not reproducible.
    """

    def __init__(
        self,
        env: EnvBase,
        disturbance: Disturbance,
        disturb: Disturb | None,
        *,
        seed: int | None = None,
    ) -> None:
        super().__init__(device=env.device, batch_size=env.batch_size)
        self.env = env
        self.disturbance = disturbance
        # This one has a state in any case: it goes on midway only if the one inside does.
        keeps = type(env).get_extra_state is not nn.Module.get_extra_state
        self.resumes_midway = keeps and getattr(env, "resumes_midway", True)
        self._disturb = disturb
        self._count = env.batch_size[0]
        self.observation_spec = env.observation_spec.clone()
        self.action_spec = env.action_spec.clone()
        self.reward_spec = env.reward_spec.clone()
        self.done_spec = env.done_spec.clone()
        rest = None if disturb is None or disturb.rest is None else disturb.rest()
        size = env.action_spec.shape[-1]
        self._rest = np.zeros(size, dtype=np.float32) if rest is None else rest
        self._asked = np.tile(self._rest, (self._count, disturbance.delay[1] + 1, 1))
        self._number_episodes(seed)

    def _set_seed(self, seed: int | None) -> None:
        self.env._set_seed(seed)
        self._number_episodes(seed)

    def _number_episodes(self, seed: int | None) -> None:
        self._seed = fresh_seed() if seed is None else seed
        self._begun = np.zeros(self._count, dtype=np.int64)
        self._elapsed = np.zeros(self._count, dtype=np.int64)
        self._episodes: list[_Episode | None] = [None] * self._count

    def _reset(self, tensordict: TensorDictBase | None, **options: Any) -> TensorDictBase:
        copies = chosen_copies(tensordict, "_reset", self._count)
        self._begun[copies] += 1
        self._elapsed[copies] = 0
        for i in copies:
            self._begin(int(i))
        self._asked[copies] = self._rest
        found = self.env._reset(self._placed(tensordict), **options)
        return self._observed(found, copies)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        copies = chosen_copies(tensordict, "_step", self._count)
        action = tensordict.get("action").detach().cpu().numpy()
        self._asked[copies, 1:] = self._asked[copies, :-1]
        self._asked[copies, 0] = action[copies]
        self._elapsed[copies] += 1
        played = action.copy()
        for i in copies:
            episode = self._of(int(i))
            played[i] = self._asked[i, episode.delay]
            if self._noisy("action_noise"):
                noise = episode.action_noise * episode.rng.standard_normal(played.shape[1])
                played[i] = np.clip(played[i] + noise, -1.0, 1.0)
        inner = tensordict.copy().set("action", torch.from_numpy(played).to(self.device))
        return self._observed(self.env._step(inner), copies)

    def _observed(self, found: TensorDictBase, copies: NDArray[np.int64]) -> TensorDictBase:
        if self._noisy("observation_noise"):
            seen = found["observation"].cpu().numpy().copy()
            for i in copies:
                episode = self._of(int(i))
                seen[i] += episode.observation_noise * episode.rng.standard_normal(seen.shape[1])
            found = found.copy().set("observation", torch.from_numpy(seen).to(self.device))
        return found

    def _noisy(self, name: str) -> bool:
        high: float = getattr(self.disturbance, name)[1]
        return high > 0.0

    def _placed(self, tensordict: TensorDictBase | None) -> TensorDictBase | None:
        """Where things stand, unless whoever resets says so."""
        places = {key for episode in self._episodes if episode for key in episode.places}
        missing = [k for k in places if tensordict is None or tensordict.get(k, None) is None]
        if not missing:
            return tensordict
        given = TensorDict({}, self.batch_size, device=self.device)
        given = given if tensordict is None else tensordict.copy()
        for key in missing:
            size = next(len(e.places[key]) for e in self._episodes if e is not None)
            rows = [np.zeros(size) if e is None else e.places[key] for e in self._episodes]
            given.set(key, torch.as_tensor(np.stack(rows), device=self.device))
        return given

    def _of(self, copy: int) -> _Episode:
        episode = self._episodes[copy]
        assert episode is not None, "reset comes before step"
        return episode

    def _begin(self, copy: int) -> None:
        """Draw what disturbs the episode of this copy, and change its model."""
        episode = self._episodes[copy] = self._drawn(copy)
        if self._disturb is not None and self.disturbance.factors:
            self._disturb.apply(self.env, copy, episode.factors)

    def _drawn(self, copy: int) -> _Episode:
        asked, number = self.disturbance, int(self._begun[copy] - 1) * self._count + copy
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(_STREAM, number)))
        return _Episode(
            rng=rng,
            observation_noise=rng.uniform(*asked.observation_noise),
            action_noise=rng.uniform(*asked.action_noise),
            delay=int(rng.integers(asked.delay[0], asked.delay[1], endpoint=True)),
            factors={name: _between(rng, span) for name, span in asked.factors.items()},
            places=self._places(rng),
        )

    def _places(self, rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
        found: dict[str, NDArray[np.float64]] = {}
        for box in () if self._disturb is None else self._disturb.boxes:
            spans = {n: span for n, span in self.disturbance.outside.items() if n in box.names}
            if spans:
                below, above = np.transpose([spans.get(name, (0.0, 0.0)) for name in box.names])
                drawn = rng.uniform(box.low + below, box.high + above)
                found[box.key] = drawn if box.placed is None else box.placed(drawn)
        return found

    def get_extra_state(self) -> dict[str, torch.Tensor]:
        """What this adds to the state of the environment inside, which is beside it."""
        arrays = {
            "seed": np.asarray(self._seed, dtype=np.int64),
            "begun": self._begun.copy(),
            "elapsed": self._elapsed.copy(),
            "asked": self._asked.copy(),
        }
        return {key: torch.from_numpy(np.asarray(value)) for key, value in arrays.items()}

    def set_extra_state(self, state: dict[str, torch.Tensor]) -> None:
        """Continue from what `get_extra_state` returned.

        Raises:
            KeyError: An entry is missing.
            ValueError: It was taken with another number of copies or another longest delay.
        """
        arrays = {key: value.cpu().numpy() for key, value in state.items()}
        if arrays["asked"].shape != self._asked.shape:
            raise ValueError(
                f"this state has {arrays['asked'].shape[0]} copies that keep "
                f"{arrays['asked'].shape[1]} actions, and there are {self._asked.shape[:2]}: take "
                "env.num_envs and task.randomise.delay of the saved run"
            )
        self._seed = int(arrays["seed"])
        self._begun, self._elapsed = arrays["begun"].copy(), arrays["elapsed"].copy()
        self._asked = arrays["asked"].copy()
        for copy in np.flatnonzero(self._begun):
            self._begin(int(copy))
            self._go_on(self._of(int(copy)), int(self._elapsed[copy]))

    def _go_on(self, episode: _Episode, steps: int) -> None:
        """Draw again what this episode's noise was until now."""
        seen, asked = self.env.observation_spec["observation"].shape[-1], self._asked.shape[-1]
        for step in range(steps + 1):
            if step > 0 and self._noisy("action_noise"):
                episode.rng.standard_normal(asked)
            if self._noisy("observation_noise"):
                episode.rng.standard_normal(seen)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the environment inside."""
        super().close(raise_if_closed=raise_if_closed)
        self.env.close(raise_if_closed=raise_if_closed)


def _between(rng: np.random.Generator, span: Range) -> float:
    """Uniform in the logarithm: half as much is as likely as twice as much."""
    low, high = np.log(span)
    return float(np.exp(rng.uniform(low, high)))
