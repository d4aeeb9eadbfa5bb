"""The state of a MuJoCo simulation, with what environments change of its model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Env = gymnasium.Env[Any, Any]

INTEGRATION: Final = mujoco.mjtState.mjSTATE_INTEGRATION
MODEL_FIELDS: Final = (
    *("body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "body_iquat"),
    *("geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_rgba"),
    *("site_pos", "site_quat", "site_size", "jnt_range", "dof_damping", "dof_armature"),
    *("dof_frictionloss", "actuator_gainprm", "actuator_biasprm", "qpos0"),
)
"""What environments are known to change of their model when an episode begins."""
DATA_FIELDS: Final = (
    *("xpos", "xquat", "xmat", "xipos", "ximat", "xanchor", "xaxis", "geom_xpos", "geom_xmat"),
    *(
        "site_xpos",
        "site_xmat",
        "cam_xpos",
        "cam_xmat",
        "subtree_com",
        "cdof",
        "cdof_dot",
        "cinert",
    ),
    *("cvel", "cacc", "cfrc_int", "cfrc_ext", "subtree_linvel", "subtree_angmom", "sensordata"),
    *("actuator_length", "actuator_velocity", "actuator_force", "act_dot", "ten_length"),
    *("ten_velocity", "qacc", "qacc_smooth", "qfrc_bias", "qfrc_passive", "qfrc_actuator"),
    *("qfrc_smooth", "qfrc_constraint", "qfrc_inverse"),
)
"""What follows from the state, but as of the last step: observations and rewards may read it."""


def mujoco_of(env: Env) -> tuple[mujoco.MjModel, mujoco.MjData] | None:
    """Model and data of ``env``; None if it is no MuJoCo environment that shows them."""
    inner: Any = env.unwrapped
    physics = getattr(inner, "physics", None)
    found = [
        getattr(holder, "ptr", holder)
        for holder in (
            getattr(physics or inner, "model", None),
            getattr(physics or inner, "data", None),
        )
    ]
    model, data = found
    if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
        return model, data
    return None


def mujoco_state(env: Env) -> dict[str, Array]:
    """All of the simulation of an environment that has one (:func:`mujoco_of`)."""
    found = mujoco_of(env)
    assert found is not None
    model, data = found
    physics = np.empty(mujoco.mj_stateSize(model, INTEGRATION))
    mujoco.mj_getState(model, data, physics, INTEGRATION)
    state = {"physics": physics}
    state |= {f"model/{name}": getattr(model, name).copy() for name in MODEL_FIELDS}
    return state | {f"data/{name}": getattr(data, name).copy() for name in DATA_FIELDS}


def set_mujoco_state(env: Env, state: Mapping[str, Array]) -> None:
    """Continues from what :func:`mujoco_state` gave, bit for bit."""
    found = mujoco_of(env)
    assert found is not None
    model, data = found
    for name in MODEL_FIELDS:
        getattr(model, name)[...] = state[f"model/{name}"]
    mujoco.mj_setState(model, data, state["physics"], INTEGRATION)
    mujoco.mj_forward(model, data)
    # Forward dynamics moved the solver's warm start.
    mujoco.mj_setState(model, data, state["physics"], INTEGRATION)
    for name in DATA_FIELDS:
        getattr(data, name)[...] = state[f"data/{name}"]
