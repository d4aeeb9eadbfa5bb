"""The pen task in MuJoCo."""

from __future__ import annotations

from functools import cache
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.adroit.hand import HandTask, Judged
from envs.adroit.judging import never
from envs.adroit.physics import HandStates
from envs.adroit.scene import HandScene, Numbers, compile_model, model_path
from envs.pen import task
from envs.pen.contacts import CONTACTS, SURFACES

ASKED_ORIENTATION: Final = "asked_orientation"
"""How the pen is to lie, a quaternion [4]."""


def build_scene() -> HandScene:
    """Compile the scene.

    Raises:
        FileNotFoundError: If the model files are missing.
    """
    model, control = compile_model(model_path("adroit_pen.xml"), task.ACTION_SIZE)
    sites = ("eps_ball", "object_top", "object_bottom", "target_top", "target_bottom")
    return HandScene(
        model=model,
        placed={ASKED_ORIENTATION: Numbers("body_quat", model.body("target").id)},
        read={
            **{name: Numbers("site_xpos", model.site(name).id) for name in sites},
            "pen": Numbers("xpos", model.body("Object").id),
        },
        **control,
    )


def _observe(states: HandStates) -> NDArray[np.float32]:
    read = states.read
    points = (read["object_top"] - read["object_bottom"]) / task.PEN_LENGTH
    asked = (read["target_top"] - read["target_bottom"]) / task.PEN_LENGTH
    parts = (
        states.qpos[:, task.HAND_QPOS],
        read["pen"],
        states.qvel[:, -6:],
        points,
        asked,
        read["pen"] - read["eps_ball"],
        points - asked,
    )
    return np.concatenate(parts, axis=1, dtype=np.float32, casting="same_kind")


def _judge(_: HandStates, observation: NDArray[np.float32]) -> Judged:
    return Judged(
        reward=task.reward(observation),
        success=task.success(observation),
        progress=task.alignment(observation),
        terminated=never(observation),
    )


def _draw(rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    angles = rng.uniform(-task.ASKED_ANGLE, task.ASKED_ANGLE, 2)
    return {ASKED_ORIENTATION: orientation(angles)}


def orientation(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions ``[..., 4]`` (w, x, y, z) of angles ``[..., 2]`` about x, then y, rad."""
    rows = np.reshape(angles, (-1, 2))
    found, about_x, about_y = np.zeros((len(rows), 4)), np.zeros(4), np.zeros(4)
    for row, quaternion in zip(rows, found, strict=True):
        mujoco.mju_axisAngle2Quat(about_x, np.array([1.0, 0.0, 0.0]), row[0])
        mujoco.mju_axisAngle2Quat(about_y, np.array([0.0, 1.0, 0.0]), row[1])
        mujoco.mju_mulQuat(quaternion, about_x, about_y)
    return found.reshape(*np.shape(angles)[:-1], 4)


def angles_of(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """The angles ``[..., 2]``, rad, that `orientation` makes these quaternions ``[..., 4]`` of."""
    w, x, y, _ = np.moveaxis(quaternion, -1, 0)
    return 2 * np.stack([np.arctan2(x, w), np.arctan2(y, w)], axis=-1)


PEN: Final = HandTask(
    copies="copies",
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


def palm(observation: NDArray[np.floating]) -> NDArray[np.float64]:
    """Palm (grasp site) positions in the world, m, shape ``[..., 3]`` from ``[..., 45]``.

    No observation shows them: they follow from the joints of the wrist, on which the hand turns.
    """
    seen = np.asarray(observation, dtype=np.float64)
    rows = seen.reshape(-1, seen.shape[-1])
    model = _model()
    data, site = mujoco.MjData(model), model.site("S_grasp").id
    found = np.empty((len(rows), 3))
    for i, row in enumerate(rows):
        data.qpos[task.HAND_QPOS] = row[task.HAND_QPOS]
        mujoco.mj_kinematics(model, data)
        found[i] = data.site_xpos[site]
    return found.reshape(*seen.shape[:-1], 3)


@cache
def _model() -> mujoco.MjModel:
    return build_scene().model
