"""Environments by name: the door, any gymnasium id, any task of the dm_control suite."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

import torch
from torchrl.data import Bounded
from torchrl.envs import (
    ActionScaling,
    CatTensors,
    Compose,
    DMControlEnv,
    DoubleToFloat,
    EnvBase,
    FlattenObservation,
    GymEnv,
    SerialEnv,
    StepCounter,
    Transform,
    TransformedEnv,
)

from envs.door import task
from envs.door.torchrl_env import DoorEnv

VALID_NAMES: Final = (
    "door, gymnasium:ID (gymnasium:Pendulum-v1), dm_control:DOMAIN/TASK (dm_control:walker/walk)"
)
OBSERVATION_KEY: Final = "observation"


class UnknownEnvironmentError(ValueError):
    """No environment has this name."""


def make_env(
    name: str,
    *,
    num_envs: int = 1,
    seed: int | None = None,
    device: torch.device | str = "cpu",
    num_threads: int | None = None,
    horizon: int | None = None,
    open_steps: int | None = None,
) -> EnvBase:
    """Build an environment that SAC can be pointed at.

    Whatever the name, the result has batch size [num_envs], a flat float32 ``observation``
    [num_envs, O], an ``action`` [num_envs, A] in [-1, 1] (rescaled to the task's own bounds),
    ``reward`` [num_envs, 1], and ``terminated`` apart from ``truncated``: time limits truncate.

    Args:
        name: ``door``, ``gymnasium:ID`` or ``dm_control:DOMAIN/TASK``.
        num_envs: Number of environments, >= 1.
        seed: Seed of the environments' own randomness. Default: not reproducible.
        device: Where the tensors live.
        num_threads: Threads that step the door; the others are stepped one after another.
        horizon: Steps until truncation. Default: the task's own limit, which `horizon` can shorten
            but, for gymnasium and dm_control, not extend.
        open_steps: Of the door: see `DoorEnv`.

    Raises:
        UnknownEnvironmentError: If the name has another form or the library does not know it.
        ValueError: If a count is below 1, the task's actions are not bounded and continuous, or
            `open_steps` is given for a task that has no door.
    """
    if num_envs < 1:
        raise ValueError(f"num_envs must be at least 1, got {num_envs}")
    if horizon is not None and horizon < 1:
        raise ValueError(f"horizon must be at least 1 step (or None), got {horizon}")
    if name == "door":
        steps = task.HORIZON if horizon is None else horizon
        return DoorEnv(
            num_envs,
            horizon=steps,
            open_steps=open_steps,
            num_threads=num_threads,
            seed=seed,
            device=device,
        )
    if open_steps is not None:
        raise ValueError(
            f"open_steps={open_steps} ends episodes whose door is open, and {name!r} has no door: "
            "leave it out (env.open_steps=null)"
        )
    library, separator, wanted = name.partition(":")
    if not separator or library not in _LIBRARIES:
        raise UnknownEnvironmentError(f"unknown environment {name!r}; valid: {VALID_NAMES}")
    single = partial(_LIBRARIES[library], wanted, torch.device(device))
    _check_single(name, single)
    env = SerialEnv(num_envs, single, device=device)
    env = TransformedEnv(env, Compose(*_transforms(env, horizon)))
    if seed is not None:
        env.set_seed(seed)
    return env


def _gymnasium(wanted: str, device: torch.device) -> EnvBase:
    return GymEnv(wanted, device=device)


def _dm_control(wanted: str, device: torch.device) -> EnvBase:
    domain, separator, task_name = wanted.partition("/")
    if not separator:
        raise ValueError("expected DOMAIN/TASK")
    return DMControlEnv(domain, task_name, device=device)


_LIBRARIES: Final[Mapping[str, Callable[[str, torch.device], EnvBase]]] = MappingProxyType(
    {"gymnasium": _gymnasium, "dm_control": _dm_control}
)


def _check_single(name: str, single: Callable[[], EnvBase]) -> None:
    """Build one environment, so that mistakes surface here and not inside a batch of them."""
    try:
        env = single()
    # gymnasium, dm_control and their task constructors each raise their own kinds.
    except Exception as error:
        raise UnknownEnvironmentError(
            f"cannot make environment {name!r} ({type(error).__name__}: {error}); "
            f"valid: {VALID_NAMES}"
        ) from error
    spec = env.action_spec
    env.close()
    bounded = isinstance(spec, Bounded) and spec.dtype.is_floating_point
    if not bounded or not (spec.space.low.isfinite() & spec.space.high.isfinite()).all():
        raise ValueError(f"{name!r} has no bounded continuous actions: {spec}; SAC needs them")


def _transforms(env: EnvBase, horizon: int | None) -> list[Transform]:
    keys = list(env.observation_spec.keys(include_nested=True, leaves_only=True))
    transforms: list[Transform] = [DoubleToFloat()]
    for key in keys:
        rank = len(env.observation_spec[key].shape) - len(env.batch_size)
        if rank > 1:
            transforms.append(FlattenObservation(-rank, -1, in_keys=[key]))
    if keys != [OBSERVATION_KEY]:
        transforms.append(CatTensors(in_keys=keys, out_key=OBSERVATION_KEY))
    transforms.append(ActionScaling())
    if horizon is not None:
        transforms.append(StepCounter(max_steps=horizon))
    return transforms
