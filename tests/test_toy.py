"""Every variant on a task that is not the door: a user's file with nothing but the basics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from torchrl.envs import check_env_specs

from configs import compose
from envs import EnvOptions
from pipeline.build import build_run
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.recipe import Recipe
from pipeline.trainer import Run
from tests.pipeline.resuming import curve_of, differences
from tests.toys import reach

FILE = str(Path(reach.__file__))
VARIANTS = sorted(p.stem for p in Path("configs/variant").glob("*.yaml"))
NAMED = f"task.name='{FILE}'"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("toy") / "reach.h5"
    reach.record(path)
    return path


def tiny(variant: str, folder: Path, demos: Path, *overrides: str) -> Recipe:
    return compose(
        f"variant={variant}", "preset=smoke", NAMED, f"demos.source='{demos}'",
        f"cache_dir='{folder / 'cache'}'", "collector.total_frames=120",
        "collector.frames_per_batch=20", "bc.updates=100", "evaluation.interval=60",
        "logging.checkpoint_interval=60", "optim.actor_delay=0", *overrides,
    )  # fmt: skip


def test_the_toy_is_an_environment():
    check_env_specs(reach.Reach(EnvOptions(num_envs=3, seed=0)))


@pytest.fixture(scope="module", params=VARIANTS)
def trained(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, recorded: Path
) -> Run:
    folder = tmp_path_factory.mktemp(request.param)
    run = build_run(tiny(request.param, folder, recorded), folder / "run")
    run.train()
    return run


def test_every_variant_trains_and_evaluates(trained: Run):
    result = evaluate_run(trained.run_dir, [NAMED])
    assert result["episodes"] == 4
    assert result["made_from"]["task"] == FILE
    assert result["made_from"]["variant"] == trained.recipe.variant
    assert result["stages"] == {"there": result["success_once"]}
    assert 0.0 <= result["success_at_end"] <= result["success_once"] <= 1.0
    assert "steps_to_success_median" in result
    # A step pays 1 minus a distance: below 1, and an episode has 20.
    assert result["return_mean"] < 20.0


def test_an_evaluation_does_not_depend_on_how_many_are_stepped_together(trained: Run):
    three, four = (evaluate_run(trained.run_dir, [NAMED, f"evaluation.batch={n}"]) for n in (3, 4))
    for figures in (three, four):
        del figures["made_from"]
        figures.update(figures.pop("stages"))
        figures["steps_to_success_median"] = figures["steps_to_success_median"] or 0
    assert three.keys() == four.keys()
    # Products of matrices round otherwise in batches of another size.
    for key, value in three.items():
        assert value == pytest.approx(four[key], rel=1e-5), key
    assert three["return_std"] > 0.0, "four different episodes"


def whole(run: Run) -> dict[str, Any]:
    modules = run.trainer._modules
    return {
        "policy": run.actor.state_dict(),
        "loss": run.trainer.loss_module.state_dict(),
        "stepper": modules["optimization_stepper"].state_dict(),
        "buffer": modules["main_buffer"][:].to_dict(),
        "frames": run.trainer.collected_frames,
        "rng": torch.get_rng_state(),
    }


def test_a_resumed_run_is_the_uninterrupted_one(recorded: Path, tmp_path: Path):
    # 19-step episodes of two copies: the cut after 60 frames, 30 of each, is within the second.
    recipe = tiny("best", tmp_path, recorded, "env.horizon=19")
    uninterrupted = build_run(recipe, tmp_path / "whole")
    uninterrupted.train()
    expected = whole(uninterrupted)
    half = build_run(recipe, tmp_path / "half")
    half.trainer.total_frames = 60
    half.train()
    torch.manual_seed(4321)
    resumed = build_run(recipe, tmp_path / "half", resume=True)
    assert resumed.trainer.collected_frames == 60
    resumed.train()
    assert differences(whole(resumed), expected) == []
    assert curve_of(tmp_path / "half") == curve_of(tmp_path / "whole")


def test_the_default_preset_of_best_runs_and_says_what_it_leaves_out(
    recorded: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    caplog.set_level("INFO", "pipeline.data.demonstrations")
    recipe = compose(
        "variant=best", "preset=default", NAMED, f"demos.source='{recorded}'",
        f"cache_dir='{tmp_path / 'cache'}'", "collector.total_frames=400",
        "actor.hidden=[8]", "critic.hidden=[8]", "evaluation.interval=400",
        "logging.progress=false", "bc.updates=100",
    )  # fmt: skip
    build_run(recipe, tmp_path / "run").train()
    assert (
        caplog.messages.count(
            "task reach cannot replay recorded episodes: the demonstrations are used as they were "
            "recorded"
        )
        == 1
    )


def test_an_evaluation_tells_all_simulator_steps(trained: Run):
    """Episodes of the toy have 20 steps; it cannot replay, so its demonstrations cost none."""
    made_from = evaluate_run(trained.run_dir, [NAMED])["made_from"]
    frames = 0 if trained.recipe.offline else 120
    rolled_out = 20 * trained.recipe.growth.bc_model_episodes * trained.recipe.growth.bc_model
    assert made_from["frames"] == frames
    assert made_from["simulator_steps"] == frames + rolled_out
    last = json.loads((trained.run_dir / "learning_curve.jsonl").read_text().splitlines()[-1])
    assert last["simulator_steps"] == frames + rolled_out
