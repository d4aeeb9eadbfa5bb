"""Demonstrations from another model's rollouts (ILD; paper, section III-E.1)."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from envs import make_env
from pipeline.episodes import EpisodeAssembler, FinishedEpisode
from pipeline.harvest import Harvest

MAX_BATCH = 250


def rollout_episodes(
    policy: TensorDictModuleBase,
    *,
    env_name: str,
    episodes: int,
    seed: int,
    horizon: int | None = None,
    num_threads: int | None = None,
    device: str = "cpu",
) -> list[FinishedEpisode]:
    """Runs the policy's mean action for ``episodes`` whole episodes, one per environment copy."""
    batch = min(episodes, MAX_BATCH)
    finished: list[FinishedEpisode] = []
    wave = 0
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        while len(finished) < episodes:
            env = make_env(
                env_name,
                num_envs=batch,
                seed=seed + wave,
                device=device,
                num_threads=num_threads,
                horizon=horizon,
            )
            steps = env.rollout(
                10**6, policy, break_when_any_done=False, break_when_all_done=True
            )
            env.close()
            wave_episodes: dict[int, FinishedEpisode] = {}
            for i, row in enumerate(steps):
                wave_episodes[i] = EpisodeAssembler()(row.unsqueeze(0))[0]
            finished.extend(wave_episodes.values())
            wave += 1
    return finished[:episodes]


def admit_rollouts(policy: TensorDictModuleBase, harvest: Harvest, **rollout: object) -> int:
    """Offers rolled-out episodes to ``harvest``; returns how many it admitted.

    Raises:
        ValueError: If none was good enough.
    """
    for episode in rollout_episodes(policy, **rollout):  # type: ignore[arg-type]
        harvest(episode, 0)
    admitted = len(harvest.grown.records)
    if admitted == 0:
        raise ValueError(
            f"None of {rollout['episodes']} episodes of the BC model passed growth.admission; lower "
            "its bounds, raise growth.bc_model_episodes or train the BC model longer (bc.updates)."
        )
    return admitted
