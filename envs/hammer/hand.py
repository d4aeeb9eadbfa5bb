"""The hammer task in MuJoCo."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.hand import HandTask, Judged
from envs.adroit.judging import never
from envs.adroit.physics import HandStates
from envs.adroit.scene import HandScene, Numbers, compile_model, model_path
from envs.hammer import task
from envs.hammer.contacts import CONTACTS, GEOMS, SURFACES

BOARD_POSITION: Final = "board_position"
"""Where the board stands, [3], m."""
BOARD_X: Final = 0.05
BOARD_Y: Final = 0.0
"""Of it, in every episode."""


def build_scene() -> HandScene:
    """Compile the scene.

    Raises:
        FileNotFoundError: If the model files are missing.
    """
    model, control = compile_model(
        model_path("adroit_hammer.xml"), task.ACTION_SIZE, sensors=True, geoms=GEOMS
    )
    hammer = model.body("Object").id
    sites = {"palm": "S_grasp", "head": "tool", "nail": "S_target", "goal": "nail_goal"}
    impact = int(model.sensor("S_nail").adr[0])
    return HandScene(
        model=model,
        placed={BOARD_POSITION: Numbers("body_pos", model.body("nail_board").id)},
        read={
            **{name: Numbers("site_xpos", model.site(site).id) for name, site in sites.items()},
            "hammer": Numbers("xpos", hammer),
            "turned": Numbers("xquat", hammer),
            "impact": Numbers("sensordata", slice(impact, impact + 1)),
        },
        **control,
    )


def _observe(states: HandStates) -> NDArray[np.float32]:
    read = states.read
    parts = (
        states.qpos[:, : task.NAIL + 1],
        states.qvel[:, -6:].clip(-1.0, 1.0),
        read["palm"],
        read["hammer"],
        task.euler_angles(read["turned"]),
        read["nail"],
        read["impact"].clip(-1.0, 1.0),
    )
    return np.concatenate(parts, axis=1, dtype=np.float32, casting="same_kind")


def _judge(states: HandStates, observation: NDArray[np.float32]) -> Judged:
    read = states.read
    to_goal = np.linalg.norm(read["nail"] - read["goal"], axis=1)
    speed = np.linalg.norm(states.qvel, axis=1)
    return Judged(
        reward=task.reward(
            read["palm"], read["hammer"], read["head"], read["nail"], to_goal, speed
        ),
        success=to_goal < task.DRIVEN,
        progress=states.qpos[:, task.NAIL],
        terminated=never(observation),
    )


def _draw(rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    return {BOARD_POSITION: np.array([BOARD_X, BOARD_Y, rng.uniform(*task.BOARD_HEIGHT)])}


HAMMER: Final = HandTask(
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
