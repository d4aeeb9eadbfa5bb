"""That the whole thing learns, judged by a statistical test."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import permutation_test

from configs import compose
from pipeline.build import build_run
from pipeline.playing import make_evaluator
from tests.toys import reach


@pytest.mark.slow
def test_sac_learns_the_pendulum(tmp_path: Path):
    """Returns of 30 episodes after 8000 frames are better than before, and not by chance."""
    config = compose(
        "variant=sac",
        "preset=smoke",
        "task.name='gymnasium:Pendulum-v1'",
        "env.num_envs=5",
        "env.horizon=null",
        "actor.hidden=[64,64]",
        "critic.hidden=[64,64]",
        "loss.n_step=1",
        "loss.init_temperature=0.1",
        "loss.entropy_in_target=true",
        "optim.actor_lr=1e-3",
        "optim.critic_lr=1e-3",
        "optim.temperature_lr=1e-3",
        "optim.updates_per_frame=1.0",
        "optim.actor_delay=0",
        "optim.actor_period=1",
        "sampler.batch_size=128",
        "collector.total_frames=8000",
        "collector.frames_per_batch=50",
        "collector.random_frames=500",
        "evaluation.interval=0",
        "logging.checkpoint_interval=100000",
    )
    evaluator = make_evaluator(config, config.find_task(), episodes=30)
    run = build_run(config, tmp_path / "run")
    before = evaluator.run(run.actor).returns
    run.train()
    after = evaluator.run(run.actor).returns
    better = permutation_test(
        (after, before),
        lambda x, y, axis: np.mean(x, axis=axis) - np.mean(y, axis=axis),
        alternative="greater",
        vectorized=True,
        n_resamples=9999,
        rng=np.random.default_rng(0),
    )
    assert better.pvalue < 0.001
    assert np.mean(after) > -400  # a random policy has about -1200, a good one -150


SEEDS: Final = (0, 1, 2)
STARTS: Final = 50


@pytest.mark.slow
def test_bc_sac_beats_imitation_and_reinforcement_learning_alone(tmp_path: Path):
    """With four demonstrations and 800 frames, at the same starts, by more than chance."""
    reach.record(tmp_path / "demos.h5", 4)
    returns = {variant: learnt(variant, tmp_path) for variant in ("bc", "sac", "bc_sac")}
    for alone in ("bc", "sac"):
        gained = returns["bc_sac"] - returns[alone]
        luck = permutation_test(
            (gained,),
            lambda x, axis: np.mean(x, axis=axis),
            permutation_type="samples",
            alternative="greater",
            vectorized=True,
            n_resamples=9999,
            rng=np.random.default_rng(0),
        )
        assert luck.pvalue < 0.001, (alone, {name: x.mean() for name, x in returns.items()})


def learnt(variant: str, folder: Path) -> NDArray[np.float64]:
    """Returns [seeds * starts] after training."""
    found = []
    for seed in SEEDS:
        recipe = compose(
            f"variant={variant}",
            "preset=smoke",
            f"task.name='{reach.__file__}'",
            f"demos.source='{folder / 'demos.h5'}'",
            f"cache_dir='{folder / 'cache'}'",
            f"seed={seed}",
            "torch_threads=1",
            "demos.held_out=0",
            "env.num_envs=5",
            "env.horizon=null",
            "actor.hidden=[64,64]",
            "critic.hidden=[64,64]",
            "bc.updates=500",
            "loss.n_step=1",
            "optim.actor_lr=1e-3",
            "optim.critic_lr=1e-3",
            "optim.temperature_lr=1e-3",
            "optim.updates_per_frame=1.0",
            "optim.actor_delay=50",
            "optim.actor_period=1",
            "sampler.batch_size=64",
            "collector.total_frames=800",
            "collector.frames_per_batch=50",
            "evaluation.interval=0",
            "logging.checkpoint_interval=100000",
        )
        run = build_run(recipe, folder / f"{variant}-{seed}")
        run.train()
        found.append(
            make_evaluator(recipe, recipe.find_task(), episodes=STARTS).run(run.actor).returns
        )
    return np.concatenate(found)
