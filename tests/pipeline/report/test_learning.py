"""What a report judges a training by."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.report.learning import DIAGNOSTICS
from pipeline.results.runs import EvaluatedRun, RunGroup


@pytest.mark.parametrize(
    ("imitation", "found"), [("nll", 3.0), ("fixed_width", 3.0), (None, 3.0), ("mse", None)]
)
def test_demonstrations_are_said_to_be_memorised_in_nats_alone(
    imitation: str | None, found: float | None
):
    """Held out -40, trained on -43; the bound of nats says nothing of squared actions."""
    (diagnostic,) = (d for d in DIAGNOSTICS if d.label.startswith("memorised"))
    curve = [{"frames": 0, "bc_nll_held_out": -40.0, "bc_nll_train": -43.0}]
    settings = {} if imitation is None else {"loss.imitation": imitation}
    row = RunGroup("row", (EvaluatedRun(Path("run"), curve=curve, settings=settings),))
    assert diagnostic.value(row) == found
