"""The imitation error that ``loss.imitation=auto`` stands for, and that a run keeps it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tensordict import TensorDict

from configs import compose
from pipeline.build import build_run
from pipeline.data.demonstrations import Demonstrations
from pipeline.imitation_choice import with_chosen_imitation
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe
from tests.toys import pick, reach

AUTO = Recipe().changed(loss={"imitation": "auto"})


def demonstrations(saturated: float) -> Demonstrations:
    return Demonstrations(TensorDict(), None, "hash", "source", saturated, success_share=1.0)


@pytest.mark.parametrize(
    ("saturated", "chosen"),
    [(0.0, "nll"), (0.06, "nll"), (0.1, "nll"), (0.11, "fixed_width"), (1.0, "fixed_width")],
)
def test_more_than_a_tenth_of_saturated_entries_is_regressed(
    saturated: float, chosen: str, caplog: pytest.LogCaptureFixture
):
    caplog.set_level("INFO", "pipeline.imitation_choice")
    found = with_chosen_imitation(AUTO, demonstrations(saturated))
    assert found == AUTO.changed(loss={"imitation": chosen})
    (told,) = caplog.messages
    how, other = {"nll": ("likelihood", "fixed_width"), "fixed_width": ("distance", "nll")}[chosen]
    assert told.startswith(f"demonstrated actions are imitated by their {how}: ")
    assert f"{100 * saturated:.0f} % of their entries are at the bounds" in told
    assert f"loss.imitation={other})" in told


def test_without_demonstrations_there_is_nothing_to_choose_by(caplog: pytest.LogCaptureFixture):
    caplog.set_level("INFO", "pipeline.imitation_choice")
    assert with_chosen_imitation(AUTO, None).loss.imitation == "nll"
    assert caplog.messages == []


@pytest.mark.parametrize("named", ["nll", "mse", "fixed_width"])
def test_an_error_that_is_named_stands(named: str):
    recipe = Recipe().changed(loss={"imitation": named})
    assert with_chosen_imitation(recipe, demonstrations(0.5)) is recipe


def test_a_loss_is_not_made_of_what_nobody_chose():
    with pytest.raises(ValueError, match=r"loss\.imitation=auto is chosen .* name nll, mse or"):
        _ = AUTO.loss.imitation_error


def test_a_run_keeps_what_was_chosen(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    """Its recipe holds the error; resumed on demonstrations that hold less, it chooses no more."""
    file = Path(pick.__file__)
    pick.record(tmp_path / "pick.h5", episodes=3)
    recipe = compose(
        "variant=bc_sac", "preset=smoke", f"task.name='{file}'", "bc.updates=100",
        f"demos.source='{tmp_path / 'pick.h5'}'", f"cache_dir='{tmp_path / 'cache'}'",
        "collector.total_frames=100", "evaluation.interval=0",
        "logging.checkpoint_interval=50",
    )  # fmt: skip
    assert recipe.loss.imitation == "auto"
    run = build_run(recipe, tmp_path / "run")
    run.train()
    assert run.trainer.loss_module.composition["bc"].error == "fixed_width"
    kept = load_recipe(tmp_path / "run", [f"task.name='{file}'"])
    assert kept == run.recipe
    assert kept.loss.imitation == "fixed_width"
    caplog.set_level("INFO", "pipeline.imitation_choice")
    resumed = build_run(kept, tmp_path / "run", resume=True)
    assert resumed.recipe == kept
    assert [r for r in caplog.records if r.name == "pipeline.imitation_choice"] == []


def test_what_presets_name():
    """The paper's preset keeps its likelihood, a task's own values come behind `default`."""
    other = f"task.name='{reach.__file__}'"
    assert compose("preset=default", other).loss.imitation == "auto"
    assert compose("preset=default").loss.imitation == "nll"
    assert compose("preset=paper", other).loss.imitation == "nll"
