"""Doors to test with, and a slow and obvious one that the batched door must equal."""

from __future__ import annotations

import numpy as np
import pytest
from dm_control import mujoco
from hypothesis import settings
from numpy.typing import ArrayLike, NDArray

from envs.adroit.scene import model_path
from envs.adroit.simulator import HandSimulator
from envs.adroit.starts import placement_of
from envs.door.hand import DOOR, DOOR_POSITION

PROPERTY = settings(max_examples=50)
"""Of the property tests here: failures must repeat, and machines may be busy."""

FINGERS = ["FFJ3", "FFJ2", "FFJ1", "FFJ0", "MFJ3", "MFJ2", "MFJ1", "MFJ0", "RFJ3", "RFJ2", "RFJ1"]
FINGERS += ["RFJ0", "LFJ4", "LFJ3", "LFJ2", "LFJ1", "LFJ0", "THJ4", "THJ3", "THJ2", "THJ1", "THJ0"]
WRIST = ["WRJ1", "WRJ0"]
ARM = ["ARTz", "ARRx", "ARRy", "ARRz"]


class ReferenceDoor:
    """One door on dm_control's `Physics`, everything by name: what RoboHive does."""

    def __init__(self) -> None:
        self.physics = mujoco.Physics.from_xml_path(str(model_path("adroit_door.xml")))
        for names, stiffness in ((WRIST, 10.0), (FINGERS, 1.0)):
            for name in names:
                self.physics.named.model.actuator_gainprm[f"A_{name}", :3] = [stiffness, 0, 0]
                self.physics.named.model.actuator_biasprm[f"A_{name}", :3] = [0, -stiffness, 0]

    def reset(
        self, door_position: NDArray[np.float64], qpos: ArrayLike = 0.0, qvel: ArrayLike = 0.0
    ) -> NDArray[np.float64]:
        self.physics.reset()
        self.physics.named.model.body_pos["frame"] = door_position
        self.physics.data.qpos[:] = qpos
        self.physics.data.qvel[:] = qvel
        self.physics.forward()
        return self.observation()

    def step(self, action: NDArray[np.float64]) -> NDArray[np.float64]:
        low, high = self.physics.model.actuator_ctrlrange.T
        self.physics.set_control((low + high) / 2 + np.clip(action, -1, 1) * (high - low) / 2)
        self.physics.step(5)
        return self.observation()

    def observation(self) -> NDArray[np.float64]:
        angle, site = self.physics.named.data.qpos, self.physics.named.data.site_xpos
        palm, handle = site["S_grasp"], site["S_handle"]
        joints = [*ARM[1:], *WRIST, *FINGERS, "latch", "door_hinge"]
        return np.concatenate([*(angle[name] for name in joints), palm, handle, palm - handle])


def door_position(seed: int, door: int, episode: int) -> NDArray[np.float64]:
    """Where the door stands in an episode of one of several, [3], m."""
    return placement_of(DOOR, seed, door, episode)[DOOR_POSITION]


@pytest.fixture
def reference_door() -> ReferenceDoor:
    return ReferenceDoor()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture(scope="module")
def one_door() -> HandSimulator:
    """A simulator to share within a file; each test resets it."""
    return HandSimulator(DOOR, 1, num_threads=1)


@pytest.fixture(autouse=True)
def _log_elsewhere(tmp_path, monkeypatch):
    """MuJoCo writes MUJOCO_LOG.TXT into the working directory when a simulation diverges."""
    monkeypatch.chdir(tmp_path)
