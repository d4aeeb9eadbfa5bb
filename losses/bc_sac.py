"""BC-SAC: soft actor-critic whose actor also imitates demonstrations (paper, section III)."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Literal

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import LossModule
from torchrl.objectives.utils import hold_out_net

from losses import functional as F
from losses.distributions import SquashedNormal
from losses.ensemble import CriticEnsemble
from losses.policy import Rows, draw, policy_distribution
from losses.schedules import ConstantWeight, Schedule
from losses.terms import ActorTerms, CriticTerms


class BCSACLoss(LossModule):
    r"""Critic, actor, temperature and imitation terms of BC-SAC and its relatives.

    One flat batch ``[B]`` serves all terms. Rows marked ``is_demo`` are samples of the
    demonstration distribution D; the imitation term is their mean. Reinforcement terms use the
    other rows, or all of them with ``rl_on_demos``. The actor's objective (section III-C) is

    .. math::
        \min_\pi \; E_{s \sim R,\, a \sim \pi} [\alpha \log \pi(a|s) - Q(s, a)]
        + \lambda_n E_{s, a \sim D} [-\log \pi(a|s)]

    with lambda a constant (BC-SAC), lambda_0 alpha^n (DBC-SAC, section III-D) or any other
    :class:`~losses.schedules.Schedule`. With no demonstrations, or weight 0, it is SAC, equal in
    values and gradients to ``torchrl.objectives.SACLoss`` with ``loss_function="l2"``.

    Networks are held as ordinary modules, not as functional parameters: an update costs about
    a fifth less than ``SACLoss``'s, and the modules passed in are the ones that learn. Every loss
    reaches the parameters of its own network only, so the backward passes may be taken together
    or one by one, in any order.

    The batch is never written to. Keys are renamed with ``set_keys``:

    ==================== ============= ===================================================
    name                 shape         meaning
    ==================== ============= ===================================================
    observation          [B, O]        state; also read under ``next``
    action               [B, A]        in [-1, 1]
    (next, reward)       [B, 1]        reward, or discounted sum of n rewards
    (next, terminated)   [B, 1] bool   the environment's end, not a time limit
    is_demo              [B, 1] bool   optional: the row comes from D
    steps_to_next_obs    [B, 1] int    optional: environment steps n to ``next``
    ==================== ============= ===================================================

    Args:
        actor: policy over one observation key with a ``TanhNormal``-like distribution on (-1, 1).
        critic: module ``(observation [B, O], action [B, A]) -> [E, B, 1]``, or a list of modules
            that return ``[B, 1]`` each. If it has ``num_critics`` and its ``forward`` takes
            ``members [M]`` too, the critics that ``target_subset`` leaves out are not run.
        gamma: discount per environment step, in [0, 1].
        init_temperature: initial entropy weight alpha, > 0.
        target_entropy: in nats; ``"auto"`` is minus the number of action dimensions, read from
            the actor's spec.
        learn_temperature: ``False`` keeps alpha where it starts.
        bc_weight: lambda, a number or a schedule of the number of updates.
        imitation: ``"nll"`` (section III-B) or ``"mse"`` of the deterministic action.
        action_margin: demonstrated actions are kept this far inside (-1, 1) before they are
            scored; see :func:`~losses.functional.clamp_to_support`.
        target_subset: critics in the target's minimum, drawn anew at each call; ``None`` is all.
        actor_value: the critics' ``"min"`` or ``"mean"`` is what the actor maximises.
        target_action: the policy's ``"sample"`` or ``"mean"`` action in the next state of the
            backup. With the mean, the critics value the policy without its noise
            (arXiv:1802.09477, without the smoothing), which has no entropy to pay for.
        entropy_in_target: whether the backup carries the entropy bonus.
        rl_on_demos: whether the reinforcement terms use the demonstration rows too.
        main_rows: rows before the demonstrations in every batch with marks, where all are built
            alike; ``None`` counts them each time, for which an accelerator's host must wait.
        bc_emphasis: factors ``[B]`` on the imitation error in :meth:`actor_terms` by observation
            ``[B, O]``, where some demonstrated steps matter more than others; ``None`` is 1.
        q_filter: whether :meth:`actor_terms` imitates only the demonstrated actions that the
            critics value above the policy's own mean action (arXiv:1709.10089, section V-C).
        tau: share of the critic that one :meth:`update_target` moves into the target, in [0, 1].
        loss_function: regression error of the critic.

    Raises:
        ValueError: for an argument outside its range, an actor with more than one input, or an
            ``"auto"`` target entropy for an actor without a spec.
    """

    @dataclass
    class _AcceptedKeys:
        observation: NestedKey = "observation"
        action: NestedKey = "action"
        reward: NestedKey = "reward"
        terminated: NestedKey = "terminated"
        is_demo: NestedKey = "is_demo"
        steps_to_next_obs: NestedKey = "steps_to_next_obs"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    log_alpha: nn.Parameter
    _averaged: tuple[list[nn.Parameter], list[nn.Parameter]]
    _has_buffers: bool

    out_keys = [  # noqa: RUF012 - TensorDictModuleBase's own contract
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

    def __init__(
        self,
        actor: ProbabilisticActor,
        critic: nn.Module | Sequence[nn.Module],
        *,
        gamma: float = 0.99,
        init_temperature: float = 0.1,
        target_entropy: float | Literal["auto"] = "auto",
        learn_temperature: bool = True,
        bc_weight: Schedule | float = 1.0,
        imitation: Literal["nll", "mse"] = "nll",
        action_margin: float = 1e-2,
        target_subset: int | None = None,
        actor_value: Literal["min", "mean"] = "min",
        target_action: Literal["sample", "mean"] = "sample",
        entropy_in_target: bool = True,
        rl_on_demos: bool = False,
        main_rows: int | None = None,
        bc_emphasis: Callable[[Tensor], Tensor] | None = None,
        q_filter: bool = False,
        tau: float = 0.005,
        loss_function: F.CriticDistance = "l2",
    ) -> None:
        super().__init__()
        _require("gamma", gamma, 0.0 <= gamma <= 1.0, "in [0, 1]")
        _require("tau", tau, 0.0 <= tau <= 1.0, "in [0, 1]")
        _require("init_temperature", init_temperature, init_temperature > 0.0, "> 0")
        _require("action_margin", action_margin, 0.0 < action_margin < 1.0, "in (0, 1)")
        _require("imitation", imitation, imitation in F.IMITATION_ERRORS, "nll or mse")
        _require("actor_value", actor_value, actor_value in F.ENSEMBLE_VALUES, "min or mean")
        _require(
            "target_action", target_action, target_action in ("sample", "mean"), "sample or mean"
        )
        _require(
            "entropy_in_target",
            entropy_in_target,
            not (entropy_in_target and target_action == "mean"),
            "False with target_action='mean', which has no density",
        )
        _require("main_rows", main_rows, main_rows is None or main_rows >= 1, "None or >= 1")
        _require("actor", actor.in_keys, len(actor.in_keys) == 1, "a policy with one input key")

        self.actor = actor
        self.critic = critic if isinstance(critic, nn.Module) else CriticEnsemble(critic)
        self.target_critic = deepcopy(self.critic).requires_grad_(False)
        self.log_alpha = nn.Parameter(
            torch.tensor(math.log(init_temperature), device=next(actor.parameters()).device),
            requires_grad=learn_temperature,
        )
        self.target_entropy = (
            _negative_action_size(actor) if target_entropy == "auto" else float(target_entropy)
        )
        self.bc_weight = bc_weight if callable(bc_weight) else ConstantWeight(float(bc_weight))
        self.gamma = gamma
        self.action_margin = action_margin
        self.target_action = target_action
        self.entropy_in_target = entropy_in_target
        self.rl_on_demos = rl_on_demos
        self.main_rows = main_rows
        self.bc_emphasis = bc_emphasis
        self.q_filter = q_filter
        self.loss_function = loss_function
        # A Python number, not a buffer: on an accelerator, reading one would be a wait per update.
        self.updates = 0
        self._imitation_error = F.IMITATION_ERRORS[imitation]
        self._actor_value = F.ENSEMBLE_VALUES[actor_value]
        self._target_subset = target_subset
        takes_members = "members" in inspect.signature(self.critic.forward).parameters
        size = getattr(self.critic, "num_critics", None) if takes_members else None
        self._ensemble_size: int | None = size
        # The averaging function of AveragedModel without its shell, which copies instead of
        # averaging at the first update and reads a counter back from the device at each.
        self._average = get_ema_multi_avg_fn(1.0 - tau)
        _list_averaged(self)
        # Loading with assign=True puts other parameters in their place.
        self.register_load_state_dict_post_hook(_list_averaged)

    # ---------------------------------------------------------------- terms, each callable alone

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute all terms of a flat batch at the present parameters.

        Args:
            tensordict: ``[B]`` with the keys of the class table.

        Returns:
            Scalars under :attr:`out_keys`. Their ``loss_*`` entries sum to what is minimised
            (``loss_bc`` is weighted); the rest are detached: the temperature, the policy's mean
            entropy in nats, the unweighted imitation error and its weight, and the mean values
            of the batch's actions, of the policy's own and of the target. ``q_policy`` rising
            away from ``q_data`` is the critic's overestimation off the data.
        """
        critic = self.critic_terms(tensordict)
        actor = self.actor_terms(tensordict)
        weight = self.current_bc_weight
        return TensorDict(
            {
                "loss_qvalue": critic.loss,
                "loss_actor": actor.rl,
                "loss_alpha": self.alpha_loss(actor.log_prob),
                "loss_bc": weight * actor.bc,
                "alpha": self.alpha,
                "entropy": -actor.log_prob.mean(),
                "bc_nll": actor.bc.detach(),
                "bc_weight": torch.full_like(actor.bc, weight),
                "q_data": critic.q.mean(),
                "q_policy": actor.q.mean(),
                "q_target": critic.target.mean(),
            }
        )

    def critic_terms(self, tensordict: TensorDictBase) -> CriticTerms:
        """Compute the critics' loss (section III-A) on the reinforcement rows.

        Args:
            tensordict: ``[B]`` with the keys of the class table.
        """
        keys = self.tensor_keys
        batch = self._reinforcement_batch(tensordict)
        target = self._soft_td_target(batch)
        q = self.critic(batch[keys.observation], batch[keys.action])
        loss = F.critic_error(q, target, self.loss_function).mean()
        return CriticTerms(loss, q.detach(), target)

    def actor_terms(self, tensordict: TensorDictBase) -> ActorTerms:
        """Compute both halves of the actor's objective with one forward pass of the actor.

        Args:
            tensordict: ``[B]``; of the class table, only observation, action and is_demo are read.
        """
        observation = tensordict[self.tensor_keys.observation]
        policy = self._policy(observation)
        rows = self._reinforcement_rows(tensordict)
        chosen = slice(None) if rows is None else rows
        action, log_prob = draw(policy, chosen)
        rl, q = self._reinforcement(observation[chosen], action, log_prob)
        if isinstance(rows, slice) and isinstance(policy, SquashedNormal):
            # After them are demonstrations alone, before them none.
            others = slice(rows.stop, None)
            policy, tensordict = policy[others], tensordict[others]
        bc = self._imitation(policy, tensordict, self._imitation_weights(policy, tensordict))
        return ActorTerms(rl, bc, log_prob.detach(), q)

    def qvalue_loss(self, tensordict: TensorDictBase) -> Tensor:
        """Return the loss ``[]`` of :meth:`critic_terms`."""
        return self.critic_terms(tensordict).loss

    def actor_loss(self, tensordict: TensorDictBase) -> Tensor:
        """Return the reinforcement half ``[]`` of :meth:`actor_terms`; no other row is run."""
        observation = self._reinforcement_batch(tensordict)[self.tensor_keys.observation]
        action, log_prob = self._policy(observation).rsample_and_log_prob()
        rl, _ = self._reinforcement(observation, action, log_prob)
        return rl

    def bc_loss(self, tensordict: TensorDictBase) -> Tensor:
        """Return the imitation error ``[]`` of all demonstration rows alike; no critic is run.

        Without ``q_filter`` and ``bc_emphasis`` it is the imitation half of :meth:`actor_terms`.
        """
        observation = tensordict[self.tensor_keys.observation]
        return self._imitation(self._policy(observation), tensordict)

    def alpha_loss(self, batch: TensorDictBase | Tensor) -> Tensor:
        """Compute the temperature's loss ``[]``.

        Args:
            batch: ``[B]`` transitions, on which the policy is sampled, or the log-densities
                ``[R]`` of actions sampled already (:attr:`ActorTerms.log_prob`).
        """
        if not isinstance(batch, Tensor):
            observation = self._reinforcement_batch(batch)[self.tensor_keys.observation]
            with torch.no_grad():
                _, batch = self._policy(observation).rsample_and_log_prob()
        return F.temperature_objective(batch, self.log_alpha, self.target_entropy).mean()

    # ------------------------------------------------------------------------ state between calls

    @property
    def alpha(self) -> Tensor:
        """The temperature ``[]``, detached."""
        return self.log_alpha.detach().exp()

    @property
    def current_bc_weight(self) -> float:
        """The weight lambda of the imitation term at the present number of updates."""
        return self.bc_weight(self.updates)

    def advance(self) -> None:
        """Count one update; the schedule of the imitation weight moves on."""
        self.updates += 1

    @torch.no_grad()
    def update_target(self) -> None:
        """Move the target critics by ``tau`` towards the critics; copy buffers, if there are any.

        Buffers are statistics (of a normalisation, say), which an average of two would falsify.
        """
        self._average(*self._averaged, None)
        if self._has_buffers:  # looked for anew, because moving a module replaces its buffers
            target, critic = self.target_critic.buffers(), self.critic.buffers()
            for mine, theirs in zip(target, critic, strict=True):
                mine.copy_(theirs)

    def get_extra_state(self) -> Tensor:
        """Return the number of updates, for ``state_dict``."""
        return torch.tensor(self.updates)

    def set_extra_state(self, state: Tensor) -> None:
        """Restore the number of updates from ``state_dict``."""
        self.updates = int(state)

    # ------------------------------------------------------------------------- TorchRL's contract

    @property
    def in_keys(self) -> list[NestedKey]:
        """The entries that a batch must have; is_demo and steps_to_next_obs are optional."""
        keys = self.tensor_keys
        return [
            keys.observation,
            keys.action,
            ("next", keys.observation),
            ("next", keys.reward),
            ("next", keys.terminated),
        ]

    @property
    def functional(self) -> bool:
        """False: networks are held as ordinary modules."""
        return False

    # ----------------------------------------------------------------------------- shared pieces

    def _policy(self, observation: Tensor) -> TanhNormal:
        """Run the actor on ``[B, O]``; nothing but the observation is handed to it."""
        return policy_distribution(self.actor, observation)

    @torch.no_grad()
    def _soft_td_target(self, batch: TensorDictBase) -> Tensor:
        """Return the regression target ``[R, 1]`` of the batch's critics."""
        keys = self.tensor_keys
        next_observation = batch["next", keys.observation]
        policy = self._policy(next_observation)
        next_action, next_log_prob = policy.rsample_and_log_prob()
        if self.target_action == "mean":
            next_action = policy.deterministic_sample
        return F.soft_td_target(
            reward=batch["next", keys.reward],
            terminated=batch["next", keys.terminated],
            next_q=self._target_value(next_observation, next_action),
            next_log_prob=next_log_prob,
            temperature=self.alpha,
            gamma=self.gamma,
            steps=batch.get(keys.steps_to_next_obs, None),
            entropy_in_target=self.entropy_in_target,
        )

    def _target_value(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the minimum ``[R, 1]`` over the target critics, or over a random few (REDQ)."""
        size = self._target_subset
        if size is None or self._ensemble_size is None:
            return F.subset_minimum(self.target_critic(observation, action), size)
        members = F.draw_members(self._ensemble_size, size, observation.device)
        return F.subset_minimum(self.target_critic(observation, action, members=members))

    def _reinforcement(
        self, observation: Tensor, action: Tensor, log_prob: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the actor's reinforcement objective ``[]`` and the detached values ``[R, 1]``."""
        # The action must carry a gradient through the critics, their parameters must not get one.
        with hold_out_net(self.critic):
            q = self._actor_value(self.critic(observation, action))
        return F.actor_objective(log_prob, q, self.alpha).mean(), q.detach()

    def _imitation(
        self, policy: TanhNormal, tensordict: TensorDictBase, weights: Tensor | None = None
    ) -> Tensor:
        """Return the mean over the demonstration rows of their imitation errors ``[]``.

        Each is multiplied by its row's of the ``weights [B]``; the divisor is the number of rows.
        """
        action = tensordict[self.tensor_keys.action]
        is_demo = self._is_demo(tensordict)
        if is_demo is None:
            return action.new_zeros(())
        # Deviation: the paper scores recorded actions as they are. At the edge of tanh's range that
        # likelihood and its gradient explode; action_margin=1e-6, float32's limit, undoes this.
        action = F.clamp_to_support(action, self.action_margin)
        error = self._imitation_error(policy, action)
        if weights is not None:
            error = error * weights
        return F.masked_mean(error, is_demo)

    def _imitation_weights(self, policy: TanhNormal, tensordict: TensorDictBase) -> Tensor | None:
        """Return the factors ``[B]`` on the rows' imitation errors, ``None`` for 1."""
        weights = None
        if self.bc_emphasis is not None:
            weights = self.bc_emphasis(tensordict[self.tensor_keys.observation])
        if self.q_filter:
            worth = self._worth_imitating(policy, tensordict)
            weights = worth.float() if weights is None else weights * worth
        return weights

    @torch.no_grad()
    def _worth_imitating(self, policy: TanhNormal, tensordict: TensorDictBase) -> Tensor:
        """Return which rows' actions ``[B]`` the critics value above the policy's mean action."""
        observation = tensordict[self.tensor_keys.observation]
        shown, own = (
            self._actor_value(self.critic(observation, action))
            for action in (tensordict[self.tensor_keys.action], policy.deterministic_sample)
        )
        return (shown > own).squeeze(-1)

    def _is_demo(self, tensordict: TensorDictBase) -> Tensor | None:
        """Return the mask ``[B]`` of the demonstration rows, ``None`` if there are no marks."""
        mask = tensordict.get(self.tensor_keys.is_demo, None)
        return None if mask is None else mask.squeeze(-1)

    def _reinforcement_rows(self, tensordict: TensorDictBase) -> Rows | None:
        """Return the indices ``[R]`` of the rows for reinforcement, ``None`` for all of them.

        Where the demonstrations come last, as in the pipeline's batches, it is a slice, after
        which all are demonstrations: a view in place of a copy of every entry. Counting makes an
        accelerator's host wait, once: the price of not running the critics on rows that do not
        count. With ``rl_on_demos`` or ``main_rows`` there is nothing to count.

        Raises:
            ValueError: if there are no such rows.
        """
        is_demo = self._is_demo(tensordict)
        if self.rl_on_demos or is_demo is None:
            return None
        if self.main_rows is not None:
            return slice(self.main_rows)
        others = is_demo.logical_not()
        count, first_demo = torch.stack([others.sum(), is_demo.int().argmax()]).tolist()
        if count == 0:
            raise ValueError(
                "all rows of the batch are demonstrations, which leaves none for reinforcement: "
                "mix in other transitions, set rl_on_demos=True, or call bc_loss alone"
            )
        if count in (first_demo, len(others)):
            return slice(count)
        return others.nonzero().squeeze(-1)

    def _reinforcement_batch(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the transitions ``[R]`` that the reinforcement terms use."""
        rows = self._reinforcement_rows(tensordict)
        return tensordict if rows is None else tensordict[rows]


def _list_averaged(loss: BCSACLoss, _incompatible_keys: object = None) -> None:
    """List what ``update_target`` averages: looking for it takes longer than averaging it."""
    target, critic = loss.target_critic, loss.critic
    loss._averaged = list(target.parameters()), list(critic.parameters())
    loss._has_buffers = next(critic.buffers(), None) is not None


def _negative_action_size(actor: ProbabilisticActor) -> float:
    """Return minus the number of action dimensions that the actor's spec states."""
    action_key = actor[-1].out_keys[0]
    if actor.spec is None or actor.spec.get(action_key) is None:
        raise ValueError(
            "target_entropy='auto' needs the size of the action: build the actor with spec=, "
            "or give target_entropy as a number"
        )
    return -float(actor.spec[action_key].shape[-1])


def _require(name: str, value: object, holds: bool, expected: str) -> None:
    """Raise ``ValueError`` naming the argument unless ``holds``."""
    if not holds:
        raise ValueError(f"{name} must be {expected}, got {value!r}")
