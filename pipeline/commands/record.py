"""``make record``: a demonstration set out of a policy (the paper's ILD procedure)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from envs.demonstrations import Episode, Provenance, find_writer, write_demonstrations
from envs.task import PROGRESS, SUCCESS
from pipeline.act.rollouts import rollout_waves
from pipeline.commands.demonstrator import Demonstrator
from pipeline.data.episodes import FinishedEpisode
from pipeline.files.run_files import versions


def record_demonstrations(
    demonstrator: Demonstrator, out: str | Path, *, episodes: int, attempts: int, seed: int
) -> dict[str, Any]:
    """Rolls a policy out and writes its first ``episodes`` good episodes.

    Args:
        demonstrator: Who acts where, and what is good.
        out: See `envs.demonstrations.write_demonstrations`.
        episodes: How many to keep.
        attempts: How many episodes to try at most.
        seed: Of the list of episodes.

    Returns:
        The card that is written into the file: how it was made, from what, and statistics.

    Raises:
        ValueError: If fewer than ``episodes`` attempts were good.
        DemonstrationError: If ``out`` names no format.
    """
    find_writer(out)  # now, not after minutes of episodes
    task, recipe = demonstrator.task, demonstrator.recipe
    good: list[FinishedEpisode] = []
    tried = 0
    waves = rollout_waves(
        demonstrator.policy,
        task=task,
        episodes=attempts,
        seed=seed,
        env_options=recipe.env_options(),
    )
    with closing(waves):
        for wave in waves:
            good += [episode for episode in wave if demonstrator.admits(episode)]
            tried += len(wave)
            if len(good) >= episodes:
                break
    if len(good) < episodes:
        raise ValueError(
            f"{demonstrator.name}: only {len(good)} of {tried} episodes passed "
            f"{demonstrator.admission}, {episodes} are wanted; train longer, raise attempts or ask "
            "for fewer."
        )
    kept = good[:episodes]
    card = {
        "made_by": f"{demonstrator.made_by} (seed {seed})",
        "policy": demonstrator.card,
        "action": "mean",
        "admission": demonstrator.admission,
        "attempts": tried,
        "admitted": len(good),
        "kept": len(kept),
        "return_mean": float(np.mean([e.episode_return for e in kept])),
        "task": task.name,
        "max_progress_mean": _mean_progress(kept),
        "versions": versions(),
    }
    write_demonstrations(out, _as_episodes(kept, demonstrator), card, schema=task.demos)
    return card


def _mean_progress(kept: Sequence[FinishedEpisode]) -> float | None:
    # JSON knows no NaN, which is what episodes of a task without progress have.
    mean = float(np.mean([e.max_progress for e in kept]))
    return None if math.isnan(mean) else mean


def _as_episodes(finished: Sequence[FinishedEpisode], demonstrator: Demonstrator) -> list[Episode]:
    episodes = []
    demos = demonstrator.task.demos
    keys = () if demos is None else demos.start
    by: dict[str, str] = {
        key: demonstrator.card[key]
        for key in ("checkpoint", "controller")
        if key in demonstrator.card
    }
    for i, episode in enumerate(finished):
        steps = episode.trajectory
        observations = torch.cat([steps["observation"], steps["next", "observation"][-1:]])
        episodes.append(
            Episode(
                observations=observations.cpu().numpy(),
                actions=steps["action"].cpu().numpy(),
                rewards=steps["next", "reward"].squeeze(-1).cpu().numpy(),
                terminated=steps["next", "terminated"].squeeze(-1).cpu().numpy(),
                provenance=Provenance(demonstrator.name, i, "policy", by),
                start={
                    # A seed is a bare number in an environment.
                    key.name: steps[key.name][0].double().cpu().numpy().reshape(key.size)
                    for key in keys
                    if key.name in steps.keys()  # noqa: SIM118 - a TensorDict is not a mapping
                },
                success=_column(steps, SUCCESS),
                progress=_column(steps, PROGRESS),
            )
        )
    return episodes


def _column(steps: TensorDictBase, key: str) -> NDArray[Any] | None:
    """``success`` or ``progress`` [T + 1] of a trajectory, None where the task does not tell it."""
    if key not in steps.keys():  # noqa: SIM118 - a TensorDict is not a mapping
        return None
    column: NDArray[Any] = (
        torch.cat([steps[key], steps["next", key][-1:]]).squeeze(-1).cpu().numpy()
    )
    return column
