"""A policy called on tensors is the policy that TorchRL calls on tensordicts."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import (
    NormalParamExtractor,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictSequential,
)
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor, TanhDelta, TanhNormal

from losses import SquashedNormal, policy
from losses.policy import policy_distribution
from tests.losses.toys import ACTION_SIZE, OBSERVATION_SIZE, make_actor

PARAMETERS = ("loc", "scale")


def network() -> nn.Sequential:
    return nn.Sequential(nn.Linear(OBSERVATION_SIZE, 2 * ACTION_SIZE), NormalParamExtractor())


class Named(nn.Module):
    """Its parameters come by name, and by another method, and with the input in second place."""

    def __init__(self) -> None:
        super().__init__()
        self.net = network()

    def forward(self, scaled_by: float = 1.0, observation: Tensor | None = None) -> tuple:
        loc, scale = self.net(observation)
        return loc * scaled_by, scale

    def swapped(self, observation: Tensor) -> tuple:
        loc, scale = self.net(observation)
        return scale, loc.exp()


class ScaleFirst(Named):
    def forward(self, observation: Tensor) -> tuple:
        loc, scale = self.net(observation)
        return scale, loc


class ByName(Named):
    def forward(self, observation: Tensor) -> dict[str, Tensor]:
        loc, scale = self.net(observation)
        return {"scale": scale, "loc": loc}


def head(net: TensorDictModule, in_keys: object = PARAMETERS, **options: object):
    keys = list(in_keys) if isinstance(in_keys, tuple) else in_keys
    options.setdefault("distribution_class", SquashedNormal)
    return ProbabilisticActor(net, in_keys=keys, **options)


def nested(named: bool) -> ProbabilisticActor:
    keys = [("head", key) for key in PARAMETERS]
    in_keys = dict(zip(PARAMETERS, keys, strict=True)) if named else keys
    return head(TensorDictModule(network(), ["observation"], keys), in_keys)


def three_modules(key: str = "observation") -> ProbabilisticActor:
    trunk = nn.Linear(OBSERVATION_SIZE, OBSERVATION_SIZE)
    modules = TensorDictSequential(
        TensorDictModule(trunk, [key], ["features"]),
        TensorDictModule(network(), ["features"], list(PARAMETERS)),
    )
    return head(modules)


def corrected_afterwards() -> ProbabilisticTensorDictSequential:
    """Its first module writes all parameters, but has not the last word on them."""
    actor = make_actor()
    shift = TensorDictModule(nn.Linear(ACTION_SIZE, ACTION_SIZE), ["loc"], ["loc"])
    return ProbabilisticTensorDictSequential(actor[0], shift, actor[-1])


def other_bounds() -> ProbabilisticActor:
    net = TensorDictModule(network(), ["observation"], list(PARAMETERS))
    bounds = {"low": -3.0, "high": 2.0}
    return head(net, distribution_class=TanhNormal, distribution_kwargs=bounds)


def one_parameter() -> ProbabilisticActor:
    net = TensorDictModule(nn.Linear(OBSERVATION_SIZE, ACTION_SIZE), ["observation"], ["param"])
    return head(net, ("param",), distribution_class=TanhDelta)


def another_order() -> ProbabilisticActor:
    return head(TensorDictModule(ScaleFirst(), ["observation"], ["scale", "loc"]))


def renamed_input() -> ProbabilisticActor:
    keys = {"observation": "observation"}
    return head(TensorDictModule(Named(), keys, list(PARAMETERS)))


def another_method() -> ProbabilisticActor:
    net = TensorDictModule(Named(), ["observation"], list(PARAMETERS), method="swapped")
    return head(net)


def with_method_options() -> ProbabilisticActor:
    class Scaled(Named):
        def forward(self, observation: Tensor, scaled_by: float = 1.0) -> tuple:
            return super().forward(scaled_by, observation)

    options = {"scaled_by": 3.0}
    return head(
        TensorDictModule(Scaled(), ["observation"], list(PARAMETERS), method_kwargs=options)
    )


def outputs_by_name() -> ProbabilisticActor:
    return head(TensorDictModule(ByName(), ["observation"], list(PARAMETERS)))


class Wrapped(TensorDictModule):
    """Changes what is written: its network's outputs are not its own."""

    def forward(self, tensordict: TensorDict, **options: object) -> TensorDict:
        out = super().forward(tensordict, **options)
        return out.set("loc", out["loc"] + 1.0)


def subclass() -> ProbabilisticActor:
    return head(Wrapped(network(), ["observation"], list(PARAMETERS)))


ON_TENSORS = {
    "ordinary": make_actor,
    "nested keys": lambda: nested(named=False),
    "nested keys by name": lambda: nested(named=True),
    "other bounds": other_bounds,
    "one parameter": one_parameter,
}
ON_TENSORDICTS = {
    "three modules": three_modules,
    "corrected afterwards": corrected_afterwards,
    "another order": another_order,
    "input by name": renamed_input,
    "another method": another_method,
    "method options": with_method_options,
    "outputs by name": outputs_by_name,
    "subclass": subclass,
}


def values(distribution: torch.distributions.Distribution) -> list[Tensor]:
    """What makes a distribution: its sample and, where it has one, the density of that."""
    torch.manual_seed(3)
    sample = distribution.rsample()
    return [distribution.deterministic_sample, sample, distribution.log_prob(sample.detach())]


@pytest.mark.parametrize("make", [*ON_TENSORS.values(), *ON_TENSORDICTS.values()], ids=[
    *ON_TENSORS, *ON_TENSORDICTS
])  # fmt: skip
def test_it_is_the_distribution_of_the_actor(make: Callable[[], ProbabilisticActor]) -> None:
    actor = make()
    observation = torch.randn(7, OBSERVATION_SIZE)
    found = policy_distribution(actor, observation)
    expected = actor.get_dist(TensorDict({"observation": observation}, [7]))
    assert type(found) is type(expected)
    total, expected_total = 0.0, 0.0
    for one, other in zip(values(found), values(expected), strict=True):
        assert torch.equal(one, other)
        total, expected_total = total + one.sum(), expected_total + other.sum()
    parameters = list(actor.parameters())
    gradients = torch.autograd.grad(total, parameters)
    for mine, other in zip(gradients, torch.autograd.grad(expected_total, parameters), strict=True):
        torch.testing.assert_close(mine, other)


@pytest.mark.parametrize("make", ON_TENSORS.values(), ids=ON_TENSORS)
def test_an_ordinary_actor_needs_no_tensordict(
    make: Callable[[], ProbabilisticActor], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_arguments: object, **_options: object) -> None:
        raise AssertionError("a tensordict was built")

    monkeypatch.setattr(policy, "TensorDict", refused)
    actor = make()
    monkeypatch.setattr(type(actor), "get_dist", refused)
    policy_distribution(actor, torch.randn(7, OBSERVATION_SIZE))


def test_the_parameters_of_an_ordinary_actor_are_its_network_s() -> None:
    actor = make_actor()
    observation = torch.randn(7, OBSERVATION_SIZE)
    loc, scale = actor[0].module(observation)
    found = policy_distribution(actor, observation)
    assert torch.equal(found.loc, loc)
    assert torch.equal(found.scale, scale)


def test_the_observation_may_have_another_name() -> None:
    for actor in (make_actor("state"), make_actor(("agent", "state")), three_modules("state")):
        observation = torch.randn(7, OBSERVATION_SIZE)
        (key,) = actor.in_keys
        expected = actor.get_dist(TensorDict({key: observation}, [7]))
        assert torch.equal(policy_distribution(actor, observation).loc, expected.loc)
