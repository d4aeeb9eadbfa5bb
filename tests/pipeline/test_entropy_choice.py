"""The entropy that ``loss.target_entropy=clone`` stands for, and that a run keeps it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from configs import compose
from pipeline import entropy_choice
from pipeline.build import build_run
from pipeline.data.demonstrations import Demonstrations
from pipeline.entropy_choice import mean_entropy, with_chosen_entropy
from pipeline.learn.networks import make_actor
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe
from tests.toys import reach

CLONE = Recipe().changed(pretrain=True, loss={"target_entropy": "clone"})


def policy(mean: float, log_std: float):
    """A policy of two entries that acts alike wherever it is."""
    actor = make_actor(3, 2, (4,), log_std_min=-20.0, log_std_max=20.0)
    last = [module for module in actor.modules() if isinstance(module, torch.nn.Linear)][-1]
    torch.nn.init.zeros_(last.weight)
    with torch.no_grad():
        # The head squashes the logarithm into its bounds by tanh.
        last.bias.copy_(torch.tensor([mean, mean, *2 * [math.atanh(log_std / 20.0)]]))
    return actor


def demonstrations(rows: int = 4000) -> Demonstrations:
    seen = TensorDict({"observation": torch.zeros(rows, 3)}, [rows])
    return Demonstrations(seen, None, "hash", "source", 0.0, success_share=1.0)


def test_the_entropy_is_the_normal_s_plus_what_tanh_takes():
    """Of a narrow normal: 0.5 log(2 pi e) + log std + log(1 - tanh(mean)^2), for each entry."""
    torch.manual_seed(0)
    for mean in (0.0, 1.0, 3.0):
        one = 0.5 * math.log(2 * math.pi * math.e) - 4.0 + math.log(1 - math.tanh(mean) ** 2)
        found, entries = mean_entropy(policy(mean, -4.0), demonstrations().rows)
        assert entries == 2
        assert found == pytest.approx(2 * one, abs=0.05)


def test_the_target_is_a_fifth_of_a_nat_an_entry_below_the_clone():
    clone = policy(0.0, -4.0)
    chosen = with_chosen_entropy(CLONE, lambda: clone, demonstrations()).loss.target_entropy
    # 2 * (1.4189 - 4 - 0.2), but for the draws.
    assert chosen == pytest.approx(-5.56, abs=0.1)
    assert with_chosen_entropy(CLONE, lambda: clone, demonstrations()).loss.target_entropy == chosen


def test_the_entropy_is_measured_all_over_a_large_set(monkeypatch: pytest.MonkeyPatch):
    numbered = replace(
        demonstrations(), rows=TensorDict({"observation": torch.arange(11.0).unsqueeze(-1)}, [11])
    )
    seen = []

    def measured(_actor: object, rows: TensorDict) -> tuple[float, int]:
        seen.append(rows["observation"].flatten().tolist())
        return 0.0, 2

    monkeypatch.setattr(entropy_choice, "mean_entropy", measured)
    for rows in (4, 11):  # 0, 11/4, 22/4 and 33/4; all of a set that is no larger
        monkeypatch.setattr(entropy_choice, "ROWS", rows)
        state = torch.get_rng_state()
        with_chosen_entropy(CLONE, lambda: None, numbered)
        assert torch.equal(torch.get_rng_state(), state)
    assert seen == [[0.0, 2.0, 5.0, 8.0], [float(row) for row in range(11)]]


def unasked():
    raise AssertionError("nobody needs a clone here")


@pytest.mark.parametrize("change", [{"pretrain": False}, {"offline": True}])
def test_what_does_not_begin_as_a_clone_has_sac_s_target(change: dict[str, bool]):
    found = with_chosen_entropy(CLONE.changed(**change), unasked, demonstrations())
    assert found.loss.target_entropy is None


@pytest.mark.parametrize("named", [None, -7.0])
def test_a_target_that_is_named_stands(named: float | None):
    recipe = CLONE.changed(loss={"target_entropy": named})
    assert with_chosen_entropy(recipe, unasked, demonstrations()) is recipe


def test_a_loss_is_not_made_of_what_nobody_measured():
    with pytest.raises(ValueError, match=r"loss\.target_entropy=clone is measured .* or null"):
        CLONE.loss.entropy_target(2)


def test_a_run_keeps_what_was_measured(tmp_path: Path):
    file = str(Path(reach.__file__))
    reach.record(tmp_path / "reach.h5")
    recipe = compose(
        "variant=bc_sac", "preset=smoke", f"task.name='{file}'", "bc.updates=100", "pretrain=true",
        f"demos.source='{tmp_path / 'reach.h5'}'", f"cache_dir='{tmp_path / 'cache'}'",
        "collector.total_frames=100", "evaluation.interval=0", "loss.target_entropy=clone",
        "logging.checkpoint_interval=50",
    )  # fmt: skip
    run = build_run(recipe, tmp_path / "run")
    run.train()
    measured = run.recipe.loss.target_entropy
    assert isinstance(measured, float)
    assert run.trainer.loss_module.composition["alpha"].target_entropy == measured
    kept = load_recipe(tmp_path / "run", [f"task.name='{file}'"])
    assert kept.loss.target_entropy == measured
    # Asked for as it was: what it stood for then stands now.
    assert build_run(recipe, tmp_path / "run", resume=True).recipe == kept
