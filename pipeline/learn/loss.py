"""The loss module that the settings of a run make."""

from __future__ import annotations

from collections.abc import Callable

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from losses import BCSACLoss, GradientRatio, Proposal
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.objective import LossSettings
from pipeline.learn.own_terms import own_terms


def make_loss(
    loss: LossSettings,
    actor: ProbabilisticActor,
    critic: BatchedCritics,
    action_size: int,
    updates: int,
    main_rows: int | None = None,
    bc_emphasis: Callable[[TensorDictBase], Tensor] | None = None,
    proposal: Proposal | None = None,
) -> BCSACLoss:
    """BCSACLoss with the configured terms.

    Args:
        loss: Its configuration.
        actor: Policy.
        critic: Ensemble.
        action_size: Dimensions of an action.
        updates: Of the actor in the whole run, over which a weight without ``duration`` moves.
        main_rows: Of each batch, before its demonstrations.
        bc_emphasis: Of the demonstrated steps in the actor's objective.
        proposal: Of another policy in the critics' targets.
    """
    ratio = loss.bc_gradient_ratio
    return BCSACLoss(
        actor,
        critic,
        gamma=loss.gamma,
        init_temperature=loss.init_temperature,
        target_entropy=loss.entropy_target(action_size),
        learn_temperature=loss.learn_temperature,
        bc_weight=loss.bc_weight.schedule(updates),
        bc_rule=None if ratio is None else GradientRatio(ratio),
        imitation=loss.imitation_error,
        action_margin=loss.action_margin,
        target_subset=loss.target_subset,
        actor_value=loss.actor_value,
        target_action=loss.target_action,
        entropy_in_target=loss.entropy_in_target,
        rl_on_demos=loss.rl_on_demos,
        main_rows=main_rows,
        bc_emphasis=bc_emphasis,
        q_filter=loss.q_filter,
        tau=loss.tau,
        proposal=proposal,
        further=[*loss.self_imitation.terms(loss), *own_terms(loss.own_terms, updates)],
    )
