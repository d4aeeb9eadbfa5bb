"""How the trajectories of a run become rows: one conversion that all its buffers share."""

from __future__ import annotations

from envs.task import PROGRESS
from pipeline.data.emphasis import ProgressEmphasis
from pipeline.data.progress_bonus import ProgressBonus
from pipeline.data.rows import TransitionRows
from pipeline.recipe import Recipe


def make_episode_rows(recipe: Recipe) -> TransitionRows:
    """The conversion of whole episodes, which tell what terms need of their ends.

    Raises:
        ValueError: As :func:`make_rows`.
    """
    return make_rows(recipe, to_end=recipe.loss.self_imitation.weight > 0.0)


def make_rows(recipe: Recipe, *, to_end: bool = False) -> TransitionRows:
    """The conversion from trajectories to rows that all buffers share.

    Args:
        recipe: Of the run.
        to_end: Whether rows hold the way to the end of their episode.

    Raises:
        ValueError: If ``loss.progress_bonus`` is negative, or rows do not look as many steps ahead
            as there are actions in a chunk.
    """
    loss, chunk = recipe.loss, recipe.actor.chunk
    if chunk > 1 and loss.n_step != chunk:
        raise ValueError(
            f"actor.chunk={chunk} gives so many actions at once, whose rewards a row adds up: set "
            f"loss.n_step={chunk} too, it is {loss.n_step}."
        )
    bonus = ProgressBonus(loss.progress_bonus, loss.progress_bonus_cap)
    return TransitionRows(
        loss.gamma,
        loss.n_step,
        loss.reward_factor,
        bonus if loss.progress_bonus else None,
        columns=() if make_emphasis(recipe) is None else (PROGRESS,),
        to_end=to_end,
        chunk=chunk,
    )


def make_emphasis(recipe: Recipe) -> ProgressEmphasis | None:
    """What weighs the demonstrated steps in the actor's objective; None if all count alike.

    Raises:
        ValueError: If a factor is out of range.
    """
    emphasis = recipe.loss.bc_emphasis
    if emphasis.before == emphasis.beyond == 1.0:
        return None
    return ProgressEmphasis(emphasis.before, emphasis.beyond, emphasis.progress)
