"""``make record``: a demonstration set out of a trained policy (the paper's ILD procedure)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from envs.demonstrations import Episode, Provenance, write_recording
from pipeline.episodes import FinishedEpisode
from pipeline.harvest import AdmissionRule
from pipeline.policy import load_policy
from pipeline.rollouts import MAX_BATCH, rollout_episodes
from pipeline.run_dir import load_config, versions


def record_demonstrations(
    run_dir: Path, out: Path, *, episodes: int, attempts: int, seed: int
) -> dict[str, Any]:
    """Rolls the run's policy out (mean action) and writes its first ``episodes`` good episodes.

    An episode is good if it passes the run's ``growth.admission``.

    Args:
        run_dir: The run whose policy acts.
        out: HDF5 file to write.
        episodes: How many to keep.
        attempts: How many doors to try at most.
        seed: Of the list of doors.

    Returns:
        The card that is written into the file: how it was made, from what, and statistics.

    Raises:
        ValueError: If the task is not the door or fewer than ``episodes`` attempts were good.
    """
    config = load_config(run_dir)
    if config.env.name != "door":
        raise ValueError(f"{run_dir}: only door runs can be recorded, this is {config.env.name!r}.")
    policy, origin = load_policy(config, run_dir)
    rule = AdmissionRule(config.growth.admission.min_angle, config.growth.admission.min_return)
    good: list[FinishedEpisode] = []
    tried = 0
    while len(good) < episodes and tried < attempts:
        wave = min(MAX_BATCH, attempts - tried)
        rollouts = rollout_episodes(
            policy,
            env_name=config.env.name,
            episodes=wave,
            seed=seed + tried,
            horizon=config.env.horizon,
            num_threads=config.env.num_threads,
            device=config.device,
        )
        good += [episode for episode in rollouts if rule.admits(episode)]
        tried += wave
    if len(good) < episodes:
        raise ValueError(
            f"{run_dir}: only {len(good)} of {tried} episodes passed growth.admission, {episodes} "
            "are wanted; train longer, raise attempts or ask for fewer."
        )
    kept = good[:episodes]
    card = {
        "made_by": f"make record RUN={run_dir.name} (seed {seed})",
        "policy": {
            "variant": config.variant,
            "preset": config.preset,
            "seed": config.seed,
            "checkpoint": origin.name,
            "trained_on": Path(config.demos.source).name,
            "multiplied": config.demos.multiply.enabled,
        },
        "action": "mean",
        "attempts": tried,
        "admitted": len(good),
        "kept": len(kept),
        "return_mean": float(np.mean([e.episode_return for e in kept])),
        "max_angle_mean_rad": float(np.mean([e.max_angle for e in kept])),
        "versions": versions(),
    }
    write_recording(out, _as_episodes(kept, run_dir.name, origin.name), card)
    return card


def _as_episodes(finished: Sequence[FinishedEpisode], run: str, checkpoint: str) -> list[Episode]:
    episodes = []
    for i, episode in enumerate(finished):
        steps = episode.trajectory
        observations = torch.cat([steps["observation"], steps["next", "observation"][-1:]])
        episodes.append(
            Episode(
                observations=observations.cpu().numpy(),
                actions=steps["action"].cpu().numpy(),
                rewards=steps["next", "reward"].squeeze(-1).cpu().numpy(),
                terminated=steps["next", "terminated"].squeeze(-1).cpu().numpy(),
                provenance=Provenance(run, i, "policy", {"checkpoint": checkpoint}),
                door_position=steps["door_position"][0].double().cpu().numpy(),
                initial_qpos=np.zeros(30),
                initial_qvel=np.zeros(30),
            )
        )
    return episodes
