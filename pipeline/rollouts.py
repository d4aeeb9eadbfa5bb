"""Whole episodes of a policy; those of another model become demonstrations (ILD; III-E.1)."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from envs import make_env
from pipeline.episodes import EpisodeAssembler, FinishedEpisode
from pipeline.evaluation import door_starts
from pipeline.harvest import Harvest
from pipeline.threads import one_torch_thread

MAX_BATCH = 250  # episodes at a time
UNTIL_DONE = 10**6  # steps: more than any task's time limit


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
    """Runs the policy's mean action for ``episodes`` whole episodes, one per environment copy.

    The doors are those of the list with this ``seed`` (see ``envs.door.starts``); the trajectories
    carry their ``door_position``.
    """
    batch = min(episodes, MAX_BATCH)
    finished: list[FinishedEpisode] = []
    with (
        torch.no_grad(),
        one_torch_thread(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
    ):
        while len(finished) < episodes:
            env = make_env(
                env_name,
                num_envs=batch,
                seed=seed + len(finished),
                device=device,
                num_threads=num_threads,
                horizon=horizon,
            )
            steps = env.rollout(
                UNTIL_DONE,
                policy,
                auto_reset=False,
                tensordict=env.reset(door_starts(env, seed, len(finished))),
                break_when_any_done=False,
                break_when_all_done=True,
            )
            env.close()
            # Copies that finish early are not stepped on, but keep repeating their last row.
            finished += [EpisodeAssembler()(copy.unsqueeze(0))[0] for copy in steps]
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
            f"None of {rollout['episodes']} episodes of the BC model passed growth.admission; "
            "lower its bounds, raise growth.bc_model_episodes or train the BC model longer "
            "(bc.updates)."
        )
    return admitted
