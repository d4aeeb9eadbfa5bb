"""``make video``: a trained policy at work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from envs import DoorEnv
from envs.door.render import DoorRenderer
from envs.door.starts import door_position
from envs.door.task import HORIZON
from pipeline import components
from pipeline.policy import load_policy
from pipeline.run_dir import load_config

FRAMES_PER_SECOND = 50  # of the film; the task runs at 100 control steps per second
STRIDE = 2  # control steps per picture: real time


def film(run_dir: Path, out: Path, episodes: int) -> None:
    """Films the policy, as it is evaluated, on the first doors of the list, one after the other.

    Args:
        run_dir: A door run.
        out: MP4 file to write.
        episodes: How many doors.

    Raises:
        ImportError: If the ``video`` extra is not installed.
        RenderingUnavailableError: If there is no OpenGL.
        ValueError: If the task is not the door.
    """
    try:
        import imageio.v2 as imageio  # noqa: PLC0415 - an optional extra
    except ImportError as error:
        raise ImportError("Films need the extra: pip install '.[video]'") from error
    config = load_config(run_dir)
    if config.env.name != "door":
        raise ValueError(f"{run_dir}: only door runs can be filmed, this is {config.env.name!r}.")
    policy, _ = load_policy(config, run_dir)
    env = DoorEnv(1, horizon=config.env.horizon or HORIZON, device=config.device)
    renderer = DoorRenderer(env.simulator)
    open_film: Any = imageio.get_writer  # its annotations lack append_data
    try:
        with (
            open_film(out, fps=FRAMES_PER_SECOND) as writer,
            components.make_evaluator(config, episodes=episodes).acting(policy) as acting,
        ):
            for i in range(episodes):
                position = np.atleast_2d(door_position(config.evaluation.seed, i, 0))
                start = {"door_position": torch.as_tensor(position, device=env.device)}
                td = env.reset(TensorDict(start, env.batch_size, device=env.device))
                step = 0
                while not td["done"].any():
                    if step % STRIDE == 0:
                        writer.append_data(renderer.render(0))
                    td = env.step_mdp(env.step(acting(td)))
                    step += 1
    finally:
        renderer.close()
        env.close()
