"""Plays gymnasium-robotics' own environment; a process of its own, because importing it warns.

Arguments: its id without version, a file with starts and actions, a file for what happened.
"""

from __future__ import annotations

import sys

import gymnasium
import gymnasium_robotics
import numpy as np


def main(name: str, given: str, out: str) -> None:
    gymnasium.register_envs(gymnasium_robotics)
    dense, sparse = (gymnasium.make(f"{name}{kind}-v1").unwrapped for kind in ("", "Sparse"))
    asked = np.load(given)
    starts = {key.removeprefix("start/"): asked[key] for key in asked if key.startswith("start/")}
    found: dict[str, list] = {}
    for copy, actions in enumerate(asked["actions"]):
        start = {key: values[copy] for key, values in starts.items()}
        first = []
        for env in (dense, sparse):
            env.reset(seed=0)
            env.set_env_state(start)
            first.append(env._get_obs())
        rows: dict[str, list] = {"observation": [first[0]]}
        for action in actions:
            observation, reward, _, _, info = dense.step(action)
            palm = dense.data.site_xpos[dense.S_grasp_site_id]
            row = {
                "observation": observation,
                "dense": reward,
                "sparse": sparse.step(action)[1],
                "success": info["success"],
                "reach": np.linalg.norm(palm - dense.data.xpos[dense.obj_body_id]),
            }
            for key, value in row.items():
                rows.setdefault(key, []).append(value)
        for key, values in rows.items():
            found.setdefault(key, []).append(values)
    for seed in range(3):
        dense.reset(seed=seed)
        for key, value in dense.get_env_state().items():
            found.setdefault(f"reset/{key}", []).append(value)
    np.savez(out, **{key: np.asarray(values) for key, values in found.items()})


if __name__ == "__main__":
    main(*sys.argv[1:])
