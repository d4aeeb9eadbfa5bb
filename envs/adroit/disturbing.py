"""What of every task of the hand can be disturbed: its servos, and the friction of all contacts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray
from torchrl.envs import EnvBase

from envs.adroit.changes import ModelChange
from envs.adroit.hand import HandTask
from envs.adroit.torchrl_env import HandEnv
from envs.disturbing import Box, Disturb, Factor

Multiply = Callable[[mujoco.MjModel, float], None]
FINGERS: Final = ("A_FFJ3", "A_THJ0")
"""The first and the last actuator of the fingers, which stand in a row."""


def scale_contact_friction(model: mujoco.MjModel, factor: float) -> None:
    """Sliding friction of all geoms; MuJoCo takes the larger of two that touch."""
    model.geom_friction[:, 0] *= factor


def scale_finger_gain(model: mujoco.MjModel, factor: float) -> None:
    """Stiffness of the fingers' servos: their force a rad from the target."""
    chosen = _finger_actuators(model)
    model.actuator_gainprm[chosen, 0] *= factor
    model.actuator_biasprm[chosen, 1] *= factor


def scale_finger_damping(model: mujoco.MjModel, factor: float) -> None:
    """Damping of the fingers' joints, N m s / rad: how slowly they follow their servos."""
    joints = model.actuator_trnid[_finger_actuators(model), 0]
    model.dof_damping[model.jnt_dofadr[joints]] *= factor


def _finger_actuators(model: mujoco.MjModel) -> slice:
    first, last = (model.actuator(name).id for name in FINGERS)
    return slice(first, last + 1)


def scale_joint(array: str, joint: str, model: mujoco.MjModel, factor: float) -> None:
    """``dof_damping`` or ``dof_frictionloss`` of a joint, which are N m s / rad and N m."""
    getattr(model, array)[model.joint(joint).dofadr[0]] *= factor


def scale_mass(bodies: tuple[str, ...], model: mujoco.MjModel, factor: float) -> None:
    """Masses and inertias of bodies, and all that MuJoCo derives from them."""
    for name in bodies:
        body = model.body(name).id
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
    mujoco.mj_setConst(model, mujoco.MjData(model))


def damping(joint: str) -> Multiply:
    """See `scale_joint`."""
    return partial(scale_joint, "dof_damping", joint)


def friction(joint: str) -> Multiply:
    """See `scale_joint`."""
    return partial(scale_joint, "dof_frictionloss", joint)


def mass(*bodies: str) -> Multiply:
    """See `scale_mass`."""
    return partial(scale_mass, bodies)


FINGER_DAMPING: Final[tuple[Factor, Multiply]] = (
    Factor("damping of the fingers' joints"),
    scale_finger_damping,
)
"""For tasks whose things have no damping of their own that a factor could change: that of a ball
and a pen is 0, and a nail's 0.05 N s/m is nothing beside its friction of 2.5 N."""
SHARED: Final[Mapping[str, tuple[Factor, Multiply]]] = MappingProxyType(
    {
        "contact_friction": (Factor("friction of all contacts"), scale_contact_friction),
        "finger_gain": (Factor("stiffness of the fingers' servos"), scale_finger_gain),
    }
)


@dataclass(frozen=True)
class _Apply:
    multiply: Mapping[str, Multiply]

    def __call__(self, env: EnvBase, copy: int, factors: Mapping[str, float]) -> None:
        assert isinstance(env, HandEnv)
        env.simulator.change_model(copy, self.change(factors))

    def change(self, factors: Mapping[str, float]) -> ModelChange:
        def written(model: mujoco.MjModel) -> None:
            for name, factor in factors.items():
                self.multiply[name](model, factor)

        return written


@dataclass(frozen=True)
class _Rest:
    task: HandTask

    def __call__(self) -> NDArray[np.float32]:
        scene = self.task.scene()
        return np.asarray(-scene.control_middle / scene.control_half_range, dtype=np.float32)


def hand_disturb(
    task: HandTask,
    own: Mapping[str, tuple[Factor, Multiply]],
    boxes: tuple[Box, ...] = (),
) -> Disturb:
    """What of a task of the hand can be disturbed.

    A hand that is left alone is sent to the angles 0, the pose in which episodes begin.

    Args:
        task: Its hand.
        own: Factors besides those of every hand, by name.
        boxes: Where its things stand.
    """
    all_of_them = {**SHARED, **own}
    return Disturb(
        apply=_Apply({name: multiply for name, (_, multiply) in all_of_them.items()}),
        factors=MappingProxyType({name: factor for name, (factor, _) in all_of_them.items()}),
        boxes=boxes,
        rest=_Rest(task),
    )
