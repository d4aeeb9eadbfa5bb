"""What is the hammer's alone."""

from __future__ import annotations

import mujoco
import numpy as np

from envs.hammer import task
from envs.hammer.hand import build_scene


def test_the_striking_face_is_where_the_simulator_has_it():
    model, rng = build_scene().model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    angles, faces = np.empty((20, 3)), np.empty((20, 3))
    for i in range(20):
        data.qpos[-6:] = rng.uniform(-1.5, 1.5, 6)
        mujoco.mj_kinematics(model, data)
        hammer = data.body("Object")
        angles[i] = task.euler_angles(hammer.xquat)
        faces[i] = data.site("tool").xpos - hammer.xpos
    np.testing.assert_allclose(task.head_offset(angles), faces, atol=1e-9)
    np.testing.assert_allclose(task.head_offset(angles.reshape(4, 5, 3))[1, 2], faces[7], atol=1e-9)
