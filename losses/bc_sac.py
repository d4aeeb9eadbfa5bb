"""BC-SAC: soft actor-critic whose actor also imitates demonstrations (paper, section III)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar, cast

from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from losses import functional as F
from losses.actor import CriticReduction, SoftValue
from losses.critic import SoftTD, TargetAction
from losses.imitation import Emphasis, ErrorName, Imitation, QFilter, RowWeight
from losses.objective import Objective
from losses.passes import ActorPass
from losses.proposal import Proposal
from losses.rules import WeightRule
from losses.schedules import Schedule
from losses.settings import SettingError
from losses.temperature import Temperature
from losses.terms import Term

AnyTerm = TypeVar("AnyTerm", bound=Term)

KEYWORDS = {
    "entropy": "entropy_in_target",
    "distance": "loss_function",
    "value": "actor_value",
    "init": "init_temperature",
    "learn": "learn_temperature",
    "error": "imitation",
    "weight": "bc_weight",
    "margin": "action_margin",
}
"""Keywords of :class:`BCSACLoss` by the settings of its terms that have another name."""

OUT_KEYS = [
    "loss_qvalue",
    "loss_actor",
    "loss_alpha",
    "loss_bc",
    "alpha",
    "entropy",
    "bc_nll",
    "bc_weight",
    "q_data",
    "q_policy",
    "q_target",
]
"""The first keys that :class:`BCSACLoss` returns; those of further terms follow."""


def _setting(term: str, name: str) -> Any:
    """Return a read-only attribute of the loss: the setting ``name`` of one of its terms."""

    def read(loss: BCSACLoss) -> Any:
        return getattr(loss.composition[term], name)

    def refuse(loss: BCSACLoss, value: Any) -> None:
        raise AttributeError(
            f"settings are not assigned: change this one by configure({term!r}, {name}={value!r})"
        )

    return property(read, refuse)


class BCSACLoss(Objective):
    r"""Critic, actor, temperature and imitation terms of BC-SAC and its variants.

    All terms are computed on one flat batch ``[B]``. Rows marked ``is_demo`` are samples of the
    demonstration distribution D, over which the imitation error is averaged. Reinforcement terms
    use the other rows, or all rows with ``rl_on_demos``. The actor's objective (section III-C) is

    .. math::
        \min_\pi \; E_{s \sim R,\, a \sim \pi} [\alpha \log \pi(a|s) - Q(s, a)]
        + \lambda_n E_{s, a \sim D} [-\log \pi(a|s)]

    with lambda a constant (BC-SAC), lambda_0 alpha^n (DBC-SAC, section III-D) or any other
    :class:`~losses.schedules.Schedule`. With no demonstrations, or weight 0, it is SAC, equal in
    values and gradients to ``torchrl.objectives.SACLoss`` with ``loss_function="l2"``.

    Networks are held as ordinary modules, not as functional parameters, so the modules that are
    passed in are the ones that learn, and an update takes about a fifth less time than with
    ``SACLoss``. The gradient of a loss reaches only its own network, so the backward passes may be
    made together or one by one, in any order.

    The batch is never written to. :class:`~losses.batch.BatchKeys` lists its entries, which
    ``set_keys`` renames.

    The terms are named ``qvalue``, ``rl``, ``alpha`` and ``bc``. Attributes such as ``gamma`` read
    their settings; :meth:`configure` changes them, e.g. ``configure("qvalue", gamma=0.995)`` or
    ``configure("bc", row_weights=[QFilter()])``.

    Args:
        actor: policy over one observation key with a ``TanhNormal``-like distribution on (-1, 1).
        critic: module ``(observation [B, O], action [B, A]) -> [E, B, 1]``, or a list of modules
            that return ``[B, 1]`` each. If the module has ``num_critics`` and its ``forward``
            also takes ``members [M]``, the critics that ``target_subset`` leaves out are not run.
        gamma: discount per environment step, in [0, 1].
        init_temperature: initial entropy weight alpha, > 0.
        target_entropy: in nats; ``"auto"`` is minus the number of action dimensions, read from
            the actor's spec.
        learn_temperature: ``False`` keeps alpha at ``init_temperature``.
        bc_weight: lambda, a number or a schedule of the number of updates.
        bc_rule: sets the imitation term's weight by the sizes of the gradients
            (:class:`~losses.GradientRatio`); ``None`` is the paper's, ``bc_weight`` alone.
        imitation: the imitation error: ``"nll"`` (section III-B), ``"mse"`` of the deterministic
            action, or ``"fixed_width"``, the same regression in nats
            (:mod:`losses.imitation_errors`).
        action_margin: demonstrated actions are kept this far inside (-1, 1) before they are
            scored; see :func:`~losses.imitation_errors.clamp_to_support`.
        target_subset: number of critics in the target's minimum, drawn anew at each call;
            ``None`` is all.
        actor_value: what the actor maximises of the critics' values, ``"min"`` or ``"mean"``.
        target_action: the policy's ``"sample"`` or ``"mean"`` action in the next state of the
            critics' target (:class:`~losses.SoftTD`).
        entropy_in_target: whether the critics' target includes the entropy bonus.
        rl_on_demos: whether the reinforcement terms use the demonstration rows too.
        main_rows: number of rows before the demonstrations, if it is the same in every batch with
            marks; ``None`` counts them in each, for which the host of an accelerator must wait.
        bc_emphasis: function of rows ``[D]`` of the batch that returns factors ``[D]`` on their
            imitation errors in :meth:`actor_terms`; ``None`` is 1.
        q_filter: whether :meth:`actor_terms` imitates only the demonstrated actions that the
            critics value above the policy's own mean action (arXiv:1709.10089, section V-C).
        tau: step of the target critics towards the critics at each :meth:`update_target`, in
            [0, 1].
        loss_function: regression error of the critics, ``"l2"``, ``"l1"`` or ``"smooth_l1"``.
        proposal: another policy, whose action the critics' target uses where the critics value it
            higher.
        further: more terms beside those of BC-SAC.

    Raises:
        ValueError: for an argument outside its range, an actor with more than one input, or an
            ``"auto"`` target entropy for an actor without a spec.
    """

    gamma = _setting("qvalue", "gamma")
    tau = _setting("qvalue", "tau")
    target_action = _setting("qvalue", "target_action")
    entropy_in_target = _setting("qvalue", "entropy")
    loss_function = _setting("qvalue", "distance")
    target_entropy = _setting("alpha", "target_entropy")
    bc_weight = _setting("bc", "weight")
    action_margin = _setting("bc", "margin")

    def __init__(  # noqa: PLR0913 - the settings of a run, flat
        self,
        actor: ProbabilisticActor,
        critic: nn.Module | Sequence[nn.Module],
        *,
        gamma: float = 0.99,
        init_temperature: float = 0.1,
        target_entropy: float | Literal["auto"] = "auto",
        learn_temperature: bool = True,
        bc_weight: Schedule | float = 1.0,
        bc_rule: WeightRule | None = None,
        imitation: ErrorName = "nll",
        action_margin: float = 1e-2,
        target_subset: int | None = None,
        actor_value: CriticReduction = "min",
        target_action: TargetAction = "sample",
        entropy_in_target: bool = True,
        rl_on_demos: bool = False,
        main_rows: int | None = None,
        bc_emphasis: Callable[[TensorDictBase], Tensor] | None = None,
        q_filter: bool = False,
        tau: float = 0.005,
        loss_function: F.CriticDistance = "l2",
        proposal: Proposal | None = None,
        further: Sequence[Term] = (),
    ) -> None:
        terms: list[Term] = [
            _term(
                SoftTD,
                gamma=gamma,
                entropy=entropy_in_target,
                target_subset=target_subset,
                target_action=target_action,
                distance=loss_function,
                proposal=proposal,
                tau=tau,
            ),
            _term(SoftValue, value=actor_value),
            _term(
                Temperature,
                init=init_temperature,
                target_entropy=target_entropy,
                learn=learn_temperature,
            ),
            _term(
                Imitation,
                error=imitation,
                weight=bc_weight,
                margin=action_margin,
                row_weights=_row_weights(bc_emphasis, q_filter, actor_value),
                rule=bc_rule,
            ),
            *further,
        ]
        super().__init__(actor, critic, terms, rl_on_demos=rl_on_demos, main_rows=main_rows)
        self.out_keys = [*OUT_KEYS, *(key for key in self.out_keys if key not in OUT_KEYS)]

    def qvalue_loss(self, tensordict: TensorDictBase) -> Tensor:
        """Return the soft TD error ``[]`` of :meth:`critic_terms`."""
        return self.critic_terms(tensordict).values["qvalue"].loss

    def actor_loss(self, tensordict: TensorDictBase) -> Tensor:
        """Return the reinforcement term ``[]`` of :meth:`actor_terms`, on its rows alone."""
        seen = ActorPass(self, self._reinforcement_batch(tensordict))
        term = cast(SoftValue, self.composition["rl"])
        return term(seen).loss

    @property
    def current_bc_weight(self) -> float:
        """The weight lambda of the imitation term at the present number of updates."""
        return self.weight_of("bc")

    @property
    def bc_emphasis(self) -> Callable[[TensorDictBase], Tensor] | None:
        """The factors by row on the imitation error; ``None`` for 1."""
        return next((row.of for row in self._row_weights if isinstance(row, Emphasis)), None)

    @property
    def q_filter(self) -> bool:
        """Whether only actions that the critics value above the policy's own are imitated."""
        return any(isinstance(row, QFilter) for row in self._row_weights)

    @property
    def _row_weights(self) -> Sequence[RowWeight]:
        return cast(Imitation, self.composition["bc"]).row_weights


def _row_weights(
    emphasis: Callable[[TensorDictBase], Tensor] | None, q_filter: bool, value: CriticReduction
) -> tuple[RowWeight, ...]:
    by_state = () if emphasis is None else (Emphasis(emphasis),)
    return (*by_state, QFilter(value)) if q_filter else by_state


def _term(kind: type[AnyTerm], **settings: Any) -> AnyTerm:
    """Return the term; an error names the setting as the keyword of the loss."""
    try:
        return kind(**settings)
    except SettingError as error:
        raise error.renamed(KEYWORDS.get(error.name, error.name)) from None
