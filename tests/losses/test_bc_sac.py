"""BCSACLoss: which rows and which network each term belongs to, its options and its state."""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from dataclasses import fields

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torch import nn
from torch.overrides import TorchFunctionMode

from losses import BCSACLoss, CriticEnsemble, ExponentialWeight, SelfImitation, SquashedNormal
from losses.batch import BatchKeys
from tests.losses.toys import (
    ConstantCritics,
    Critic,
    gradients,
    make_actor,
    make_batch,
    make_full_batch,
    make_loss,
    q_of,
)


def moves(loss: torch.Tensor, module: nn.Module) -> bool:
    return any(bool(gradient.any()) for gradient in gradients(loss, module))


# ------------------------------------------------------------- each term reaches its own network

MATRIX = {
    "loss_qvalue": {"critic"},
    "loss_actor": {"actor"},
    "loss_bc": {"actor"},
    "loss_alpha": {"temperature"},
}


@pytest.mark.parametrize(("name", "reached"), MATRIX.items())
def test_gradient_independence(name: str, reached: set[str]) -> None:
    loss = make_loss()
    term = loss(make_batch(12, demo_rows=4))[name]
    temperature = nn.ParameterList([loss.log_alpha])
    networks = {"actor": loss.actor, "critic": loss.critic, "temperature": temperature}
    assert {network for network, module in networks.items() if moves(term, module)} == reached
    assert all(not p.requires_grad for p in loss.target_critic.parameters())


def test_the_critic_learns_again_after_the_actor_s_turn() -> None:
    """Holding the critic out of the actor's graph must not outlive the call."""
    loss = make_loss()
    loss.actor_terms(make_batch(4, demo_rows=0))
    assert all(p.requires_grad for p in loss.critic.parameters())


def test_every_diagnostic_is_detached_and_every_key_is_announced() -> None:
    loss = make_loss()
    terms = loss(make_batch(12, demo_rows=4))
    assert list(terms.keys()) == loss.out_keys
    for name, value in terms.items():
        assert value.shape == ()
        assert value.requires_grad == name.startswith("loss_"), name


# ------------------------------------------------------------------------------- rows and means


@pytest.mark.parametrize("rl_on_demos", [False, True])
def test_reinforcement_uses_demonstrations_only_when_told(rl_on_demos: bool) -> None:
    loss = make_loss(rl_on_demos=rl_on_demos)
    batch = make_batch(12, demo_rows=4)
    spoiled = batch.clone()
    spoiled["next", "reward"][-4:] = math.nan
    assert loss.qvalue_loss(spoiled).isnan().item() == rl_on_demos
    terms = loss.actor_terms(batch)
    assert terms.log_prob.shape == (12 if rl_on_demos else 8,)
    q_policy = terms.values["rl"].measured["q_policy"]
    assert q_policy.shape == (*terms.log_prob.shape, 1)
    assert q_of(loss, batch).shape == (2, *q_policy.shape)


@pytest.mark.parametrize("rl_on_demos", [False, True])
def test_each_half_of_the_actor_s_objective_depends_on_its_own_rows(rl_on_demos: bool) -> None:
    """Densities, values and imitation errors, all read off the gradient of the states."""
    loss = make_loss(rl_on_demos=rl_on_demos)
    batch = make_batch(12, demo_rows=4)[torch.randperm(12)]
    batch["observation"].requires_grad_()
    is_demo = batch["is_demo"].squeeze(-1)
    terms = loss.actor_terms(batch)
    by_rl, by_bc = (
        torch.autograd.grad(half, batch["observation"], retain_graph=True)[0].any(-1)
        for half in (terms.values["rl"].loss, terms.values["bc"].loss)
    )
    assert torch.equal(by_bc, is_demo)
    assert torch.equal(by_rl, torch.ones_like(is_demo) if rl_on_demos else ~is_demo)


def test_leaving_rows_out_keeps_states_actions_and_densities_together() -> None:
    """With one draw of actions, the chosen rows have the values that they have among all."""
    loss = make_loss(rl_on_demos=True)
    batch = make_batch(12, demo_rows=4)[torch.randperm(12)]
    others = ~batch["is_demo"].squeeze(-1)
    torch.manual_seed(1)
    among_all = loss.actor_terms(batch)
    loss.rl_on_demos = False
    torch.manual_seed(1)
    alone = loss.actor_terms(batch)
    torch.testing.assert_close(
        alone.values["rl"].measured["q_policy"],
        among_all.values["rl"].measured["q_policy"][others],
    )
    torch.testing.assert_close(alone.log_prob, among_all.log_prob[others])


def test_demonstrations_draw_no_actions() -> None:
    """They are scored, so the draws of the other rows are those of a batch without them."""
    loss = make_loss()
    loss.actor[-1].distribution_class = SquashedNormal
    batch = make_batch(12, demo_rows=4)
    torch.manual_seed(1)
    with_demos = loss.actor_terms(batch)
    after = torch.rand(1)
    torch.manual_seed(1)
    alone = loss.actor_terms(batch[:8].exclude("is_demo"))
    assert torch.equal(torch.rand(1), after)
    torch.testing.assert_close(with_demos.log_prob, alone.log_prob)
    torch.testing.assert_close(with_demos.values["rl"].loss, alone.values["rl"].loss)
    torch.testing.assert_close(with_demos.values["bc"].loss, loss.bc_loss(batch))


class RowNoise(SquashedNormal):
    """Draws noise that belongs to the row, wherever in the batch the row is."""

    def _noise(self, sample_shape: object) -> torch.Tensor:
        return torch.sin(1e4 * self.loc.detach())


@given(order=st.permutations(range(10)), demo_rows=st.integers(0, 9))
@settings(max_examples=40)
@pytest.mark.parametrize("rl_on_demos", [False, True])
def test_no_term_cares_where_the_demonstrations_are(
    rl_on_demos: bool, order: list[int], demo_rows: int
) -> None:
    """Demonstrations last are cut off by a slice, others by their indices: to the same effect."""
    loss = make_loss(rl_on_demos=rl_on_demos)
    loss.actor[-1].distribution_class = RowNoise
    batch = make_batch(10, demo_rows)
    trained = nn.ModuleList([loss.actor, loss.critic, nn.ParameterList([loss.log_alpha])])
    found = []
    for rows in (batch, batch[order]):
        terms = loss(rows)
        total = sum(terms[name] for name in loss.out_keys if name.startswith("loss_"))
        found.append([*terms.values(), *gradients(total, trained)])
    torch.testing.assert_close(*found)


def rows_seen(loss: BCSACLoss, batch: TensorDict) -> dict[str, torch.Tensor]:
    """The tensors that the networks are called with in the two halves of an update."""
    seen = {}
    handles = [
        loss.critic.register_forward_pre_hook(
            lambda _, inputs: seen.setdefault("critic", inputs) and None
        ),
        loss.actor[0].module.register_forward_pre_hook(
            lambda _, inputs: seen.setdefault("target's actor", inputs) and None
        ),
    ]
    loss.critic_terms(batch)
    found = {"observation": seen["critic"][0], "action": seen["critic"][1]}
    found["next observation"] = seen["target's actor"][0]
    seen.clear()
    loss.actor_terms(batch)
    found["actor's critic"] = seen["critic"][0]
    for handle in handles:
        handle.remove()
    return found


@given(marks=st.lists(st.booleans(), min_size=1, max_size=12).filter(lambda marks: not all(marks)))
@settings(max_examples=60)
def test_the_critics_see_the_other_rows_in_their_order(marks: list[bool]) -> None:
    batch = make_batch(len(marks), demo_rows=0)
    batch["is_demo"] = torch.tensor(marks).unsqueeze(-1)
    others = ~batch["is_demo"].squeeze(-1)
    seen = rows_seen(make_loss(), batch)
    assert torch.equal(seen["observation"], batch["observation"][others])
    assert torch.equal(seen["action"], batch["action"][others])
    assert torch.equal(seen["next observation"], batch["next", "observation"][others])
    assert torch.equal(seen["actor's critic"], batch["observation"][others])


@pytest.mark.parametrize("demo_rows", [None, 0, 4])
def test_rows_before_the_demonstrations_are_not_copied(demo_rows: int | None) -> None:
    def in_place(batch: TensorDict) -> dict[str, bool]:
        entries = {name: batch[name] for name in ("observation", "action")}
        entries["next observation"] = batch["next", "observation"]
        entries["actor's critic"] = batch["observation"]
        seen = rows_seen(make_loss(), batch)
        return {name: seen[name].data_ptr() == entries[name].data_ptr() for name in seen}

    assert set(in_place(make_batch(12, demo_rows)).values()) == {True}
    assert set(in_place(make_batch(12, 4)[torch.arange(11, -1, -1)]).values()) == {False}


@pytest.mark.parametrize("demo_rows", [0, 4, None])
def test_rows_that_are_known_need_no_counting(demo_rows: int | None) -> None:
    batch = make_batch(12, demo_rows=demo_rows)
    counted = make_loss()
    known = make_loss(main_rows=12 - (demo_rows or 0))
    known.load_state_dict(counted.state_dict())
    found = []
    for loss in (counted, known):
        torch.manual_seed(1)
        found.append(loss(batch))
    assert (found[0] == found[1]).all()


def test_a_batch_of_demonstrations_can_be_imitated_and_with_rl_on_demos_reinforced() -> None:
    batch = make_batch(6, demo_rows=6)
    loss = make_loss(rl_on_demos=True)
    terms = loss(batch)
    assert moves(terms["loss_bc"], loss.actor)
    assert moves(terms["loss_actor"], loss.actor)
    alone = make_loss(rl_on_demos=False)
    assert moves(alone.bc_loss(batch), alone.actor)


@pytest.mark.parametrize("term", ["critic_terms", "actor_terms", "actor_loss", "alpha_loss"])
def test_reinforcement_without_a_row_for_it_is_an_error_with_its_remedy(term: str) -> None:
    with pytest.raises(ValueError, match="set rl_on_demos=True, or call bc_loss"):
        getattr(make_loss(), term)(make_batch(6, demo_rows=6))


def test_no_demonstrations_make_an_imitation_term_of_zero() -> None:
    loss = make_loss()
    none_marked = loss.actor_terms(make_batch(6, demo_rows=0)).values["bc"].loss
    assert none_marked.item() == 0.0
    assert not moves(none_marked, loss.actor)
    no_marks = loss.actor_terms(make_batch(6, demo_rows=None)).values["bc"].loss
    assert no_marks.item() == 0.0
    assert not no_marks.requires_grad


# ------------------------------------------------------------------- one forward, no host waits


def test_both_halves_of_the_actor_share_one_forward_pass_and_equal_the_separate_calls() -> None:
    loss = make_loss(rl_on_demos=True)
    batch = make_batch(12, demo_rows=4)
    calls: Counter[str] = Counter()
    loss.actor[0].module.register_forward_hook(lambda *_: calls.update(["trunk"]))
    torch.manual_seed(3)
    terms = loss.actor_terms(batch)
    assert calls["trunk"] == 1
    torch.manual_seed(3)
    rl, bc = loss.actor_loss(batch), loss.bc_loss(batch)
    assert calls["trunk"] == 3
    for together, apart in ((terms.values["rl"].loss, rl), (terms.values["bc"].loss, bc)):
        torch.testing.assert_close(together, apart)
        for one, other in zip(
            gradients(together, loss.actor), gradients(apart, loss.actor), strict=True
        ):
            torch.testing.assert_close(one, other)


class CountWaits(TorchFunctionMode):
    """Counts the operations whose result an accelerator's host must wait for."""

    WAITS = ("item", "tolist", "nonzero", "__bool__", "__int__", "__float__", "cpu", "numpy")

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_function__(self, func, types, args=(), kwargs=None):
        self.count += getattr(func, "__name__", "") in self.WAITS
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize(
    ("options", "per_update"), [({"rl_on_demos": True}, 0), ({"main_rows": 8}, 0), ({}, 2)]
)
def test_an_update_waits_for_the_device_no_more_than_its_policies_do(
    options: dict[str, object], per_update: int
) -> None:
    """TanhNormal's constructor waits; beyond it, only the choice of rows may (once a network)."""
    loss = make_loss(**options)
    batch = make_batch(12, demo_rows=4)
    with CountWaits() as for_one_policy:
        loss.actor.get_dist(batch.select("observation"))
    with CountWaits() as for_an_update:
        loss.critic_terms(batch)
        loss.alpha_loss(loss.actor_terms(batch).log_prob)
        loss.update_target()
        loss.advance()
    assert for_an_update.count == 2 * for_one_policy.count + per_update


# --------------------------------------------------------------------------------------- options


def test_the_weight_follows_its_schedule_and_scales_nothing_else() -> None:
    loss = make_loss(bc_weight=ExponentialWeight(4.0, 0.5))
    batch = make_batch(6, demo_rows=5)
    for expected in (4.0, 2.0, 1.0):
        terms = loss(batch)
        assert terms["bc_weight"].item() == loss.current_bc_weight == expected
        torch.testing.assert_close(terms["loss_bc"], expected * loss.bc_loss(batch))
        torch.testing.assert_close(terms["bc_nll"], loss.bc_loss(batch))
        loss.advance()


def test_a_number_is_a_constant_weight() -> None:
    loss = make_loss(bc_weight=10)
    loss.advance()
    assert loss.current_bc_weight == 10.0


def test_critics_may_be_a_list_or_one_module() -> None:
    actor, critics = make_actor(), [Critic(), Critic(), Critic()]
    batch = make_batch(6, demo_rows=None)
    as_list = q_of(BCSACLoss(actor, critics), batch)
    as_module = q_of(BCSACLoss(actor, CriticEnsemble(critics)), batch)
    assert torch.equal(as_list, as_module)
    assert as_list.shape == (3, 6, 1)
    for row, critic in zip(as_list, critics, strict=True):
        assert torch.equal(row, critic(batch["observation"], batch["action"]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gamma": 1.1}, r"gamma must be in \[0, 1\], got 1.1"),
        ({"main_rows": 0}, r"main_rows must be None or >= 1, got 0"),
        ({"tau": -0.1}, "tau must be in"),
        ({"init_temperature": 0.0}, "init_temperature must be > 0"),
        ({"action_margin": 0.0}, "action_margin must be in"),
        ({"imitation": "l2"}, "imitation must be nll, mse or fixed_width, got 'l2'"),
        ({"actor_value": "max"}, "actor_value must be min or mean"),
        ({"target_action": "mode"}, "target_action must be sample or mean, got 'mode'"),
        ({"target_action": "mean"}, "entropy_in_target must be False with target_action='mean'"),
        ({"bc_weight": -1.0}, "weight and must be finite and >= 0"),
    ],
)
def test_a_bad_argument_is_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_loss(**options)


def test_an_empty_ensemble_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one critic"):
        BCSACLoss(make_actor(), [])


def test_a_missing_key_is_named() -> None:
    with pytest.raises(KeyError, match="terminated"):
        make_loss().qvalue_loss(make_batch(4, demo_rows=None).exclude(("next", "terminated")))


# ------------------------------------------------------------------------------- keys and state


def test_the_batch_is_left_as_it_was() -> None:
    batch = make_batch(12, demo_rows=4).set("steps_to_next_obs", torch.ones(12, 1))
    before, keys = batch.clone(), set(batch.keys(True, True))
    make_loss()(batch)
    assert set(batch.keys(True, True)) == keys
    assert (batch == before).all()


def test_every_key_can_be_renamed() -> None:
    plain, renamed = (make_loss(further=[SelfImitation()]) for _ in range(2))
    renamed.load_state_dict(plain.state_dict())
    batch = make_full_batch(12, demo_rows=4)
    names = {
        "observation": "state",
        "action": "command",
        "reward": "score",
        "terminated": "dead",
        "is_demo": ("source", "human"),
        "steps_to_next_obs": "n",
        "imitated_action": ("source", "clean"),
        "to_end": "rest",
    }
    assert names.keys() == {field.name for field in fields(BatchKeys)}
    other = batch.clone()
    for key, name in names.items():
        renamed.set_keys(**{key: name})
        for parent in (other, other["next"]):
            if key in parent.keys():  # noqa: SIM118 - iterating a tensordict goes over its rows
                parent.rename_key_(key, name)
    torch.manual_seed(1)
    expected = plain(batch)
    torch.manual_seed(1)
    assert (renamed(other) == expected).all()
    assert expected["better_share"] > 0.0
    assert set(renamed.in_keys) <= set(other.keys(True, True))


def test_the_target_averages_from_the_first_update_on_and_copies_statistics() -> None:
    critic = ConstantCritics(0.0, 4.0)
    critic.register_buffer("seen", torch.tensor(0.0))
    loss = BCSACLoss(make_actor(), critic, tau=0.25)
    with torch.no_grad():
        critic.values += 8.0
        critic.seen += 1.0
    loss.update_target()
    assert torch.equal(loss.target_critic.values, torch.tensor([2.0, 6.0]))
    loss.update_target()
    assert torch.equal(loss.target_critic.values, torch.tensor([3.5, 7.5]))
    assert torch.equal(critic.values, torch.tensor([8.0, 12.0]))
    assert loss.target_critic.seen.item() == 1.0


def assigned(loss: BCSACLoss) -> BCSACLoss:
    loss.load_state_dict({k: v.clone() for k, v in loss.state_dict().items()}, assign=True)
    return loss


@pytest.mark.parametrize("moved", [deepcopy, BCSACLoss.double, assigned])
def test_the_target_follows_networks_that_were_copied_moved_or_loaded(
    moved: Callable[[BCSACLoss], BCSACLoss],
) -> None:
    critic = ConstantCritics(0.0, 4.0)
    critic.register_buffer("seen", torch.tensor(0.0))
    original = BCSACLoss(make_actor(), critic, tau=0.25)
    loss = moved(original)
    with torch.no_grad():
        loss.critic.values += 8.0
        loss.critic.seen += 1.0
    loss.update_target()
    assert loss.target_critic.values.tolist() == [2.0, 6.0]
    assert loss.target_critic.seen.item() == 1.0
    assert loss is original or original.target_critic.values.tolist() == [0.0, 4.0]


def test_the_policy_that_learns_is_the_one_that_was_passed_in() -> None:
    actor, critic = make_actor(), ConstantCritics(1.0)
    loss = BCSACLoss(actor, critic)
    assert loss.actor is actor
    assert loss.critic is critic
    assert not set(loss.target_critic.parameters()) & set(critic.parameters())


def test_state_survives_a_file_and_keeps_the_parameters_identity() -> None:
    source, target = make_loss(bc_weight=ExponentialWeight(1.0, 0.5)), make_loss()
    for _ in range(3):
        source.advance()
    with torch.no_grad():
        source.log_alpha += 1.0
        next(source.target_critic.parameters()).add_(1.0)
    file = io.BytesIO()
    torch.save(source.state_dict(), file)
    file.seek(0)
    identities = [id(p) for p in target.parameters()]
    target.load_state_dict(torch.load(file, weights_only=True))
    assert [id(p) for p in target.parameters()] == identities
    assert target.updates == 3
    for name, value in source.state_dict().items():
        assert torch.equal(value, target.state_dict()[name]), name
