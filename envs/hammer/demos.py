"""What demonstrations of the hammer look like."""

from __future__ import annotations

from typing import Final

from envs.adroit.judging import never
from envs.adroit.resimulation import QPOS, QVEL
from envs.demonstrations.schema import DemoSchema, StartKey
from envs.hammer import task
from envs.hammer.hand import BOARD_POSITION

SCHEMA: Final = DemoSchema(
    describes="the Adroit hammer (46-d observations, 26-d actions)",
    observation_size=task.OBSERVATION_SIZE,
    action_size=task.ACTION_SIZE,
    # Humans' position targets lie beyond 1; far beyond it the actions are of another kind.
    action_bound=3.0,
    start=(
        StartKey(BOARD_POSITION, 3, ("board_pos",)),
        StartKey(QPOS, task.STATE_SIZE, ("initial_qpos",)),
        StartKey(QVEL, task.STATE_SIZE, ("initial_qvel",)),
    ),
    reward=task.observed_reward,
    # The velocity penalty, which no observation shows, and the nail's way in 2 ms.
    reward_tolerance=0.6,
    terminated=never,
    success=task.success,
    progress=task.driven,
    horizon=task.HORIZON,
    full_progress=task.NAIL_LENGTH,
)
