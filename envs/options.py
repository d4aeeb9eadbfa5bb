"""How environments are made, and what a user says about somebody's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class EnvOptions:
    """How an environment is made, the same for every task.

    Attributes:
        num_envs: copies N stepped as one batch, >= 1.
        seed: of the environments' own randomness; None is not reproducible.
        device: where the tensors live.
        num_threads: physics threads of a task that is batched natively; None is one per core.
        workers: processes that step copies of a Python environment; None lets the task decide.
        horizon: steps until truncation; None is the task's own limit.
        success_steps: truncates an episode after so many steps of success in a row, for training,
            which then spends its steps on getting there; None never does.
        reward: one of the task's `Task.rewards`; None is its own.
        render_mode: what its pictures are to be asked for, ``rgb_array`` or ``human``, of
            environments that must know from the start; None: no pictures.
        strategies: whether the columns of `Task.strategies` are written.

    Raises:
        ValueError: a count is below 1.
    """

    num_envs: int = 1
    seed: int | None = None
    device: torch.device | str = "cpu"
    num_threads: int | None = None
    workers: int | None = None
    horizon: int | None = None
    success_steps: int | None = None
    reward: str | None = None
    render_mode: str | None = None
    strategies: bool = False

    def __post_init__(self) -> None:
        for name in ("num_envs", "horizon", "success_steps", "num_threads"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"env.{name} must be at least 1, got {value}")
        if self.workers is not None and self.workers < 0:
            raise ValueError(f"env.workers must not be negative, got {self.workers}")


@dataclass(frozen=True)
class TaskOptions:
    """What a user says about somebody's environment; a task of this project takes none of it.

    Attributes:
        kwargs: keyword arguments of the environment.
        wrappers: gymnasium wrappers by import path (``module:Class``), applied in this order.
        success: what counts as success: ``info:KEY``, ``terminated``, ``reward>=X``, ``return>=X``
            (of the episode so far), or ``path.py:function`` with
            ``function(observation [B, O]) -> [B]``; None takes ``info["success"]`` or
            ``info["is_success"]`` where the environment tells one of them.
        reward: ``path.py:function`` that replaces the environment's reward:
            ``function(observation [B, O], action [B, A], next_observation [B, O]) -> [B]``, with
            flat float32 observations and actions in [-1, 1], of environments and recordings alike.
        progress: ``info:KEY``, or ``path.py:function`` as for success.
    """

    kwargs: Mapping[str, Any] = field(default_factory=dict)
    wrappers: tuple[str, ...] = ()
    success: str | None = None
    reward: str | None = None
    progress: str | None = None

    def given(self) -> dict[str, Any]:
        """The options that say something, by their key in the configuration."""
        return {f"task.{name}": value for name, value in vars(self).items() if value}
