"""What one batch teaches the networks: gradients, and what was measured on the way to them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from losses import BCSACLoss
from losses.terms import ActorTerms

Gradients = Sequence[Tensor]
"""One for each of the parameters that they belong to."""
Teaching = Callable[[TensorDictBase], tuple[dict[str, Tensor], Gradients]]
"""Detached scalars by name and gradients, from a batch; it changes nothing.

It decides nothing by a number that changes: what it reads besides the batch is tensors, so that it
can be compiled and recorded.
"""


class BCSACGradients:
    """The gradients of BC-SAC's objectives: :class:`Teaching` for the critics and the actor.

    Args:
        loss: Terms and networks.
        bc_weight: ``[]``, the weight of the imitation term.
        bc_gradient_ratio: See :class:`~pipeline.stepper.BCSACStepper`.
    """

    def __init__(
        self, loss: BCSACLoss, bc_weight: Tensor, bc_gradient_ratio: float | None = None
    ) -> None:
        self.loss = loss
        self.bc_weight = bc_weight
        self.bc_gradient_ratio = bc_gradient_ratio
        self.critic_parameters = learning(loss.critic.parameters())
        self.actor_parameters = learning(loss.actor.parameters())
        self.temperature = learning([loss.log_alpha])

    def critic(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """Of :attr:`critic_parameters`."""
        terms = self.loss.critic_terms(batch)
        gradients = torch.autograd.grad(terms.loss, self.critic_parameters)
        return {"loss_qvalue": terms.loss.detach(), "q_data": terms.q.mean()}, gradients

    def actor(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """Of :attr:`actor_parameters` and then of :attr:`temperature`."""
        return self._together(self.loss.actor_terms(batch))

    def actor_by_terms(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """The same as :meth:`actor`, with the two terms' gradients measured, or balanced."""
        terms = self.loss.actor_terms(batch)
        if not terms.bc.requires_grad:
            return self._together(terms)
        g_rl = torch.autograd.grad(terms.rl, self.actor_parameters, retain_graph=True)
        g_bc = torch.autograd.grad(terms.bc, self.actor_parameters)
        norm_rl, norm_bc = _norm(g_rl), _norm(g_bc)
        weight = self.bc_weight.clone()
        if self.bc_gradient_ratio is not None:
            weight = weight * norm_rl / norm_bc.clamp_min(1e-12)
        gradients = [rl + weight * bc for rl, bc in zip(g_rl, g_bc, strict=True)]
        found = {
            "grad_norm_rl": norm_rl,
            "grad_norm_bc": norm_bc,
            "grad_cosine": _dot(g_rl, g_bc) / (norm_rl * norm_bc).clamp_min(1e-12),
        }
        more, gradients = self._with_temperature(terms, weight, gradients)
        return found | more, gradients

    def _together(self, terms: ActorTerms) -> tuple[dict[str, Tensor], list[Tensor]]:
        objective = terms.rl + self.bc_weight * terms.bc
        gradients = torch.autograd.grad(objective, self.actor_parameters)
        return self._with_temperature(terms, self.bc_weight.clone(), gradients)

    def _with_temperature(
        self, terms: ActorTerms, weight: Tensor, gradients: Gradients
    ) -> tuple[dict[str, Tensor], list[Tensor]]:
        loss = self.loss.alpha_loss(terms.log_prob)
        own = torch.autograd.grad(loss, self.temperature) if self.temperature else ()
        found = {
            "loss_actor": terms.rl.detach(),
            "loss_alpha": loss.detach(),
            "bc_nll": terms.bc.detach(),
            "bc_weight": weight,
            "entropy": -terms.log_prob.mean(),
            "q_policy": terms.q.mean(),
        }
        return found, [*gradients, *own]


class ImitationGradients:
    """The gradient of the imitation term alone (paper III-B).

    Args:
        loss: Its imitation term and actor.
    """

    def __init__(self, loss: BCSACLoss) -> None:
        self.loss = loss
        self.actor_parameters = learning(loss.actor.parameters())

    def actor(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """Of :attr:`actor_parameters`, on demonstration rows."""
        loss = self.loss.bc_loss(batch)
        return {"loss_bc": loss.detach()}, torch.autograd.grad(loss, self.actor_parameters)


def learning(parameters: Iterable[nn.Parameter]) -> list[nn.Parameter]:
    """Those that are not frozen."""
    return [parameter for parameter in parameters if parameter.requires_grad]


def hand_over(parameters: Iterable[nn.Parameter], gradients: Iterable[Tensor]) -> None:
    """Put gradients where an optimizer looks for them."""
    for parameter, gradient in zip(parameters, gradients, strict=True):
        parameter.grad = gradient


def _norm(tensors: Iterable[Tensor]) -> Tensor:
    return torch.nn.utils.get_total_norm(tensors)


def _dot(left: Iterable[Tensor], right: Iterable[Tensor]) -> Tensor:
    return torch.stack([(a * b).sum() for a, b in zip(left, right, strict=True)]).sum()
