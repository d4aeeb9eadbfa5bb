"""The MuJoCo model of the door task, with its indices resolved once."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.door.task import ACTION_SIZE

SUBSTEPS = 5
"""Simulation steps (0.002 s each) per action: control runs at 100 Hz."""

_MODEL_PACKAGE = "gymnasium_robotics"
_MODEL_FILE = Path("envs", "assets", "adroit_hand", "adroit_door.xml")

# Position-servo stiffness (N m / rad) per actuator group, by the group's first and last actuator.
# RoboHive and DAPG set these in code after loading, and so the task does not depend on the file.
_SERVO_STIFFNESS = {("A_WRJ1", "A_WRJ0"): 10.0, ("A_FFJ3", "A_THJ0"): 1.0}


@dataclass(frozen=True)
class DoorScene:
    """A compiled door model and the indices needed to play it."""

    model: mujoco.MjModel
    """The model. `body_pos[frame_body]` is the door's position and is written at run time."""
    frame_body: int
    """Body id of the door frame."""
    palm_site: int
    """Site id of the palm's grasp point."""
    handle_site: int
    """Site id of the door handle."""
    hinge_qpos: int
    """Index of the door hinge in `qpos`."""
    latch_qpos: int
    """Index of the latch in `qpos`."""
    control_middle: NDArray[np.float64]
    """Centre of the actuators' ranges, shape [28], rad (m for A_ARTz): the target of action 0."""
    control_half_range: NDArray[np.float64]
    """Half-width of the actuators' ranges, shape [28]: action +-1 is `middle +- half_range`."""


def model_path() -> Path:
    """Path of `adroit_door.xml` inside the installed package gymnasium-robotics.

    The package is located, not imported: importing it registers environments and prints warnings.

    Raises:
        FileNotFoundError: If the package or its model file is missing.
    """
    spec = importlib.util.find_spec(_MODEL_PACKAGE)
    if spec is None or spec.origin is None:
        raise FileNotFoundError(
            "the door's model files come with gymnasium-robotics, which is not installed: "
            "pip install gymnasium-robotics"
        )
    path = Path(spec.origin).parent / _MODEL_FILE
    if not path.is_file():
        raise FileNotFoundError(
            f"gymnasium-robotics is installed without {_MODEL_FILE}: reinstall it, "
            "pip install --force-reinstall gymnasium-robotics"
        )
    return path


def build_scene() -> DoorScene:
    """Compile the door scene with the suite's actuator gains.

    Raises:
        FileNotFoundError: If the model files are missing (see `model_path`).
        ValueError: If the model file does not describe the task's hand.
    """
    spec = mujoco.MjSpec.from_file(str(model_path()))
    _set_servo_stiffness(spec)
    # A diverged door must stay visibly broken. MuJoCo would reset it to the start pose instead.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET.value
    # Nothing reads the file's 65 sensors, which take 2 % of a step and do not act on it.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR.value
    model = spec.compile()
    if model.nu != ACTION_SIZE:
        raise ValueError(f"{model_path()} has {model.nu} actuators, the task needs {ACTION_SIZE}")
    low, high = model.actuator_ctrlrange.T
    return DoorScene(
        model=model,
        frame_body=model.body("frame").id,
        palm_site=model.site("S_grasp").id,
        handle_site=model.site("S_handle").id,
        hinge_qpos=int(model.joint("door_hinge").qposadr[0]),
        latch_qpos=int(model.joint("latch").qposadr[0]),
        control_middle=(low + high) / 2,
        control_half_range=(high - low) / 2,
    )


def _set_servo_stiffness(spec: mujoco.MjSpec) -> None:
    names = [actuator.name for actuator in spec.actuators]
    for (first, last), stiffness in _SERVO_STIFFNESS.items():
        for actuator in spec.actuators[names.index(first) : names.index(last) + 1]:
            # Force = gain * target + bias * angle, so equal and opposite terms make a servo.
            actuator.gainprm[:3] = (stiffness, 0.0, 0.0)
            actuator.biasprm[:3] = (0.0, -stiffness, 0.0)
