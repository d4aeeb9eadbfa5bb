"""Normal forces between the parts of a hand and what a task's hand touches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.adroit.scene import SUBSTEPS
from envs.adroit.touch import Contacts

Floats = NDArray[np.float64]

THUMB: Final = "thumb"
BACK: Final = "back"
PARTS: Final = ("palm", BACK, THUMB, "first", "middle", "ring", "little", "arm")
"""``back`` is the dorsal side of palm and fingers, ``arm`` the forearm and the wrist."""
_PREFIXES: Final[Mapping[str, str]] = {
    "forearm": "arm",
    "wrist": "arm",
    "palm": "palm",
    "lfmetacarpal": "palm",
    "ff": "first",
    "mf": "middle",
    "rf": "ring",
    "lf": "little",
    "th": THUMB,
}
"""Part by the beginning of a body's name; the longest that fits."""
_PALMAR: Final = np.array([0.0, -1.0, 0.0])
"""Where a palm looks, in its own frame: its grasp site lies there."""
DORSAL_M: Final = 0.004
"""A contact so far behind the middle of a geom is on the back of the hand."""

Face = Callable[[Floats], str]
"""The target at a point [3] in the frame of the touched body, where one geom has several."""


@dataclass(frozen=True)
class Surface:
    """A geom that a hand may touch, and what is touched with it.

    Attributes:
        geom: its name.
        target: one of `Contacts.targets`, or which of them is where.
    """

    geom: str
    target: str | Face


class ContactReader:
    """Plays a control step of one thread's copy and averages the contacts that it solves.

    All of its simulation steps count: contacts chatter, and any one of them alone misses touches.

    Args:
        model: Of the thread.
        contacts: Their names.
        surfaces: What can be touched.

    Raises:
        KeyError: If a geom has no such name.
    """

    def __init__(
        self, model: mujoco.MjModel, contacts: Contacts, surfaces: tuple[Surface, ...]
    ) -> None:
        self._model = model
        self._targets = {name: k for k, name in enumerate(contacts.targets)}
        self._held = {self._targets[name] for name in contacts.held}
        self._surfaces = {model.geom(s.geom).id: s.target for s in surfaces}
        self._part, self._palmar = _hand(model)
        # 1 for a geom of the hand, 2 for one that it touches: only a sum of 3 is looked at.
        self._kind = np.zeros(model.ngeom, dtype=np.int8)
        self._kind[[g for g in range(model.ngeom) if self._part[g] >= 0]] = 1
        self._kind[list(self._surfaces)] = 2
        self._force = np.zeros(6)
        self._forces = np.zeros((len(contacts.parts), len(contacts.targets)))
        self._pushes = np.zeros((2, 3))  # of the thumb, and of all others

    def step(
        self, data: mujoco.MjData, forces: NDArray[np.float32], steps: int = SUBSTEPS
    ) -> float:
        """Make ``steps`` of the simulation; ``forces`` [P, K] become their mean normal forces, N.

        Returns:
            The opposition, see `envs.adroit.touch.OPPOSITION`.
        """
        self._forces[:] = 0.0
        self._pushes[:] = 0.0
        for _ in range(steps):
            mujoco.mj_step(self._model, data)
            self._add(data)
        forces[:] = self._forces / steps
        thumb, others = self._pushes
        lengths = float(np.linalg.norm(thumb) * np.linalg.norm(others))
        return float(thumb @ others) / lengths if lengths > 0.0 else 0.0

    def _add(self, data: mujoco.MjData) -> None:
        if not data.ncon:
            return
        touching = np.flatnonzero(self._kind[data.contact.geom].sum(axis=1) == 3)
        for i in touching.tolist():
            contact = data.contact[i]
            if contact.efc_address < 0:  # too far apart for a force
                continue
            first, second = contact.geom1, contact.geom2
            hand, touched, sign = (
                (first, second, -1.0) if self._kind[first] == 1 else (second, first, 1.0)
            )
            mujoco.mj_contactForce(self._model, data, i, self._force)
            normal = self._force[0]
            part = self._side(data, hand, contact.pos)
            target = self._target(data, touched, contact.pos)
            self._forces[part, target] += normal
            if target in self._held:
                # The normal points from the first geom to the second.
                pusher = 0 if PARTS[part] == THUMB else 1
                self._pushes[pusher] += sign * normal * contact.frame[:3]

    def _side(self, data: mujoco.MjData, geom: int, point: Floats) -> int:
        part = self._part[geom]
        if PARTS[part] in (THUMB, "arm"):
            return part
        body = self._model.geom_bodyid[geom]
        palmar = data.xmat[body].reshape(3, 3) @ self._palmar[body]
        behind = float((point - data.geom_xpos[geom]) @ palmar) < -DORSAL_M
        return PARTS.index(BACK) if behind else part

    def _target(self, data: mujoco.MjData, geom: int, point: Floats) -> int:
        target = self._surfaces[geom]
        if not isinstance(target, str):
            body = self._model.geom_bodyid[geom]
            target = target(data.xmat[body].reshape(3, 3).T @ (point - data.xpos[body]))
        return self._targets[target]


def _hand(model: mujoco.MjModel) -> tuple[list[int], Floats]:
    """The part of each geom, -1 for none, and where each body's palmar side looks, [B, 3]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    palmar = np.zeros((model.nbody, 3))
    looks = data.body("palm").xmat.reshape(3, 3) @ _PALMAR
    part_of_body = {}
    for body in range(model.nbody):
        palmar[body] = data.xmat[body].reshape(3, 3).T @ looks
        fitting = [p for p in _PREFIXES if model.body(body).name.startswith(p)]
        if fitting:
            part_of_body[body] = PARTS.index(_PREFIXES[max(fitting, key=len)])
    return [part_of_body.get(int(body), -1) for body in model.geom_bodyid], palmar
