"""docs/tutorial/compose.md: its examples as they stand."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest
import yaml

from configs import compose
from envs.door import definition
from envs.door.definition import TASK
from losses import LinearWeight
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.networks import make_actor
from pipeline.learn.own_terms import own_terms
from pipeline.recipe import Recipe
from pipeline.trainer import Run
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, make_batch, write_demos

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / "docs" / "tutorial" / "compose.md"
SNIPPET = re.compile(r"<!-- snippet:(\w+) -->\n```python\n(.*?)```", re.DOTALL)
FILE = re.compile(r"<!-- file:configs/variant/(\w+)\.yaml -->\n```yaml\n(.*?)```", re.DOTALL)


def snippet(name: str) -> str:
    return dict(SNIPPET.findall(TUTORIAL.read_text()))[name]


def variant(name: str) -> str:
    return dict(FILE.findall(TUTORIAL.read_text()))[name]


def test_the_yaml_and_the_python_make_the_same_method():
    given = yaml.safe_load(variant("filtered"))
    assert given["defaults"] == ["bc_sac", "_self_"]
    changes = {key: value for key, value in given.items() if key != "defaults"}
    of_yaml = compose("variant=bc_sac", "preset=smoke").changed(**changes)
    assert of_yaml.loss.q_filter
    assert of_yaml.growth.self_imitation
    weight = of_yaml.loss.bc_weight.schedule(40)
    assert [weight(0), weight(20), weight(40)] == pytest.approx([1.0, 0.6, 0.2])
    assert "LinearWeight(init=1.0, final=0.2" in snippet("python")


def test_the_python_of_the_page_trains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    demos = write_demos(tmp_path / "demos.h5")
    bundled = dataclasses.replace(TASK.demos, bundled=demos)
    monkeypatch.setattr(definition, "TASK", dataclasses.replace(TASK, demos=bundled))
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(snippet("python"), str(TUTORIAL), "exec"), names)
    run = names["run"]
    assert isinstance(run, Run)
    assert (tmp_path / "runs" / "mine" / "config.yaml").is_file()
    assert run.trainer.collected_frames == run.recipe.collector.total_frames
    assert isinstance(run.trainer.loss_module.bc_weight, LinearWeight)


def test_the_term_of_the_page_is_part_of_the_objective():
    names = {
        "__name__": __name__,  # where dataclasses look annotations up
        "actor": make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8]),
        "critic": BatchedCritics(OBSERVATION_SIZE, ACTION_SIZE, [8], 2),
        "batch": make_batch(8, 3),
    }
    exec(compile(snippet("term"), str(TUTORIAL), "exec"), names)
    action = names["actor"](names["batch"].select("observation"))
    assert action["action"].shape == (8, ACTION_SIZE)
    assert float(names["losses"]["centre"]) >= 0.0


def test_the_term_of_the_page_has_the_settings_of_the_yaml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Its class alone, as a user's file would hold it."""
    (tmp_path / "my_terms.py").write_text(snippet("term").split("terms = [")[0])
    monkeypatch.chdir(tmp_path)
    given = yaml.safe_load(variant("centred"))
    loss = compose("variant=bc_sac").changed(loss=given["loss"]).loss
    (term,) = own_terms(loss.own_terms, updates=10)
    assert term.at == 0.2
    assert [term.weight_at(n) for n in (0, 5, 10)] == pytest.approx([0.1, 0.05, 0.0])
    (typed,) = re.findall(r"'(loss\.own_terms=.*)'\"", TUTORIAL.read_text())
    (term,) = own_terms(compose("variant=bc_sac", typed).loss.own_terms, updates=10)
    assert (term.at, term.weight_at(0)) == (0.2, 0.1)


def test_the_schedule_of_the_page_has_the_settings_of_the_yaml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Half of its way down, at its end, and begun again; typed, it has the parent's first one."""
    (tmp_path / "my_schedules.py").write_text(snippet("schedule"))
    monkeypatch.chdir(tmp_path)
    given = yaml.safe_load(variant("sawtooth"))["loss"]
    named, typed = re.findall(r"ARGS=\"'?(loss\.bc_weight.*?)'?\"", TUTORIAL.read_text())[::-1]
    for recipe in (
        compose("variant=bc_sac").changed(loss=given),
        compose("variant=bc_sac", typed),
        compose("variant=bc_sac", named, "loss.bc_weight.kwargs.period=5000"),
    ):
        weight = recipe.loss.bc_weight.schedule(10)
        assert [weight(n) for n in (0, 2500, 4999, 5000)] == pytest.approx([1, 0.5, 2e-4, 1])
        assert recipe.plain()["loss"]["bc_weight"]["kwargs"] == {"period": 5000}


def test_the_python_of_the_page_names_a_task_and_demonstrations_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "my_task.py").write_text("def make(): ...\n")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(snippet("own"), str(TUTORIAL), "exec"), names)
    recipe = names["recipe"]
    assert isinstance(recipe, Recipe)
    assert recipe.task.name == "my_task.py:make"
    assert recipe.demos.source == "demos.h5"
