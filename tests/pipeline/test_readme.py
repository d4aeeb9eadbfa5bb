"""What README and CONTRIBUTING say: examples run as they stand, results are the published ones."""

from __future__ import annotations

import dataclasses
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from envs import EnvOptions, registry
from envs.demonstrations import DemoSchema, Kind, Notes, open_source, readers
from envs.door import definition
from envs.door.definition import TASK
from envs.door.paper import PAPER
from losses import CosineWeight
from pipeline.act.evaluation import Evaluator
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.networks import make_actor
from pipeline.results.rows import load_published
from pipeline.results.tables import render_summary
from pipeline.trainer import Run
from tests.pipeline.toys import ACTION_SIZE, OBSERVATION_SIZE, make_batch

WORDS, NUMBERS = 500, 3
"""Words of the README outside of tables and code, and numbers in a paragraph of it, at most."""
CONTRIBUTING = Path(__file__).parents[2] / "CONTRIBUTING.md"
README = Path(__file__).parents[2] / "README.md"
RESULTS = README.parent / "docs" / "results"
TABLE = re.compile(r"<!-- results: docs/results/summary\.md -->\n(.*?)<!-- end -->", re.DOTALL)
TASK_EXAMPLE = re.compile(r"<!-- snippet:task -->\n```python\n(.*?)```", re.DOTALL)
READER = re.compile(r"<!-- snippet:reader -->\n```python\n(.*?)```", re.DOTALL)
TERM = re.compile(r"<!-- snippet:term -->\n```python\n(.*?)```", re.DOTALL)
SNIPPET = re.compile(r"<!-- snippet:compose -->\n```python\n(.*?)```", re.DOTALL)


def test_the_snippet_composes_and_trains(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    (snippet,) = SNIPPET.findall(README.read_text())
    assert len([line for line in snippet.splitlines() if line.strip()]) <= 15
    monkeypatch.chdir(tmp_path)
    bundled = dataclasses.replace(TASK.demos, bundled=demos)
    monkeypatch.setattr(definition, "TASK", dataclasses.replace(TASK, demos=bundled))
    names: dict[str, object] = {}
    exec(compile(snippet, str(README), "exec"), names)
    run = names["run"]
    assert isinstance(run, Run)
    assert (tmp_path / "runs" / "mine" / "config.yaml").is_file()
    assert run.trainer.collected_frames == run.recipe.collector.total_frames
    assert isinstance(run.trainer.loss_module.bc_weight, CosineWeight)
    assert run.trainer.loss_module.updates > 0


def table(text: str) -> dict[tuple[str, str], str]:
    """Cells of a Markdown table by row's name and column's header."""
    head, _, *lines = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in text.strip().splitlines()
    ]
    return {
        (line[0], name): cell
        for line in lines
        for name, cell in zip(head[1:], line[1:], strict=True)
    }


def test_the_table_of_results_is_of_the_published_one():
    """Some rows and columns of summary.md, which `make results` writes."""
    (shown,) = TABLE.findall(README.read_text())
    cells = table(shown)
    assert {"`sac`", "`bc`", "`best`"} <= {row for row, _ in cells}
    assert cells.items() <= table((RESULTS / "summary.md").read_text()).items()


def prose(text: str) -> list[str]:
    """Paragraphs and items of lists, without code blocks, tables, marks and addresses of links."""
    text = re.sub(r"```.*?```|<!--.*?-->|^\|.*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    return [part for part in re.split(r"\n\s*\n|\n(?=- )", text) if part.strip()]


def test_the_readme_is_short():
    assert sum(len(part.split()) for part in prose(README.read_text())) <= WORDS
    for part in prose(README.read_text()):
        # Not those in names: door-v1, bc_sac_0.1.
        assert len(re.findall(r"(?<![\w.,-])\d[\d.,]*", part)) <= NUMBERS, part


def test_prose_leaves_out_tables_code_and_addresses():
    text = "Two [words](of/a/link.md).\n\n- An item\n- another\n\n```\ncode\n```\n| a | table |\n"
    assert [part.split() for part in prose(text)] == [
        ["Two", "[words]."], ["-", "An", "item"], ["-", "another"],
    ]  # fmt: skip


def test_the_term_of_the_contributing_guide_trains():
    """At weight 0.3, with everything logged that its text names."""
    (snippet,) = TERM.findall(CONTRIBUTING.read_text())
    names = {
        "__name__": __name__,  # where dataclasses look annotations up
        "actor": make_actor(OBSERVATION_SIZE, ACTION_SIZE, [8]),
        "critic": BatchedCritics(OBSERVATION_SIZE, ACTION_SIZE, [8], 2),
        "batch": make_batch(8, 3),
    }
    exec(compile(snippet, str(CONTRIBUTING), "exec"), names)
    metrics = names["metrics"]
    assert metrics["effort_weight"] == pytest.approx(0.3)
    for name in ("effort", "grad_norm_effort", "grad_cosine_effort"):
        assert metrics[name].isfinite(), name


def test_the_task_of_the_contributing_guide_is_found_by_its_entry_point_and_evaluated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (snippet,) = TASK_EXAMPLE.findall(CONTRIBUTING.read_text())
    (tmp_path / "upright_task.py").write_text(snippet)
    monkeypatch.syspath_prepend(tmp_path)
    offered = EntryPoint("upright", "upright_task:TASK", registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, "entry_points", lambda group: [offered])
    task = registry.find_task("upright")
    (stage,) = task.stages
    # Its first entry is the cosine of the angle: 0.96 is upright, 0.94 is not.
    after = TensorDict({"observation": torch.tensor([[0.96, 0.28, 0.0], [0.94, 0.34, 0.0]])}, [2])
    assert stage.reached(after).tolist() == [True, False]
    still = TensorDictModule(lambda seen: torch.zeros(len(seen), 1), ["observation"], ["action"])
    figures = Evaluator(task, episodes=3, seed=0, env_options=EnvOptions(horizon=5)).run(still)
    assert list(figures.stages) == ["upright"]
    assert figures.lengths.tolist() == [5, 5, 5]


def test_the_reader_of_the_contributing_guide_is_found_and_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A module in the folder of readers is all it takes; here that folder has a second part."""
    (snippet,) = READER.findall(CONTRIBUTING.read_text())
    (tmp_path / "readers").mkdir()
    (tmp_path / "readers" / "csv_of_the_guide.py").write_text(snippet)
    monkeypatch.setattr(readers, "__path__", [*readers.__path__, str(tmp_path / "readers")])
    readers.find_readers.cache_clear()
    file = tmp_path / "episode.csv"
    # Two observations and an action a row; the observation after the third action is not there.
    file.write_text("o0,o1,a0,reward\n1,2,0.1,10\n3,4,0.2,20\n5,6,0.3,30\n")
    schema, notes = DemoSchema("the toy", observation_size=2, action_size=1), Notes()
    try:
        (episode,) = open_source(file).load(schema, notes)
    finally:
        readers.find_readers.cache_clear()
    assert episode.observations.tolist() == [[1, 2], [3, 4], [5, 6]]
    assert episode.actions.ravel().tolist() == pytest.approx([0.1, 0.2])
    assert episode.rewards.tolist() == [10, 20]
    assert notes.findings("episode.csv").count(Kind.LAST_ACTION) == 1


def test_the_published_summary_is_that_of_the_published_seeds():
    lines = (RESULTS / "summary.md").read_text().splitlines()
    computed = render_summary(load_published(RESULTS), PAPER).splitlines()
    assert sorted(line.split() for line in lines) == sorted(line.split() for line in computed)
