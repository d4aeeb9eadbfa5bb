"""Rivals as compositions: each is what its paper says it is, on the toy."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.trainers import Trainer

from envs import EnvOptions, find_task
from envs.task import MissingCapabilityError
from pipeline.build import build_run
from pipeline.cloning import behaviour_cloned
from pipeline.conversion import make_rows
from pipeline.data.demonstrations import Demonstrations, make_demonstrations
from pipeline.data.rows import ROW_KEYS
from pipeline.playing import make_curriculum
from pipeline.policy import load_policy
from pipeline.recipe import Recipe
from pipeline.trainer import Run
from tests.pipeline.resuming import differences
from tests.test_toy import FILE, tiny, whole
from tests.toys import reach

FRAMES = 40


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rivals") / "reach.h5"
    reach.record(path)
    return path


def built(variant: str, folder: Path, demos: Path, *overrides: str) -> Run:
    recipe = tiny(variant, folder, demos, f"collector.total_frames={FRAMES}", *overrides)
    return build_run(recipe, folder / "run")


def loaded(recipe: Recipe) -> Demonstrations:
    return make_demonstrations(
        recipe.demos,
        find_task(FILE),
        make_rows(recipe),
        cache_dir=Path(recipe.cache_dir),
        num_threads=1,
    )


def test_rlpd_has_twenty_critic_updates_a_frame_on_half_demonstrations(tmp_path: Path, demos: Path):
    run = built("rlpd", tmp_path, demos)
    shares = []
    loss, stepper = run.trainer.loss_module, run.trainer.optimization_stepper
    step = stepper.step

    def watched(trainer: Trainer, batch: TensorDictBase) -> TensorDictBase:
        shares.append(float(batch["is_demo"].float().mean()))
        return step(trainer, batch)

    stepper.step = watched
    run.train()
    assert set(shares) == {0.5}
    assert len(shares) == stepper.critic_updates == 20 * FRAMES
    assert loss.updates == FRAMES
    assert loss.critic(torch.zeros(3, 4), torch.zeros(3, 2)).shape == (10, 3, 1)


def test_sacfd_has_its_demonstrations_in_the_replay_buffer(tmp_path: Path, demos: Path):
    run = built("sacfd", tmp_path, demos)
    rows = loaded(run.recipe).rows
    buffer = run.trainer._modules["main_buffer"]
    held = buffer[:]
    assert held.shape == rows.shape
    for key in ROW_KEYS:
        assert torch.equal(held[key], rows[key])
    run.train()
    assert len(buffer) > len(rows) + FRAMES // 2, "what was collected came behind them"
    assert torch.equal(buffer[:]["action"][: len(rows)], rows["action"])
    # A resumed run has them once.
    again = build_run(run.recipe, run.run_dir, resume=True)
    assert len(again.trainer._modules["main_buffer"]) == len(buffer)


def test_loki_begins_as_the_bc_model_and_imitates_no_more(tmp_path: Path, demos: Path):
    run = built("loki", tmp_path, demos)
    model = behaviour_cloned(run.recipe, find_task(FILE), loaded(run.recipe))
    for name, weights in model.state_dict().items():
        assert torch.equal(run.actor.state_dict()[name], weights), name
    assert run.recipe.loss.bc_weight.init == 0.0
    assert run.recipe.sampler.demo_ratio == 0.0


def test_sil_learns_from_returns_of_demonstrations_and_its_own_episodes(
    tmp_path: Path, demos: Path
):
    run = built("sil", tmp_path, demos, "loss.self_imitation.advantage_cap=null")
    run.train()
    grown = run.trainer._modules["grown_buffer"][:]
    # Two copies, 20 steps each: all their episodes are there, with ends 20, 19, ... steps ahead.
    assert grown["to_end", "steps"].squeeze(-1).tolist() == 2 * list(range(20, 0, -1))
    first = grown[:20]
    assert (first["to_end", "observation"] == first["to_end", "observation"][0]).all()
    assert not grown["to_end", "terminated"].any(), "a time limit, no end of its own"
    assert "to_end" not in run.trainer._modules["main_buffer"][:].keys()  # noqa: SIM118
    found = run.trainer.optimization_stepper.last
    assert 0.0 < found["better_share"] <= 1.0
    assert found["self_imitation_weight"] == 1.0
    assert found["grad_norm_self_imitation"] > 0.0


def test_ibrl_acts_and_looks_ahead_with_a_frozen_clone(tmp_path: Path, demos: Path):
    run = built("ibrl", tmp_path, demos)
    model = behaviour_cloned(run.recipe, find_task(FILE), loaded(run.recipe))
    run.train()
    proposal = run.trainer.loss_module.composition["qvalue"].proposal
    assert run.actor.proposal is proposal
    assert run.actor.critic is run.trainer.loss_module.target_critic
    for name, weights in model.state_dict().items():
        assert torch.equal(proposal.actor.state_dict()[name], weights), name
    policy, _ = load_policy(run.recipe, find_task(FILE), run.run_dir)
    assert all(torch.equal(policy.state_dict()[k], v) for k, v in run.actor.state_dict().items())


def test_da_sac_may_learn_from_what_turned_out_better(tmp_path: Path, demos: Path):
    """Its batches without demonstrations have no ends; those of the extra updates do."""
    more = ("loss.self_imitation.weight=0.25", "optim.actor_period=1")
    run = built("da_sac", tmp_path, demos, *more)
    shares = []
    stepper = run.trainer.optimization_stepper
    step = stepper.step

    def watched(trainer: Trainer, batch: TensorDictBase) -> TensorDictBase:
        found = step(trainer, batch)
        shares.append(float(stepper.last["better_share"]))
        return found

    stepper.step = watched
    run.train()
    assert [share > 0.0 for share in shares] == 2 * [False, False, True]


def test_rfcl_begins_in_demonstrations_and_moves_their_frontiers(tmp_path: Path, demos: Path):
    run = built("rfcl", tmp_path, demos, "optim.updates_per_frame=0.1", "optim.actor_period=1")
    curriculum = run.trainer._modules["curriculum"]
    lasts = curriculum.lasts.tolist()
    seen = []
    begin = curriculum.begin
    run.trainer.collector.env.begin = lambda count: seen.append(begin(count)) or seen[-1]
    run.train()
    starts, at = (torch.cat(part) for part in zip(*seen, strict=True))
    assert len(at) >= 2
    for (demo, step), start in zip(at.tolist(), starts["start"], strict=True):
        assert torch.equal(start, curriculum.states[demo]["start"][step])
        assert step <= lasts[demo]
    # The controller that was recorded ends within the goal: to begin there is to succeed.
    assert at[:2, 1].tolist() == [lasts[demo] for demo in at[:2, 0].tolist()]
    again = build_run(run.recipe, run.run_dir, resume=True)
    assert (
        again.trainer._modules["curriculum"].state_dict().keys() == curriculum.state_dict().keys()
    )
    assert torch.equal(again.trainer._modules["curriculum"].frontiers, curriculum.frontiers)


def test_rfcl_is_refused_where_no_state_can_be_entered(tmp_path: Path, demos: Path):
    recipe = tiny("rfcl", tmp_path, demos, "task.name='gymnasium:Pendulum-v1'")
    needs = r"curriculum\.reverse=true needs a task that can begin an episode anywhere"
    task = find_task("gymnasium:Pendulum-v1")
    env = task.make_env(EnvOptions(seed=0))
    with pytest.raises(MissingCapabilityError, match=needs):
        make_curriculum(recipe, task, env, None)
    env.close()


def test_qc_rlpd_learns_and_acts_in_chunks_of_five(tmp_path: Path, demos: Path):
    run = built("qc_rlpd", tmp_path, demos, "optim.updates_per_frame=0.1")
    run.train()
    rows = run.trainer._modules["main_buffer"][:]
    assert rows["action"].shape[-1] == 5 * 2
    assert (rows["steps_to_next_obs"] == 5).all()
    # Rows that follow each other overlap: each begins with the second action of the one before.
    follows = (rows["observation"][1:] - rows["observation"][:-1]).abs().amax(-1) < 0.2
    assert follows.sum() > 10
    assert torch.equal(rows["action"][:-1, 2:][follows], rows["action"][1:, :-2][follows])
    assert run.trainer.loss_module.composition["alpha"].target_entropy == -10.0
    assert run.recipe.loss.bc_weight.init == 0.01
    assert run.actor.length == 5


def test_chunks_look_as_far_ahead_as_they_are_long(tmp_path: Path, demos: Path):
    with pytest.raises(ValueError, match=r"actor\.chunk=5 .* set loss\.n_step=5 too, it is 3"):
        built("qc_rlpd", tmp_path, demos, "loss.n_step=3")


@pytest.mark.parametrize("variant", ["ibrl", "qc_rlpd", "rfcl", "sil"])
def test_a_resumed_run_is_the_uninterrupted_one(variant: str, tmp_path: Path, demos: Path):
    """Two copies, episodes of 19 steps, chunks of 5: the cut after 20 of each is within both."""
    few = ("env.horizon=19", "optim.updates_per_frame=0.1", "optim.actor_period=1")
    recipe = tiny(variant, tmp_path, demos, "collector.total_frames=80", *few)
    uninterrupted = build_run(recipe, tmp_path / "whole")
    uninterrupted.train()
    half = build_run(recipe, tmp_path / "half")
    half.trainer.total_frames = 40
    half.train()
    torch.manual_seed(4321)
    resumed = build_run(recipe, tmp_path / "half", resume=True)
    assert resumed.trainer.collected_frames == 40
    resumed.train()
    assert differences(whole(resumed), whole(uninterrupted)) == []
