"""A task of three observed numbers and two actions; its demonstrations in every format."""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from envs.demonstrations import DemoSchema, Episode, Provenance

SCHEMA = DemoSchema(describes="the toy (3 observed, 2 actions)", observation_size=3, action_size=2)


def toy_episode(seed: int = 0, steps: int = 5, **changes: Any) -> Episode:
    """Uniform noise in [-0.9, 0.9], with everything that an episode can tell."""
    rng = np.random.default_rng(seed)
    fields: dict[str, Any] = {
        "observations": rng.uniform(-0.9, 0.9, (steps + 1, 3)).astype(np.float32),
        "actions": rng.uniform(-0.9, 0.9, (steps, 2)).astype(np.float32),
        "rewards": rng.uniform(-0.9, 0.9, steps).astype(np.float32),
        "terminated": np.zeros(steps, dtype=bool),
        "provenance": Provenance("toy", seed, "recorded", {"seed": seed}),
        "success": np.arange(steps + 1) >= steps - 1,
        "progress": np.linspace(0.0, 1.0, steps + 1, dtype=np.float32),
    }
    return Episode(**(fields | changes))


def assert_same(read: Sequence[Episode], written: Sequence[Episode], *names: str) -> None:
    """Equal arrays under ``names``, in the same order of episodes."""
    assert [e.length for e in read] == [e.length for e in written]
    for name in names:
        for one, other in zip(read, written, strict=True):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def write_dapg(path: Path, episodes: Sequence[Episode], protocol: int = 4) -> Path:
    demos = [
        {"observations": e.observations, "actions": e.actions, "rewards": e.rewards}
        for e in episodes
    ]
    path.write_bytes(pickle.dumps(demos, protocol=protocol))
    return path


def write_flat(path: Path, episodes: Sequence[Episode], **changes: Any) -> Path:
    """D4RL's layout as D4RL writes it: no observation after the last action of an episode.

    Args:
        path: to write.
        episodes: one after the other.
        changes: arrays in place of these; None leaves one out.
    """
    arrays: dict[str, Any] = {
        "observations": np.concatenate([e.observations[:-1] for e in episodes]),
        "actions": np.concatenate([e.actions for e in episodes]),
        "rewards": np.concatenate([e.rewards for e in episodes]),
        "terminals": np.concatenate([e.terminated for e in episodes]),
        "timeouts": np.concatenate([np.arange(e.length) == e.length - 1 for e in episodes]),
    } | changes
    with h5py.File(path, "w") as file:
        for key, array in arrays.items():
            if array is not None:
                file[key] = array
    return path


def following(episodes: Sequence[Episode]) -> np.ndarray:
    """``next_observations`` of `write_flat`."""
    return np.concatenate([e.observations[1:] for e in episodes])


def write_roboset(path: Path, episodes: Sequence[Episode]) -> Path:
    with h5py.File(path, "w") as file:
        for i, episode in enumerate(episodes):
            for key in ("observations", "actions", "rewards"):
                file[f"Trial{i}/{key}"] = getattr(episode, key)
    return path


def write_robomimic(path: Path, episodes: Sequence[Episode], *, next_obs: bool = True) -> Path:
    """Two arrays that make the observation, joint (first) and tip, and a picture."""
    with h5py.File(path, "w") as file:
        for i, episode in enumerate(episodes):
            demo = file.create_group(f"data/demo_{i}")
            demo["actions"], demo["rewards"] = episode.actions, episode.rewards
            demo["dones"] = np.ones(episode.length, dtype=np.int64)
            demo["states"] = np.arange(episode.length * 4.0).reshape(-1, 4) + i
            sides = {"obs": episode.observations[:-1], "next_obs": episode.observations[1:]}
            for key, rows in sides.items() if next_obs else [("obs", sides["obs"])]:
                demo[f"{key}/tip"], demo[f"{key}/joint"] = rows[:, 2:], rows[:, :2]
                demo[f"{key}/front_image"] = np.zeros((episode.length, 4, 4, 3), np.uint8)
    return path


ROBOMIMIC_SCHEMA = DemoSchema(
    describes="the toy", observation_size=3, action_size=2, observation_keys=("tip", "joint")
)


def write_npz(path: Path, episodes: Sequence[Episode], **changes: Any) -> Path:
    arrays: dict[str, Any] = {
        key: np.concatenate([getattr(e, key) for e in episodes])
        for key in ("observations", "actions", "rewards", "terminated", "success", "progress")
    }
    arrays["episode_ends"] = np.cumsum([e.length for e in episodes])
    np.savez_compressed(path, **(arrays | changes))
    return path


def write_lerobot(
    path: Path, files: Sequence[Sequence[Episode]], *, success: bool = True, **changes: Any
) -> Path:
    """Version 3: several episodes in each of several files."""
    import pyarrow
    import pyarrow.parquet

    features = {
        "observation.state": {"dtype": "float32", "shape": [3]},
        "observation.images.front": {"dtype": "video", "shape": [4, 4, 3]},
        "action": {"dtype": "float32", "shape": [2]},
        "next.reward": {"dtype": "float32", "shape": [1]},
        "next.done": {"dtype": "bool", "shape": [1]},
        **({"next.success": {"dtype": "bool", "shape": [1]}} if success else {}),
        **{key: {"dtype": "int64", "shape": [1]} for key in ("episode_index", "frame_index")},
    }
    (path / "meta").mkdir(parents=True)
    (path / "meta" / "info.json").write_text(
        json.dumps({"codebase_version": "v3.0", "features": features})
    )
    number = 0
    for i, episodes in enumerate(files):
        rows: dict[str, Any] = {key: [] for key in features if "images" not in key}
        for episode in episodes:
            rows["observation.state"] += list(episode.observations[:-1])
            rows["action"] += list(episode.actions)
            rows["next.reward"] += list(episode.rewards)
            rows["next.done"] += list(np.arange(episode.length) == episode.length - 1)
            if success:
                rows["next.success"] += list(episode.success[1:])
            rows["episode_index"] += [number] * episode.length
            rows["frame_index"] += list(range(episode.length))
            number += 1
        file = path / "data" / "chunk-000" / f"file-{i:03d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        pyarrow.parquet.write_table(pyarrow.table(rows | changes), file)
    return path


def write_minari(
    dataset: str, episodes: Sequence[Episode], observations: Sequence[Any], space: Any
) -> None:
    """A dataset by minari itself, with any structure of observations."""
    import gymnasium
    import minari

    buffers = [
        minari.data_collector.EpisodeBuffer(
            observations=observed,
            actions=episode.actions,
            rewards=episode.rewards,
            terminations=episode.terminated,
            truncations=np.arange(episode.length) == episode.length - 1,
            infos={
                "success": episode.success,
                "seat": {"height": np.tile([7.0], (episode.length + 1, 1))},
            },
        )
        for episode, observed in zip(episodes, observations, strict=True)
    ]
    minari.create_dataset_from_buffers(
        dataset,
        buffer=buffers,
        observation_space=space,
        action_space=gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32),
        author="tests", author_email="tests@example.org", code_permalink="none",
        algorithm_name="none", description="synthetic",
    )  # fmt: skip
