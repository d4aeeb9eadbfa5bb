"""Pictures show where things stand. The OpenGL library is chosen when mujoco is imported, so that
pictures need a process of their own."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PICTURES = """
import sys
import numpy as np
from envs import EnvOptions, find_task
from envs.adroit.render import HandRenderer, RenderingUnavailableError
for name in ("hammer", "pen", "relocate"):
    env = find_task(name).make_env(EnvOptions(num_envs=2, seed=0))
    env.reset()
    try:
        renderer = HandRenderer(env.simulator, 64, 48)
    except RenderingUnavailableError as error:
        sys.exit(f"unavailable: {error}")
    first, second, again = (renderer.render(copy).copy() for copy in (0, 1, 0))
    renderer.close()
    assert first.shape == (48, 64, 3) and first.dtype == np.uint8, first.shape
    assert first.std() > 5, "the picture is blank"
    assert np.array_equal(first, again), "the picture of one copy changes"
    assert not np.array_equal(first, second), "the picture does not show where things stand"
"""


def test_pictures(request):
    result = subprocess.run(
        [sys.executable, "-c", PICTURES],
        env=os.environ | {"MUJOCO_GL": "egl", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        cwd=request.config.rootpath,
        check=False,
    )
    if "unavailable: " in result.stderr:
        pytest.skip(result.stderr.strip().splitlines()[-1])
    assert result.returncode == 0, result.stderr
