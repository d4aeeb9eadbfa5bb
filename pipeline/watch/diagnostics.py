"""What is measured beside the success rate, so that a failure can be explained."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.modules import TanhNormal

from losses import Objective
from losses import functional as F
from losses.policy import policy_distribution
from pipeline.learn.stepper import BCSACStepper

PROBE_ROWS = 512
"""Demonstration rows that a probe looks at: enough for a mean, cheap beside an evaluation."""


class DemonstrationProbe:
    """What critics and actor make of demonstrations, on the same few rows every time.

    Args:
        loss: Of the run.
        training: Rows [R] that the run trains on.
        held_out: Rows [H] that it does not train on; None if there are none.
        limit: Rows looked at, spread evenly over each set.
    """

    def __init__(
        self,
        loss: Objective,
        training: TensorDictBase,
        held_out: TensorDictBase | None,
        limit: int = PROBE_ROWS,
    ) -> None:
        self.loss = loss
        device = loss.log_alpha.device
        self.training = _marked(training.to(device), limit)
        self.held_out = None if held_out is None else _marked(held_out.to(device), limit)

    @torch.no_grad()
    def __call__(self) -> dict[str, float]:
        """Values and errors now.

        ``q_demo_actions`` and ``q_policy_actions`` are the critics' least value of the demonstrated
        and of the policy's own mean action in the same states; the second rising away from the
        first is overestimation off the data. ``bc_nll_train`` and ``bc_nll_held_out`` are the
        imitation error on rows trained on and not; other terms that imitate have theirs likewise.
        """
        keys = self.loss.tensor_keys
        observation = self.training[keys.observation]
        policy: TanhNormal = policy_distribution(self.loss.actor, observation)
        own = policy.deterministic_sample
        found = {
            "q_demo_actions": self._value(observation, self.training[keys.action]),
            "q_policy_actions": self._value(observation, own),
            **self._errors(self.training, "train"),
        }
        if self.held_out is not None:
            found |= self._errors(self.held_out, "held_out")
        return found

    def _errors(self, rows: TensorDictBase, of: str) -> dict[str, float]:
        errors = self.loss.demonstration_errors(rows)
        return {f"{metric}_{of}": float(error) for metric, error in errors.items()}

    def _value(self, observation: Tensor, action: Tensor) -> float:
        return float(F.subset_minimum(self.loss.critic(observation, action)).mean())


class TrainingState:
    """The last step's metrics, the number of actor updates and what the terms aim at."""

    def __init__(self, stepper: BCSACStepper) -> None:
        self.stepper = stepper

    def __call__(self) -> Mapping[str, float]:
        """Finite values only: a metric that was never computed is left out."""
        last = {key: float(value) for key, value in self.stepper.last.items()}
        finite = {key: value for key, value in last.items() if math.isfinite(value)}
        loss = self.stepper.loss
        aims = [term.constants() for term in loss.composition.terms]
        return {
            **finite,
            "actor_updates": float(loss.updates),
            **{key: value for of_term in aims for key, value in of_term.items()},
        }


def _marked(rows: TensorDictBase, limit: int) -> TensorDictBase:
    stride = max(1, len(rows) // limit)
    chosen = rows[::stride][:limit].clone()
    chosen.set("is_demo", torch.ones(len(chosen), 1, dtype=torch.bool, device=rows.device))
    return chosen
