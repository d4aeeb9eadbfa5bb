"""What a service that logs a run calls it: the same when it goes on, another for another run."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline.files.run_files import RunDirectoryError
from pipeline.watch import loggers
from pipeline.watch.loggers import WANDB_ID, make_loggers


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> list[str | None]:
    """The names under which wandb was opened; its package need not be there."""
    names: list[str | None] = []

    def opened(_kind: str, *_places: str, **options: dict[str, str]) -> SimpleNamespace:
        names.append(options["wandb_kwargs"].get("id"))
        return SimpleNamespace(experiment=SimpleNamespace())

    monkeypatch.setattr(loggers, "get_logger", opened)
    monkeypatch.setattr(loggers, "require_extras", lambda *_: None)
    return names


def test_a_run_that_goes_on_goes_on_under_its_name(called: list[str | None], tmp_path: Path):
    """TorchRL's logger refuses a checkpoint that was written under another one."""
    for run in ("one", "one", "other"):
        make_loggers(["wandb"], tmp_path / run, "project")
    first, again, other = called
    assert first is not None
    assert first == again != other


def test_who_does_not_log_there_has_no_name(called: list[str | None], tmp_path: Path):
    make_loggers(["csv"], tmp_path, "project")
    assert called == [None]
    assert not (tmp_path / "logs" / WANDB_ID).exists()


@pytest.mark.parametrize("text", ["", "../../other", "0" * 31])
def test_a_damaged_name_is_refused(text: str, called: list[str | None], tmp_path: Path):
    path = tmp_path / "logs" / WANDB_ID
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(RunDirectoryError, match=r"wandb\.id is damaged"):
        make_loggers(["wandb"], tmp_path, "project")


def test_what_a_checkpoint_holds_of_the_csv_files_does_not_grow(tmp_path: Path):
    group = make_loggers(["csv"], tmp_path, "project")
    (csv,) = group.loggers
    csv._load_checkpoint_state({"scalars": {"loss": [(0, 9.0)]}})  # as checkpoints of before hold
    sizes = []
    for step in range(1, 4):
        group.log_scalar("loss", step / 2, step=step)
        sizes.append(len(json.dumps(group.state_dict())))
    assert len(set(sizes)) == 1
    assert (tmp_path / "logs/csv/scalars/loss.csv").read_text() == "1,0.5\n2,1.0\n3,1.5\n"
