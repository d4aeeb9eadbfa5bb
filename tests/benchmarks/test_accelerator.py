"""The comparison on a CUDA device, as far as it can be looked at without one."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import typer

from benchmarks import accelerator
from benchmarks.worker import Timing


def test_seconds_become_milliseconds_in_the_table_of_their_size():
    timings = {
        "ours_sac_fp32": Timing([0.001, 0.002, 0.003], 0.0),
        "sb3": Timing([0.02, 0.02, 0.02], 0.0),
    }
    content = {
        "machine": {"gpu": "Abacus", "cpu": "beads", "cores": 3, "versions": {"torch": "2.99"}},
        "rounds": 3,
        "256": accelerator.summarise(timings),
    }
    text = accelerator.render(content)
    assert text.startswith("# Updates on Abacus\n\nbeads, 3 cores, torch 2.99;")
    cells = [
        [cell.strip() for cell in row.split("|")[1:-1]] for row in text.splitlines() if "|" in row
    ]
    assert cells[0] == ["ms per update", "256 x 256"]
    assert cells[2:] == [["ours_sac_fp32", "2.0 (1.5 - 2.5)"], ["sb3", "20.0 (20.0 - 20.0)"]]


def test_contestants_have_different_names_and_the_device():
    entries = accelerator.entries(256, 256, "cuda:3", 10)
    assert len({entry.name for entry in entries}) == len(entries) == 7
    for entry in entries:
        given = entry.arguments
        assert given.get("device") == "cuda:3" or "device=cuda:3" in given["overrides"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_without_a_device_nothing_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(typer.Exit):
        accelerator.main(out=tmp_path)
    assert "no CUDA device; `make bench` measures" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_width_that_is_not_measured_is_named(tmp_path: Path, capsys: pytest.CaptureFixture):
    with pytest.raises(typer.Exit) as stopped:
        accelerator.main(out=tmp_path, width=[1024, 7])
    assert stopped.value.exit_code == 2
    assert "--width 7: there are 256, 1024" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
