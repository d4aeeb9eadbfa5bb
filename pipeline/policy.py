"""A trained policy: out of a run directory, or out of a file of weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_model, save_model
from torchrl.modules import ProbabilisticActor

from configs.schema import Config
from pipeline import components
from pipeline.checkpoint import latest_checkpoint, load_component, trained_frames
from pipeline.compute import hidden_dtype
from pipeline.networks import ObservationNormalizer

WEIGHTS = "policy.safetensors"
"""Weights alone, where a policy was exported; a run directory holds checkpoints instead."""


@dataclass(frozen=True)
class PolicyOrigin:
    """Where weights came from."""

    name: str
    """Of the checkpoint or file."""
    frames: int
    """Collected when they were saved."""


def load_policy(config: Config, run_dir: Path) -> tuple[ProbabilisticActor, PolicyOrigin]:
    """The policy of the newest checkpoint of ``run_dir``, or of the weights exported to it.

    The demonstrations are not needed: normalisation statistics travel with the weights.

    Returns:
        The actor in evaluation mode and where it came from.

    Raises:
        FileNotFoundError: If there are neither.
        ValueError: If they are damaged or belong to another architecture.
    """
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
    weights = run_dir / WEIGHTS
    if weights.is_file():
        return actor.eval(), PolicyOrigin(WEIGHTS, _load_weights(actor, weights))
    checkpoint = latest_checkpoint(run_dir)
    load_component(checkpoint, "policy", actor)
    frames = 0 if config.offline else trained_frames(checkpoint)
    return actor.eval(), PolicyOrigin(checkpoint.name, frames)


def save_weights(actor: ProbabilisticActor, path: Path, *, frames: int) -> None:
    """Writes the weights as safetensors, which hold tensors and nothing that runs."""
    save_model(actor, str(path), metadata={"frames": str(frames)})


def _load_weights(actor: ProbabilisticActor, path: Path) -> int:
    """Loads ``path`` into ``actor``; returns the frames that its file tells."""
    try:
        load_model(actor, str(path))
        with safe_open(str(path), framework="pt") as file:
            return int(file.metadata()["frames"])
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is damaged or does not fit the config.yaml beside it ({error}); export it "
            "again with: make results"
        ) from error
