"""A term of one's own trains through the pipeline's stepper: nothing of ours knows it."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor

from losses import (
    ActorPass,
    ActorTerm,
    CriticPass,
    CriticTerm,
    Emphasis,
    GradientRatio,
    Imitation,
    LinearWeight,
    Objective,
    Schedule,
    SoftTD,
    SoftValue,
    Temperature,
    TermValue,
)
from losses.passes import Networks
from losses.rules import WeightRule
from losses.terms import Term
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.networks import make_actor
from pipeline.learn.stepper import BCSACStepper, UpdateSchedule
from pipeline.machine.compilation import why_not_compiled
from pipeline.watch.diagnostics import DemonstrationProbe, TrainingState
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, make_batch, parameters_of, same
from tests.pipeline.updating import DEMO_ROWS, MAIN_ROWS, UPDATES, learnt, marked

needs_compiler = pytest.mark.skipif(
    why_not_compiled() is not None, reason=f"cannot compile here: {why_not_compiled()}"
)
pytestmark = pytest.mark.usefixtures("float64")

SAC = (SoftTD(gamma=0.9), SoftValue("min"), Temperature(target_entropy=-float(ACTION_SIZE)))


@dataclass(frozen=True)
class Smoothness(ActorTerm):
    """Squared difference between the deterministic actions of rows that follow each other."""

    weight: Schedule | float = LinearWeight(2.0, 0.5, UPDATES)  # noqa: RUF009 - frozen
    rule: WeightRule | None = None
    name: str = "smooth"

    logs = ("largest",)

    def __call__(self, seen: ActorPass) -> TermValue:
        action = seen.policy.deterministic_sample
        return TermValue(action.diff(dim=0).square().mean(), {"largest": action.detach().abs()})


@dataclass(frozen=True)
class SmallBias(ActorTerm):
    """Of the first parameter alone; logs what an update leaves of it."""

    weight: Schedule | float = 1.0
    name: str = "small"

    logs_after_step = ("size",)

    def __call__(self, seen: ActorPass) -> TermValue:
        return TermValue(next(seen.networks.actor.parameters()).square().sum())

    def after_step(self, networks: Networks) -> dict[str, Tensor]:
        return {"size": next(networks.actor.parameters()).detach().square().sum()}


@dataclass(frozen=True)
class Conservative(CriticTerm):
    """The critics' mean value of the batch's own actions, pushed up."""

    weight: Schedule | float = 0.25
    name: str = "conservative"

    def __call__(self, seen: CriticPass) -> TermValue:
        return TermValue(-seen.q.mean())


def early(rows: TensorDictBase) -> Tensor:
    observation: Tensor = rows["observation"]
    return (observation[..., 0] > 0.0).to(observation.dtype)


PULL = Imitation("mse", weight=0.5, row_weights=[Emphasis(early)], name="pull")


def make_objective(*terms: Term) -> Objective:
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [16, 16])
    critic = BatchedCritics(OBSERVATION_SIZE, ACTION_SIZE, [16, 16], 3)
    return Objective(actor, critic, [*SAC, *terms], main_rows=MAIN_ROWS)


def make_stepper(loss: Objective, **options) -> BCSACStepper:
    rates = {"actor_lr": 1e-3, "critic_lr": 2e-3, "temperature_lr": 3e-3}
    schedule = UpdateSchedule(diagnostics_period=3)
    return BCSACStepper(loss, **({"schedule": schedule} | rates | options))


def flat(tensors) -> Tensor:
    return torch.cat([tensor.flatten() for tensor in tensors])


def of_one_step(loss: Objective, **options) -> tuple[Tensor, dict[str, Tensor], dict[str, Tensor]]:
    """What the actor's optimizer was given, each term's own gradient by autograd, and metrics."""
    reference, (batch,) = deepcopy(loss), marked(1)
    stepper = make_stepper(loss, actor_lr=0.0, critic_lr=0.0, temperature_lr=0.0, **options)
    torch.manual_seed(5)
    metrics = stepper.named(stepper.step(None, batch))
    torch.manual_seed(5)
    reference.critic_terms(batch)  # takes its share of the random numbers
    actor = list(reference.actor.parameters())
    own = {
        name: flat(torch.autograd.grad(value.loss, actor, retain_graph=True))
        for name, value in reference.actor_terms(batch).values.items()
    }
    return flat(parameter.grad for parameter in loss.actor.parameters()), own, metrics


def test_a_new_term_is_weighed_measured_and_logged_under_its_name():
    """Weights 2 and 0.5 at the first update, beside 0.7 of the imitation."""
    loss = make_objective(Imitation(weight=0.7), Smoothness(), PULL)
    given, own, metrics = of_one_step(loss)
    expected = own["rl"] + 0.7 * own["bc"] + 2.0 * own["smooth"] + 0.5 * own["pull"]
    torch.testing.assert_close(given, expected)
    for name in ("smooth", "pull"):
        torch.testing.assert_close(metrics[f"grad_norm_{name}"], own[name].norm())
        cosine = torch.cosine_similarity(own["rl"], own[name], dim=0)
        torch.testing.assert_close(metrics[f"grad_cosine_{name}"], cosine)
        assert metrics[name] > 0.0
    assert metrics["smooth_weight"] == 2.0
    assert metrics["pull_weight"] == 0.5
    assert 0.0 < metrics["largest"] < 1.0
    assert metrics["bc_weight"] == 0.7


@pytest.mark.parametrize("factor", [2.5, 0.0])
def test_several_terms_may_have_a_size_relative_to_reinforcement(factor: float):
    """|w g| = lambda ratio |g_RL| for each of them."""
    terms = (
        Imitation(weight=0.8, rule=GradientRatio(factor)),
        Smoothness(weight=0.1, rule=GradientRatio(3.0)),
    )
    given, own, metrics = of_one_step(
        make_objective(*terms, PULL), schedule=UpdateSchedule(diagnostics_period=10**9)
    )
    scale = own["rl"].norm()
    weights = {"bc": 0.8 * factor, "smooth": 0.3}
    expected = own["rl"] + 0.5 * own["pull"]
    for name, share in weights.items():
        weight = share * scale / own[name].norm()
        torch.testing.assert_close(metrics[f"{name}_weight"], weight)
        expected = expected + weight * own[name]
    torch.testing.assert_close(given, expected)


def test_a_critic_s_term_moves_the_critics_alone():
    """Its gradient is -0.25 of the mean value's, beside the soft TD error's."""
    plain, more = make_objective(), make_objective(Conservative())
    more.load_state_dict(plain.state_dict())
    (batch,) = marked(1)
    given, metrics = [], {}
    for loss in (plain, more):
        torch.manual_seed(5)
        stepper = make_stepper(loss, critic_lr=0.0)
        metrics = stepper.named(stepper.step(None, batch))
        given.append(flat(parameter.grad for parameter in loss.critic.parameters()))
    rows = batch[:MAIN_ROWS]
    value = plain.critic(rows["observation"], rows["action"]).mean()
    own = flat(torch.autograd.grad(value, list(plain.critic.parameters())))
    torch.testing.assert_close(given[1] - given[0], -0.25 * own)
    torch.testing.assert_close(metrics["conservative"], -value.detach())
    assert metrics["conservative_weight"] == 0.25
    assert same(parameters_of(plain.actor), parameters_of(more.actor))


@needs_compiler
@pytest.mark.parametrize("rule", [None, GradientRatio(0.5)], ids=["weights", "ratio"])
def test_compiled_updates_with_new_terms_are_the_ordinary_ones(rule: WeightRule | None):
    plain = make_objective(Imitation(), Smoothness(rule=rule), PULL, Conservative())
    fast = deepcopy(plain)
    given = marked(8)
    expected = learnt(plain, make_stepper(plain), given)
    found = learnt(fast, make_stepper(fast, compile_updates=True), given)
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9, equal_nan=True)
    assert plain.weight_of("smooth") == 2.0 - 1.5 * 8 / UPDATES  # another weight at each update


def test_a_new_term_changes_what_is_learned():
    plain, more = make_objective(), make_objective(Smoothness(weight=100.0))
    more.load_state_dict(plain.state_dict())
    batch = make_batch(MAIN_ROWS + DEMO_ROWS, DEMO_ROWS)
    left = []
    for loss in (plain, more):
        stepper = make_stepper(loss, actor_lr=1e-2)
        for _ in range(30):
            stepper.step(None, batch)
        left.append(Smoothness()(ActorPass(loss, loss.batch(batch))).loss.item())
    assert left[1] < 0.1 * left[0]


def test_a_batch_that_says_nothing_about_a_term_leaves_it_out():
    """Without marks there is nothing to imitate; smoothness is measured all the same."""
    loss = make_objective(Imitation(), Smoothness())
    stepper = make_stepper(loss)
    metrics = stepper.named(stepper.step(None, make_batch(MAIN_ROWS, None)))
    assert metrics["grad_norm_smooth"] > 0.0
    assert metrics["grad_norm_bc"].isnan()
    assert metrics["bc_nll"] == 0.0


def test_the_probe_and_the_state_name_what_the_terms_do():
    loss = make_objective(Imitation(), PULL)
    stepper = make_stepper(loss)
    stepper.step(None, *marked(1))
    state = TrainingState(stepper)()
    assert {"pull", "pull_weight", "grad_norm_pull", "target_entropy"} <= state.keys()
    rows = make_batch(6)
    found = DemonstrationProbe(loss, rows, rows)()
    assert found["pull_train"] == found["pull_held_out"] > 0.0
    assert {"bc_nll_train", "bc_nll_held_out"} <= found.keys()


def test_a_term_may_be_about_some_parameters_and_what_becomes_of_them():
    """The gradient of w^2 is 2 w, and there is none of the other parameters."""
    loss = make_objective(SmallBias())
    first = next(loss.actor.parameters())
    stepper = make_stepper(loss)
    before = first.detach().clone()
    metrics = stepper.named(stepper.step(None, *marked(1)))
    torch.testing.assert_close(metrics["grad_norm_small"], 2.0 * before.norm())
    torch.testing.assert_close(metrics["size"], first.detach().square().sum())
    assert metrics["size"] < metrics["small"]


def test_a_stepper_needs_something_to_teach():
    actor = make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8])
    critic = BatchedCritics(OBSERVATION_SIZE, ACTION_SIZE, [8], 2)
    with pytest.raises(ValueError, match=r"trains the critics: add SoftTD\(\)"):
        make_stepper(Objective(actor, critic, [Imitation()]))
    with pytest.raises(ValueError, match=r"trains the actor: add SoftValue\(\)"):
        make_stepper(
            Objective(actor, critic, [SAC[0], Temperature(target_entropy=-1.0, learn=False)])
        )
