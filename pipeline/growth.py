"""Demonstrations that grow, composed from the configuration: SID and ILD (paper, section III-E)."""

from __future__ import annotations

from torchrl.trainers import Trainer

from configs.schema import Config
from pipeline.buffers import DemonstrationDistribution, GrownDemonstrations, make_core_buffer
from pipeline.cloning import behaviour_cloned
from pipeline.components import Demonstrations
from pipeline.harvest import AdmissionRule, Harvest, MovingBound
from pipeline.hooks import GrownHook
from pipeline.rollouts import admit_rollouts
from pipeline.rows import TransitionRows
from pipeline.time_use import TimeUse


def require_growth(config: Config) -> None:
    """Refuses options that nothing would read."""
    growth = config.growth
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
    config: Config,
    demos: Demonstrations | None,
    to_rows: TransitionRows,
    time_use: TimeUse,
) -> tuple[GrownDemonstrations | None, DemonstrationDistribution | None]:
    """The part of D that grows, and D; with ILD, a BC model's episodes have joined already.

    Both are None without demonstrations; the first also where nothing may join D.
    """
    if demos is None:
        return None, None
    core = make_core_buffer(demos.rows, config.device)
    growth = config.growth
    if not growth.self_imitation and not growth.bc_model:
        return None, DemonstrationDistribution(core)
    grown = GrownDemonstrations(growth.capacity, config.device)
    if growth.bc_model:
        harvest = Harvest(grown, _admission(config), to_rows, source="bc_model")
        admit_rollouts(
            behaviour_cloned(config, demos, time_use),
            harvest,
            env_name=config.env.name,
            episodes=growth.bc_model_episodes,
            seed=config.seed,
            horizon=config.env.horizon,
            num_threads=config.env.num_threads,
            device=config.device,
        )
    return grown, DemonstrationDistribution(core, grown, growth.share)


def register_growth(
    config: Config,
    grown: GrownDemonstrations | None,
    to_rows: TransitionRows,
    trainer: Trainer,
) -> list[Harvest]:
    """Has ``trainer`` log and checkpoint what grows; returns what training episodes are offered to.

    That is one harvest with self-imitation (SID), and none without.
    """
    if grown is None:
        return []
    bound = _moving_bound(config)
    GrownHook(grown, bound).register(trainer)
    if not config.growth.self_imitation:
        return []
    return [Harvest(grown, _admission(config), to_rows, "policy", bound)]


def _admission(config: Config) -> AdmissionRule:
    return AdmissionRule(config.growth.admission.min_angle, config.growth.admission.min_return)


def _moving_bound(config: Config) -> MovingBound | None:
    admission = config.growth.admission
    if admission.quantile is None:
        return None
    return MovingBound(admission.quantile, admission.window)
