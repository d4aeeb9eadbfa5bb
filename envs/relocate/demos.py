"""What demonstrations of relocate look like."""

from __future__ import annotations

from typing import Final

from envs.adroit.judging import never
from envs.adroit.resimulation import QPOS, QVEL
from envs.demonstrations.schema import DemoSchema, StartKey
from envs.relocate import task
from envs.relocate.hand import BALL_POSITION, TARGET_POSITION, observed_reward

SCHEMA: Final = DemoSchema(
    describes="the Adroit hand that relocates a ball (39-d observations, 30-d actions)",
    observation_size=task.OBSERVATION_SIZE,
    action_size=task.ACTION_SIZE,
    # Humans' position targets lie beyond 1; far beyond it the actions are of another kind.
    action_bound=3.0,
    start=(
        StartKey(BALL_POSITION, 3, ("obj_pos",)),
        StartKey(TARGET_POSITION, 3, ("target_pos",)),
        StartKey(QPOS, task.STATE_SIZE, ("initial_qpos",)),
        StartKey(QVEL, task.STATE_SIZE, ("initial_qvel",)),
    ),
    reward=observed_reward,
    reward_tolerance=1e-4,
    terminated=never,
    success=task.success,
    progress=task.nearness,
    horizon=task.HORIZON,
    full_progress=0.0,
)
