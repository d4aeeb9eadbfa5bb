"""What demonstrations of the pen look like."""

from __future__ import annotations

from typing import Final

from envs.adroit.judging import never
from envs.adroit.resimulation import QPOS, QVEL
from envs.demonstrations.schema import DemoSchema, StartKey
from envs.pen import task
from envs.pen.hand import ASKED_ORIENTATION

SCHEMA: Final = DemoSchema(
    describes="the Adroit pen (45-d observations, 24-d actions)",
    observation_size=task.OBSERVATION_SIZE,
    action_size=task.ACTION_SIZE,
    # Humans' position targets lie beyond 1; far beyond it the actions are of another kind.
    action_bound=3.0,
    start=(
        StartKey(ASKED_ORIENTATION, 4, ("desired_orien",)),
        StartKey(QPOS, task.STATE_SIZE, ("initial_qpos",)),
        StartKey(QVEL, task.STATE_SIZE, ("initial_qvel",)),
    ),
    reward=task.reward,
    reward_tolerance=1e-4,
    terminated=never,
    success=task.success,
    progress=task.alignment,
    horizon=task.HORIZON,
    full_progress=1.0,
)
