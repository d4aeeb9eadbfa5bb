"""Demonstrations that grow, composed from the configuration: SID and ILD (paper, section III-E)."""

from __future__ import annotations

from torchrl.trainers import Trainer

from envs import Task
from pipeline.act.policy_wrappers import acting_policy
from pipeline.act.rollouts import admit_rollouts
from pipeline.cloning import behaviour_cloned
from pipeline.data.admission import AdmissionRule, EpisodeAdmission, MovingBound
from pipeline.data.buffers import DemonstrationDistribution, GrownDemonstrations, make_core_buffer
from pipeline.data.demonstrations import Demonstrations
from pipeline.data.rows import TransitionRows
from pipeline.files.time_use import TimeUse
from pipeline.hooks import GrownHook
from pipeline.recipe import Recipe


def require_growth(recipe: Recipe) -> None:
    """Refuses options that nothing would read."""
    growth = recipe.growth
    if growth.admission.quantile is not None and not growth.self_imitation:
        raise ValueError(
            "growth.admission.quantile judges training episodes, which join the demonstrations "
            "only with growth.self_imitation=true: set that, or the quantile to null."
        )
    if growth.share is not None and not growth.self_imitation and not growth.bc_model:
        raise ValueError(
            "growth.share is for demonstrations that grow: set growth.self_imitation=true or "
            "growth.bc_model=true, or the share to null."
        )


def demonstration_distribution(
    recipe: Recipe,
    task: Task,
    demos: Demonstrations | None,
    to_rows: TransitionRows,
    time_use: TimeUse,
) -> tuple[GrownDemonstrations | None, DemonstrationDistribution | None]:
    """The part of D that grows, and D; with ILD, a BC model's episodes have joined already.

    Both are None without demonstrations; the first also where nothing may join D.
    """
    if demos is None:
        return None, None
    core = make_core_buffer(demos.rows, recipe.device)
    growth = recipe.growth
    if not growth.self_imitation and not growth.bc_model:
        return None, DemonstrationDistribution(core)
    grown = GrownDemonstrations(growth.capacity, recipe.device)
    if growth.bc_model:
        admission = EpisodeAdmission(grown, admission_rule(recipe), to_rows, source="bc_model")
        admit_rollouts(
            acting_policy(behaviour_cloned(recipe, task, demos, time_use), recipe.actor.chunk),
            admission,
            task=task,
            episodes=growth.bc_model_episodes,
            seed=recipe.seed,
            env_options=recipe.env_options(),
        )
    return grown, DemonstrationDistribution(core, grown, growth.share)


def register_growth(
    recipe: Recipe,
    grown: GrownDemonstrations | None,
    to_rows: TransitionRows,
    trainer: Trainer,
) -> list[EpisodeAdmission]:
    """Has ``trainer`` log and checkpoint what grows; returns what training episodes are offered to.

    That is one admission with self-imitation (SID), and none without.
    """
    if grown is None:
        return []
    bound = _moving_bound(recipe)
    GrownHook(grown, bound).register(trainer)
    if not recipe.growth.self_imitation:
        return []
    return [EpisodeAdmission(grown, admission_rule(recipe), to_rows, "policy", bound)]


def admission_rule(recipe: Recipe) -> AdmissionRule:
    """Which episodes are good, as the configuration says."""
    admission = recipe.growth.admission
    return AdmissionRule(
        admission.success, admission.min_progress, admission.min_return, admission.at_end
    )


def _moving_bound(recipe: Recipe) -> MovingBound | None:
    admission = recipe.growth.admission
    if admission.quantile is None:
        return None
    return MovingBound(admission.quantile, admission.window)
