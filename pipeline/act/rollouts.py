"""Whole episodes of a policy; those of another model become demonstrations (ILD; III-E.1)."""

from __future__ import annotations

from dataclasses import replace

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from envs import EnvOptions, Task
from envs.steps import count_steps
from pipeline.act.evaluation import reset_td
from pipeline.data.episodes import EpisodeAssembler, FinishedEpisode
from pipeline.data.harvest import Harvest
from pipeline.machine.threads import one_torch_thread

MAX_BATCH = 250  # episodes at a time
UNTIL_DONE = 10**6  # steps: more than any task's time limit


def rollout_episodes(
    policy: TensorDictModuleBase,
    *,
    task: Task,
    episodes: int,
    seed: int,
    env_options: EnvOptions | None = None,
) -> list[FinishedEpisode]:
    """Runs the policy's mean action for ``episodes`` whole episodes, one per environment copy.

    The episodes are those of the task's list with this ``seed``, where it has one; the trajectories
    carry their starts.

    Args:
        policy: Maps ``observation [N, O]`` to ``action [N, A]`` of N copies.
        task: Whose episodes.
        episodes: How many.
        seed: Of the list.
        env_options: How the copies are made; their number and seed are set here.
    """
    options = replace(
        env_options or EnvOptions(), num_envs=task.copies(min(episodes, MAX_BATCH)), seed=seed
    )
    finished: list[FinishedEpisode] = []
    with (
        torch.no_grad(),
        one_torch_thread(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
    ):
        env = task.make_env(options)
        while len(finished) < episodes:
            env.set_seed(seed + len(finished))
            steps = env.rollout(
                UNTIL_DONE,
                policy,
                auto_reset=False,
                tensordict=env.reset(reset_td(task, env, seed, len(finished))),
                break_when_any_done=False,
                break_when_all_done=True,
            )
            # Copies that finish early are not stepped on, but keep repeating their last row.
            wave = [EpisodeAssembler()(copy.unsqueeze(0))[0] for copy in steps]
            count_steps(sum(episode.length for episode in wave))
            finished += wave
        env.close()
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
