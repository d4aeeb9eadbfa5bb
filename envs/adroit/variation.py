"""How one recorded action sequence becomes another: speed and noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from envs.adroit.scene import HandScene


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
    rng: np.random.Generator, shape: tuple[int, int], scale: float, correlation: float
) -> NDArray[np.float64]:
    """Stationary AR(1) noise with standard deviation ``scale``.

    White noise averages out in the position servos; correlated noise pushes the hand off its path.

    Args:
        rng: source of randomness.
        shape: of the result: steps, and entries of an action.
        scale: standard deviation of each entry.
        correlation: between consecutive steps, in [0, 1).
    """
    white = rng.standard_normal(shape)
    noise = np.empty_like(white)
    noise[0] = white[0]
    innovation = np.sqrt(1.0 - correlation**2)
    for t in range(1, len(white)):
        noise[t] = correlation * noise[t - 1] + innovation * white[t]
    return scale * noise


def servo_compliance(scene: HandScene) -> NDArray[np.float64]:
    """Target change per joint change in equilibrium, [A]: 0.4 for the arm, 1 for the hand.

    Force = gain * target - bias * joint, and the arm's gain is 2.5 times its bias.
    """
    model = scene.model
    return -model.actuator_biasprm[:, 1] / model.actuator_gainprm[:, 0]
