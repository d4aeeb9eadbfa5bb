"""The relocate task in MuJoCo."""

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
from envs.relocate import task
from envs.relocate.contacts import CONTACTS, GEOMS, SURFACES

BALL_POSITION: Final = "ball_position"
"""Where the ball lies at first, [3], m."""
TARGET_POSITION: Final = "target_position"
"""Where it is to be carried, [3], m."""


def build_scene() -> HandScene:
    """Compile the scene.

    Raises:
        FileNotFoundError: If the model files are missing.
    """
    model, control = compile_model(model_path("adroit_relocate.xml"), task.ACTION_SIZE, geoms=GEOMS)
    ball, target = model.body("Object").id, model.site("target").id
    return HandScene(
        model=model,
        placed={
            BALL_POSITION: Numbers("body_pos", ball),
            TARGET_POSITION: Numbers("site_pos", target),
        },
        read={
            "palm": Numbers("site_xpos", model.site("S_grasp").id),
            "ball": Numbers("xpos", ball),
            "target": Numbers("site_xpos", target),
        },
        **control,
    )


def _observe(states: HandStates) -> NDArray[np.float32]:
    palm, ball, target = (states.read[name] for name in ("palm", "ball", "target"))
    parts = (states.qpos[:, task.HAND_QPOS], palm - ball, palm - target, ball - target)
    return np.concatenate(parts, axis=1, dtype=np.float32, casting="same_kind")


def _judge(states: HandStates, observation: NDArray[np.float32]) -> Judged:
    return Judged(
        reward=task.reward(observation, states.read["ball"][:, 2]),
        success=task.success(observation),
        progress=task.nearness(observation),
        terminated=never(observation),
    )


def _draw(rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    return {
        BALL_POSITION: np.append(rng.uniform(task.BALL_LOW, task.BALL_HIGH), task.BALL_HEIGHT),
        TARGET_POSITION: rng.uniform(task.TARGET_LOW, task.TARGET_HIGH),
    }


RELOCATE: Final = HandTask(
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


def observed_reward(next_observation: NDArray[np.floating]) -> NDArray[np.float32]:
    """The task's reward of observations, shape ``[...]`` from ``[..., 39]``.

    For recordings that are not played again. No observation shows how high the ball is: that
    follows from the joints of the hand, which say where the palm is; a ball that is out of its
    reach lies on the table.
    """
    seen = np.asarray(next_observation, dtype=np.float64)
    rows = seen.reshape(-1, seen.shape[-1])
    model = _model()
    data, palm = mujoco.MjData(model), model.site("S_grasp").id
    height = np.empty(len(rows))
    for i, row in enumerate(rows):
        data.qpos[task.HAND_QPOS] = row[task.HAND_QPOS]
        mujoco.mj_kinematics(model, data)
        height[i] = data.site_xpos[palm, 2] - row[task.BALL_TO_PALM][2]
    # Joints are 2 ms younger than positions (`HandScene.current`): swinging, a hand that is nowhere
    # near the ball would seem to lift it.
    height[np.linalg.norm(rows[:, task.BALL_TO_PALM], axis=1) > task.REACH] = task.BALL_HEIGHT
    return task.reward(seen, height.reshape(seen.shape[:-1]))


@cache
def _model() -> mujoco.MjModel:
    return build_scene().model
