"""Objective: terms that go together, their sum, their metrics and their state."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from losses import (
    ActorPass,
    ActorTerm,
    ConstantWeight,
    CosineWeight,
    CriticPass,
    CriticTerm,
    Emphasis,
    ExponentialWeight,
    GradientRatio,
    Imitation,
    LinearWeight,
    Objective,
    QFilter,
    Schedule,
    SoftTD,
    SoftValue,
    Temperature,
    TermValue,
)
from losses.terms import Term, total, weighted
from tests.losses.toys import ConstantCritics, Critic, gradients, make_actor, make_batch, make_loss

SAC = (SoftTD(), SoftValue(), Temperature())


@dataclass(frozen=True)
class Effort(ActorTerm):
    """Mean square of the deterministic action."""

    weight: Schedule | float = 0.5
    rule: GradientRatio | None = None
    name: str = "effort"

    def __call__(self, seen: ActorPass) -> TermValue:
        action = seen.policy.deterministic_sample
        return TermValue(action.square().mean(), {"largest": action.detach().abs().amax(-1)})


@dataclass(frozen=True)
class LowValue(CriticTerm):
    """Mean value of the batch's own actions."""

    weight: Schedule | float = 2.0
    name: str = "low"

    def __call__(self, seen: CriticPass) -> TermValue:
        return TermValue(seen.q.mean())


def objective(*terms: Term, **options: Any) -> Objective:
    return Objective(make_actor(), [Critic(), Critic()], terms, **options)


def test_it_is_bcsac_with_bcsac_s_terms() -> None:
    loss = make_loss(gamma=0.9, bc_weight=0.3, q_filter=True, target_entropy=-3.0)
    terms = (
        SoftTD(gamma=0.9),
        SoftValue("min"),
        Temperature(target_entropy=-3),
        Imitation("nll", weight=0.3, row_weights=[QFilter()]),
    )
    composed = objective(*terms)
    composed.load_state_dict(loss.state_dict())
    batch = make_batch(12, demo_rows=4)
    torch.manual_seed(1)
    expected = loss(batch)
    torch.manual_seed(1)
    found = composed(batch)
    assert set(composed.out_keys) == set(loss.out_keys) == set(found.keys())
    for key in loss.out_keys:
        assert torch.equal(found[key], expected[key]), key
    assert composed.composition.metrics == loss.composition.metrics


def test_bcsac_logs_what_it_always_has() -> None:
    """Learning curves, alarms and plots of finished runs go by these names."""
    assert make_loss().composition.metrics == (
        "loss_qvalue",
        "loss_actor",
        "loss_alpha",
        "bc_nll",
        "bc_weight",
        "alpha",
        "entropy",
        "q_data",
        "q_policy",
        "grad_norm_rl",
        "grad_norm_bc",
        "grad_cosine",
    )


def test_names_follow_from_the_term() -> None:
    metrics = objective(*SAC, Effort(), LowValue()).composition.metrics
    ours = {"effort", "effort_weight", "grad_norm_effort", "grad_cosine_effort"}
    assert set(metrics) - set(objective(*SAC).composition.metrics) == ours | {"low", "low_weight"}
    second = objective(*SAC, Imitation(), Imitation("mse", name="pull")).composition.metrics
    assert {"bc_nll", "pull", "pull_weight", "grad_norm_pull", "grad_cosine_pull"} <= set(second)


def test_a_sum_has_each_loss_times_its_weight() -> None:
    """3 + 0.5 * 4 + 2 * 1 = 7; a term without a weight counts once."""
    losses = {"a": 3.0, "b": 4.0, "c": 1.0}
    values = {name: TermValue(torch.tensor(loss)) for name, loss in losses.items()}
    assert total(values, {"b": 0.5, "c": torch.tensor(2.0)}).item() == 7.0
    assert weighted(values["b"], None).item() == 4.0


def test_every_term_reaches_the_parameters_it_trains_only() -> None:
    loss = objective(*SAC, Effort(), LowValue())
    found = loss(make_batch(6, demo_rows=2))
    for key, actor, critic in (("loss_effort", True, False), ("loss_low", False, True)):
        for network, reached in ((loss.actor, actor), (loss.critic, critic)):
            assert any(bool(g.any()) for g in gradients(found[key], network)) is reached


def test_forward_weighs_a_term_by_its_schedule() -> None:
    """lambda_0 alpha^n = 4, 2, 1 of Effort; the metric is the loss without it."""
    loss = objective(*SAC, Effort(weight=ExponentialWeight(4.0, 0.5)))
    batch = make_batch(6, demo_rows=None)
    for expected in (4.0, 2.0, 1.0):
        found = loss(batch)
        assert found["effort_weight"].item() == expected
        torch.testing.assert_close(found["loss_effort"], expected * found["effort"])
        assert not found["effort"].requires_grad
        loss.advance()


def test_terms_share_one_forward_pass_of_the_actor() -> None:
    loss = objective(*SAC, Imitation(), Effort(), Imitation("mse", name="pull"))
    calls: list[int] = []
    loss.actor[0].module.register_forward_hook(lambda *_: calls.append(1))
    terms = loss.actor_terms(make_batch(12, demo_rows=4))
    assert list(terms.values) == ["rl", "bc", "effort", "pull"]
    assert len(calls) == 1


def test_imitation_alone_needs_no_other_rows_and_draws_nothing() -> None:
    loss = objective(Imitation())
    batch = make_batch(6, demo_rows=6)
    before = torch.random.get_rng_state()
    terms = loss.actor_terms(batch)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert terms.log_prob is None
    assert torch.equal(terms.values["bc"].loss, loss.bc_loss(batch))
    assert loss.composition.metrics == ("bc_nll", "bc_weight")


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ([*SAC, Imitation(), Imitation("mse")], "two terms have the name 'bc'"),
        ([*SAC, Imitation(), Imitation(name="bc_nll")], "two terms have the metric 'bc_nll'"),
        ([SoftTD(), SoftValue()], r"'qvalue' weighs entropy .* add Temperature\(\)"),
        ([*SAC, Temperature(name="other")], "at most one term with a temperature, .* 'other'"),
        ([*SAC, SoftTD(name="other")], "at most one term with tau, got 'qvalue', 'other'"),
        ([Imitation(rule=GradientRatio(1.0))], r"'bc' is relative to .* add SoftValue\(\)"),
    ],
)
def test_terms_that_do_not_go_together_are_named(terms: list[Term], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        objective(*terms)


def test_what_trains_nothing_is_no_term() -> None:
    with pytest.raises(TypeError, match="CriticTerm, an ActorTerm or a Temperature, got 'nll'"):
        objective(*SAC, "nll")  # type: ignore[arg-type]


def test_losses_without_their_term_name_it() -> None:
    batch = make_batch(6, demo_rows=2)
    with pytest.raises(ValueError, match=r"add Imitation\(\)"):
        objective(*SAC).bc_loss(batch)
    with pytest.raises(ValueError, match=r"add Temperature\(\)"):
        objective(Imitation()).alpha_loss(batch)


def test_settings_change_in_place_and_are_checked() -> None:
    loss = objective(*SAC, Effort())
    loss.configure("effort", weight=3)
    assert loss.weight_of("effort") == 3.0
    loss.configure("effort", weight=LinearWeight(1.0, 0.0, 2))
    loss.advance()
    assert loss.weight_of("effort") == 0.5
    with pytest.raises(ValueError, match=r"no term 'effrt' .* qvalue, rl, alpha, effort"):
        loss.configure("effrt", weight=3)
    with pytest.raises(ValueError, match="'effort' keeps its name"):
        loss.configure("effort", name="work")
    with pytest.raises(ValueError, match="gamma must be"):
        loss.configure("qvalue", gamma=2.0)


@pytest.mark.parametrize(
    ("name", "term", "setting", "value"),
    [
        ("bc_weight", "bc", "weight", CosineWeight(1.0, 0.1, 5)),
        ("action_margin", "bc", "margin", 0.5),
        ("gamma", "qvalue", "gamma", 0.5),
        ("tau", "qvalue", "tau", 0.5),
        ("loss_function", "qvalue", "distance", "l1"),
        ("entropy_in_target", "qvalue", "entropy", False),
        ("target_entropy", "alpha", "target_entropy", -9.0),
    ],
)
def test_settings_of_bcsac_are_read_as_attributes_and_changed_by_configure(
    name: str, term: str, setting: str, value: object
) -> None:
    loss, other = make_loss(), make_loss()
    with pytest.raises(AttributeError, match=rf"by configure\('{term}', {setting}="):
        setattr(loss, name, value)
    loss.configure(term, **{setting: value})
    assert getattr(loss, name) == value
    assert getattr(other, name) != value


def test_emphasis_and_filter_are_row_weights_of_the_imitation_term() -> None:
    loss = make_loss(actor_value="mean", bc_emphasis=torch.sigmoid, q_filter=True)
    assert loss.composition["bc"].row_weights == (Emphasis(torch.sigmoid), QFilter("mean"))
    assert (loss.bc_emphasis, loss.q_filter) == (torch.sigmoid, True)
    loss.configure("bc", row_weights=[])
    assert (loss.bc_emphasis, loss.q_filter) == (None, False)
    for name in ("bc_emphasis", "q_filter"):
        with pytest.raises(AttributeError, match="no setter"):
            setattr(loss, name, True)


def test_the_target_moves_by_the_tau_of_its_term() -> None:
    """From 0 to 0.25 * 8 = 2; without a term that has one it stays."""
    for terms, expected in ((SAC, 0.04), ((SoftTD(tau=0.25), *SAC[1:]), 2.0), ((), 0.0)):
        loss = Objective(make_actor(), ConstantCritics(0.0), [*terms, Imitation()])
        with torch.no_grad():
            loss.critic.values += 8.0
        loss.update_target()
        assert loss.target_critic.values.item() == pytest.approx(expected)


def test_a_loss_may_be_sent_to_another_process() -> None:
    loss = make_loss(tau=0.25, bc_weight=ExponentialWeight(1.0, 0.5), q_filter=True)
    loss.advance()
    sent = pickle.loads(pickle.dumps(loss))
    assert sent.updates == 1
    batch = make_batch(12, demo_rows=4)
    for one in (loss, sent):
        with torch.no_grad():
            next(one.critic.parameters()).add_(1.0)
        one.update_target()
    torch.manual_seed(1)
    expected = loss(batch)
    torch.manual_seed(1)
    assert (sent(batch) == expected).all()
    for name, value in loss.state_dict().items():
        assert torch.equal(value, sent.state_dict()[name]), name


def test_weights_given_as_numbers_are_constant_schedules() -> None:
    assert Imitation(weight=2).weight == Effort(weight=2.0).weight == ConstantWeight(2.0)
    with pytest.raises(ValueError, match="weight and must be finite and >= 0"):
        Effort(weight=-1.0)


def test_a_term_may_read_entries_of_its_own() -> None:
    @dataclass(frozen=True)
    class Marked(ActorTerm):
        name: str = "marked"

        reads = ("observation", "mark")

        def __call__(self, seen: ActorPass) -> TermValue:
            mark: Tensor = seen.batch.data["mark"]
            return TermValue((mark * seen.policy.deterministic_sample).mean())

    batch: TensorDict = make_batch(4, demo_rows=None).set("mark", torch.zeros(4, 1))
    loss = objective(*SAC, Marked())
    assert loss.actor_terms(batch).values["marked"].loss.item() == 0.0
    assert set(loss.in_keys) == {*objective(*SAC).in_keys, "mark"}


def test_a_temperature_that_nothing_draws_actions_for() -> None:
    """Critics of a fixed temperature need no reinforcement term of the actor; learning one does."""
    fixed = objective(SoftTD(), Temperature(learn=False), Imitation(weight=1.0))
    found = fixed(make_batch(12, demo_rows=4))
    assert set(found.keys()) == set(fixed.out_keys)
    assert "loss_alpha" not in fixed.out_keys
    assert "loss_alpha" not in fixed.composition.metrics
    with pytest.raises(ValueError, match=r"'alpha' learns from actions.*add SoftValue\(\), or"):
        objective(SoftTD(), Temperature(), Imitation(weight=1.0))
