"""Environments that are nothing but their spaces and a clock; importing this registers them."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

BOX = spaces.Box(-1.0, 1.0, (2,), np.float64)
HERE = "gymnasium:tests.envs.library.toys:Toys"
"""Prefix of the tasks' names."""
OBSERVATIONS: dict[str, spaces.Space[Any]] = {
    "Box": BOX,
    "Goal": spaces.Dict({"observation": BOX, "achieved_goal": BOX, "desired_goal": BOX}),
    "Discrete": spaces.Discrete(5, start=2),
    "Nested": spaces.Dict({
        "b": spaces.Dict({"y": spaces.MultiDiscrete([2, 3]), "x": spaces.MultiBinary(2)}),
        "a": spaces.Tuple((spaces.Box(0, 9, (2, 2), np.int64), BOX)),
    }),
    "Bytes": spaces.Box(0, 255, (3,), np.uint8),
    "Image": spaces.Dict({"camera": spaces.Box(0, 255, (8, 8, 3), np.uint8), "speed": BOX}),
    "Text": spaces.Text(4),
}  # fmt: skip
ACTIONS: dict[str, spaces.Space[Any]] = {
    "Matrix": spaces.Box(np.array([[-2.0], [0.0]]), np.array([[2.0], [6.0]]), dtype=np.float64),
    "Integer": spaces.Box(0, 10, (1,), np.int64),
    "Infinite": spaces.Box(np.array([-1.0, -np.inf]), np.array([1.0, np.inf]), dtype=np.float64),
    "Single": spaces.Box(np.array([-1.0, 3.0]), np.array([1.0, 3.0]), dtype=np.float64),
    "Choices": spaces.Discrete(4),
}


class SpacesToy(gymnasium.Env):
    """Draws observations from a space; its reward is the last entry of the action it got."""

    def __init__(self, seen: str = "Box", done: str = "Box") -> None:
        print("a banner that nobody asked for")
        warnings.warn("and a warning", stacklevel=1)
        self.observation_space = OBSERVATIONS[seen]
        self.action_space = ACTIONS.get(done, BOX)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        if seed is not None:
            self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> Any:
        assert action.dtype == self.action_space.dtype
        assert action.shape == self.action_space.shape
        return self.observation_space.sample(), float(action.flat[-1]), False, False, {}


class ClockToy(gymnasium.Env):
    """Observes [start, t, speed]; an episode of start k (1 to 9) terminates in step 3 + k.

    The start is drawn with the seed. Each step pays ``pay``. ``told`` is the key of ``info`` that
    is true from step 3 on, in ``late`` only told then.
    """

    observation_space = spaces.Box(-np.inf, np.inf, (3,), np.float64)
    action_space = spaces.Box(-3.0, 3.0, (1,), np.float32)

    def __init__(
        self,
        told: str = "is_success",
        late: bool = False,
        pay: float = -1.0,
        fails_in: str = "",
        ballast: int = 0,
    ) -> None:
        self.told, self.late, self.pay, self.fails_in = told, late, pay, fails_in
        self.ballast = np.ones(ballast, np.uint8)
        self.resets = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.resets += 1
        if self.fails_in == "reset" and self.resets > 1:
            raise RuntimeError("the simulator\nis gone")
        self.start, self.t, self.speed = int(self.np_random.integers(1, 10)), 0, 0.0
        return self._observation(), {}

    def step(self, action: Any) -> Any:
        self.t += 1
        self.speed = float(action[0])
        if self.fails_in == "step" and self.t == 6:
            raise KeyError("wheel")
        info = {"depth": self.t / 10.0}
        if not self.late or self.t >= 3:
            info[self.told] = self.t >= 3
        return self._observation(), self.pay, self.t == 3 + self.start, False, info

    def _observation(self) -> Any:
        return np.array([self.start, self.t, self.speed])


class Otherwise(gymnasium.Env):
    """Keeps to gymnasium's API but for ``what``, in steps from ``since`` on."""

    observation_space = BOX
    action_space = BOX

    def __init__(self, what: str = "", since: int = 0) -> None:
        self.what, self.since, self.steps = what, since, 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        return np.zeros(2) if self.what == "reset" else (np.zeros(2), {})

    def step(self, _action: Any) -> Any:
        self.steps += 1
        ends: dict[str, Any] = {"array": np.zeros(3, bool), "nan": float("nan"), "none": None}
        end = ends.get(self.what, np.array([0.0]))
        if self.what == "step":
            return np.zeros(2), 0.0, False, {}
        return np.zeros(2), 0.0, end if self.steps > self.since else False, False, {}

    def close(self) -> None:
        if self.what == "close":
            raise RuntimeError("the window\nis gone")


class EndsItself(gymnasium.Env):
    """Truncates by itself; tells only in an episode's last step whether it is a success.

    Its k-th episode lasts ``limits[k]`` steps, later ones as long as the last of these; 0 is for
    ever. It observes its time; episodes whose first draw is below 0.5 succeed.
    """

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float64)
    action_space = BOX

    def __init__(self, limits: Any = (30,)) -> None:
        self.limits, self.episode = tuple(limits), -1

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.episode += 1
        self.t, self.good = 0, bool(self.np_random.random() < 0.5)
        return np.zeros(1), {}

    def step(self, _action: Any) -> Any:
        self.t += 1
        ended = self.t == self.limits[min(self.episode, len(self.limits) - 1)]
        info = {"time": self.t} | ({"is_success": self.good} if ended else {})
        return np.full(1, self.t), 0.0, False, ended, info


class Drifts(gymnasium.Env):
    """Drifts at random between two walls; it keeps all that it is in Python, and can tell it.

    Args:
        leaves_out: an entry that its ``get_state`` does not tell, of those that ``set_state`` has.
        holds: another entry that it tells.
    """

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = BOX

    def __init__(self, leaves_out: str = "", holds: Any = 0) -> None:
        self.leaves_out, self.holds = leaves_out, holds
        self.own = np.random.default_rng(0)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        if seed is not None:
            self.own = np.random.default_rng(seed)
        self.place = self.np_random.normal(size=2)
        self.speed, self.wall, self.told, self.hits = -0.5, "left", False, -1
        return self.place.copy(), {}

    def step(self, action: Any) -> Any:
        drawn = self.np_random.normal() + self.own.normal()
        self.speed += 0.1 * drawn
        self.place = self.place + self.speed * np.asarray(action)
        if self.told:
            self.hits -= 1
        self.told = bool(self.place[0] > 0)
        self.wall = "right" if self.told else "left"
        paid = self.hits + self.speed + len(self.wall)
        return self.place.copy(), paid, False, False, {"is_success": self.told}

    def get_state(self) -> Any:
        state = {
            "place": self.place,
            "body": {"speed": self.speed, "wall": self.wall},
            "told": self.told,
            "hits": self.hits,
            "own": self.own.bit_generator.state,
            "holds": self.holds,
        }
        state.pop(self.leaves_out, None)
        return state

    def set_state(self, state: Any) -> None:
        for key in {"place", "told", "hits"} & state.keys():
            assert type(state[key]) is type(getattr(self, key))
            setattr(self, key, state[key])
        self.speed, self.wall = state["body"]["speed"], state["body"]["wall"]
        if "own" in state:
            self.own.bit_generator.state = state["own"]


class InnerLimit(ClockToy):
    """Its own time limit cannot be seen from outside of the environment's own wrapper."""


class Doubled(gymnasium.ObservationWrapper):
    """Twice the observation."""

    def observation(self, observation: Any) -> Any:
        return 2 * observation


class PlusOne(gymnasium.ObservationWrapper):
    """One more."""

    def observation(self, observation: Any) -> Any:
        return observation + 1


def limited() -> gymnasium.Env:
    """A clock that is limited inside of what is registered."""
    return gymnasium.wrappers.TimeLimit(InnerLimit(), 4)


gymnasium.register("Toys/Spaces-v0", SpacesToy, max_episode_steps=5)
gymnasium.register("Toys/Clock-v0", ClockToy, max_episode_steps=30)
gymnasium.register("Toys/Endless-v0", ClockToy)
gymnasium.register("Toys/Inner-v0", limited)
gymnasium.register("Toys/Drifts-v0", Drifts, max_episode_steps=100)
gymnasium.register("Toys/EndsItself-v0", EndsItself)
gymnasium.register("Toys/EndsLater-v0", EndsItself, max_episode_steps=40)
gymnasium.register("Toys/Otherwise-v0", Otherwise, max_episode_steps=30)
