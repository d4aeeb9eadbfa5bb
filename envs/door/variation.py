"""How one recorded action sequence becomes another: speed, door position, noise."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.door import task
from envs.door.scene import DoorScene

#: The four actuators that carry the hand: forearm slide, then its three rotations.
ARM = slice(0, 4)
#: Keeps the least-squares step small where the arm cannot move the palm in some direction (m/rad).
_DAMPING = 0.01


def retime(values: NDArray[np.float64], speed: float, steps: int) -> NDArray[np.float64]:
    """Play a sequence ``speed`` times as fast, by linear interpolation; then hold its last entry.

    The actions are position targets, so a faster sequence of them is a faster movement.

    Args:
        values: [T, ...].
        speed: > 0; 1 leaves the sequence as it is.
        steps: number of entries to return.

    Returns:
        [steps, ...].
    """
    position = np.minimum(np.arange(steps) * speed, len(values) - 1)
    before = position.astype(int)
    after = np.minimum(before + 1, len(values) - 1)
    share = (position - before).reshape(-1, *[1] * (values.ndim - 1))
    return (1.0 - share) * values[before] + share * values[after]


def correlated_noise(
    rng: np.random.Generator, steps: int, scale: float, correlation: float
) -> NDArray[np.float64]:
    """Stationary AR(1) noise [steps, 28] with standard deviation ``scale``.

    White noise averages out in the position servos; correlated noise pushes the hand off its path.

    Args:
        rng: source of randomness.
        steps: length.
        scale: standard deviation of each entry.
        correlation: between consecutive steps, in [0, 1).
    """
    white = rng.standard_normal((steps, task.ACTION_SIZE))
    noise = np.empty_like(white)
    noise[0] = white[0]
    innovation = np.sqrt(1.0 - correlation**2)
    for t in range(1, steps):
        noise[t] = correlation * noise[t - 1] + innovation * white[t]
    return scale * noise


def servo_compliance(scene: DoorScene) -> NDArray[np.float64]:
    """Target change per joint change in equilibrium, [28]: 0.4 for the arm, 1 for the hand.

    Force = gain * target - bias * joint, and the arm's gain is 2.5 times its bias.
    """
    model = scene.model
    return -model.actuator_biasprm[:, 1] / model.actuator_gainprm[:, 0]


@dataclass(frozen=True)
class ArmGuide:
    """Moves the palm along with the door, through the arm's four actuators.

    Replayed at a door that stands elsewhere, the recorded hand misses the handle. Shifting the
    palm's path by the same offset brings it back (MimicGen transforms whole object-relative
    end-effector paths; here the first-order correction is enough: the arm reaches 10 cm and keeps
    the wrist nearly parallel).

    Args:
        scene: the door scene; its model is read only.
        ramp_steps: the offset grows linearly over so many recorded steps, because every episode
            starts in the same reset pose.
    """

    scene: DoorScene
    ramp_steps: int = 60

    def action_per_metre(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Change of the four arm actions per metre of palm displacement.

        Args:
            observations: [T, 38] along the recorded episode.

        Returns:
            [T, 4, 3]: multiply by a displacement [3] in metres.
        """
        per_radian = servo_compliance(self.scene)[ARM] / self.scene.control_half_range[ARM]
        jacobian = self._palm_jacobian(observations)
        transposed = jacobian.swapaxes(-1, -2)
        inverse = transposed @ np.linalg.inv(jacobian @ transposed + _DAMPING**2 * np.eye(3))
        ramp = np.minimum(np.arange(len(observations)) / self.ramp_steps, 1.0)
        return ramp[:, None, None] * per_radian[:, None] * inverse

    def _palm_jacobian(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        model, data = self.scene.model, mujoco.MjData(self.scene.model)
        # The forearm slide is not observed and not needed: sliding does not turn anything.
        hand = slice(1, 1 + task.HAND_QPOS.stop)
        full = np.zeros((3, model.nv))
        jacobian = np.empty((len(observations), 3, ARM.stop))
        for t, observation in enumerate(observations):
            data.qpos[hand] = observation[task.HAND_QPOS]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, full, None, self.scene.palm_site)
            jacobian[t] = full[:, ARM]
        return jacobian
