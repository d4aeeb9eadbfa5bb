"""SIGKILL at random moments: whatever a run was doing, it goes on to the same end."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from tests.faults.kills import subject_of, tortured
from tests.toys import reach

KILLS = 3
"""Of each run; with `-m slow` ten times as many."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("toy") / "reach.h5"
    reach.record(path)
    return path


def killed_and_resumed(variant: str, kills: int, folder: Path, recorded: Path) -> None:
    tally = tortured(subject_of(variant, recorded), kills, folder, Random(f"{variant} {kills}"))
    assert tally.wrong == []
    assert tally.injected == tally.survived == tally.exact == kills


@pytest.mark.parametrize("variant", ["sac", "sid_dbc"])
def test_a_run_survives_kills(variant: str, tmp_path: Path, recorded: Path):
    killed_and_resumed(variant, KILLS, tmp_path, recorded)


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["bc", "bc_sac", "da_sac", "ila_bc", "best"])
def test_a_run_survives_many_kills(variant: str, tmp_path: Path, recorded: Path):
    killed_and_resumed(variant, 10 * KILLS, tmp_path, recorded)
