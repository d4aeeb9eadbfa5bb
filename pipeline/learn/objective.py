"""The settings of the objective, and the loss that they make."""

from __future__ import annotations

from dataclasses import field
from typing import Any, Literal

from pydantic import field_validator
from pydantic.dataclasses import dataclass as settings

from losses import SelfImitation
from losses.imitation import ErrorName
from losses.terms import Term
from pipeline.learn.own_terms import OwnTerm
from pipeline.learn.weights import WeightSettings
from pipeline.settings import STRICT, Count, Positive, Rate, Share


@settings(frozen=True, kw_only=True, config=STRICT)
class EmphasisSettings:
    """Factors on the imitation error of demonstrated steps, by how far the task has progressed."""

    before: Rate = 1.0  # up to the progress
    beyond: Rate = 1.0
    progress: float = 0.0  # in the task's unit


@settings(frozen=True, kw_only=True, config=STRICT)
class SelfImitationSettings:
    """Imitation of what turned out better than the critics expect (losses/self_imitation.py)."""

    weight: Rate = 0.0  # 0 = there is no such term
    advantage_cap: Positive | None = None  # the largest advantage that counts
    bootstrap: bool = True  # the return goes on behind a time limit, with the critics' value

    def terms(self, loss: LossSettings) -> list[Term]:
        """The term, as the others of ``loss`` are; none without a weight."""
        if self.weight == 0.0:
            return []
        term = SelfImitation(
            weight=self.weight,
            gamma=loss.gamma,
            error=loss.imitation_error,
            margin=loss.action_margin,
            value=loss.actor_value,
            entropy=loss.entropy_in_target,
            bootstrap=self.bootstrap,
            cap=self.advantage_cap,
        )
        return [term]


@settings(frozen=True, kw_only=True, config=STRICT)
class LossSettings:
    """Terms of BCSACLoss."""

    gamma: Share = 0.99
    n_step: Count = 1  # steps of reward before the bootstrap
    # Factor on rewards; auto: by what demonstrations are worth (pipeline/scale_choice.py)
    reward_scale: Positive | Literal["auto"] = 1.0
    progress_bonus: Rate = 0.0  # training only: reward per unit of progress, at every step
    progress_bonus_cap: float | None = None  # progress beyond which it grows no further
    init_temperature: Positive = 0.1
    # None = -(action size); clone: a little below the BC model's (pipeline/entropy_choice.py)
    target_entropy: float | Literal["clone"] | None = None
    learn_temperature: bool = True
    entropy_in_target: bool = True
    target_subset: Count | None = None  # critics in the target's minimum; None = all
    actor_value: Literal["min", "mean"] = "min"  # over the ensemble
    target_action: Literal["sample", "mean"] = "sample"  # the policy's next action in the target
    rl_on_demos: bool = False  # do the RL terms also see the demonstration rows?
    q_filter: bool = False  # imitate only actions that the critics value above the policy's own
    # nll: paper III-B; auto: chosen by what the demonstrations hold (pipeline/imitation_choice.py)
    imitation: Literal["nll", "mse", "fixed_width", "auto"] = "nll"
    action_margin: Positive = 1e-2  # demonstrated actions are clamped to +-(1 - action_margin)
    tau: Share = 0.005
    bc_weight: WeightSettings = field(default_factory=WeightSettings)
    bc_emphasis: EmphasisSettings = field(default_factory=EmphasisSettings)
    self_imitation: SelfImitationSettings = field(default_factory=SelfImitationSettings)
    # Terms of your own beside these: path.py:NAME, or {term: path.py:NAME, weight: 0.1, ...}
    own_terms: tuple[OwnTerm, ...] = ()
    bc_gradient_ratio: Rate | None = None  # if set: bc_weight(n) * ratio * |g_RL| / |g_BC|

    @property
    def reward_factor(self) -> float:
        """The factor itself.

        Raises:
            ValueError: It is not chosen yet (``auto``), as it is where a run is built.
        """
        if isinstance(self.reward_scale, str):
            raise ValueError(
                f"loss.reward_scale={self.reward_scale} is chosen where a run is built with its "
                "demonstrations: give a number."
            )
        return self.reward_scale

    @property
    def imitation_error(self) -> ErrorName:
        """The error itself.

        Raises:
            ValueError: It is not chosen yet (``auto``), as it is where a run is built.
        """
        if self.imitation == "auto":
            raise ValueError(
                "loss.imitation=auto is chosen where a run is built with its demonstrations: name "
                "nll, mse or fixed_width."
            )
        return self.imitation

    def entropy_target(self, action_size: int) -> float:
        """What the temperature holds the entropy at, in nats.

        Raises:
            ValueError: It is not chosen yet (``clone``), as it is where a run is built.
        """
        if self.target_entropy == "clone":
            raise ValueError(
                "loss.target_entropy=clone is measured where a run is built with its BC model: "
                "name a number of nats, or null."
            )
        return -float(action_size) if self.target_entropy is None else self.target_entropy

    @field_validator("bc_weight", mode="before")
    @classmethod
    def _weight(cls, value: Any) -> Any:
        """A number or a schedule of `losses.schedules` will do."""
        if isinstance(value, int | float) or callable(value):
            return WeightSettings.of(value)
        return value
