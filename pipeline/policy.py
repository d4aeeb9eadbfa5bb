"""A trained policy out of a run directory."""

from __future__ import annotations

from pathlib import Path

from torchrl.modules import ProbabilisticActor

from configs.schema import Config
from pipeline import components
from pipeline.checkpoint import latest_checkpoint, load_component
from pipeline.compute import hidden_dtype
from pipeline.networks import ObservationNormalizer


def load_policy(config: Config, run_dir: Path) -> tuple[ProbabilisticActor, Path]:
    """The policy of the newest checkpoint of ``run_dir``.

    The demonstrations are not needed: normalisation statistics travel with the weights.

    Returns:
        The actor in evaluation mode and the checkpoint it came from.

    Raises:
        FileNotFoundError: If there is no checkpoint.
        ValueError: If the checkpoint is damaged or belongs to another architecture.
    """
    checkpoint = latest_checkpoint(run_dir)
    env = components.make_training_env(config)
    observation_size = env.observation_spec["observation"].shape[-1]
    normalizer = (
        ObservationNormalizer.identity(observation_size)
        if config.actor.normalise_observations
        else None
    )
    actor = components.make_policy(
        config.actor, env, normalizer, config.device, hidden_dtype(config)
    )
    env.close()
    load_component(checkpoint, "policy", actor)
    return actor.eval(), checkpoint
