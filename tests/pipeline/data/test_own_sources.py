"""Sources of batch rows in a user's file: trained with, resumed, and never run unasked."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import torch

from pipeline.data.buffers import make_buffer, newest
from pipeline.data.own_sources import SourceContext, own_sources
from pipeline.data.rows import ROW_KEYS
from pipeline.files.run_files import RunDirectoryError
from pipeline.policy import load_policy
from pipeline.run_dir import load_recipe
from tests.pipeline.resuming import differences, everything, whole_and_halved
from tests.pipeline.toys import built, tagged_rows, tiny_config

CONTRIBUTING = Path(__file__).parents[3] / "CONTRIBUTING.md"
SNIPPET = re.compile(r"<!-- snippet:source -->\n```python\n(.*?)```", re.DOTALL)
FILE = """

class InTurn:
    '''Rows of the demonstrations, one after another.'''

    is_demo = True

    def __init__(self, context, rows=2):
        self.all, self.rows, self.next = context.demonstrations.rows, rows, 0

    def sample(self, count):
        positions = (self.next + torch.arange(count)) % len(self.all)
        self.next += count
        return self.all[positions]

    def state_dict(self):
        return {"next": self.next}

    def load_state_dict(self, state):
        self.next = state["next"]


class Given:
    '''What a test says.'''

    def __init__(self, context, **said):
        self.context = context
        vars(self).update(rows=1, is_demo=False)
        vars(self).update({key: None if one == "none" else one for key, one in said.items()})

    def sample(self, count):
        return altered(self.context.main[:1].expand(count).clone())


def altered(rows):
    return rows
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The class that CONTRIBUTING shows, and those of this file."""
    (recent,) = SNIPPET.findall(CONTRIBUTING.read_text())
    path = tmp_path / "my_sources.py"
    path.write_text(recent + FILE)
    return path


def context_of(rows: int) -> SourceContext:
    """Of a full ring of 8 rows, the newest tagged ``rows - 1``."""
    main = make_buffer(8)
    for tag in range(rows):
        main.extend(tagged_rows(float(tag), 1))
    return SourceContext(main, None, ROW_KEYS, torch.device("cpu"))


@pytest.mark.parametrize(
    ("rows", "tags"), [(0, []), (2, [1, 0]), (8, [7, 6, 5]), (11, [10, 9, 8]), (13, [12, 11, 10])]
)
def test_the_newest_rows_are_found_wherever_the_ring_begins(rows: int, tags: list[int]):
    main = context_of(rows).main
    found = newest(main, 3)
    assert found.tolist() == [tag % 8 for tag in tags]
    if rows:
        assert main[found]["observation"][:, 0].tolist() == tags


def test_the_source_of_the_contributing_guide_draws_of_the_newest_rows(file: Path):
    entry = {"source": f"{file}:Recent", "rows": 3, "among": 2}
    (recent,) = own_sources([entry], context_of(11)).values()
    assert (recent.rows, recent.is_demo, recent.keeps_state) == (3, False, False)
    drawn = recent.sample(200)
    assert drawn.batch_size == (200,)
    assert set(drawn["observation"][:, 0].tolist()) == {9.0, 10.0}


def test_a_run_learns_from_them_and_goes_on_as_if_it_had_not_been_stopped(
    tmp_path: Path, demos: Path, file: Path, monkeypatch: pytest.MonkeyPatch
):
    own = f"[{{source: {file}:Recent, rows: 3, among: 50}},{file}:InTurn]"
    whole, halved = whole_and_halved(tmp_path, demos, f"sampler.own_sources={own}")
    assert differences(everything(halved), everything(whole)) == []
    modules = whole.trainer._modules
    assert "own_source_0" not in modules
    assert halved.trainer._modules["own_source_1"].next == modules["own_source_1"].next > 0
    # Rows of main and the newest, 8 + 3, then those of D and in turn.
    assert whole.trainer.loss_module.main_rows == 11
    mixture = whole.updates.mixture
    mixture.renew()
    batch = mixture.sample()
    demo_rows = round(whole.recipe.sampler.demo_ratio * 8) + 2
    marks = [False] * 11 + [True] * demo_rows
    assert batch["is_demo"].squeeze(-1).tolist() == marks
    main = modules["main_buffer"]
    recent = main[newest(main, 50)]["observation"]
    assert all((row == recent).all(-1).any() for row in batch["observation"][8:11])

    monkeypatch.delenv("TRUST", raising=False)
    recipe = load_recipe(whole.run_dir)  # to be played, which imports none of it
    load_policy(recipe, recipe.find_task(), whole.run_dir)
    with pytest.raises(RunDirectoryError, match=r"asks to import .*my_sources\.py.*own_sources="):
        load_recipe(whole.run_dir, training=True)
    typed = f"sampler.own_sources={own}"
    assert load_recipe(whole.run_dir, [typed], training=True).sampler == recipe.sampler


def test_cloning_does_not_draw_from_them(tmp_path: Path, demos: Path, file: Path):
    """Neither that before a run, nor a run that is cloning alone, which says so."""
    own = f"sampler.own_sources=[{file}:Recent]"
    run = built(tiny_config("bc_sac", tmp_path, demos, own, "pretrain=true"))
    assert run.trainer.loss_module.main_rows == 8 + 64
    with pytest.raises(ValueError, match=r"sampler\.own_sources would not be drawn from: leave it"):
        built(tiny_config("bc", tmp_path, demos, own))


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"rows": 0}, "must say rows, its number in each batch: 0"),
        ({"rows": True}, "must say rows"),
        ({"rows": "three"}, "must say rows"),
        ({"is_demo": "none"}, "must say is_demo, whether its rows count as demonstrations"),
        ({"sample": 1}, r"must have sample\(count\)"),
    ],
)
def test_a_source_that_does_not_say_what_it_is_is_refused(
    file: Path, said: dict[str, Any], message: str
):
    with pytest.raises(ValueError, match=message) as refused:
        own_sources([{"source": f"{file}:Given", **said}], context_of(3))
    assert str(refused.value).startswith(f"sampler.own_sources={{source: {file}:Given")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("rows[:1]", r"gave \[1\] for 2 rows; expected \[2\]"),
        ("rows.to_dict()", r"gave <class 'dict'> for 2 rows"),
        ("rows.exclude('action')", r"gave rows with 'action' none; expected torch.float32 \[2\]"),
        (
            "rows.set(('next', 'reward'), rows['next', 'reward'].double())",
            r"with \('next', 'reward'\) torch.float64 \[1\]; expected torch.float32 \[1\]",
        ),
        (
            "rows.set('observation', rows['observation'][:, :2])",
            r"'observation' torch.float32 \[2\]",
        ),
    ],
)
def test_rows_of_another_form_are_refused(file: Path, change: str, message: str):
    file.write_text(file.read_text().replace("    return rows\n", f"    return {change}\n"))
    (source,) = own_sources([f"{file}:Given"], context_of(3)).values()
    with pytest.raises(ValueError, match=message) as refused:
        source.sample(2)
    assert "\n" not in str(refused.value)


def test_entries_of_a_row_that_others_do_not_have_are_left_out(file: Path):
    file.write_text(file.read_text().replace("rows\n", "rows.set('mine', rows['action'])\n"))
    (source,) = own_sources([f"{file}:Given"], context_of(3)).values()
    assert set(source.sample(2).keys(True, True)) == {*ROW_KEYS, "index"}
