"""What demonstrations of the door look like."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from envs.adroit.resimulation import QPOS, QVEL
from envs.demonstrations.schema import DemoSchema, Floats, StartKey
from envs.door import task
from envs.door.hand import DOOR_POSITION

SAME_DOOR_M: Final = 0.03
"""Between two observations of one episode the door and its handle move by millimetres; between two
demonstrations they differ by centimetres, because the door stands elsewhere."""
SAME_POSE_RAD: Final = 0.3
"""The fastest recorded joint moves 0.2 rad in a control step of 10 ms."""


def continues(before: Floats, after: Floats) -> bool:
    """Whether the observation ``after`` [>=38] may follow ``before`` in one episode."""
    change = abs(after - before)
    return bool(
        change[task.HANDLE].max() < SAME_DOOR_M and change[task.HAND_QPOS].max() < SAME_POSE_RAD
    )


SCHEMA: Final = DemoSchema(
    describes="the Adroit door (38-d or 39-d observations, 28-d actions)",
    observation_size=task.OBSERVATION_SIZE,
    action_size=task.ACTION_SIZE,
    # DAPG and D4RL/Minari append a door_open flag to the 38 entries of the task.
    observation_widths=(task.OBSERVATION_SIZE + 1,),
    # The published human actions reach 1.37. Far beyond that the actions cannot be this task's
    # normalised position targets: they are raw joint angles, torques, or another scaling.
    action_bound=3.0,
    start=(
        StartKey(DOOR_POSITION, 3, ("door_body_pos",), axes=("x", "y", "z"), unit="m"),
        StartKey(QPOS, task.STATE_SIZE, ("initial_qpos",)),
        StartKey(QVEL, task.STATE_SIZE, ("initial_qvel",)),
    ),
    reward=task.reward,
    # The published rewards hold a velocity penalty that no observation shows; it stays below this.
    reward_tolerance=0.05,
    terminated=task.terminated,
    success=task.success,
    progress=task.hinge_angle,
    continues=continues,
    bundled=Path(__file__).parent / "bundled" / "door_dbc_sac.h5",
    horizon=task.HORIZON,
    full_progress=task.FULLY_OPEN,
)
