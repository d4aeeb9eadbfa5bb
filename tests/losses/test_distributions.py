"""The squashed normal: TorchRL's TanhNormal where that one is exact, and right where it is not."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor, TanhNormal

from losses import SquashedNormal

B, A = 3, 2
PROPERTY = settings(max_examples=60)

# Samples stay where 1 - tanh(u)^2 > 1e-6, or TanhNormal itself would lose the digits to compare.
LOCS = st.lists(st.floats(-2.0, 2.0), min_size=B * A, max_size=B * A)
SCALES = st.lists(st.floats(0.01, 1.0), min_size=B * A, max_size=B * A)
ACTIONS = st.lists(st.floats(-0.999, 0.999), min_size=B * A, max_size=B * A)
SEEDS = st.integers(0, 2**31)


def leaf(numbers: list[float]) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64).reshape(B, A).requires_grad_()


def both(locs: list[float], scales: list[float]) -> list[tuple]:
    """Ours and TorchRL's, each with parameters of its own."""
    made = []
    for kind, bounds in ((SquashedNormal, {}), (TanhNormal, {"low": -1.0, "high": 1.0})):
        loc, scale = leaf(locs), leaf(scales)
        made.append((kind(loc, scale, **bounds), loc, scale))
    return made


def weights(*shape: int) -> Tensor:
    """Different for each entry, so that a misplaced gradient shows."""
    return torch.arange(1.0, math.prod(shape) + 1.0, dtype=torch.float64).reshape(shape)


def test_the_density_by_hand() -> None:
    # a = 1/2 is tanh(u) for u = ln(3)/2, and 1 - a^2 = 3/4.
    u = math.log(3.0) / 2
    # One dimension, standard normal: -u^2/2 - ln(2 pi)/2 - ln(3/4)
    #     = -0.150868620 - 0.918938533 + 0.287682072 = -0.782125081.
    one = SquashedNormal(torch.zeros(1), torch.ones(1))
    assert one.log_prob(torch.tensor([0.5])).item() == pytest.approx(-0.782125081, abs=1e-9)
    # A second, at its mean with scale 2: -ln(2) - 0.918938533 + 0.287682072 = -1.324403642.
    two = SquashedNormal(torch.tensor([0.0, u]), torch.tensor([1.0, 2.0]))
    assert two.log_prob(torch.tensor([0.5, 0.5])).item() == pytest.approx(-2.106528723, abs=1e-9)


@PROPERTY
@given(locs=LOCS, scales=SCALES, seed=SEEDS)
def test_samples_and_their_densities_equal_tanh_normal_s(
    locs: list[float], scales: list[float], seed: int
) -> None:
    (ours, *mine), (theirs, *other) = both(locs, scales)
    torch.manual_seed(seed)
    action, log_prob = ours.rsample_and_log_prob()
    torch.manual_seed(seed)
    expected = theirs.rsample()
    expected_log_prob = theirs.log_prob(expected)
    torch.testing.assert_close(action, expected)
    torch.testing.assert_close(log_prob, expected_log_prob)
    torch.manual_seed(seed)
    assert torch.equal(ours.rsample(), action)

    def objective(action: Tensor, log_prob: Tensor) -> Tensor:
        return (weights(B, A) * action).sum() + (weights(B) * log_prob).sum()

    gradients = torch.autograd.grad(objective(action, log_prob), mine)
    expected_gradients = torch.autograd.grad(objective(expected, expected_log_prob), other)
    torch.testing.assert_close(gradients, expected_gradients, rtol=1e-6, atol=1e-8)


@PROPERTY
@given(locs=LOCS, scales=SCALES, actions=ACTIONS)
def test_densities_of_given_actions_equal_tanh_normal_s(
    locs: list[float], scales: list[float], actions: list[float]
) -> None:
    values, gradients = [], []
    for distribution, loc, scale in both(locs, scales):
        action = leaf(actions)
        log_prob = distribution.log_prob(action)
        values.append(log_prob)
        leaves = [loc, scale, action]
        gradients.append(torch.autograd.grad((weights(B) * log_prob).sum(), leaves))
    torch.testing.assert_close(*values)
    torch.testing.assert_close(*gradients)


@PROPERTY
@given(locs=LOCS, scales=SCALES)
def test_the_deterministic_action_equals_tanh_normal_s(
    locs: list[float], scales: list[float]
) -> None:
    values, gradients = [], []
    for distribution, loc, _ in both(locs, scales):
        action = distribution.deterministic_sample
        values.append(action)
        gradients.append(torch.autograd.grad((weights(B, A) * action).sum(), loc))
    torch.testing.assert_close(*values)
    torch.testing.assert_close(*gradients)


@pytest.mark.parametrize("loc", [0.0, -1.5])
@pytest.mark.parametrize("scale", [0.2, 1.0])
def test_the_density_integrates_to_one(loc: float, scale: float) -> None:
    actions = torch.linspace(-1.0, 1.0, 400_001)[1:-1]
    density = SquashedNormal(torch.tensor([loc]), torch.tensor([scale]))
    mass = torch.trapezoid(density.log_prob(actions.unsqueeze(-1)).exp(), actions)
    assert mass.item() == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_action_at_the_edge_has_the_density_of_the_closest_one_inside(
    sign: float, dtype: torch.dtype
) -> None:
    # a = 1 - 2^-24: u = ln((2 - 2^-24) 2^24) / 2 = 12.5 ln 2 = 8.664339757, 1 - a^2 = 2^-23;
    # -u^2/2 - ln(2 pi)/2 + 23 ln 2 = -37.535391712 - 0.918938533 + 15.942385153 = -22.511945092.
    loc = torch.zeros(1, dtype=dtype, requires_grad=True)
    scale = torch.ones(1, dtype=dtype, requires_grad=True)
    log_prob = SquashedNormal(loc, scale).log_prob(torch.tensor([sign], dtype=dtype))
    assert log_prob.dtype == dtype
    assert log_prob.item() == pytest.approx(-22.511945, abs=1e-4)
    by_loc, by_scale = torch.autograd.grad(log_prob, [loc, scale])
    # d/dloc = u / scale^2, d/dscale = (u^2 / scale^2 - 1) / scale.
    assert by_loc.item() == pytest.approx(sign * 8.6643398, rel=1e-5)
    assert by_scale.item() == pytest.approx(74.0707834, rel=1e-5)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_saturated_policy_keeps_its_density_and_gradient(sign: float, dtype: torch.dtype) -> None:
    loc = torch.full((A,), 20.0 * sign, dtype=dtype, requires_grad=True)
    scale = torch.full((A,), 0.5, dtype=dtype, requires_grad=True)
    torch.manual_seed(5)
    noise = torch.randn(A, dtype=dtype)
    torch.manual_seed(5)
    action, log_prob = SquashedNormal(loc, scale).rsample_and_log_prob()
    assert torch.equal(action, torch.full_like(action, sign))  # 1 - tanh(20)^2 is 1.7e-17
    # For large |u|, 1 - tanh(u)^2 is 4 exp(-2 |u|), to less than a part in 1e16.
    u = (loc + scale * noise).abs()
    normal = -(noise**2) / 2 - math.log(2 * math.pi) / 2 - math.log(0.5)
    torch.testing.assert_close(log_prob, (normal + 2 * u - math.log(4.0)).sum())
    by_loc, by_scale = torch.autograd.grad(log_prob, [loc, scale])
    torch.testing.assert_close(by_loc, torch.full_like(by_loc, 2.0 * sign))
    torch.testing.assert_close(by_scale, 2.0 * sign * noise - 2.0)  # -1/scale
    edge = SquashedNormal(loc, scale).log_prob(torch.full_like(loc, -sign))
    assert edge.isfinite()
    assert all(g.isfinite().all() for g in torch.autograd.grad(edge, [loc, scale]))


def test_shapes() -> None:
    distribution = SquashedNormal(torch.randn(B, A), torch.rand(B, A) + 0.1)
    assert distribution.batch_shape == (B,)
    assert distribution.event_shape == (A,)
    assert distribution.rsample().shape == (B, A)
    assert distribution.rsample((4, 5)).shape == (4, 5, B, A)
    assert distribution.sample(torch.Size([4])).shape == (4, B, A)
    action, log_prob = distribution.rsample_and_log_prob((4,))
    assert action.shape == (4, B, A)
    assert log_prob.shape == (4, B)
    torch.testing.assert_close(distribution.log_prob(action), log_prob)
    assert distribution.support.check(action).all()
    assert not distribution.support.check(2.0 * torch.ones(B, A)).any()


def test_a_sample_has_no_gradient() -> None:
    loc = torch.zeros(B, A, requires_grad=True)
    distribution = SquashedNormal(loc, torch.ones(B, A))
    assert not distribution.sample().requires_grad
    assert distribution.rsample().requires_grad


def test_it_computes_in_the_precision_of_its_parameters() -> None:
    distribution = SquashedNormal(torch.zeros(B, A).float(), torch.ones(B, A).float())
    parts = (*distribution.rsample_and_log_prob(), distribution.rsample())
    assert {part.dtype for part in parts} == {torch.float32}  # the default here is float64


def test_samples_have_the_distribution_s_moments() -> None:
    """u = atanh(a) is normal; the bounds are five standard errors of 20,000 samples."""
    distribution = SquashedNormal(torch.tensor([0.3, -0.2]), torch.tensor([0.5, 0.1]))
    before_tanh = distribution.sample((20_000,)).atanh()
    errors = (before_tanh.mean(0) - distribution.loc).abs() / distribution.scale
    assert (errors < 5 / math.sqrt(20_000)).all()
    spread = before_tanh.std(0) / distribution.scale
    assert ((spread - 1.0).abs() < 5 / math.sqrt(40_000)).all()


def test_an_actor_acts_with_it_as_it_is_told_to_explore() -> None:
    net = nn.Sequential(nn.Linear(3, 2 * A), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=SquashedNormal,
        return_log_prob=True,
    )
    observation = TensorDict({"observation": torch.randn(B, 3)}, [B])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        told = actor(observation.clone())
    assert torch.equal(told["action"], told["loc"].tanh())
    drawn = []
    with set_exploration_type(ExplorationType.RANDOM):
        for seed in (1, 1, 2):
            torch.manual_seed(seed)
            drawn.append(actor(observation.clone()))
    torch.manual_seed(1)
    noise = torch.randn(B, A)
    expected = (told["loc"] + told["scale"] * noise).tanh()
    torch.testing.assert_close(drawn[0]["action"], expected)
    assert torch.equal(drawn[0]["action"], drawn[1]["action"])
    assert not torch.equal(drawn[0]["action"], drawn[2]["action"])
    density = SquashedNormal(told["loc"], told["scale"]).log_prob(expected)
    torch.testing.assert_close(drawn[0]["action_log_prob"], density)
