"""The factor that ``loss.reward_scale=auto`` stands for, and that a run keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from configs import compose
from envs.demonstrations.episode import Episode, Provenance
from pipeline.build import build_run
from pipeline.data.demonstrations import Demonstrations
from pipeline.data.rows import TransitionRows
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe
from pipeline.scale_choice import good_value, with_chosen_scale
from tests.pipeline.toys import trajectory
from tests.toys import reach

AUTO = Recipe().changed(loss={"reward_scale": "auto", "gamma": 0.5})


def episode(rewards: Sequence[float]) -> Episode:
    steps = len(rewards)
    return Episode(
        observations=np.zeros((steps + 1, 1), np.float32),
        actions=np.zeros((steps, 1), np.float32),
        rewards=np.asarray(rewards, np.float32),
        terminated=np.zeros(steps, bool),
        provenance=Provenance("by hand", 0, "recorded", {}),
        start={},
    )


def demonstrations(*episodes: Sequence[float]) -> Demonstrations:
    rewards = torch.tensor([[reward] for of_one in episodes for reward in of_one])
    rows = TensorDict({"next": {"reward": rewards}}, [len(rewards)])
    return Demonstrations(
        rows, None, "hash", "source", 0.0, 1.0, episodes=[episode(of_one) for of_one in episodes]
    )


def test_a_state_is_worth_its_discounted_rewards_to_go():
    # From the end: 8, 4 + 8 / 2 = 8, 2 + 8 / 2 = 6; alone -40. Of |6, 8, 8, 40|, 0.9 is 0.7 of the
    # way from the third to the fourth.
    assert good_value([episode([2, 4, 8]), episode([-40])], 0.5) == pytest.approx(8 + 0.7 * 32)


@pytest.mark.parametrize(
    ("reward", "scale"),
    # 30 / 300; 30 / 700 in two digits; what is worth 30 or less stays as it is.
    [(300.0, 0.1), (700.0, 0.043), (-300.0, 0.1), (30.0, 1.0), (0.5, 1.0), (0.0, 1.0)],
)
def test_good_states_come_to_be_worth_thirty(
    reward: float, scale: float, caplog: pytest.LogCaptureFixture
):
    caplog.set_level("INFO", "pipeline.scale_choice")
    found, demos = with_chosen_scale(AUTO, demonstrations([reward], [reward]))
    done = "used as they are" if scale == 1.0 else f"multiplied by {scale}, or imitation would"
    (told,) = caplog.messages
    assert told.startswith(f"rewards are {done}")
    assert f"add up to {abs(reward):g}, discounted by loss.gamma=0.5" in told
    assert "loss.reward_scale=" in told
    assert found == AUTO.changed(loss={"reward_scale": scale})
    assert demos is not None
    assert demos.rows["next", "reward"].flatten().tolist() == pytest.approx([reward * scale] * 2)


def test_without_demonstrations_rewards_stay_as_they_are():
    assert with_chosen_scale(AUTO, None) == (AUTO.changed(loss={"reward_scale": 1.0}), None)


def test_a_factor_that_is_named_stands():
    recipe, demos = Recipe().changed(loss={"reward_scale": 2.0}), demonstrations([500.0])
    assert with_chosen_scale(recipe, demos) == (recipe, demos)


def test_a_loss_is_not_made_of_what_nobody_chose():
    with pytest.raises(ValueError, match=r"loss\.reward_scale=auto is chosen .*: give a number"):
        _ = AUTO.loss.reward_factor


@pytest.mark.parametrize("to_end", [False, True])
def test_rows_that_are_scaled_later_are_those_that_were_scaled_when_made(to_end: bool):
    steps = trajectory([1.0, -2.0, 0.3, 7.0], truncated=[3])
    later, at_once = (
        TransitionRows(0.9, 2, reward_scale=scale, to_end=to_end)(steps.clone())
        for scale in (1.0, 0.1)
    )
    demos = Demonstrations(later, later, "hash", "source", 0.0, None).rewarded(0.1)
    for rows in (demos.rows, demos.held_out):
        assert rows is not None
        assert (rows == at_once).all()
    assert not (later["next", "reward"] == at_once["next", "reward"]).any()


def test_a_run_keeps_what_was_chosen(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    file = Path(reach.__file__)
    reach.record(tmp_path / "reach.h5")
    recipe = compose(
        "variant=bc_sac", "preset=smoke", f"task.name='{file}'", "bc.updates=5", "loss.gamma=0.999",
        f"demos.source='{tmp_path / 'reach.h5'}'", f"cache_dir='{tmp_path / 'cache'}'",
        "collector.total_frames=40", "evaluation.interval=0", "logging.checkpoint_interval=20",
    )  # fmt: skip
    assert recipe.loss.reward_scale == "auto"
    run = build_run(recipe, tmp_path / "run")
    run.train()
    chosen = run.recipe.loss.reward_scale
    assert isinstance(chosen, float)
    kept = load_recipe(tmp_path / "run", [f"task.name='{file}'"])
    assert kept.loss.reward_scale == chosen
    caplog.set_level("INFO", "pipeline.scale_choice")
    # Asked for as it was: what it stood for then stands now.
    assert build_run(recipe, tmp_path / "run", resume=True).recipe == kept
    assert [r for r in caplog.records if r.name == "pipeline.scale_choice"] == []
