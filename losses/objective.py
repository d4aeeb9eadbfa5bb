"""A list of terms as one loss module."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from copy import deepcopy
from functools import cache
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import LossModule

from losses.batch import OPTIONAL, Batch, BatchKeys, location, reinforcement_rows
from losses.composition import Composition
from losses.ensemble import CriticEnsemble
from losses.passes import ActorPass, CriticPass
from losses.policy import Rows
from losses.settings import require
from losses.temperature import Temperature
from losses.terms import ActorTerms, CriticTerms, Term, TermValue, weighted

averaging = cache(get_ema_multi_avg_fn)
"""The averaging function of torch's ``AveragedModel``, without that class: its first update copies
instead of averaging, and each update reads a counter back from the device. It is kept outside the
loss because an object that holds a local function cannot be pickled."""


class Objective(LossModule):
    """Networks, and the terms that train them: their sum, each times its weight, is minimised.

    All terms are computed on one flat batch ``[B]``. Rows marked ``is_demo`` are samples of the
    demonstration distribution D. Reinforcement terms use the other rows, or all rows with
    ``rl_on_demos``. The gradient of a term reaches only the network that it trains, so the
    backward passes may be made together or one by one, in any order::

        Objective(actor, critic, [
            SoftTD(gamma=0.995, entropy=False), SoftValue("min"),
            Temperature(init=0.01, target_entropy=-45),
            Imitation("nll", weight=CosineWeight(1.0, 0.1, 20_000)),
        ])

    The batch is never written to. :class:`~losses.batch.BatchKeys` lists its entries, which
    ``set_keys`` renames.

    Args:
        actor: policy over one observation key with a ``TanhNormal``-like distribution on (-1, 1).
        critic: module ``(observation [B, O], action [B, A]) -> [E, B, 1]``, or a list of modules
            that return ``[B, 1]`` each. If the module has ``num_critics`` and its ``forward``
            also takes ``members [M]``, a target runs only the critics of its random subset.
        terms: each with another name.
        rl_on_demos: whether reinforcement terms use the demonstration rows too.
        main_rows: number of rows before the demonstrations, if it is the same in every batch with
            marks; ``None`` counts them in each, for which the host of an accelerator must wait.

    Raises:
        ValueError: for terms that cannot be combined (:class:`~losses.composition.Composition`),
            or an actor with more than one input.
    """

    _AcceptedKeys = BatchKeys
    default_keys = BatchKeys
    tensor_keys: BatchKeys
    log_alpha: nn.Parameter
    _averaged: tuple[list[nn.Parameter], list[nn.Parameter]]
    _has_buffers: bool

    def __init__(
        self,
        actor: ProbabilisticActor,
        critic: nn.Module | Sequence[nn.Module],
        terms: Sequence[Term],
        *,
        rl_on_demos: bool = False,
        main_rows: int | None = None,
    ) -> None:
        super().__init__()
        require("main_rows", main_rows, main_rows is None or main_rows >= 1, "None or >= 1")
        require("actor", actor.in_keys, len(actor.in_keys) == 1, "a policy with one input key")
        self.composition = Composition(terms).resolved(actor)
        self.actor = actor
        self.critic = critic if isinstance(critic, nn.Module) else CriticEnsemble(critic)
        self.target_critic = deepcopy(self.critic).requires_grad_(False)
        # Without one that learns it, it is there all the same: one layout of the state for all.
        temperature = self.composition.temperature or Temperature(learn=False)
        self.log_alpha = nn.Parameter(
            torch.tensor(math.log(temperature.init), device=next(actor.parameters()).device),
            requires_grad=temperature.learn,
        )
        self.rl_on_demos = rl_on_demos
        self.main_rows = main_rows
        # A Python number, not a buffer: on an accelerator, reading one would be a wait per update.
        self.updates = 0
        takes_members = "members" in inspect.signature(self.critic.forward).parameters
        self.ensemble_size = getattr(self.critic, "num_critics", None) if takes_members else None
        self.out_keys = self.composition.out_keys
        _list_averaged(self)
        # Loading with assign=True puts other parameters in their place.
        self.register_load_state_dict_post_hook(_list_averaged)

    # ---------------------------------------------------------------- terms, each callable alone

    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute all terms of a flat batch at the present parameters.

        Args:
            tensordict: ``[B]`` with :attr:`in_keys`.

        Returns:
            Scalars under :attr:`out_keys`. The ``loss_*`` entries are the losses times their
            weights; their sum is minimised. All other entries are detached: the weights, the
            losses without them, and the means of what the terms measure.
        """
        found: dict[str, Tensor] = {}
        critic, actor = self.critic_terms(tensordict), self.actor_terms(tensordict)
        values: dict[str, TermValue] = {**critic.values, **actor.values}
        temperature = self.composition.temperature
        if temperature is not None and actor.log_prob is not None:
            values[temperature.name] = temperature(actor.log_prob, self.log_alpha)
        for name, value in values.items():
            term = self.composition[name]
            weight = None if term.weight is None else self.weight_of(name)
            found |= {key: tensor.mean() for key, tensor in value.measured.items()}
            found[term.loss_key] = weighted(value, weight)
            if weight is not None:
                found[term.metric] = value.loss.detach()
                found[term.weight_metric] = torch.full_like(value.loss.detach(), weight)
        found |= self.after_step()
        return TensorDict({key: found[key] for key in self.out_keys})

    def critic_terms(self, tensordict: TensorDictBase) -> CriticTerms:
        """Compute the critics' terms on the rows for reinforcement.

        Args:
            tensordict: ``[B]`` with what these terms read.
        """
        seen = CriticPass(self, self._reinforcement_batch(tensordict))
        return CriticTerms({term.name: term(seen) for term in self.composition.of_critic})

    def actor_terms(self, tensordict: TensorDictBase) -> ActorTerms:
        """Compute the terms of the actor's objective with one forward pass of the actor.

        Args:
            tensordict: ``[B]`` with what these terms read.
        """
        batch = self.batch(tensordict)
        reinforces = self.composition.reference is not None
        seen = ActorPass(self, batch, self._reinforcement_rows(batch) if reinforces else None)
        values = {term.name: term(seen) for term in self.composition.of_actor}
        return ActorTerms(values, seen.sample.log_prob.detach() if reinforces else None)

    def bc_loss(self, tensordict: TensorDictBase) -> Tensor:
        """Return the mean error ``[]`` of the first term that imitates, without row weights.

        No critic is run. If the term has no row weights, it is its loss in :meth:`actor_terms`.

        Raises:
            ValueError: if no term imitates.
        """
        errors = self.demonstration_errors(tensordict)
        if not errors:
            raise ValueError("bc_loss needs a term that imitates: add Imitation() to the terms")
        return next(iter(errors.values()))

    def demonstration_errors(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return :meth:`bc_loss` of every term that imitates, by the name of its metric."""
        seen = ActorPass(self, self.batch(tensordict))
        terms = self.composition.of_actor
        errors = ((term.metric, term.demonstration_error(seen)) for term in terms)
        return {metric: error for metric, error in errors if error is not None}

    def alpha_loss(self, batch: TensorDictBase | Tensor) -> Tensor:
        """Compute the temperature's loss ``[]``.

        Args:
            batch: ``[B]`` transitions, on which the policy is sampled, or the log-densities
                ``[R]`` of actions sampled already (:attr:`ActorTerms.log_prob`).

        Raises:
            ValueError: if the objective has no temperature.
        """
        temperature = self.composition.temperature
        if temperature is None:
            raise ValueError("alpha_loss needs a temperature: add Temperature() to the terms")
        if not isinstance(batch, Tensor):
            with torch.no_grad():
                batch = ActorPass(self, self._reinforcement_batch(batch)).sample.log_prob
        return temperature(batch, self.log_alpha).loss

    # ------------------------------------------------------------------------ state between calls

    @property
    def alpha(self) -> Tensor:
        """The temperature ``[]``, detached."""
        return self.log_alpha.detach().exp()

    def weight_of(self, name: str) -> float:
        """Return a term's weight at the present number of updates, before its rule."""
        return self.composition[name].weight_at(self.updates)

    def configure(self, name: str, /, **settings: Any) -> None:
        """Change settings of the term ``name``, from the next call on.

        Compiled or recorded updates keep the settings that they were made with, except for
        ``weight``.

        Raises:
            ValueError: for an unknown term, a change of its name, or a value outside its range.
            TypeError: for a setting that the term does not have.
        """
        self.composition = self.composition.with_settings(name, **settings)

    def after_step(self) -> dict[str, Tensor]:
        """Return the detached scalars ``[]`` that the terms log about the state after an update."""
        found: dict[str, Tensor] = {}
        for term in self.composition.terms:
            found |= term.after_step(self)
        return found

    def advance(self) -> None:
        """Count one update, by which the schedules of the weights move on."""
        self.updates += 1

    @torch.no_grad()
    def update_target(self) -> None:
        """Move the target critics towards the critics by ``tau``, and copy the critics' buffers.

        Buffers hold statistics, of a normalisation for example, whose average would be wrong.
        Without a term that has a ``tau``, nothing happens.
        """
        tau = self.composition.tau
        if tau is None:
            return
        averaging(1.0 - tau)(*self._averaged, None)
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
        """The entries that a batch must have: what the terms read and cannot do without.

        What a function given to a term reads (``bc_emphasis``, say) is not known here.
        """
        read = (name for term in self.composition.terms for name in term.reads)
        needed = dict.fromkeys(name for name in read if name not in OPTIONAL)
        return [location(name, self.tensor_keys) for name in needed]

    @property
    def functional(self) -> bool:
        """False: networks are held as ordinary modules."""
        return False

    # ----------------------------------------------------------------------------- shared pieces

    def batch(self, tensordict: TensorDictBase) -> Batch:
        """Return ``tensordict [B]`` as a :class:`~losses.batch.Batch` for the terms."""
        return Batch(tensordict, self.tensor_keys)

    def _reinforcement_rows(self, batch: Batch) -> Rows | None:
        """Return the R rows for reinforcement, ``None`` for all of them."""
        return None if self.rl_on_demos else reinforcement_rows(batch, self.main_rows)

    def _reinforcement_batch(self, tensordict: TensorDictBase) -> Batch:
        """Return the transitions ``[R]`` for reinforcement."""
        batch = self.batch(tensordict)
        rows = self._reinforcement_rows(batch)
        return batch if rows is None else batch[rows]


def _list_averaged(loss: Objective, _incompatible_keys: object = None) -> None:
    """List what ``update_target`` averages: looking for it takes longer than averaging it."""
    target, critic = loss.target_critic, loss.critic
    loss._averaged = list(target.parameters()), list(critic.parameters())
    loss._has_buffers = next(critic.buffers(), None) is not None
