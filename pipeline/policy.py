"""A trained policy: out of a run directory, or out of a file of weights."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_model, save_model
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.modules import ProbabilisticActor

from envs import Task
from envs.whole_files import whole_file
from pipeline.act.policy_wrappers import acting_policy
from pipeline.compute import hidden_dtype
from pipeline.files.checkpoint import (
    latest_checkpoint,
    load_component,
    require_finite,
    trained_frames,
)
from pipeline.files.run_format import require_plain
from pipeline.files.sums import DamagedError
from pipeline.learn.critics import make_critic
from pipeline.learn.networks import (
    ActorSettings,
    CriticSettings,
    ObservationNormalizer,
    make_policy,
)
from pipeline.recipe import Recipe

WEIGHTS = "policy.safetensors"
"""Weights alone, where a policy was exported; a run directory holds checkpoints instead."""
MADE = "made"
FRAMES = "frames"
DIGEST = "sha256"
_AGAIN = "export it again with: make results"


@dataclass(frozen=True)
class PolicyOrigin:
    """Where weights came from."""

    name: str
    """Of the checkpoint or file."""
    frames: int
    """Collected when they were saved."""


def load_policy(
    recipe: Recipe, task: Task, run_dir: Path
) -> tuple[TensorDictModuleBase, PolicyOrigin]:
    """The policy of the newest checkpoint of ``run_dir``, or of the weights exported to it.

    The demonstrations are not needed: normalisation statistics travel with the weights.

    Returns:
        The policy in evaluation mode and where it came from.

    Raises:
        FileNotFoundError: If there are neither.
        ValueError: If they are damaged or belong to another architecture.
    """
    env = task.make_env(recipe.env_options(workers=0))
    policy = _untrained(recipe, env)
    env.close(raise_if_closed=False)  # some start their copies with the first reset
    weights = run_dir / WEIGHTS
    if weights.is_file() or weights.is_symlink():
        require_plain(weights)
        return policy.eval(), PolicyOrigin(WEIGHTS, _load_weights(policy, weights))
    checkpoint = latest_checkpoint(run_dir)
    load_component(checkpoint, "policy", policy)
    frames = recipe.budget.frames(trained_frames(checkpoint))
    return policy.eval(), PolicyOrigin(checkpoint.name, frames)


def _untrained(recipe: Recipe, env: EnvBase) -> TensorDictModuleBase:
    """The policy that a run of ``recipe`` acts with, before anything was loaded into it."""
    device, dtype = recipe.device, hidden_dtype(recipe)
    observation_size = env.observation_spec["observation"].shape[-1]

    def normalizer(part: ActorSettings | CriticSettings) -> ObservationNormalizer | None:
        if not part.normalise_observations:
            return None
        return ObservationNormalizer.identity(observation_size)

    def actor() -> ProbabilisticActor:
        own = normalizer(recipe.actor)
        return make_policy(recipe.actor, env, own, device, dtype)

    if not recipe.proposal.acting:
        return acting_policy(actor(), recipe.actor.chunk)
    critic = make_critic(
        recipe.critic, env, normalizer(recipe.critic), device, dtype, recipe.actor.chunk
    )
    proposal = recipe.proposal.of(actor())
    return acting_policy(actor(), recipe.actor.chunk, proposal, critic)


def save_weights(actor: TensorDictModuleBase, path: Path, *, frames: int) -> None:
    """Writes the weights as safetensors, which hold tensors and nothing that runs."""
    made = {FRAMES: frames, DIGEST: _digest(actor, frames)}
    # One entry: safetensors writes several in an order that changes from process to process.
    metadata = {MADE: json.dumps(made)}
    with whole_file(path) as temporary:
        save_model(actor, str(temporary), metadata=metadata)
        _with_usual_mode(temporary)


def _with_usual_mode(path: Path) -> None:
    """Other files follow the umask; what safetensors writes its owner alone can read."""
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)


def _load_weights(actor: TensorDictModuleBase, path: Path) -> int:
    """Loads ``path`` into ``actor``; returns the frames that its file tells."""
    try:
        load_model(actor, str(path))
        with safe_open(str(path), framework="pt") as file:
            metadata = file.metadata()
        made = json.loads(metadata[MADE]) if MADE in metadata else metadata  # of files of before
        frames = int(made[FRAMES])
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is damaged or does not fit the config.yaml beside it ({error}); {_AGAIN}"
        ) from error
    require_finite(actor, path)
    # The oldest have none.
    if made.get(DIGEST, digest := _digest(actor, frames)) != digest:
        raise DamagedError(f"{path}: is not as it was written (another checksum); {_AGAIN}")
    return frames


def _digest(actor: TensorDictModuleBase, frames: int) -> str:
    """SHA-256 (hex) over all that a file of weights says."""
    digest = hashlib.sha256(f"{frames}".encode())
    for name, tensor in sorted(actor.state_dict().items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return digest.hexdigest()
