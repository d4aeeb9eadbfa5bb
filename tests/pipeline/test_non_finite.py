"""Numbers that are not finite are found, named and kept, and nothing is built on them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from safetensors import safe_open
from tensordict import TensorDict

from envs import EnvOptions
from losses import ActorPass, ActorTerm, Objective, SoftTD, SoftValue, Temperature, TermValue
from pipeline.act.evaluation import run_wave
from pipeline.compute import require_device
from pipeline.files.run_files import as_json
from pipeline.finite import require_finite_step
from pipeline.hooks import PortionGuard
from pipeline.learn.imitation import ImitationStepper
from pipeline.learn.stepper import BCSACStepper
from pipeline.learn.update_guard import HEALTH
from pipeline.non_finite import BATCH, NonFiniteError
from pipeline.trainer import Run
from tests.pipeline import updating
from tests.pipeline.toys import built, make_batch, make_loss, tiny_config
from tests.toys import reach

NAN, INF = math.nan, math.inf


def portion(copies: int = 2, steps: int = 3) -> TensorDict:
    shape = [copies, steps]
    told = {"observation": torch.zeros(*shape, 4), "reward": torch.zeros(*shape, 1)}
    own = {"observation": torch.zeros(*shape, 4), "action": torch.zeros(*shape, 2)}
    return TensorDict({**own, "next": told}, shape)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("observation", NAN, r"^observation is nan at frame 104 \(environment copy 1\): .*reset"),
        ("action", INF, r"^action is inf at frame 104 .*the policy gave it"),
        (("next", "reward"), -INF, r"^next\.reward is -inf at frame 104 .*task\.reward"),
        (("next", "observation"), NAN, r"^next\.observation is nan at frame 104 .*simulation"),
    ],
)
def test_a_collected_step_that_is_not_finite_is_named(key: str, value: float, message: str):
    """Copies take their steps together: frame 104 of 2 copies after 100 is copy 1, second step."""
    guard = PortionGuard()
    guard._trainer = SimpleNamespace(collected_frames=100)
    seen = portion()
    assert guard(seen) is seen
    seen[key][1, 1, -1] = value
    with pytest.raises(NonFiniteError, match=message) as error:
        guard(seen)
    assert error.value.batch is seen


def test_the_first_of_several_is_the_one_that_is_named():
    """A step's own reward comes before the next step's observation, which is what it showed."""
    seen = portion()
    seen["next", "observation"][0, 2] = NAN
    seen["observation"][0, 2] = NAN
    seen["next", "reward"][1, 1] = NAN
    with pytest.raises(NonFiniteError, match=r"next\.reward is nan at frame 4 "):
        PortionGuard()(seen)


def test_a_stream_of_empty_portions_passes():
    empty = TensorDict({}, [100])
    assert PortionGuard()(empty) is empty


def after(stepper: BCSACStepper | ImitationStepper, batch: TensorDict) -> NonFiniteError:
    """What the second of two steps raises, on ``batch``."""
    stepper.step(None, make_batch(6, 3))
    with pytest.raises(NonFiniteError) as error:
        stepper.step(None, batch)
    assert error.value.batch is batch
    return error.value


@pytest.mark.parametrize(("row", "value"), [(2, NAN), (1, INF)])
def test_a_batch_that_is_not_finite_is_named(row: int, value: float):
    batch = make_batch(6, 3)
    batch["next", "reward"][row] = value
    found = after(updating.make_stepper(make_loss(), target_period=1), batch)
    assert str(found).startswith(f"next.reward of the batch is {value} at [{row}, 0] in update 2: ")


def test_a_loss_that_overflows_is_named_with_what_is_too_large():
    batch = make_batch(6, 3)
    batch["next", "reward"][0] = 1e30
    found = str(after(updating.make_stepper(make_loss()), batch))
    assert (
        "(loss_qvalue) is inf in update 2: next.reward of the batch is as large as 1e+30" in found
    )


@dataclass(frozen=True)
class Cusp(ActorTerm):
    """The root of nothing: 0, with a gradient that is infinite times 0."""

    name: str = "cusp"

    def __call__(self, seen: ActorPass) -> TermValue:
        return TermValue((seen.policy.deterministic_sample * 0).square().mean().sqrt())


def test_a_gradient_that_is_not_finite_is_named_in_its_own_update():
    of = make_loss()
    terms = [SoftTD(gamma=0.9), SoftValue("min"), Temperature(target_entropy=-2.0), Cusp()]
    stepper = BCSACStepper(
        Objective(of.actor, of.critic, terms), actor_lr=1e-3, critic_lr=1e-3, temperature_lr=1e-3
    )
    stepper.loss.updates = 1  # not the update in a hundred that takes the terms apart
    with pytest.raises(
        NonFiniteError, match=r"^actor\..* is nan .* after update 1: .*gradient"
    ) as e:
        stepper.step(None, make_batch(6))
    assert "optim.actor_lr" in str(e.value)


@pytest.mark.parametrize("whose", ["critic", "temperature"])
def test_a_rate_that_is_too_large_is_blamed(whose: str):
    rates = {"actor_lr": 1e-3, "critic_lr": 1e-3, "temperature_lr": 1e-3} | {f"{whose}_lr": 1e39}
    stepper = BCSACStepper(make_loss(), **rates)
    with pytest.raises(
        NonFiniteError, match=rf"^{whose}\..* after update 1: .*lower optim\.{whose}_lr"
    ):
        stepper.step(None, make_batch(6))


def test_a_critic_that_breaks_is_seen_beside_an_actor_that_does_not_notice(
    monkeypatch: pytest.MonkeyPatch,
):
    stepper = BCSACStepper(make_loss(), actor_lr=1e-3, critic_lr=1e39, temperature_lr=1e-3)
    for part in ("_learn_actor", "_learn_actor_by_terms"):
        monkeypatch.setattr(stepper, part, lambda _batch: {HEALTH: torch.zeros(())})
    with pytest.raises(NonFiniteError, match=r"^critic\..* after update 1: "):
        stepper.step(None, make_batch(6))


def test_cloning_is_guarded_too():
    batch = make_batch(6, 6)
    batch["observation"][4] = NAN
    found = after(ImitationStepper(make_loss(bc_weight=1.0), actor_lr=1e-3), batch)
    assert str(found).startswith("observation of the batch is nan at [4, 0] in update 2")


def test_a_guarded_run_learns_bit_for_bit_what_one_without_learns():
    results = []
    for guarded in (True, False):
        torch.manual_seed(1)
        loss = updating.make_loss()
        stepper = updating.make_stepper(loss, guarded=guarded)
        results.append(updating.learnt(loss, stepper, updating.marked(updating.UPDATES)))
    (weights, found, drawn), (others, their_found, their_drawn) = results
    assert all(torch.equal(weights[name], others[name]) for name in weights)
    assert [str(of_one) for of_one in found] == [str(of_one) for of_one in their_found]
    assert torch.equal(drawn, their_drawn)


@pytest.mark.slow
def test_compiled_updates_are_guarded_and_unchanged_by_it():
    results = []
    for guarded in (True, False):
        torch.manual_seed(1)
        loss = updating.make_loss()
        stepper = updating.make_stepper(loss, compile_updates=True, guarded=guarded)
        results.append(updating.learnt(loss, stepper, updating.marked(updating.UPDATES))[0])
        if guarded:
            batch = updating.marked(1)[0]
            batch["next", "reward"][0] = 1e30
            with pytest.raises(NonFiniteError, match="loss_qvalue"):
                stepper.step(None, batch)
    assert all(torch.equal(results[0][name], results[1][name]) for name in results[0])


def evaluated_step() -> TensorDict:
    return TensorDict(
        {
            "action": torch.zeros(3, 2),
            "next": {"observation": torch.zeros(3, 4), "reward": torch.zeros(3, 1)},
        },
        [3],
    )


@pytest.mark.parametrize("key", ["action", ("next", "observation"), ("next", "reward")])
def test_an_evaluation_looks_at_the_episodes_that_go_on(key: str):
    step = evaluated_step()
    step[key][1] = NAN
    require_finite_step(step, torch.tensor([[True], [False], [True]]))
    name = key if isinstance(key, str) else key[1]
    with pytest.raises(NonFiniteError, match=rf"^{name} is nan .* evaluation episode 1 of"):
        require_finite_step(step, torch.tensor([[True], [True], [True]]))


def test_an_evaluation_ends_where_a_number_is_not_finite():
    env = reach.Reach(EnvOptions(num_envs=2, seed=0))
    step = env._step
    env._step = lambda td: step(td).update({"reward": torch.full((2, 1), NAN)})
    with pytest.raises(NonFiniteError, match=r"^reward is nan .* evaluation episode 0 of"):
        run_wave(env, lambda td: td.set("action", torch.zeros(2, 2)), None)


def test_json_has_no_nan():
    row = {"a": NAN, "b": [INF, 1.5, (2, -INF)], "c": {"d": NAN}, "e": "nan"}
    expected = {"a": None, "b": [None, 1.5, [2, None]], "c": {"d": None}, "e": "nan"}
    assert json.loads(as_json(row)) == expected


@pytest.mark.parametrize("device", ["cuda:99", "meta", "toaster"])
def test_a_device_that_is_not_there_is_named(device: str):
    with pytest.raises(ValueError, match=rf"^device={device} cannot be used \(.*set device=cpu"):
        require_device(device)


def poisoned_after(run: Run, frames: int) -> None:
    """From ``frames`` on, what the environment pays is NaN."""
    env = run.trainer.collector.env
    step = env._step

    def paid(td: TensorDict) -> TensorDict:
        out = step(td)
        if run.trainer.collected_frames >= frames:
            out["reward"] = out["reward"] * NAN
        return out

    env._step = paid


def test_a_run_keeps_the_batch_and_its_last_good_checkpoint(tmp_path: Path, demos: Path):
    recipe = tiny_config("sac", tmp_path, demos, "logging.checkpoint_interval=10")
    run = built(recipe)
    poisoned_after(run, 20)
    with pytest.raises(
        NonFiniteError, match=r"next\.reward is nan at frame 21 .*batch is in .*sac"
    ):
        run.train()
    with safe_open(run.run_dir / BATCH, "pt") as file:
        assert file.get_tensor("next.reward").isnan().all()
        assert "next.reward is nan at frame 21" in file.metadata()["message"]
    (checkpoint,) = (run.run_dir / "checkpoints").glob("checkpoint-*")
    assert checkpoint.name == "checkpoint-000000000020"
    again = built(recipe, resume=True)
    again.train()
    assert again.trainer.collected_frames == 40


def test_parameters_that_break_are_not_saved(tmp_path: Path, demos: Path):
    run = built(tiny_config("bc_sac", tmp_path, demos, "logging.checkpoint_interval=10"))
    with torch.no_grad():
        next(run.trainer.loss_module.critic.parameters()).fill_(NAN)
    with pytest.raises(NonFiniteError, match=r"term '.*' .* is nan in update 1: "):
        run.train()
    assert not (run.run_dir / "checkpoints").exists()
