"""What the batches of a run are drawn from: its own experience, D, and what D grows by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import TensorDictReplayBuffer

from envs import Task
from envs.steps import counted_steps
from pipeline.conversion import make_episode_rows, make_rows
from pipeline.data.buffers import DemonstrationDistribution, GrownDemonstrations, make_buffer
from pipeline.data.demonstrations import Demonstrations
from pipeline.data.mixture import DRAWS, BatchPart, Mixture
from pipeline.data.own_sources import OwnSource, SourceContext, own_sources
from pipeline.data.rows import ROW_KEYS, TransitionRows
from pipeline.files.time_use import TimeUse
from pipeline.growth import demonstration_distribution
from pipeline.recipe import Recipe
from pipeline.updates import (
    frames_before_learning,
    frames_of_run,
    portion_frames,
    updates_per_portion,
)

ROW_LIMIT = 1_000_000
"""The main buffer holds the whole run up to this many frames, or ``sampler.capacity``."""


@dataclass(frozen=True)
class Sources:
    """The buffers of a run.

    Attributes:
        main: of the run's own experience.
        grown: the part of D that grows; None where nothing may join it.
        demos: D; None without demonstrations.
        own: those of the user's own files, by name.
        mixture: draws the batches of all.
        to_rows: how experience becomes rows.
        episode_rows: how whole episodes do.
        simulator_steps: that filling them has taken.
    """

    main: TensorDictReplayBuffer
    grown: GrownDemonstrations | None
    demos: DemonstrationDistribution | None
    own: Mapping[str, OwnSource]
    mixture: Mixture
    to_rows: TransitionRows
    episode_rows: TransitionRows
    simulator_steps: int


def make_main(recipe: Recipe, demos: Demonstrations | None) -> TensorDictReplayBuffer:
    """The buffer of the run's own experience; what is preloaded is in it.

    Raises:
        ValueError: If a size in the configuration cannot be.
    """
    preloaded = _preloaded(recipe, demos)
    main = make_buffer(_capacity(recipe) + len(preloaded), recipe.device)
    if len(preloaded):
        main.extend(preloaded)
    return main


def make_own_sources(
    recipe: Recipe, main: TensorDictReplayBuffer, demos: Demonstrations | None
) -> dict[str, OwnSource]:
    """The sources of the user's own files; usually none.

    Raises:
        ValueError: If one cannot be made.
    """
    keys = make_rows(recipe).keys
    context = SourceContext(main, demos, keys, torch.device(recipe.device))
    return own_sources(recipe.sampler.own_sources, context)


def reinforced_rows(recipe: Recipe, own: Mapping[str, OwnSource]) -> int:
    """Rows of a batch that are no demonstrations, which come first in it."""
    return recipe.sampler.batch_size + sum(one.rows for one in own.values() if not one.is_demo)


def make_sources(
    recipe: Recipe,
    task: Task,
    demos: Demonstrations | None,
    main: TensorDictReplayBuffer,
    own: Mapping[str, OwnSource],
    time_use: TimeUse,
) -> Sources:
    """The buffers and their mixture; with ILD, a BC model's episodes are in D.

    A batch has rows of ``main``, of sources of one's own that are no demonstrations, of D, and of
    sources of one's own that are.

    Raises:
        ValueError: If a share in the configuration cannot be.
    """
    to_rows = make_rows(recipe)
    episode_rows = make_episode_rows(recipe)
    with counted_steps() as rolled_out:
        grown, distribution = demonstration_distribution(
            recipe, task, demos, episode_rows, time_use
        )
    mixture = Mixture(
        {
            "main": BatchPart(main, recipe.sampler.batch_size),
            "demos": BatchPart(distribution, _demo_rows(recipe), is_demo=True),
            **{name: BatchPart(one, one.rows, one.is_demo) for name, one in own.items()},
        },
        draws=min(updates_per_portion(recipe), DRAWS),
        device=recipe.device,
    )
    return Sources(main, grown, distribution, own, mixture, to_rows, episode_rows, rolled_out.taken)


def _preloaded(recipe: Recipe, demos: Demonstrations | None) -> TensorDictBase:
    """Rows of the demonstrations for the main buffer, which holds as many more; often none."""
    if demos is None or not recipe.sampler.preload:
        return TensorDict({}, [0])
    return demos.rows.select(*ROW_KEYS)


def _demo_rows(recipe: Recipe) -> int:
    """Rows of a batch that are drawn from the demonstrations.

    Raises:
        ValueError: If a share is asked for that is less than half a row.
    """
    ratio, rows = recipe.sampler.demo_ratio, recipe.sampler.batch_size
    demo_rows = round(ratio * rows)
    if ratio > 0 and rows > 0 and demo_rows == 0:
        raise ValueError(
            f"sampler.demo_ratio ({ratio}) of sampler.batch_size ({rows}) is less than a row, so "
            f"nothing would be imitated: set it to at least {1 / rows:.2g}, or to 0."
        )
    return demo_rows


def _capacity(recipe: Recipe) -> int:
    """Rows of the main buffer.

    Raises:
        ValueError: If it cannot hold what is stored at once, or if nothing could be stored before
            the first update.
    """
    copies, n_step = recipe.env.num_envs, recipe.loss.n_step
    steps = frames_before_learning(recipe) // copies
    if steps < min(n_step, recipe.env.horizon or n_step):
        raise ValueError(
            f"loss.n_step ({n_step}) needs as many steps of each environment before the first "
            f"update, which comes after {steps}: set collector.random_frames or "
            f"collector.frames_per_batch to at least {n_step * copies}."
        )
    # With a portion come rows that waited for it.
    at_once = portion_frames(recipe) + copies * (n_step - 1)
    capacity = recipe.sampler.capacity
    if capacity is None:
        return max(min(frames_of_run(recipe), ROW_LIMIT), at_once)
    if capacity < at_once:
        raise ValueError(
            f"sampler.capacity ({capacity}) must hold at least one collected batch and the rows "
            f"that wait for it, {at_once}: collector.frames_per_batch is "
            f"{recipe.collector.frames_per_batch}, loss.n_step {n_step}."
        )
    return capacity
