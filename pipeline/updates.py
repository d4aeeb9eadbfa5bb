"""How many updates a run makes: one count for every schedule, average and choice that needs it."""

from __future__ import annotations

from pipeline.recipe import Recipe

CLONING_PORTION = 100
"""Updates of behaviour cloning between two looks of the trainer at its hooks."""


def portion_frames(recipe: Recipe) -> int:
    """Frames of one collected portion: every environment makes as many steps as the others.

    Raises:
        ValueError: If there are no environments.
    """
    environments = recipe.env.num_envs
    if environments < 1:
        raise ValueError(f"env.num_envs must be at least 1, got {environments}.")
    return -(-recipe.collector.frames_per_batch // environments) * environments


def updates_per_portion(recipe: Recipe) -> int:
    """Updates after each collected portion: as many for each frame as were asked for.

    Where the copies make a portion larger than ``collector.frames_per_batch``, it is the nearest
    whole number.

    Raises:
        ValueError: If it is no whole number of at least 1 for a portion as large as was asked for.
    """
    updates = recipe.optim.updates_per_frame * recipe.collector.frames_per_batch
    if updates < 1 or abs(updates - round(updates)) > 1e-9:
        raise ValueError(
            f"optim.updates_per_frame ({recipe.optim.updates_per_frame}) times "
            f"collector.frames_per_batch ({recipe.collector.frames_per_batch}) must be a whole "
            f"number of at least 1, got {updates}."
        )
    return round(recipe.optim.updates_per_frame * portion_frames(recipe))


def frames_of_run(recipe: Recipe) -> int:
    """Frames that the whole run collects: ``collector.total_frames`` in whole portions."""
    frames = portion_frames(recipe)
    return _portions(recipe.collector.total_frames, frames) * frames


def frames_before_learning(recipe: Recipe) -> int:
    """Frames that are collected before the first update."""
    frames = portion_frames(recipe)
    return _portions(recipe.collector.random_frames, frames) * frames


def main_updates(recipe: Recipe) -> int:
    """Updates of the whole run without DA-SAC's extra ones, as TorchRL's trainer makes them.

    It collects whole portions until it has ``total_frames``, and learns after each portion with
    which the ``random_frames`` are complete.
    """
    if recipe.offline:
        return _portions(recipe.bc.updates, CLONING_PORTION) * CLONING_PORTION
    updates, frames = updates_per_portion(recipe), portion_frames(recipe)
    first = frames_before_learning(recipe) // frames
    learning = frames_of_run(recipe) // frames - first + 1
    return max(learning, 0) * updates


def critic_updates(recipe: Recipe) -> int:
    """All updates of the whole run."""
    updates = main_updates(recipe)
    period = recipe.sampler.demo_update_period
    return updates if recipe.offline or not period else updates + updates // period


def actor_updates(recipe: Recipe) -> int:
    """Actor updates of the whole run: what annealing and schedules that last as long count."""
    if recipe.offline:
        return main_updates(recipe)
    after_delay = critic_updates(recipe) - recipe.optim.actor_delay
    return max(after_delay, 0) // recipe.optim.actor_period


def late_actor(recipe: Recipe) -> str | None:
    """A warning of a run that learns nothing, or whose critics warm up for half of it; or None.

    The policy of such a run is the clone that it began with, or hardly another.
    """
    delay, updates, learns = recipe.optim.actor_delay, critic_updates(recipe), actor_updates(recipe)
    if not updates:
        return (
            f"nothing is learned in this run: all of its {recipe.collector.total_frames} frames "
            f"are random actions (collector.random_frames={recipe.collector.random_frames}); "
            "collect more (collector.total_frames) or lower collector.random_frames"
        )
    if recipe.offline or 2 * delay < updates:
        return None
    remedy = f"set optim.actor_delay={updates // 3} or collect more frames (collector.total_frames)"
    if not learns:
        return (
            f"the policy will not change in this run: its actor starts after optim.actor_delay="
            f"{delay} updates and there are only {updates}; {remedy}"
        )
    return (
        f"the policy hardly changes in this run: its actor gets only {learns} of {updates} "
        f"updates, since it starts after optim.actor_delay={delay}; {remedy}"
    )


def _portions(total: int, size: int) -> int:
    """Portions until there are ``total``, and at least one: the trainer looks after a portion."""
    return max(-(-total // size), 1)
