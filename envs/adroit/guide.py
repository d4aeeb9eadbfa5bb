"""Moves the palm along with what a task places elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.adroit.scene import HandScene
from envs.adroit.variation import servo_compliance

PALM: Final = "S_grasp"
"""Site of the palm's grasp point in every model of the hand."""
#: Keeps the least-squares step small where the arm cannot move the palm in some direction (m/rad).
_DAMPING = 0.01


@dataclass(frozen=True)
class ArmGuide:
    """Moves the palm through the actuators of the arm, those that carry the hand.

    Replayed where something stands elsewhere, the recorded hand misses it. Shifting the palm's path
    by the same offset brings it back (MimicGen transforms whole object-relative end-effector paths;
    here the first-order correction is enough: the arm reaches 10 cm and keeps the wrist nearly
    parallel).

    Attributes:
        arm: its actuators, which are the first ones, each of the joint with its number.
        joints: the joints in ``qpos`` that observations hold.
        observed: where observations hold them. Joints that they leave out must not turn anything.
    """

    arm: slice
    joints: slice
    observed: slice

    def action_per_metre(
        self, scene: HandScene, observations: NDArray[np.float32], share: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Change of the arm's actions per metre of palm displacement.

        Args:
            scene: the task's; its model is read only.
            observations: [T, O] along the recorded episode.
            share: [T] of the displacement that the palm has made, in [0, 1].

        Returns:
            [T, arm, 3]: multiply by a displacement [3] in metres.
        """
        per_radian = servo_compliance(scene)[self.arm] / scene.control_half_range[self.arm]
        jacobian = self._palm_jacobian(scene, observations)
        transposed = jacobian.swapaxes(-1, -2)
        inverse = transposed @ np.linalg.inv(jacobian @ transposed + _DAMPING**2 * np.eye(3))
        return share[:, None, None] * per_radian[:, None] * inverse

    def _palm_jacobian(
        self, scene: HandScene, observations: NDArray[np.float32]
    ) -> NDArray[np.float64]:
        model, data = scene.model, mujoco.MjData(scene.model)
        palm = model.site(PALM).id
        full = np.zeros((3, model.nv))
        jacobian = np.empty((len(observations), 3, self.arm.stop))
        for t, observation in enumerate(observations):
            data.qpos[self.joints] = observation[self.observed]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, full, None, palm)
            jacobian[t] = full[:, self.arm]
        return jacobian
