"""One optimization step: its order, its schedule, and how the two actor gradients meet."""

from __future__ import annotations

import gc
from copy import deepcopy

import pytest
import torch
from torch import nn

from losses import BCSACLoss, ExponentialWeight, GradientRatio
from pipeline.learn import loss as configured
from pipeline.learn.imitation import ImitationStepper
from pipeline.learn.objective import LossSettings
from pipeline.learn.stepper import BCSACStepper, UpdateSchedule
from tests.pipeline.toys import ACTION_SIZE, make_batch, make_loss, parameters_of, same


def make_stepper(loss: BCSACLoss, **options) -> BCSACStepper:
    rates = {"actor_lr": 1e-2, "critic_lr": 1e-2, "temperature_lr": 1e-2}
    return BCSACStepper(loss, **(rates | options))


def spied(loss: BCSACLoss, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the parts of the loss in the order in which they are called from now on."""
    calls: list[str] = []

    def watch(name: str) -> None:
        original = getattr(loss, name)

        def called(*arguments, **options):
            calls.append(name)
            return original(*arguments, **options)

        monkeypatch.setattr(loss, name, called)

    for name in ("critic_terms", "actor_terms", "alpha_loss", "update_target"):
        watch(name)
    return calls


STEP = ["critic_terms", "actor_terms", "alpha_loss", "update_target"]


def test_canonical_order(monkeypatch: pytest.MonkeyPatch):
    loss = make_loss()
    calls = spied(loss, monkeypatch)
    make_stepper(loss, schedule=UpdateSchedule(target_period=1)).step(None, make_batch(6))
    assert calls == STEP


def test_each_part_sees_what_the_part_before_it_learned(monkeypatch: pytest.MonkeyPatch):
    loss = make_loss()
    before = {name: parameters_of(getattr(loss, name)) for name in ("critic", "actor")}
    changed: dict[str, set[str]] = {}

    def watch(part: str) -> None:
        original = getattr(loss, part)

        def called(*arguments):
            changed[part] = {
                name
                for name in before
                if not same(before[name], parameters_of(getattr(loss, name)))
            }
            return original(*arguments)

        monkeypatch.setattr(loss, part, called)

    for part in STEP:
        watch(part)
    make_stepper(loss, schedule=UpdateSchedule(target_period=1)).step(None, make_batch(6))
    # The temperature's loss needs the sampled log-densities alone; its step is the actor's.
    seen = [set(), {"critic"}, {"critic"}, {"critic", "actor"}]
    assert changed == dict(zip(STEP, seen, strict=True))


def test_schedule(monkeypatch: pytest.MonkeyPatch):
    """Delay 3, then an actor update every 2nd and a target update every 4th critic update."""
    loss = make_loss()
    calls = spied(loss, monkeypatch)
    schedule = UpdateSchedule(actor_period=2, target_period=4, actor_delay=3)
    stepper = make_stepper(loss, schedule=schedule)
    happened = []
    for _ in range(10):
        calls.clear()
        stepper.step(None, make_batch(6))
        happened.append("".join(name[0] for name in calls))
    actor, target = [5, 7, 9], [4, 8]
    assert [i for i, names in enumerate(happened, 1) if "a" in names] == actor
    assert [i for i, names in enumerate(happened, 1) if "u" in names] == target
    assert loss.updates == len(actor)  # n of lambda(n) counts actor updates


@pytest.mark.parametrize(
    ("option", "value"),
    [("actor_period", 0), ("target_period", 0), ("actor_delay", -1), ("diagnostics_period", 0)],
)
def test_a_senseless_schedule_names_its_key(option: str, value: int):
    with pytest.raises(ValueError, match=rf"optim\.{option} must .* got {value}"):
        UpdateSchedule(**{option: value})


@pytest.mark.parametrize("diagnostics_period", [1, 10**9], ids=["two gradients", "one gradient"])
def test_weight_zero_is_no_imitation(diagnostics_period: int):
    marked, plain = make_loss(bc_weight=0.0, rl_on_demos=True), None
    plain = deepcopy(marked)
    schedule = UpdateSchedule(diagnostics_period=diagnostics_period)
    for loss, demo_rows in ((marked, 3), (plain, None)):
        stepper = make_stepper(loss, schedule=schedule)
        torch.manual_seed(5)
        for _ in range(3):
            stepper.step(None, make_batch(6, demo_rows))
    for mine, theirs in zip(parameters_of(marked), parameters_of(plain), strict=True):
        torch.testing.assert_close(mine, theirs)


def test_measuring_the_gradients_does_not_change_the_step():
    first = make_loss(bc_weight=0.7)
    second = deepcopy(first)
    for loss, period in ((first, 1), (second, 10**9)):
        # The very first step measures, whatever the period.
        loss.updates = 1
        torch.manual_seed(5)
        stepper = make_stepper(loss, schedule=UpdateSchedule(diagnostics_period=period))
        stepper.step(None, make_batch(6, 3))
    for mine, theirs in zip(parameters_of(first), parameters_of(second), strict=True):
        torch.testing.assert_close(mine, theirs)


def flat(tensors) -> torch.Tensor:
    return torch.cat([tensor.flatten() for tensor in tensors])


def gradients_of_a_step(
    loss: BCSACLoss, demo_rows: int, **options
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, dict]:
    """The gradient that the actor's optimizer was given, and both halves by autograd."""
    frozen = {"actor_lr": 0.0, "critic_lr": 0.0, "temperature_lr": 0.0}
    reference = deepcopy(loss)
    batch = make_batch(6, demo_rows)
    torch.manual_seed(5)
    stepper = make_stepper(loss, **frozen, **options)
    metrics = stepper.named(stepper.step(None, batch))
    torch.manual_seed(5)
    reference.critic_terms(batch)  # takes its share of the random numbers
    terms = reference.actor_terms(batch)
    actor = list(reference.actor.parameters())
    g_rl = torch.autograd.grad(terms.values["rl"].loss, actor, retain_graph=True)
    g_bc = torch.autograd.grad(terms.values["bc"].loss, actor)
    given = flat(parameter.grad for parameter in loss.actor.parameters())
    return given, flat(g_rl), flat(g_bc), metrics


def test_fixed_weights_add_the_gradients():
    loss = make_loss(bc_weight=0.7)
    given, g_rl, g_bc, metrics = gradients_of_a_step(loss, 3)
    torch.testing.assert_close(given, g_rl + 0.7 * g_bc)
    assert metrics["bc_weight"] == pytest.approx(0.7)


@pytest.mark.parametrize("updates", [0, 3])
def test_in_ratio_mode_imitation_has_a_set_share_of_the_rl_gradient(updates: int):
    """|w g_BC| = lambda(n) ratio |g_RL|, in the direction of g_BC."""
    loss = make_loss(bc_weight=ExponentialWeight(init=0.8, decay=0.5), bc_rule=GradientRatio(2.5))
    loss.updates = updates
    share = 0.8 * 0.5**updates * 2.5
    given, g_rl, g_bc, metrics = gradients_of_a_step(loss, 3)
    imitation = given - g_rl
    torch.testing.assert_close(imitation.norm(), share * g_rl.norm(), rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(
        torch.cosine_similarity(imitation, g_bc, dim=0), torch.tensor(1.0), rtol=1e-4, atol=0
    )
    torch.testing.assert_close(metrics["grad_norm_rl"], g_rl.norm())
    torch.testing.assert_close(metrics["grad_norm_bc"], g_bc.norm())
    torch.testing.assert_close(
        metrics["grad_cosine"], torch.cosine_similarity(g_rl, g_bc, dim=0), rtol=1e-4, atol=1e-5
    )
    torch.testing.assert_close(metrics["bc_weight"] * g_bc.norm(), share * g_rl.norm())


@pytest.mark.parametrize(("ratio", "rule"), [(None, None), (2.5, GradientRatio(2.5))])
def test_the_configured_ratio_is_the_rule_of_the_imitation_term(
    ratio: float | None, rule: GradientRatio | None
):
    networks = make_loss()
    settings = LossSettings(bc_gradient_ratio=ratio)
    loss = configured.make_loss(settings, networks.actor, networks.critic, ACTION_SIZE, updates=1)
    assert loss.composition["bc"].rule == rule


def test_a_ratio_of_zero_imitates_nothing():
    loss = make_loss(bc_weight=0.8, bc_rule=GradientRatio(0.0))
    given, g_rl, g_bc, metrics = gradients_of_a_step(loss, 3)
    assert g_bc.norm() > 0
    torch.testing.assert_close(given, g_rl)
    assert metrics["bc_weight"] == 0


def test_ratio_mode_without_demonstrations_is_reinforcement_alone():
    loss = make_loss(bc_weight=1.0)
    plain = deepcopy(loss)
    loss.configure("bc", rule=GradientRatio(2.0))
    for one in (loss, plain):
        torch.manual_seed(5)
        make_stepper(one).step(None, make_batch(6))
    assert same(parameters_of(loss), parameters_of(plain))


def test_the_norm_of_both_gradients_is_clipped():
    loss = make_loss(bc_weight=100.0)
    make_stepper(loss, max_grad_norm=1e-3).step(None, make_batch(6, 3))
    for network in (loss.actor, loss.critic):
        norm = flat(parameter.grad for parameter in network.parameters()).norm()
        assert norm <= 1e-3 * (1 + 1e-4)


def test_results_are_detached_and_have_the_same_keys_at_every_step():
    """TorchRL averages them over a batch's steps by the keys of the first."""
    stepper = make_stepper(make_loss(), schedule=UpdateSchedule(actor_period=3))
    for _ in range(4):
        result = stepper.step(None, make_batch(6, 2))
        assert [(key, value.shape) for key, value in result.items()] == [("metrics", (12,))]
        assert not result["metrics"].requires_grad
    assert result["metrics"].isfinite().all()
    assert stepper.named(result) == stepper.last
    assert set(stepper.last) == set(stepper.metrics)


def test_steps_leave_no_tensors_behind():
    stepper = make_stepper(make_loss(), schedule=UpdateSchedule(diagnostics_period=2))

    def alive_after(steps: int) -> int:
        for _ in range(steps):
            stepper.step(None, make_batch(6, 2))
        gc.collect()
        return sum(issubclass(type(thing), torch.Tensor) for thing in gc.get_objects())

    alive_after(4)
    assert alive_after(2) == alive_after(10)


def test_the_temperature_moves_only_if_it_is_learned():
    for learned in (True, False):
        loss = make_loss(learn_temperature=learned)
        before = loss.log_alpha.detach().clone()
        make_stepper(loss).step(None, make_batch(6))
        assert torch.equal(before, loss.log_alpha.detach()) is not learned


def movements(actor: nn.Module, step, times: int) -> list[float]:
    """How far each of several steps moves the actor's weights."""
    moved, before = [], flat(parameters_of(actor))
    for _ in range(times):
        step()
        after = flat(parameters_of(actor))
        moved.append((after - before).norm().item())
        before = after
    return moved


@pytest.mark.parametrize("imitation", [True, False])
def test_an_annealed_rate_goes_to_zero_and_stays_there(imitation: bool):
    loss = make_loss()
    batch = make_batch(8, 4)
    if imitation:
        stepper = ImitationStepper(loss, actor_lr=1e-2, anneal_updates=4)
    else:
        stepper = make_stepper(loss, anneal_updates=4)
    moved = movements(loss.actor, lambda: stepper.step(None, batch), 7)
    assert min(moved[:4]) > 0
    assert moved[3] < 0.4 * moved[0]
    assert moved[4:] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("imitation", [True, False])
def test_a_rate_is_constant_unless_annealed(imitation: bool):
    """Adam's steps have the size of its rate while the gradient keeps its direction."""
    loss = make_loss()
    batch = make_batch(8, 4)
    stepper = ImitationStepper(loss, actor_lr=1e-4) if imitation else make_stepper(loss)
    optimizer = stepper.optimizer if imitation else stepper.optimizers["actor"]
    rates = []
    for _ in range(8):
        rates.append(optimizer.param_groups[0]["lr"])
        stepper.step(None, batch)
    assert len(set(rates)) == 1


@pytest.mark.parametrize("anneal_updates", [None, 3])
def test_a_step_goes_on_from_its_state(anneal_updates: int | None):
    schedule = UpdateSchedule(actor_period=2, target_period=4, diagnostics_period=2)
    torch.manual_seed(1)
    batches = [make_batch(6, 2) for _ in range(7)]
    whole = make_loss()
    halved = deepcopy(whole)
    options = {"schedule": schedule, "anneal_updates": anneal_updates}
    first = make_stepper(halved, **options)
    for loss, stepper in ((whole, make_stepper(whole, **options)), (halved, first)):
        torch.manual_seed(5)
        for batch in batches[:3]:
            stepper.step(None, batch)
        if loss is whole:
            expected = [stepper.step(None, batch) for batch in batches[3:]]
    second = make_stepper(halved, **options)
    second.load_state_dict(deepcopy(first.state_dict()))
    metrics = [second.step(None, batch) for batch in batches[3:]]
    assert same(parameters_of(whole), parameters_of(halved))
    # Those that the first steps do not compute, too.
    assert all((mine == theirs).all() for mine, theirs in zip(metrics, expected, strict=True))


def test_imitation_alone_fits_the_demonstrations_and_touches_nothing_else():
    loss = make_loss()
    batch = make_batch(16, 16)
    others = parameters_of(loss.critic)
    stepper = ImitationStepper(loss, actor_lr=1e-2)
    losses = [stepper.step(None, batch)["loss_bc"].item() for _ in range(60)]
    assert losses[-1] < losses[0] - 1.0
    assert same(others, parameters_of(loss.critic))
    assert torch.equal(loss.log_alpha, make_loss().log_alpha)


def test_imitation_goes_on_from_its_state():
    whole = make_loss()
    halved = deepcopy(whole)
    batch = make_batch(8, 8)
    options = {"actor_lr": 1e-2, "anneal_updates": 8}
    first, second = (ImitationStepper(halved, **options) for _ in range(2))
    stepper = ImitationStepper(whole, **options)
    for _ in range(6):
        stepper.step(None, batch)
    for _ in range(3):
        first.step(None, batch)
    second.load_state_dict(deepcopy(first.state_dict()))
    for _ in range(3):
        second.step(None, batch)
    assert same(parameters_of(whole.actor), parameters_of(halved.actor))


def test_the_networks_are_the_ones_that_were_given():
    """The stepper optimises the modules themselves: what the collector acts with, learns."""
    loss = make_loss()
    actor: nn.Module = loss.actor
    before = parameters_of(actor)
    make_stepper(loss).step(None, make_batch(6))
    assert not same(before, parameters_of(actor))


def rates(*optimizers: torch.optim.Optimizer) -> list[float]:
    return [float(group["lr"]) for one in optimizers for group in one.param_groups]


@pytest.mark.parametrize("compile_updates", [False, True], ids=["numbers", "in memory"])
def test_a_resumed_stepper_learns_at_its_own_rates(compile_updates: bool):
    """Rates in memory are those of a compiled update; nothing is compiled until one is made."""
    before = make_stepper(make_loss(), anneal_updates=4)
    for _ in range(2):
        before.step(None, make_batch(6, 3))
    # Half of a cosine from 1 to 0.
    assert rates(*before.optimizers.values()) == pytest.approx([1e-2, 5e-3, 1e-2])
    after = make_stepper(
        make_loss(),
        actor_lr=2e-3,
        critic_lr=3e-3,
        temperature_lr=4e-3,
        anneal_updates=4,
        compile_updates=compile_updates,
    )
    after.load_state_dict(before.state_dict())
    assert rates(*after.optimizers.values()) == pytest.approx([3e-3, 1e-3, 4e-3])
    after.annealing.step()  # three quarters of it: (1 + cos(3 pi / 4)) / 2 = 0.1464466
    assert rates(*after.optimizers.values()) == pytest.approx([3e-3, 0.1464466 * 2e-3, 4e-3])


def test_a_resumed_annealing_is_as_long_as_it_is_now():
    """Two updates of four done; with eight, a quarter of the cosine: (1 + cos(pi / 4)) / 2."""
    before = make_stepper(make_loss(), anneal_updates=4)
    for _ in range(2):
        before.step(None, make_batch(6, 3))
    for updates, share in ((8, 0.853553), (None, 1.0)):
        after = make_stepper(make_loss(), anneal_updates=updates)
        after.load_state_dict(before.state_dict())
        assert rates(after.optimizers["actor"])[0] == pytest.approx(share * 1e-2)


@pytest.mark.parametrize("anneal_updates", [None, 4])
def test_a_resumed_cloning_learns_at_its_own_rate(anneal_updates: int | None):
    before = ImitationStepper(make_loss(), actor_lr=1e-2, anneal_updates=anneal_updates)
    for _ in range(2):
        before.step(None, make_batch(6, 6))
    after = ImitationStepper(make_loss(), actor_lr=2e-3, anneal_updates=anneal_updates)
    after.load_state_dict(before.state_dict())
    assert rates(after.optimizer) == pytest.approx([2e-3 if anneal_updates is None else 1e-3])
