"""What one batch teaches the networks: gradients, and what was measured on the way to them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from losses import ActorTerms, Objective
from losses.rules import WeightRule
from losses.terms import TermValue, total

Gradients = Sequence[Tensor]
"""One for each of the parameters that they belong to."""
Teaching = Callable[[TensorDictBase], tuple[dict[str, Tensor], Gradients]]
"""Detached scalars by name and gradients, from a batch; it changes nothing.

It decides nothing by a number that changes: what it reads besides the batch is tensors, so that it
can be compiled and recorded.
"""


class Weights:
    """The terms' weights as tensors ``[]``, which a compiled or recorded update reads anew.

    Args:
        loss: Terms, whose rules are read once.
    """

    def __init__(self, loss: Objective) -> None:
        terms = loss.composition
        self.loss = loss
        self.rules: dict[str, WeightRule] = {
            term.name: term.rule for term in terms.of_actor if term.rule is not None
        }
        self.tensors = {
            term.name: torch.zeros((), device=loss.log_alpha.device)
            for term in terms.terms
            if term.weight is not None
        }

    def update(self) -> None:
        """Read the schedules at the loss's present number of updates."""
        for name, weight in self.tensors.items():
            rule = self.rules.get(name)
            weight.fill_(self.loss.weight_of(name) * (1.0 if rule is None else rule.factor))

    def of(self, values: Mapping[str, TermValue]) -> dict[str, Tensor]:
        """Copies of those of some terms, without what their rules make of them."""
        return {name: self.tensors[name].clone() for name in values if name in self.tensors}


class ObjectiveGradients:
    """The gradients of an objective's terms: :class:`Teaching` for the critics and the actor.

    Args:
        loss: Terms and networks.
        weights: Of the terms.

    Raises:
        ValueError: If no term trains the critics, or none the actor.
    """

    def __init__(self, loss: Objective, weights: Weights) -> None:
        self.loss = loss
        self.terms = loss.composition
        self.weights = weights
        for what, terms, example in (
            ("critics", self.terms.of_critic, "SoftTD()"),
            ("actor", self.terms.of_actor, "SoftValue()"),
        ):
            if not terms:
                raise ValueError(f"no term of the objective trains the {what}: add {example}.")
        self.critic_parameters = learning(loss.critic.parameters())
        self.actor_parameters = learning(loss.actor.parameters())
        self.temperature = learning([loss.log_alpha])

    def critic(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """Of :attr:`critic_parameters`."""
        values = self.loss.critic_terms(batch).values
        gradients = torch.autograd.grad(total(values, self.weights.tensors), self.critic_parameters)
        return self._logged(values, self.weights.of(values)), gradients

    def actor(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """Of :attr:`actor_parameters` and then of :attr:`temperature`."""
        return self._together(self.loss.actor_terms(batch))

    def actor_by_terms(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """The same as :meth:`actor`, with the terms' gradients measured, and ruled by."""
        terms = self.loss.actor_terms(batch)
        reference = self.terms.reference
        # A term of which the batch says nothing is a constant.
        live = [name for name, value in terms.values.items() if value.loss.requires_grad]
        if reference is None or reference.name not in live or len(live) == 1:
            return self._together(terms)
        gradients = {
            name: torch.autograd.grad(
                terms.values[name].loss,
                self.actor_parameters,
                retain_graph=name != live[-1],
                materialize_grads=True,
            )
            for name in live
        }
        norms = {name: _norm(of_one) for name, of_one in gradients.items()}
        weights = self.weights.of(terms.values)
        for name, rule in self.weights.rules.items():
            if name in gradients:
                weights[name] = rule(weights[name], norms[reference.name], norms[name])
        found = self._compared(gradients, norms, reference.name)
        more, others = self._with_temperature(terms, weights, _sum(gradients, weights))
        return found | more, others

    def _together(self, terms: ActorTerms) -> tuple[dict[str, Tensor], list[Tensor]]:
        objective = total(terms.values, self.weights.tensors)
        gradients = torch.autograd.grad(objective, self.actor_parameters)
        return self._with_temperature(terms, self.weights.of(terms.values), gradients)

    def _with_temperature(
        self, terms: ActorTerms, weights: Mapping[str, Tensor], gradients: Gradients
    ) -> tuple[dict[str, Tensor], list[Tensor]]:
        found = self._logged(terms.values, weights)
        temperature = self.terms.temperature
        if temperature is None or terms.log_prob is None:
            return found, [*gradients]
        loss = self.loss.alpha_loss(terms.log_prob)
        own = torch.autograd.grad(loss, self.temperature) if self.temperature else ()
        return found | {temperature.metric: loss.detach()}, [*gradients, *own]

    def _logged(
        self, values: Mapping[str, TermValue], weights: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        found = {}
        for name, value in values.items():
            term = self.terms[name]
            found[term.metric] = value.loss.detach()
            found |= {key: value.measured[key].mean() for key in term.logs}
            if name in weights:
                found[term.weight_metric] = weights[name]
        return found

    def _compared(
        self, gradients: Mapping[str, Gradients], norms: Mapping[str, Tensor], reference: str
    ) -> dict[str, Tensor]:
        found = {self.terms[name].norm_metric: norm for name, norm in norms.items()}
        for name in gradients:
            if name != reference:
                dot = _dot(gradients[reference], gradients[name])
                size = norms[reference] * norms[name]
                found[self.terms[name].cosine_metric] = dot / size.clamp_min(1e-12)
        return found


class ImitationGradients:
    """The gradient of the imitation term alone (paper III-B).

    Args:
        loss: Its imitation term and actor.
    """

    def __init__(self, loss: Objective) -> None:
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


def _sum(gradients: Mapping[str, Gradients], weights: Mapping[str, Tensor]) -> Gradients:
    first, *others = [
        [weights[name] * gradient for gradient in of_one] if name in weights else of_one
        for name, of_one in gradients.items()
    ]
    for other in others:
        first = [one + more for one, more in zip(first, other, strict=True)]
    return first


def _norm(tensors: Iterable[Tensor]) -> Tensor:
    return torch.nn.utils.get_total_norm(tensors)


def _dot(left: Iterable[Tensor], right: Iterable[Tensor]) -> Tensor:
    return torch.stack([(a * b).sum() for a, b in zip(left, right, strict=True)]).sum()
