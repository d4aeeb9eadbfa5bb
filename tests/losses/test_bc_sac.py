"""BCSACLoss: which rows and which network each term belongs to, its options and its state."""

from __future__ import annotations

import io
import math
from collections import Counter
from collections.abc import Callable
from copy import deepcopy
from typing import ClassVar

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from losses import BCSACLoss, CriticEnsemble, ExponentialWeight, SquashedNormal
from tests.losses.toys import (
    ACTION_SIZE,
    ConstantCritics,
    Critic,
    gradients,
    make_actor,
    make_batch,
    make_loss,
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


def test_the_imitation_term_is_the_mean_over_the_demonstrations_alone() -> None:
    loss = make_loss()
    batch = make_batch(12, demo_rows=4)
    alone = loss.bc_loss(batch[-4:])
    torch.testing.assert_close(loss.bc_loss(batch), alone)
    torch.testing.assert_close(loss.actor_terms(batch).bc, alone)
    one_by_one = torch.stack([loss.bc_loss(batch[row : row + 1]) for row in range(8, 12)])
    torch.testing.assert_close(one_by_one.mean(), alone)


@given(order=st.permutations(range(8)))
def test_the_imitation_term_does_not_care_where_its_rows_are(order: list[int]) -> None:
    loss = make_loss()
    batch = make_batch(8, demo_rows=3)
    torch.testing.assert_close(loss.bc_loss(batch[order]), loss.bc_loss(batch))


@pytest.mark.parametrize("rl_on_demos", [False, True])
def test_reinforcement_uses_demonstrations_only_when_told(rl_on_demos: bool) -> None:
    loss = make_loss(rl_on_demos=rl_on_demos)
    batch = make_batch(12, demo_rows=4)
    spoiled = batch.clone()
    spoiled["next", "reward"][-4:] = math.nan
    assert loss.qvalue_loss(spoiled).isnan().item() == rl_on_demos
    terms = loss.actor_terms(batch)
    assert terms.log_prob.shape == (12 if rl_on_demos else 8,)
    assert terms.q.shape == (*terms.log_prob.shape, 1)
    assert loss.critic_terms(batch).q.shape == (2, *terms.q.shape)


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
        for half in (terms.rl, terms.bc)
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
    torch.testing.assert_close(alone.q, among_all.q[others])
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
    torch.testing.assert_close(with_demos.rl, alone.rl)
    torch.testing.assert_close(with_demos.bc, loss.bc_loss(batch))


class RowNoise(SquashedNormal):
    """Draws noise that belongs to the row, wherever in the batch the row is."""

    def _noise(self, sample_shape: object) -> torch.Tensor:
        return torch.sin(1e4 * self.loc.detach())


@given(order=st.permutations(range(10)), demo_rows=st.integers(0, 9))
@settings(deadline=None, derandomize=True, max_examples=40)
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
@settings(deadline=None, derandomize=True, max_examples=60)
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
    none_marked = loss.actor_terms(make_batch(6, demo_rows=0)).bc
    assert none_marked.item() == 0.0
    assert not moves(none_marked, loss.actor)
    no_marks = loss.actor_terms(make_batch(6, demo_rows=None)).bc
    assert no_marks.item() == 0.0
    assert not no_marks.requires_grad


@pytest.mark.parametrize("edge", [1.0, -1.3])
def test_actions_at_and_beyond_the_edge_give_finite_gradients(edge: float) -> None:
    loss = make_loss()
    batch = make_batch(6, demo_rows=6)
    batch["action"].fill_(edge)
    at_the_edge = loss.bc_loss(batch)
    batch["action"].fill_(math.copysign(1.0 - loss.action_margin, edge))
    torch.testing.assert_close(at_the_edge, loss.bc_loss(batch))
    assert all(g.isfinite().all() for g in gradients(at_the_edge, loss.actor))


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
    for together, apart in ((terms.rl, rl), (terms.bc, bc)):
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


def test_steps_discount_the_future_by_their_number() -> None:
    """gamma over two steps is gamma squared over one."""
    batch = make_batch(12, demo_rows=None)
    loss = make_loss(gamma=0.9)
    two_steps = batch.clone().set("steps_to_next_obs", torch.full((12, 1), 2))
    torch.manual_seed(1)
    in_two_steps = loss.critic_terms(two_steps).target
    loss.gamma = 0.81
    torch.manual_seed(1)
    torch.testing.assert_close(in_two_steps, loss.critic_terms(batch).target)


def test_only_a_termination_ends_the_return() -> None:
    loss = make_loss()
    batch = make_batch(12, demo_rows=None)
    reward, target = batch["next", "reward"], loss.critic_terms(batch).target
    terminated = batch["next", "terminated"]
    assert (batch["next", "done"] & ~terminated).any()  # truncations: they bootstrap
    assert torch.equal(target == reward, terminated)


def test_the_target_can_do_without_entropy() -> None:
    targets = []
    for temperature in (0.1, 10.0):
        torch.manual_seed(0)
        loss = make_loss(entropy_in_target=False, init_temperature=temperature)
        targets.append(loss.critic_terms(make_batch(12, demo_rows=None)).target)
    assert torch.equal(*targets)


def test_the_target_can_value_the_policy_without_its_noise() -> None:
    """The critic is the sum of the action, so the target shows which action it was asked about."""

    class ActionSum(nn.Module):
        def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
            return action.sum(-1, keepdim=True).expand(1, -1, 1)

    actor, batch = make_actor(), make_batch(6, demo_rows=None)
    batch["next", "terminated"] = torch.zeros_like(batch["next", "terminated"])
    batch["next", "reward"] = torch.zeros_like(batch["next", "reward"])
    following = batch["next"].select("observation")
    mean = actor.get_dist(following).deterministic_sample.sum(-1, keepdim=True)
    for action, is_mean in (("mean", True), ("sample", False)):
        loss = BCSACLoss(
            actor, ActionSum(), target_action=action, gamma=1.0, entropy_in_target=False
        )
        assert torch.allclose(loss.critic_terms(batch).target, mean) == is_mean


@pytest.mark.parametrize(("subset", "values"), [(None, {1.0}), (1, {1.0, 2.0, 6.0}), (3, {1.0})])
def test_the_target_takes_the_minimum_over_a_random_subset(
    subset: int | None, values: set[float]
) -> None:
    critic = ConstantCritics(2.0, 1.0, 6.0)
    loss = BCSACLoss(make_actor(), critic, target_subset=subset, gamma=1.0, entropy_in_target=False)
    batch = make_batch(4, demo_rows=None)
    batch["next", "reward"].zero_()
    batch["next", "terminated"].zero_()
    seen = {loss.critic_terms(batch).target[0].item() for _ in range(60)}
    assert seen == values


@pytest.mark.parametrize(("actor_value", "expected"), [("min", 1.0), ("mean", 3.0)])
def test_what_the_actor_maximises_of_the_ensemble(actor_value: str, expected: float) -> None:
    loss = BCSACLoss(make_actor(), ConstantCritics(2.0, 1.0, 6.0), actor_value=actor_value)
    torch.testing.assert_close(
        loss.actor_terms(make_batch(4, demo_rows=None)).q, torch.full((4, 1), expected)
    )


def test_the_temperature_may_be_fixed_and_starts_where_told() -> None:
    loss = make_loss(init_temperature=0.2, learn_temperature=False)
    assert loss.alpha.item() == pytest.approx(0.2)
    assert not loss.alpha_loss(make_batch(4, demo_rows=None)).requires_grad


def test_the_temperature_s_loss_takes_a_batch_or_log_densities() -> None:
    loss = make_loss(target_entropy=-7.0, init_temperature=math.exp(-2.0))
    by_hand = loss.alpha_loss(torch.tensor([8.0, 10.0]))  # -(-2) * (9 - 7)
    assert by_hand.item() == pytest.approx(4.0)
    batch = make_batch(12, demo_rows=4)
    torch.manual_seed(1)
    from_batch = loss.alpha_loss(batch)
    torch.manual_seed(1)
    log_prob = loss.actor_terms(batch[:8]).log_prob
    torch.testing.assert_close(from_batch, loss.alpha_loss(log_prob))


def test_auto_target_entropy_is_minus_the_action_s_size() -> None:
    assert make_loss().target_entropy == -ACTION_SIZE


def test_critics_may_be_a_list_or_one_module() -> None:
    actor, critics = make_actor(), [Critic(), Critic(), Critic()]
    batch = make_batch(6, demo_rows=None)
    as_list = BCSACLoss(actor, critics).critic_terms(batch)
    as_module = BCSACLoss(actor, CriticEnsemble(critics)).critic_terms(batch)
    assert torch.equal(as_list.q, as_module.q)
    assert as_list.q.shape == (3, 6, 1)
    for row, critic in zip(as_list.q, critics, strict=True):
        assert torch.equal(row, critic(batch["observation"], batch["action"]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gamma": 1.1}, r"gamma must be in \[0, 1\], got 1.1"),
        ({"main_rows": 0}, r"main_rows must be None or >= 1, got 0"),
        ({"tau": -0.1}, "tau must be in"),
        ({"init_temperature": 0.0}, "init_temperature must be > 0"),
        ({"action_margin": 0.0}, "action_margin must be in"),
        ({"imitation": "l2"}, "imitation must be nll or mse, got 'l2'"),
        ({"actor_value": "max"}, "actor_value must be min or mean"),
        ({"target_action": "mode"}, "target_action must be sample or mean, got 'mode'"),
        ({"target_action": "mean"}, "entropy_in_target must be False with target_action='mean'"),
        ({"bc_weight": -1.0}, "weight and must be finite and >= 0"),
    ],
)
def test_a_bad_argument_is_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_loss(**options)


def test_auto_target_entropy_without_a_spec_names_the_remedy() -> None:
    with pytest.raises(ValueError, match="build the actor with spec="):
        BCSACLoss(make_actor(with_spec=False), [Critic()])
    assert (
        BCSACLoss(make_actor(with_spec=False), [Critic()], target_entropy=-1).target_entropy == -1
    )


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


def test_in_keys_are_sufficient() -> None:
    loss = make_loss()
    loss(make_batch(4, demo_rows=None).select(*loss.in_keys))


def test_every_key_can_be_renamed() -> None:
    plain, renamed = make_loss(), make_loss()
    renamed.load_state_dict(plain.state_dict())
    batch = make_batch(12, demo_rows=4).set("steps_to_next_obs", torch.full((12, 1), 3))
    names = {
        "observation": "state",
        "action": "command",
        "reward": "score",
        "terminated": "dead",
        "is_demo": ("source", "human"),
        "steps_to_next_obs": "n",
    }
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


class CountingCritics(CriticEnsemble):
    """Notes how many members each call runs."""

    ran: ClassVar[list[int]] = []

    def forward(self, observation, action, members=None):
        q = super().forward(observation, action, members)
        self.ran.append(len(q))
        return q


class WithoutMembers(nn.Module):
    """An ensemble that cannot run a part of itself."""

    def __init__(self, critics: CriticEnsemble) -> None:
        super().__init__()
        self.critics = critics

    def forward(self, observation, action):
        return self.critics(observation, action)


def test_critics_outside_the_target_subset_are_not_run() -> None:
    critics = CountingCritics([Critic() for _ in range(5)])
    batch = make_batch(6, demo_rows=None)
    targets = []
    actor = make_actor()
    for critic in (critics, WithoutMembers(critics)):
        critics.ran.clear()
        loss = BCSACLoss(actor, critic, target_subset=2)
        torch.manual_seed(3)
        targets.append(loss.critic_terms(batch).target)
        assert critics.ran == ([2, 5] if critic is critics else [5, 5])
    torch.testing.assert_close(*targets)


class SumOfActions(nn.Module):
    """One critic that values an action by the sum of its entries."""

    def forward(self, _observation: Tensor, action: Tensor) -> Tensor:
        return action.sum(-1, keepdim=True).unsqueeze(0)


def test_the_q_filter_leaves_out_demonstrations_worse_than_the_policy() -> None:
    """Rows 4-7 are demonstrations; the critic prefers large actions, so rows 4 and 5 stay."""
    actor = make_actor()
    loss = BCSACLoss(actor, SumOfActions(), q_filter=True)
    batch = make_batch(8, 4)
    batch["action"] = torch.tensor([0.99, 0.99, -0.99, -0.99] * 2).unsqueeze(-1).expand(8, 2)
    batch["action"] = batch["action"].contiguous()
    everything = BCSACLoss(actor, SumOfActions()).bc_loss(batch[4:6])
    # The mean is over all four demonstrations, of which two count.
    assert torch.isclose(loss.actor_terms(batch).bc, everything / 2)
    assert loss.actor_terms(batch).bc.requires_grad


def test_emphasis_multiplies_the_error_of_each_demonstrated_step() -> None:
    """The mean over three demonstrations of their own errors, times 2, 0 and 0.5."""
    factors = {0.0: 2.0, 1.0: 0.0, 2.0: 0.5}
    batch = make_batch(5, demo_rows=3)
    batch["observation"][-3:, 0] = torch.tensor(list(factors))
    loss = make_loss(
        bc_emphasis=lambda observation: torch.stack(
            [torch.tensor(factors.get(row[0].item(), 100.0)) for row in observation]
        )
    )
    errors = [loss.bc_loss(batch[row : row + 1]) for row in (2, 4)]
    expected = (2.0 * errors[0] + 0.5 * errors[1]) / 3.0
    torch.testing.assert_close(loss.actor_terms(batch).bc, expected)
    torch.testing.assert_close(loss(batch)["bc_nll"], expected.detach())


def test_emphasis_and_q_filter_both_apply() -> None:
    batch = make_batch(6, demo_rows=6)
    loss = make_loss(q_filter=True, rl_on_demos=True)
    filtered = loss.actor_terms(batch).bc
    loss.bc_emphasis = lambda observation: torch.full((len(observation),), 3.0)
    torch.testing.assert_close(loss.actor_terms(batch).bc, 3.0 * filtered)


def test_without_the_q_filter_every_demonstration_counts() -> None:
    loss = BCSACLoss(make_actor(), SumOfActions())
    batch = make_batch(8, 4)
    assert torch.isclose(loss.actor_terms(batch).bc, loss.bc_loss(batch))
