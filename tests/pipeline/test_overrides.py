"""What is typed on top of a recipe: read as for a new run, and no new name for the old one."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser

from configs import compose
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.run_files import RunDirectoryError
from pipeline.machine.memory import told_memory
from pipeline.overrides import overridden
from pipeline.recipe import Recipe
from pipeline.run_dir import create_run_dir, load_recipe
from pipeline.settings import SettingsError
from tests.pipeline.test_resuming import FILE, stopped


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("evaluation.seed", "010"),  # 8 in YAML
        ("evaluation.seed", "1_000"),
        ("loss.gamma", "9e-1"),  # a string in YAML
        ("loss.gamma", ".5"),
        ("loss.learn_temperature", "False"),
        ("loss.bc_gradient_ratio", "null"),
        ("actor.hidden", "[8,0016]"),
        ("task.randomise.factors", "{mass: [0.5, 2]}"),
        ("evaluation.exploration", "'sample'"),
    ],
)
def test_a_value_means_what_it_means_to_a_new_run(key: str, text: str):
    parsed = OverridesParser.create().parse_override(f"{key}={text}").value()
    change = {part: getattr(parsed, "text", parsed) for part in [key.rpartition(".")[2]]}
    for part in reversed(key.split(".")[:-1]):
        change = {part: change}
    assert overridden(Recipe(), f"{key}={text}") == Recipe().changed(**change)


@pytest.mark.parametrize(
    "override",
    [
        "evaluation.seed=1:30",  # 90 in YAML
        "evaluation.seed=0x10",
        "loss.learn_temperature=no way",
        "evaluation.seed=[",
        "seed=true",
        "seed=4294967296",
        "loss.gamma=true",
        "actor.hidden=[32,true]",
        "loss.reward_scale=0",
        "loss.bc_weight.init=1e39",
        "sampler.demo_ratio=1e30",
        "task.randomise.delay=[0,1000000000]",
        "demos.multiply.speed_low=5",
        "demos.multiply.target_episodes=5000",
        "demos.multiply.speed_bins=1000000000000",
    ],
)
def test_what_is_no_value_is_refused_by_its_key(override: str):
    with pytest.raises(SettingsError) as error:
        overridden(Recipe(), override)
    told = str(error.value)
    assert override.partition("=")[0] in told
    assert "\n" not in told


@pytest.mark.parametrize(
    ("override", "meant"),
    [
        ("evaluation.episdes=3", "did you mean evaluation.episodes"),
        ("evaluation={episdes: 3}", "did you mean evaluation.episodes"),
        ("zzz=3", "no key zzz: all are listed by: make settings"),
    ],
)
def test_an_unknown_key_is_refused_with_what_was_meant(override: str, meant: str):
    with pytest.raises(SettingsError) as refused:
        overridden(Recipe(), override)
    assert meant in str(refused.value)


@pytest.mark.parametrize("override", ["variant=sac", "+preset=paper", "seed=3", "run_dir=other"])
def test_a_run_stays_what_it_was_trained_as(override: str, tmp_path: Path):
    create_run_dir(tmp_path / "run", compose("variant=dbc_sac", "preset=smoke"))
    with pytest.raises(RunDirectoryError, match="leave out " + override.lstrip("+")):
        load_recipe(tmp_path / "run", [override])


def test_an_evaluation_tells_of_the_training_what_was_trained(tmp_path: Path):
    run_dir = stopped(tmp_path / "run")
    overrides = [f"task.name='{FILE}'", "loss.bc_weight.init=5", "evaluation.seed=7"]
    made_from = evaluate_run(run_dir, overrides, episodes=2)["made_from"]
    assert made_from["bc_weight"] == 0.0, "sac imitates nothing"
    assert made_from["evaluation_seed"] == 7
    assert made_from["overrides"] == overrides


def test_memory_that_runs_out_is_told_in_one_line():
    with pytest.raises(RuntimeError) as error:
        torch.empty(10**15)
    told = told_memory(error.value)
    assert told is not None
    assert told.startswith("out of memory (")
    assert "\n" not in told
    assert told_memory(RuntimeError("shapes do not fit")) is None
