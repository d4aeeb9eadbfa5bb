"""Networks: bounds, and that the batched critics are what separate ones would be."""

from __future__ import annotations

import math
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch.nn import functional as F

from pipeline.learn.critics import BatchedCritics, EnsembleLayerNorm, EnsembleLinear
from pipeline.learn.networks import (
    OBSERVATION_CLIP,
    GaussianHead,
    ObservationNormalizer,
    make_actor,
)

E, B, OBS, A = 3, 7, 5, 2


def member_value(critics: BatchedCritics, member: int, inputs: torch.Tensor) -> torch.Tensor:
    """What one member says, computed layer by layer with ordinary functions."""
    for layer in [*critics.hidden.layers, critics.head]:
        if isinstance(layer, EnsembleLinear):
            inputs = F.linear(inputs, layer.weight[member].T, layer.bias[member, 0])
        elif isinstance(layer, EnsembleLayerNorm):
            scale, shift = layer.weight[member, 0], layer.bias[member, 0]
            inputs = F.layer_norm(inputs, inputs.shape[-1:], scale, shift)
        else:
            inputs = layer(inputs)
    return inputs


def randomise(module: nn.Module) -> None:
    for parameter in module.parameters():
        nn.init.normal_(parameter)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_batched_critics_are_separate_networks(layer_norm: bool):
    critics = BatchedCritics(OBS, A, [6, 4], E, layer_norm=layer_norm)
    randomise(critics)
    observation, action = torch.randn(B, OBS), torch.randn(B, A)
    values = critics(observation, action)
    assert values.shape == (E, B, 1)
    for member in range(E):
        alone = member_value(critics, member, torch.cat([observation, action], -1))
        torch.testing.assert_close(values[member], alone)


def test_each_member_has_weights_of_its_own():
    weight = BatchedCritics(OBS, A, [6], E).hidden.layers[0].weight
    assert not torch.equal(weight[0], weight[1])
    # Orthogonal per member, not over the stacked tensor.
    torch.testing.assert_close(weight[0].T @ weight[0], torch.eye(6))


@pytest.mark.parametrize("layer_norm", [False, True])
def test_a_members_loss_reaches_no_other_member(layer_norm: bool):
    critics = BatchedCritics(OBS, A, [6, 4], E, layer_norm=layer_norm)
    critics(torch.randn(B, OBS), torch.randn(B, A))[1].sum().backward()
    for name, parameter in critics.named_parameters():
        assert parameter.grad is not None, name
        touched = parameter.grad.flatten(1).abs().sum(1) > 0
        assert touched.tolist() == [False, True, False], name


def test_paper_sizes():
    actor = make_actor(38, 28, [1024, 1024])
    critics = BatchedCritics(38, 28, [1024, 1024], 2)
    linear = [tuple(m.weight.shape) for m in actor.modules() if isinstance(m, nn.Linear)]
    assert linear == [(1024, 38), (1024, 1024), (56, 1024)]
    stacked = [tuple(m.weight.shape) for m in critics.modules() if isinstance(m, EnsembleLinear)]
    assert stacked == [(2, 66, 1024), (2, 1024, 1024), (2, 1024, 1)]


def test_log_std_stays_within_its_bounds_and_keeps_a_gradient():
    head = GaussianHead(-5.0, 2.0)
    features = torch.tensor([[0.3, -100.0], [0.4, 100.0], [0.5, 0.0], [0.6, 3.0]])
    features.requires_grad_()
    loc, scale = head(features)
    torch.testing.assert_close(loc.squeeze(-1), torch.tensor([0.3, 0.4, 0.5, 0.6]))
    log_std = scale.log().squeeze(-1)
    torch.testing.assert_close(log_std[:3], torch.tensor([-5.0, 2.0, -1.5]))
    scale[3].sum().backward()
    assert features.grad[3, 1] > 0


def test_the_bounds_of_log_std_must_be_in_order():
    with pytest.raises(ValueError, match=r"actor\.log_std_min \(2\.0\) must be below"):
        make_actor(OBS, A, [4], log_std_min=2.0, log_std_max=2.0)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_the_actor_writes_actions_inside_the_unit_box(layer_norm: bool):
    actor = make_actor(OBS, A, [6], layer_norm=layer_norm, log_std_min=-1.0, log_std_max=1.0)
    norms = [m for m in actor.modules() if isinstance(m, nn.LayerNorm)]
    assert [tuple(m.normalized_shape) for m in norms] == ([(6,)] if layer_norm else [])
    out = actor(TensorDict({"observation": 50 * torch.randn(100, OBS)}, [100]))
    assert out["action"].shape == (100, A)
    assert (out["action"].abs() <= 1).all()
    assert (out["scale"] >= math.exp(-1) * 0.999).all()
    assert (out["scale"] <= math.exp(1) * 1.001).all()


def test_normaliser_standardises_clips_and_floors():
    normalizer = ObservationNormalizer(
        torch.tensor([1.0, -2.0, 0.0]), torch.tensor([2.0, 4.0, 0.0])
    )
    scaled = normalizer(torch.tensor([[5.0, -6.0, 0.02], [1e6, -1e6, 0.0]]))
    floored = 0.02 / 1e-2
    expected = [[2.0, -1.0, floored], [OBSERVATION_CLIP, -OBSERVATION_CLIP, 0.0]]
    torch.testing.assert_close(scaled, torch.tensor(expected))


def test_identity_normaliser_only_clips():
    observation = torch.tensor([[0.3, -4.0, 9.0]])
    scaled = ObservationNormalizer.identity(3)(observation)
    torch.testing.assert_close(scaled, torch.tensor([[0.3, -4.0, OBSERVATION_CLIP]]))


def test_statistics_travel_with_the_weights():
    normalizer = ObservationNormalizer(torch.randn(OBS), torch.rand(OBS) + 0.5)
    trained = make_actor(OBS, A, [6], normalizer=normalizer)
    fresh = make_actor(OBS, A, [6], normalizer=ObservationNormalizer.identity(OBS))
    fresh.load_state_dict(trained.state_dict())
    observation = TensorDict({"observation": torch.randn(B, OBS)}, [B])
    torch.testing.assert_close(
        fresh.get_dist(observation).deterministic_sample,
        trained.get_dist(observation).deterministic_sample,
    )


@pytest.mark.parametrize("part", ["actor", "critic"])
def test_networks_look_through_their_normaliser(part: str):
    mean, std = torch.full((OBS,), 3.0), torch.full((OBS,), 2.0)
    normalizer = ObservationNormalizer(mean, std)
    observation, action = torch.randn(B, OBS), torch.randn(B, A)
    torch.manual_seed(1)
    if part == "actor":
        with_statistics = make_actor(OBS, A, [6], normalizer=normalizer)[0].module
        torch.manual_seed(1)
        without = make_actor(OBS, A, [6])[0].module
        seen, expected = with_statistics(observation)[0], without((observation - mean) / std)[0]
    else:
        with_statistics = BatchedCritics(OBS, A, [6], E, normalizer=normalizer)
        torch.manual_seed(1)
        without = BatchedCritics(OBS, A, [6], E)
        seen = with_statistics(observation, action)
        expected = without((observation - mean) / std, action)
    torch.testing.assert_close(seen, expected)


def test_an_empty_ensemble_is_refused():
    with pytest.raises(ValueError, match=r"critic\.num_critics must be at least 1, got 0"):
        BatchedCritics(OBS, A, [4], 0)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_named_members_alone_give_their_own_values(layer_norm: bool):
    critics = BatchedCritics(OBS, A, [6, 4], E, layer_norm=layer_norm)
    randomise(critics)
    observation, action = torch.randn(B, OBS), torch.randn(B, A)
    members = torch.tensor([2, 0])
    torch.testing.assert_close(
        critics(observation, action, members=members), critics(observation, action)[members]
    )


# ------------------------------------------------------------------- hidden layers in bfloat16


def both_precisions(part: str, layer_norm: bool) -> list[nn.Module]:
    """The same network twice, its hidden layers in float32 and in bfloat16."""
    made = []
    for dtype in (None, torch.bfloat16):
        torch.manual_seed(2)
        options = {"layer_norm": layer_norm, "hidden_dtype": dtype}
        if part == "actor":
            made.append(make_actor(OBS, A, [64, 64], **options))
        else:
            made.append(BatchedCritics(OBS, A, [64, 64], E, **options))
    return made


def outputs(network: nn.Module) -> list[torch.Tensor]:
    torch.manual_seed(3)
    observation, action = torch.randn(50, OBS), torch.rand(50, A)
    if isinstance(network, BatchedCritics):
        return [network(observation, action)]
    return list(network[0].module(observation))


def flat_gradient(network: nn.Module) -> torch.Tensor:
    sum((output**2).mean() for output in outputs(network)).backward()
    return torch.cat([parameter.grad.flatten() for parameter in network.parameters()])


@pytest.mark.parametrize("layer_norm", [False, True])
@pytest.mark.parametrize("part", ["actor", "critic"])
def test_hidden_layers_in_bfloat16_are_close_and_all_else_stays_float32(
    part: str, layer_norm: bool
):
    """bfloat16 keeps 8 bits: each of two layers errs by about 2^-8 of its largest output."""
    plain, rounded = both_precisions(part, layer_norm)
    for exact, near in zip(outputs(plain), outputs(rounded), strict=True):
        assert near.dtype == exact.dtype == torch.float32
        error = (near - exact).abs().max() / exact.abs().max()
        assert 1e-5 < error < 2e-2  # rounded it is, but no more than that
    exact, near = flat_gradient(plain), flat_gradient(rounded)
    assert near.dtype == torch.float32
    assert (near - exact).norm() / exact.norm() < 4e-2
    assert {p.dtype for p in rounded.parameters()} == {torch.float32}
    assert {p.grad.dtype for p in rounded.parameters()} == {torch.float32}


def note_dtype(seen: list[torch.dtype], _layer: nn.Module, _inputs: tuple, output) -> None:
    seen.append(output.dtype)


@pytest.mark.parametrize("part", ["actor", "critic"])
def test_a_hidden_layer_really_multiplies_in_its_precision(part: str):
    """Inside, products are bfloat16; the last layer and everything behind it are not."""
    precisions = (torch.float32, torch.bfloat16)
    for network, expected in zip(both_precisions(part, False), precisions, strict=True):
        products: list[torch.dtype] = []
        for layer in network.modules():
            if isinstance(layer, (nn.Linear, EnsembleLinear)):
                layer.register_forward_hook(partial(note_dtype, products))
        outputs(network)
        assert products == [expected, expected, torch.float32]


def test_the_distribution_of_a_bfloat16_actor_is_float32():
    _, actor = both_precisions("actor", layer_norm=False)
    distribution = actor.get_dist(TensorDict({"observation": torch.randn(B, OBS)}, [B]))
    action, log_prob = distribution.rsample_and_log_prob()
    tensors = (distribution.loc, distribution.scale, action, log_prob)
    assert {tensor.dtype for tensor in tensors} == {torch.float32}


@pytest.mark.parametrize("part", ["actor", "critic"])
def test_weights_trained_in_one_precision_load_in_the_other(part: str):
    plain, rounded = both_precisions(part, layer_norm=True)
    assert list(plain.state_dict()) == list(rounded.state_dict())
    randomise(rounded)
    plain.load_state_dict(rounded.state_dict())
    for one, other in zip(plain.parameters(), rounded.parameters(), strict=True):
        assert torch.equal(one, other)
