"""What a service that logs a run calls it: the same when it goes on, another for another run."""

from __future__ import annotations

import json
import sys
import uuid
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from pipeline.files.run_files import RunDirectoryError
from pipeline.watch import loggers
from pipeline.watch.loggers import MLFLOW_ID, WANDB_ID, make_loggers


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


class FakeMLflow(ModuleType):
    """What of mlflow a logger calls: experiments by name, runs by id, and who is told what."""

    def __init__(self):
        super().__init__("mlflow")
        self.experiments, self.runs, self.told, self.uri, self.active = {}, {}, [], None, None

    def set_tracking_uri(self, uri):
        self.uri = uri

    def get_experiment_by_name(self, name):
        return self.experiments.get(name)

    def create_experiment(self, name, artifact_location, tags):
        found = SimpleNamespace(experiment_id=str(len(self.experiments)), at=artifact_location)
        self.experiments[name] = found
        return found.experiment_id

    def set_experiment(self, experiment_id):
        assert experiment_id in {each.experiment_id for each in self.experiments.values()}

    def start_run(self, run_id=None, experiment_id=None):
        assert self.active is None, "mlflow refuses a second active run"
        if run_id is None:
            run_id = uuid.uuid4().hex
            info = SimpleNamespace(run_id=run_id, experiment_id=experiment_id)
            self.runs[run_id] = SimpleNamespace(info=info)
        self.active = self.runs[run_id]
        return self.active

    def end_run(self):
        self.active = None

    def log_metric(self, key, value, step):
        self.told.append((self.active.info.run_id, key, value, step))


@pytest.fixture
def mlflow(monkeypatch: pytest.MonkeyPatch) -> FakeMLflow:
    fake = FakeMLflow()
    monkeypatch.setitem(sys.modules, "mlflow", fake)
    monkeypatch.setattr("torchrl.record.loggers.mlflow._has_mlflow", True)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return fake


def test_mlflow_s_run_goes_on_in_the_project_s_experiment(mlflow: FakeMLflow, tmp_path: Path):
    for step, run in enumerate(("one", "one", "other")):
        make_loggers(["mlflow"], tmp_path / run, "project").log_scalar("loss", 0.5, step=step)
    first, again, other = [told[0] for told in mlflow.told]
    assert first == again != other
    assert [told[1:] for told in mlflow.told] == [("loss", 0.5, step) for step in range(3)]
    assert list(mlflow.experiments) == ["project"]
    assert mlflow.experiments["project"].at == (tmp_path / "one/logs/mlflow").as_uri()
    assert mlflow.uri == f"sqlite:///{tmp_path}/other/logs/mlflow/mlflow.db"


def test_a_server_of_mlflow_s_keeps_its_own_files(
    mlflow: FakeMLflow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://server:5000")
    make_loggers(["mlflow"], tmp_path, "project")
    assert mlflow.uri == "http://server:5000"
    assert mlflow.experiments["project"].at is None


def test_a_run_that_mlflow_does_not_know_is_told_in_one_line(mlflow: FakeMLflow, tmp_path: Path):
    make_loggers(["mlflow"], tmp_path, "project")
    mlflow.runs.clear()
    with pytest.raises(
        RunDirectoryError, match=r"^mlflow cannot go on with run .*KeyError"
    ) as told:
        make_loggers(["mlflow"], tmp_path, "project")
    assert "\n" not in str(told.value)
    (tmp_path / "logs" / MLFLOW_ID).write_text("../other")
    with pytest.raises(RunDirectoryError, match=r"mlflow\.id is damaged: .* run of mlflow's"):
        make_loggers(["mlflow"], tmp_path, "project")


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
