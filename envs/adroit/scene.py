"""MuJoCo models of the hand, with the suite's actuator gains, and what of them a task uses."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

SUBSTEPS = 5
"""Simulation steps (0.002 s each) per action: control runs at 100 Hz."""
STEPS_PER_SECOND = 100.0

SKY = ((0.82, 0.87, 0.93), (0.55, 0.63, 0.74))
"""Colours of the sky in pictures, above and at the horizon."""
SKY_PX = 64

_MODEL_PACKAGE = "gymnasium_robotics"
_MODEL_FOLDER = Path("envs", "assets", "adroit_hand")

# Position-servo stiffness (N m / rad) per actuator group, by the group's first and last actuator.
# RoboHive and DAPG set these in code after loading, and so the task does not depend on the file.
_SERVO_STIFFNESS = {("A_WRJ1", "A_WRJ0"): 10.0, ("A_FFJ3", "A_THJ0"): 1.0}


@dataclass(frozen=True)
class Numbers:
    """Some numbers of a MuJoCo model or of its data, by the name of the array that holds them."""

    array: str
    index: int | slice

    def of(self, owner: mujoco.MjModel | mujoco.MjData) -> NDArray[np.float64]:
        """A view into MuJoCo's memory, shape [k]."""
        view: NDArray[np.float64] = getattr(owner, self.array)[self.index]
        return view


@dataclass(frozen=True)
class HandScene:
    """A compiled model and what is needed to play it."""

    model: mujoco.MjModel
    """The model. What `placed` names is written at run time."""
    placed: Mapping[str, Numbers]
    """Numbers of the model that tell one copy from another, by name: where things stand."""
    read: Mapping[str, Numbers]
    """Numbers of the data that observations and rewards are made of, besides positions and
    velocities of joints, by name."""
    control_middle: NDArray[np.float64]
    """Centre of the actuators' ranges, shape [A], rad (m for slides): the target of action 0."""
    control_half_range: NDArray[np.float64]
    """Half-width of the actuators' ranges, shape [A]: action +-1 is `middle +- half_range`."""
    current: bool = False
    """Whether `read` is of the same instant as the joint positions, as in dm_control and RoboHive.
    Otherwise it is what ``mj_step`` leaves behind, which is one simulation step (2 ms) older: so
    gymnasium-robotics reads it, and DAPG before."""


def model_path(file: str) -> Path:
    """Path of a model of the hand inside the installed package gymnasium-robotics.

    The package is located, not imported: importing it registers environments and prints warnings.

    Args:
        file: Its name: ``adroit_door.xml``.

    Raises:
        FileNotFoundError: If the package or its model file is missing.
    """
    spec = importlib.util.find_spec(_MODEL_PACKAGE)
    if spec is None or spec.origin is None:
        raise FileNotFoundError(
            "the hand's model files come with gymnasium-robotics, which is not installed: "
            "pip install gymnasium-robotics"
        )
    path = Path(spec.origin).parent / _MODEL_FOLDER / file
    if not path.is_file():
        raise FileNotFoundError(
            f"gymnasium-robotics is installed without {_MODEL_FOLDER / file}: reinstall it, "
            "pip install --force-reinstall gymnasium-robotics"
        )
    return path


def compile_model(
    path: Path,
    action_size: int,
    *,
    sensors: bool = False,
    geoms: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> tuple[mujoco.MjModel, dict[str, Any]]:
    """Compile a scene with the suite's actuator gains.

    Args:
        path: Of the model file.
        action_size: Actuators that the task needs.
        sensors: Whether the task reads one.
        geoms: Names for the geoms of a body that the file leaves without, by the body's.

    Returns:
        The model, and the control fields of its `HandScene`.

    Raises:
        ValueError: If the model file does not describe the task's hand.
    """
    spec = mujoco.MjSpec.from_file(str(path))
    _set_servo_stiffness(spec)
    # A diverged copy must stay visibly broken. MuJoCo would reset it to the start pose instead.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    if not sensors:
        # The file has 65, which take 2 % of a step and do not act on it.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR.value
    _set_sky(spec)
    for body, names in geoms.items():
        for geom, name in zip(_geoms_of(spec, body), names, strict=True):
            geom.name = name
    model = spec.compile()
    if model.nu != action_size:
        raise ValueError(f"{path} has {model.nu} actuators, the task needs {action_size}")
    low, high = model.actuator_ctrlrange.T
    return model, {"control_middle": (low + high) / 2, "control_half_range": (high - low) / 2}


def _geoms_of(spec: mujoco.MjSpec, name: str) -> Iterator[mujoco.MjsGeom]:
    """Of one body; MuJoCo before 3.3 has neither `MjSpec.body` nor `MjsBody.geoms`."""
    body = next(body for body in spec.bodies if body.name == name)
    geom = body.first_geom()
    while geom is not None:
        yield geom
        geom = body.next_geom(geom)


def _set_sky(spec: mujoco.MjSpec) -> None:
    # The file has none, and the dark door and the arm are hard to see on black.
    sky = spec.add_texture()
    sky.name = "sky"
    sky.type = mujoco.mjtTexture.mjTEXTURE_SKYBOX
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = SKY
    sky.width = sky.height = SKY_PX


def _set_servo_stiffness(spec: mujoco.MjSpec) -> None:
    names = [actuator.name for actuator in spec.actuators]
    for (first, last), stiffness in _SERVO_STIFFNESS.items():
        for actuator in spec.actuators[names.index(first) : names.index(last) + 1]:
            # Force = gain * target + bias * angle, so equal and opposite terms make a servo.
            actuator.gainprm[:3] = (stiffness, 0.0, 0.0)
            actuator.biasprm[:3] = (0.0, -stiffness, 0.0)
