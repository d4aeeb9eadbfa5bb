"""Whole episodes of a policy; those of another model become demonstrations (ILD; III-E.1)."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from envs import EnvOptions, Task
from envs.steps import count_steps
from pipeline.act.evaluation import reset_td
from pipeline.data.admission import EpisodeAdmission
from pipeline.data.episodes import EpisodeAssembler, FinishedEpisode
from pipeline.machine.threads import one_torch_thread

MAX_BATCH = 250  # episodes at a time
UNTIL_DONE = 10**6  # steps: more than any task's time limit


def rollout_waves(
    make_policy: Callable[[], TensorDictModuleBase],
    *,
    task: Task,
    episodes: int,
    seed: int,
    env_options: EnvOptions | None = None,
) -> Generator[list[FinishedEpisode], None, None]:
    """Plays the mean action, as many whole episodes at once as there are copies, until closed.

    The copies are made once, with the first wave. The episodes are those of the task's list with
    this ``seed``, where it has one, in its order; the trajectories carry their starts.

    Args:
        make_policy: Makes what acts in one wave: ``observation [N, O]`` to ``action [N, A]``.
        task: Whose episodes.
        episodes: How many in all; the last wave is cut there.
        seed: Of the list.
        env_options: How the copies are made; their number and seed are set here.
    """
    copies = task.copies(min(episodes, MAX_BATCH))
    env = task.make_env(replace(env_options or EnvOptions(), num_envs=copies, seed=seed))
    try:
        for first in range(0, episodes, copies):
            env.set_seed(seed + first)
            with (
                torch.no_grad(),
                one_torch_thread(),
                set_exploration_type(ExplorationType.DETERMINISTIC),
            ):
                steps = env.rollout(
                    UNTIL_DONE,
                    make_policy(),
                    auto_reset=False,
                    tensordict=env.reset(reset_td(task, env, seed, first)),
                    break_when_any_done=False,
                    break_when_all_done=True,
                )
            # Copies that finish early are not stepped on, but keep repeating their last row.
            wave = [EpisodeAssembler()(copy.unsqueeze(0))[0] for copy in steps]
            count_steps(sum(episode.length for episode in wave))
            yield wave[: episodes - first]
    finally:
        env.close()


def rollout_episodes(policy: TensorDictModuleBase, **rollout: Any) -> list[FinishedEpisode]:
    """Plays all of them; see :func:`rollout_waves`."""
    return [episode for wave in rollout_waves(lambda: policy, **rollout) for episode in wave]


def admit_rollouts(
    policy: TensorDictModuleBase, admission: EpisodeAdmission, **rollout: Any
) -> int:
    """Offers rolled-out episodes to ``admission``; returns how many it admitted.

    Raises:
        ValueError: If none was good enough.
    """
    for episode in rollout_episodes(policy, **rollout):
        admission(episode, 0)
    admitted = len(admission.grown.records)
    if admitted == 0:
        raise ValueError(
            f"None of {rollout['episodes']} episodes of the BC model passed growth.admission; "
            "lower its bounds, raise growth.bc_model_episodes or train the BC model longer "
            "(bc.updates)."
        )
    return admitted
