"""The actor's imitation term (paper, sections III-B to III-D) and the weights of its rows."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import ClassVar, Literal, Protocol

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.modules import TanhNormal

from losses import functional as F
from losses.actor import CriticReduction
from losses.batch import Batch
from losses.imitation_errors import IMITATION_ERRORS, clamp_to_support
from losses.passes import ActorPass, DemonstratedRows
from losses.rules import WeightRule
from losses.schedules import ConstantWeight, Schedule
from losses.settings import require
from losses.terms import ActorTerm, TermValue

ErrorName = Literal["nll", "mse", "fixed_width"]

FORMER_NAMES = {"bc": "bc_nll", "grad_cosine_bc": "grad_cosine"}
"""Names that two metrics of the paper's term kept from before other terms could stand beside it."""


class RowWeight(Protocol):
    """Factors on the imitation errors of the rows: how much each demonstrated step counts."""

    def __call__(self, seen: DemonstratedRows) -> Tensor:
        """Return ``[D]``, numbers or bool; those of rows that are no demonstrations are unused."""


@dataclass(frozen=True)
class Emphasis:
    """Factors by row, where some demonstrated steps matter more than others.

    Attributes:
        of: function of rows ``[D]`` of the batch that returns their factors ``[D]``.
    """

    of: Callable[[TensorDictBase], Tensor]

    def __call__(self, seen: DemonstratedRows) -> Tensor:
        """Return the factors ``[D]``."""
        return self.of(seen.batch.data)


@dataclass(frozen=True)
class QFilter:
    """Only demonstrated actions that the critics value above the policy's own mean action.

    Source: arXiv:1709.10089, section V-C.

    Attributes:
        value: which of the critics' values are compared, their ``"min"`` or ``"mean"``.
    """

    value: CriticReduction = "min"

    def __post_init__(self) -> None:
        """Validate the settings."""
        require("value", self.value, self.value in F.ENSEMBLE_VALUES, "min or mean")

    @torch.no_grad()
    def __call__(self, seen: DemonstratedRows) -> Tensor:
        """Return ``[D]`` bool."""
        critic, batch = seen.networks.critic, seen.batch
        shown, own = (
            F.ENSEMBLE_VALUES[self.value](critic(batch.observation, action))
            for action in (batch.demonstrated_action, seen.policy.deterministic_sample)
        )
        return (shown > own).squeeze(-1)


@dataclass(frozen=True)
class Imitation(ActorTerm):
    """Mean error of the policy on the demonstration rows, weighted by lambda.

    Lambda is a constant (BC-SAC), ``lambda_0 alpha^n`` (DBC-SAC, section III-D) or any other
    schedule. The divisor of the mean is the number of demonstration rows, whatever their weights.

    Attributes:
        error: ``"nll"`` (section III-B), ``"mse"`` of the deterministic action, or its regression
            in nats, ``"fixed_width"`` (:func:`~losses.imitation_errors.fixed_width_nll`).
        weight: lambda, a number or a schedule of the number of updates.
        margin: demonstrated actions are kept this far inside (-1, 1) before they are scored; see
            :func:`~losses.imitation_errors.clamp_to_support`.
        row_weights: the factor on a row's error is the product of these; without any it is 1.
        rule: computes the weight from the gradients, such as
            :class:`~losses.rules.GradientRatio`; ``None`` uses the schedule's.
        name: of the term. With another than the default the metrics are ``NAME``,
            ``NAME_weight``, ``grad_norm_NAME`` and ``grad_cosine_NAME``.

    Raises:
        SettingError: for a setting outside its range.
        ValueError: for a negative weight.
    """

    error: ErrorName = "nll"
    weight: Schedule | float = ConstantWeight(1.0)  # noqa: RUF009 - frozen
    margin: float = 1e-2
    row_weights: Sequence[RowWeight] = ()
    rule: WeightRule | None = None
    name: str = "bc"

    reads: ClassVar[tuple[NestedKey, ...]] = (
        "observation",
        "action",
        "imitated_action",
        "is_demo",
    )

    def __post_init__(self) -> None:
        """Validate the settings; a list of row weights becomes a tuple."""
        super().__post_init__()
        object.__setattr__(self, "row_weights", tuple(self.row_weights))
        require("error", self.error, self.error in IMITATION_ERRORS, "nll, mse or fixed_width")
        require("margin", self.margin, 0.0 < self.margin < 1.0, "in (0, 1)")

    @property
    def metric(self) -> str:
        """Name in the logs of the mean error."""
        return FORMER_NAMES.get(super().metric, super().metric)

    @property
    def cosine_metric(self) -> str:
        """Name in the logs of the cosine between its gradient and the reinforcement term's."""
        return FORMER_NAMES.get(super().cosine_metric, super().cosine_metric)

    def __call__(self, seen: ActorPass) -> TermValue:
        """Compute the loss; a constant 0 if the batch does not mark demonstrations."""
        shown = seen.demonstrations
        weights = None
        if self.row_weights and shown.batch.is_demo is not None:
            weights = reduce(operator.mul, [of_rows(shown) for of_rows in self.row_weights])
        return TermValue(self.mean_error(shown.policy, shown.batch, weights))

    def demonstration_error(self, seen: ActorPass) -> Tensor:
        """Return the mean error ``[]`` without row weights, for which no critic is run."""
        return self.mean_error(seen.policy, seen.batch)

    def mean_error(self, policy: TanhNormal, batch: Batch, weights: Tensor | None = None) -> Tensor:
        """Return the mean imitation error ``[]`` of the demonstration rows.

        Args:
            policy: the distribution in the states of ``batch``.
            batch: ``[D]``.
            weights: ``[D]``, factors on the rows' errors; the divisor stays the number of rows.
        """
        action = batch.demonstrated_action
        if batch.is_demo is None:
            return action.new_zeros(())
        # Deviation: the paper scores recorded actions as they are. At the edge of tanh's range that
        # likelihood and its gradient explode; margin=1e-6, float32's limit, undoes this.
        error = IMITATION_ERRORS[self.error](policy, clamp_to_support(action, self.margin))
        if weights is not None:
            error = error * weights
        return F.masked_mean(error, batch.is_demo)
