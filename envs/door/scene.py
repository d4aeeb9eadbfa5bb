"""The MuJoCo model of the door task, with its indices resolved once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from envs.adroit import scene
from envs.adroit.scene import SUBSTEPS, HandScene, Numbers
from envs.door.contacts import GEOMS
from envs.door.task import ACTION_SIZE

__all__ = ["SUBSTEPS", "DoorScene", "build_scene", "model_path"]


@dataclass(frozen=True, kw_only=True)
class DoorScene(HandScene):
    """A compiled door model and the indices needed to play it."""

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


def model_path() -> Path:
    """Path of `adroit_door.xml` inside the installed package gymnasium-robotics.

    Raises:
        FileNotFoundError: If the package or its model file is missing.
    """
    return scene.model_path("adroit_door.xml")


def build_scene() -> DoorScene:
    """Compile the door scene with the suite's actuator gains.

    Raises:
        FileNotFoundError: If the model files are missing (see `model_path`).
        ValueError: If the model file does not describe the task's hand.
    """
    model, control = scene.compile_model(model_path(), ACTION_SIZE, geoms=GEOMS)
    frame, palm, handle = (
        model.body("frame").id,
        model.site("S_grasp").id,
        model.site("S_handle").id,
    )
    return DoorScene(
        model=model,
        placed={"door_position": Numbers("body_pos", frame)},
        read={"palm": Numbers("site_xpos", palm), "handle": Numbers("site_xpos", handle)},
        current=True,
        frame_body=frame,
        palm_site=palm,
        handle_site=handle,
        hinge_qpos=int(model.joint("door_hinge").qposadr[0]),
        latch_qpos=int(model.joint("latch").qposadr[0]),
        **control,
    )
