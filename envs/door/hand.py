"""The door task in MuJoCo."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.hand import HandTask, Judged
from envs.adroit.physics import HandStates
from envs.adroit.scene import HandScene, Numbers, compile_model, model_path
from envs.door import task
from envs.door.contacts import CONTACTS, GEOMS, SURFACES

DOOR_POSITION: Final = "door_position"
"""Where the door frame stands, [3], m."""
OBSERVED_JOINTS: Final = np.r_[1:28, 29, 28]
"""Indices in ``qpos`` of an observation's first entries: the arm's sliding joint (0) is not
observed, and the latch (29) comes before the hinge (28)."""


def build_scene() -> HandScene:
    """Compile the scene.

    Raises:
        FileNotFoundError: If the model files are missing.
        ValueError: If the model file does not describe the task's hand.
    """
    model, control = compile_model(model_path("adroit_door.xml"), task.ACTION_SIZE, geoms=GEOMS)
    sites = {"palm": "S_grasp", "handle": "S_handle"}
    return HandScene(
        model=model,
        placed={DOOR_POSITION: Numbers("body_pos", model.body("frame").id)},
        read={name: Numbers("site_xpos", model.site(site).id) for name, site in sites.items()},
        current=True,
        **control,
    )


def _observe(states: HandStates) -> NDArray[np.float32]:
    palm, handle = states.read["palm"], states.read["handle"]
    observation = np.empty((len(palm), task.OBSERVATION_SIZE), dtype=np.float32)
    observation[:, : task.HINGE + 1] = states.qpos[:, OBSERVED_JOINTS]
    observation[:, task.PALM] = palm
    observation[:, task.HANDLE] = handle
    observation[:, task.PALM_TO_HANDLE] = palm - handle
    return observation


def _judge(_: HandStates, observation: NDArray[np.float32]) -> Judged:
    return Judged(
        reward=task.reward(observation),
        success=task.success(observation),
        progress=task.hinge_angle(observation),
        terminated=task.terminated(observation),
    )


def _draw(rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    """From the box of the paper (section IV-A) and of RoboHive."""
    return {DOOR_POSITION: rng.uniform(task.DOOR_POSITION_LOW, task.DOOR_POSITION_HIGH)}


DOOR: Final = HandTask(
    copies="doors",
    observation_size=task.OBSERVATION_SIZE,
    action_size=task.ACTION_SIZE,
    horizon=task.HORIZON,
    scene=build_scene,
    observe=_observe,
    judge=_judge,
    draw=_draw,
    contacts=CONTACTS,
    surfaces=SURFACES,
)
