"""Updates are counted as the trainer makes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from configs import compose
from pipeline.learner import average_decay
from pipeline.recipe import Recipe
from pipeline.updates import (
    actor_updates,
    critic_updates,
    frames_of_run,
    late_actor,
    main_updates,
    updates_per_portion,
)
from tests.pipeline.toys import built, tiny_config

PENDULUM = (
    "task.name='gymnasium:Pendulum-v1'",
    "optim.updates_per_frame=0.2",  # 4 updates after each portion of 20 frames
    "loss.n_step=1",
    "actor.normalise_observations=false",
    "critic.normalise_observations=false",
    "actor.hidden=[4]",
    "critic.hidden=[4]",
    "evaluation.interval=0",
    "compile_updates=false",
    "torch_threads=1",
    "optim.anneal_actor=true",
    "growth.admission.min_return=0.0",
)


@pytest.mark.parametrize(
    ("frames", "random", "envs", "portions", "each"),
    [
        (80, 0, 2, 4, 4),
        (70, 0, 2, 4, 4),  # whole portions: 80 frames are collected
        (80, 20, 2, 4, 4),  # the first portion completes the random frames, and is learned from
        (80, 40, 2, 3, 4),
        (80, 50, 2, 2, 4),  # complete with the third portion
        (80, 500, 2, 0, 4),
        (70, 30, 3, 3, 4),  # portions of 21 frames: 21, 42, 63, 84; the first is too early
        (70, 0, 32, 3, 6),  # portions of 32 frames, a step of each copy: 6.4 updates
    ],
)
@pytest.mark.filterwarnings("ignore:.*is not exactly a multiple")
@pytest.mark.filterwarnings("ignore:.*is not exactly divisible")
def test_online_updates_by_hand_and_by_a_run(
    frames: int, random: int, envs: int, portions: int, each: int, tmp_path: Path, demos: Path
):
    options = (
        *PENDULUM,
        f"collector.total_frames={frames}",
        f"collector.random_frames={random}",
        f"env.num_envs={envs}",
        "optim.actor_period=2",
        "optim.actor_delay=3",
    )
    config = tiny_config("sac", tmp_path, demos, *options)
    assert main_updates(config) == critic_updates(config) == each * portions
    assert actor_updates(config) == max(each * portions - 3, 0) // 2
    run = built(config)
    run.train()
    assert run.trainer._optim_count == main_updates(config)
    stepper = run.trainer.optimization_stepper
    assert stepper.critic_updates == critic_updates(config)
    assert stepper.loss.updates == actor_updates(config)
    if portions:
        # The annealing has just come to its end.
        assert stepper.optimizers["actor"].param_groups[0]["lr"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("per_frame", "asked", "envs", "updates", "frames"),
    [
        (0.3, 500, 10, 150, 1000),  # 2 portions of 500 for 900 frames
        (0.3, 500, 64, 154, 1024),  # portions of 512: 153.6 updates
        (1.0, 1, 64, 64, 960),  # as many as frames, not one for all copies; 15 portions
        (0.2, 20, 3, 4, 903),  # 43 portions of 21: 4.2 updates
    ],
)
def test_updates_are_counted_by_what_is_collected(
    per_frame: float, asked: int, envs: int, updates: int, frames: int
):
    recipe = Recipe().changed(
        env={"num_envs": envs},
        optim={"updates_per_frame": per_frame},
        collector={"frames_per_batch": asked, "total_frames": 900},
    )
    assert updates_per_portion(recipe) == updates
    assert frames_of_run(recipe) == frames


@pytest.mark.parametrize("period", [1, 3])
def test_extra_updates_on_demonstrations_count(period: int, tmp_path: Path, demos: Path):
    """40 frames, 2 portions of 2 updates each: 4 more with period 1, 1 more with period 3."""
    config = tiny_config("da_sac", tmp_path, demos, f"sampler.demo_update_period={period}")
    assert main_updates(config) == 4
    assert critic_updates(config) == 4 + 4 // period
    run = built(config)
    run.train()
    assert run.trainer._optim_count == 4
    assert run.trainer.optimization_stepper.critic_updates == critic_updates(config)


@pytest.mark.parametrize(("asked", "made"), [(100, 100), (150, 200), (5, 100)])
def test_cloning_updates_come_in_hundreds(asked: int, made: int, tmp_path: Path, demos: Path):
    options = (f"bc.updates={asked}", "bc.anneal=true", "evaluation.interval=0")
    config = tiny_config("bc", tmp_path, demos, *options)
    assert main_updates(config) == critic_updates(config) == actor_updates(config) == made
    run = built(config)
    run.train()
    assert run.trainer._optim_count == made
    optimizer = run.trainer.optimization_stepper.optimizer
    assert optimizer.param_groups[0]["lr"] == pytest.approx(0.0, abs=1e-12)


def test_the_average_spans_the_updates_that_are_made():
    """A tenth of 3,000 updates: random frames teach nothing but with their last portion."""
    config = compose(
        "optim.actor_average=null",
        "optim.actor_average_share=0.1",
        "optim.updates_per_frame=0.1",
        "collector.total_frames=100000",
        "collector.frames_per_batch=500",
        "collector.random_frames=70500",
    )
    # Portions 141 to 200 of 50 updates each.
    assert main_updates(config) == 60 * 50
    assert average_decay(config) == 1.0 - 1.0 / 300


def test_no_environments_are_named():
    with pytest.raises(ValueError, match=r"env\.num_envs=0: must be 1 or more"):
        compose("env.num_envs=0")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        # 0.3 updates a frame: 1,500 updates, fewer than the critics' warm-up of 2,000.
        (
            ["collector.total_frames=5000"],
            "the policy will not change in this run: its actor starts after optim.actor_delay=2000 "
            "updates and there are only 1500; set optim.actor_delay=500 or collect more",
        ),
        # 2,400 updates; the actor learns in the last 400.
        (["collector.total_frames=8000"], "its actor gets only 400 of 2400 updates"),
        (["collector.total_frames=20000"], None),
        (["collector.total_frames=5000", "optim.actor_delay=100"], None),
        (
            ["collector.random_frames=9000", "collector.total_frames=900"],
            "nothing is learned in this run: all of its 900",
        ),
    ],
)
def test_a_run_that_hardly_moves_its_policy_is_warned_of(changes: list[str], told: str | None):
    found = late_actor(compose("variant=bc_sac", "preset=default", *changes))
    assert found is None if told is None else told in str(found)
