"""The three tasks beside gymnasium-robotics' own, and DAPG's published policies."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from envs.adroit.hand import HandTask
from envs.adroit.simulator import HandSimulator
from envs.door.hand import DOOR
from envs.hammer.hand import HAMMER
from envs.pen.hand import PEN
from envs.relocate.hand import RELOCATE

HANDS: dict[str, HandTask] = {"door": DOOR, "hammer": HAMMER, "pen": PEN, "relocate": RELOCATE}
OTHERS = ["hammer", "pen", "relocate"]

POLICIES = "ADROIT_POLICIES"
"""Environment variable with the folder of DAPG's policies as arrays, NAME.npz each."""
EPISODES = "ADROIT_EPISODES"
"""Environment variable with the folder of episodes that these policies played."""


def folder(variable: str) -> Path:
    """What an environment variable names; skips the test where it does not."""
    if variable not in os.environ:
        pytest.skip(f"{variable} names no folder")
    return Path(os.environ[variable])


@dataclass(frozen=True)
class Stock:
    """How the suite calls a task."""

    name: str
    keys: dict[str, str]
    """Of a start: ours and theirs."""
    reach_sign: float
    """Of the reach term in their dense reward, relative to the right one."""


STOCK = {
    "hammer": Stock("AdroitHandHammer", {"board_position": "board_pos"}, -1.0),
    "pen": Stock("AdroitHandPen", {"asked_orientation": "desired_orien"}, 1.0),
    "relocate": Stock(
        "AdroitHandRelocate", {"ball_position": "obj_pos", "target_position": "target_pos"}, -1.0
    ),
}

Arrays = dict[str, NDArray]


@dataclass(frozen=True)
class Accomplished:
    """What a task that is accomplished looks like."""

    stage: str
    """Label of the stage that says so."""
    put: Callable[[NDArray, Arrays], object]
    """Writes it into the joint positions [nq] and the placement [1, k] of a start."""


ACCOMPLISHED = {
    "door": Accomplished("> 1.35 rad", lambda qpos, _: qpos.put(28, 1.5)),
    "hammer": Accomplished("nail in", lambda qpos, _: qpos.put(26, 0.09)),
    "pen": Accomplished(
        "> 0.95 aligned",
        lambda _, where: where.update(asked_orientation=np.array([[0.70711, 0.0, 0.70711, 0.0]])),
    ),
    "relocate": Accomplished(
        "< 0.1 m",
        lambda _, where: where.update(target_position=where["ball_position"] + [0.0, 0.0, 0.03]),
    ),
}


@pytest.fixture
def play_stock(tmp_path) -> Callable[[str, Arrays, NDArray], Arrays]:
    """Plays actions [S, T, A] from starts [S, k] in the suite's environment."""

    def play(task: str, starts: Arrays, actions: NDArray) -> Arrays:
        theirs = STOCK[task].keys
        named = {f"start/{theirs.get(key, key)}": values for key, values in starts.items()}
        given, out = tmp_path / "given.npz", tmp_path / "out.npz"
        np.savez(given, actions=actions, **named)
        script = Path(__file__).parent / "stock.py"
        subprocess.run(
            [sys.executable, script, STOCK[task].name, given, out], check=True, capture_output=True
        )
        return dict(np.load(out))

    return play


def play_ours(task: str, starts: Arrays, actions: NDArray) -> Arrays:
    """The same in ours."""
    hand = HANDS[task]
    found: dict[str, list] = {"observation": []}
    with HandSimulator(hand, len(actions), 2) as simulator:
        placement = {name: starts[name] for name in simulator.placement}
        observation = simulator.start(placement, qpos=starts["qpos"], qvel=starts["qvel"])
        found["observation"].append(observation)
        for action in actions.swapaxes(0, 1):
            observation = simulator.step(action)
            found["observation"].append(observation)
            for key, value in simulator.judged(observation)._asdict().items():
                found.setdefault(key, []).append(value)
    return {key: np.stack(values, 1) for key, values in found.items()}


def starts_of(task: str, count: int, seed: int = 0) -> Arrays:
    """Starts of the task's reset distribution."""
    hand, rng = HANDS[task], np.random.default_rng(seed)
    drawn = [hand.draw(rng) for _ in range(count)]
    model = hand.scene().model
    return {
        "qpos": np.zeros((count, model.nq)),
        "qvel": np.zeros((count, model.nv)),
        **{name: np.stack([one[name] for one in drawn]) for name in drawn[0]},
    }


def held_actions(task: str, copies: int, steps: int, seed: int = 0) -> NDArray:
    """Actions [S, T, A] that go beyond [-1, 1] and are held, so that hands get somewhere."""
    size, rng = HANDS[task].action_size, np.random.default_rng(seed)
    return rng.uniform(-1.3, 1.3, (copies, steps // 10, size)).repeat(10, axis=1)


class DapgPolicy:
    """The mean action of a published policy."""

    def __init__(self, task: str) -> None:
        self._of = dict(np.load(folder(POLICIES) / f"{task}.npz"))

    def __call__(self, observation: NDArray) -> NDArray:
        """Actions [N, A] for observations [N, O]."""
        of = self._of
        hidden = (observation - of["in_shift"]) / (of["in_scale"] + 1e-8)
        for layer in "01":
            hidden = np.tanh(hidden @ of[f"w{layer}"].T + of[f"b{layer}"])
        action = (hidden @ of["w2"].T + of["b2"]) * of["out_scale"] + of["out_shift"]
        return action.clip(-1.0, 1.0)


@pytest.fixture(autouse=True)
def _log_elsewhere(tmp_path, monkeypatch):
    """MuJoCo writes MUJOCO_LOG.TXT into the working directory when a simulation diverges."""
    monkeypatch.chdir(tmp_path)
