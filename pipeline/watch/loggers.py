"""Loggers of a run: TorchRL's own, several at a time."""

from __future__ import annotations

import os
import re
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic.dataclasses import dataclass as settings
from torchrl.record.loggers import Logger, get_logger
from torchrl.record.loggers.mlflow import MLFlowLogger

from envs.one_line import kind_and_text
from pipeline.files.run_files import RunDirectoryError, write_atomically
from pipeline.machine.extras import require_extras
from pipeline.settings import STRICT, Count

KNOWN = ("csv", "tensorboard", "wandb", "mlflow")
WANDB_ID = "wandb.id"
MLFLOW_ID = "mlflow.id"
"""Beside the logs: what wandb or mlflow calls the run. A run that goes on must go on under it."""
MLFLOW_URI = "MLFLOW_TRACKING_URI"
"""Variable of the environment that names a server of mlflow's; without it, it is a local file."""


@settings(frozen=True, kw_only=True, config=STRICT)
class LoggingSettings:
    """Loggers and checkpoints."""

    loggers: tuple[str, ...] = ("csv", "tensorboard")  # + wandb, mlflow
    project: str = "bc-sac"  # wandb / mlflow project
    interval: Count = 500  # frames between logged scalars
    checkpoint_interval: Count = 10_000  # frames
    checkpoints: Count = 2  # the newest are kept: if the last is damaged, the one before serves
    progress: bool = True  # a bar on stderr; a line for each phase is logged in any case


class LoggerGroup(Logger):
    """Hands every call to each of several loggers; the trainer takes only one.

    Args:
        loggers: The members by name, in order.
        log_dir: Directory of the run.
    """

    def __init__(self, loggers: Mapping[str, Logger], log_dir: str) -> None:
        self.names = list(loggers)
        self.loggers = list(loggers.values())
        super().__init__(exp_name="group", log_dir=log_dir)

    def _create_experiment(self) -> list[Logger]:
        return self.loggers

    def flush(self, timeout: float | None = None) -> None:
        """Flushes every member."""
        for logger in self.loggers:
            logger.flush(timeout)

    def _checkpoint_state(self) -> dict[str, Any]:
        return {
            name: logger.state_dict() for name, logger in zip(self.names, self.loggers, strict=True)
        }

    def _load_checkpoint_state(self, state_dict: Mapping[str, Any]) -> None:
        # A resumed run may have others; earlier checkpoints know them by their place.
        for place, (name, logger) in enumerate(zip(self.names, self.loggers, strict=True)):
            state = state_dict.get(name, state_dict.get(str(place)))
            if state is not None:
                logger.load_state_dict(state)

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        """Logs one number to every member."""
        for logger in self.loggers:
            logger.log_scalar(name, float(value), step=step)

    def log_video(self, name: str, video: Any, **kwargs: Any) -> None:
        """Logs one video to every member."""
        for logger in self.loggers:
            logger.log_video(name, video, **kwargs)

    def log_hparams(self, cfg: Any) -> None:
        """Logs the configuration to every member."""
        for logger in self.loggers:
            logger.log_hparams(cfg)

    def log_histogram(self, name: str, data: Sequence[float], **kwargs: Any) -> None:
        """Logs one histogram to every member."""
        for logger in self.loggers:
            logger.log_histogram(name, data, **kwargs)

    def __repr__(self) -> str:
        return f"LoggerGroup({self.loggers})"


def require_loggers(names: Sequence[str]) -> None:
    """Asks before any work is done whether the loggers called ``names`` can be made.

    Raises:
        ValueError: If a name is unknown.
        MissingExtraError: If a logger's package is not installed.
    """
    unknown = sorted(set(names) - set(KNOWN))
    if unknown:
        raise ValueError(f"logging.loggers: unknown {unknown}; choose from {list(KNOWN)}.")
    require_extras(names, f"logging.loggers=[{','.join(names)}]")


def make_loggers(names: Sequence[str], run_dir: Path, project: str) -> LoggerGroup:
    """Builds the loggers called ``names`` below ``run_dir / "logs"``.

    Raises:
        ValueError, MissingExtraError: As :func:`require_loggers`.
        RunDirectoryError: If the run's name on wandb or mlflow is damaged, or mlflow does not know
            it.
    """
    require_loggers(names)
    log_dir = run_dir / "logs"
    wandb = {"project": project, "id": _wandb_id(log_dir)} if "wandb" in names else {}
    loggers = {
        name: _mlflow(log_dir.absolute(), project)
        if name == "mlflow"
        else get_logger(name, str(log_dir), name, wandb_kwargs=wandb)
        for name in names
    }
    if "csv" in loggers:
        loggers["csv"].experiment.scalars = _NoHistory()
    return LoggerGroup(loggers, str(log_dir))


class _NoHistory(dict[str, list[Any]]):
    """In place of all scalars of a run, which TorchRL's CSV logger keeps beside their files.

    It would save them with every checkpoint, each time more.
    """

    def __missing__(self, name: str) -> list[Any]:
        return []

    def update(self, *_history: Any, **_more: Any) -> None:
        """Nothing: checkpoints of before hold one."""


def _wandb_id(log_dir: Path) -> str:
    path = log_dir / WANDB_ID
    if not path.exists():
        log_dir.mkdir(parents=True, exist_ok=True)
        write_atomically(path, uuid.uuid4().hex)
    return _kept_id(path)


def _kept_id(path: Path) -> str:
    name = path.read_text(errors="replace")
    if re.fullmatch(r"[0-9a-f]{32}", name) is None:
        raise RunDirectoryError(
            f"{path} is damaged: restore it, or remove it and log to another run of "
            f"{path.stem}'s with RUN=<new directory>."
        )
    return name


def _mlflow(log_dir: Path, project: str) -> ResumedMLFlow:
    path = log_dir / MLFLOW_ID
    run_id = _kept_id(path) if path.exists() else None
    server = os.environ.get(MLFLOW_URI)
    local = log_dir / "mlflow"
    local.mkdir(parents=True, exist_ok=True)
    logger = ResumedMLFlow(
        project,
        # Not a folder of files, which mlflow has given up (3.10).
        server or f"sqlite:///{local / 'mlflow.db'}",
        run_id,
        artifact_location=None if server else local.as_uri(),
    )
    if run_id is None:
        write_atomically(path, logger.experiment.info.run_id)
    return logger


class ResumedMLFlow(MLFlowLogger):
    """TorchRL's logger, which by itself begins another run each time.

    Args:
        project: Experiment of mlflow's in which a new run begins.
        tracking_uri: Where mlflow keeps it.
        run_id: Of the run that goes on; None begins one.
        artifact_location: Of a new experiment; None is the server's.

    Raises:
        RunDirectoryError: If mlflow cannot go on with the run.
    """

    def __init__(
        self,
        project: str,
        tracking_uri: str,
        run_id: str | None,
        *,
        artifact_location: str | None,
    ) -> None:
        self._run_id = run_id
        super().__init__(project, tracking_uri, artifact_location=artifact_location)

    def _create_experiment(self) -> Any:
        import mlflow  # noqa: PLC0415 - an optional dependency

        mlflow.end_run()  # of the job before, in a sweep; it does nothing where there is none
        if self._run_id is None:
            return super()._create_experiment()
        try:
            run = mlflow.start_run(run_id=self._run_id)
        # Its own exceptions, and those of databases and servers.
        except Exception as error:
            raise RunDirectoryError(
                f"mlflow cannot go on with run {self._run_id} at {self.log_dir} "
                f"({kind_and_text(error)}); is {MLFLOW_URI} as it was? "
                "Without mlflow: logging.loggers=[csv,tensorboard]."
            ) from error
        self.id = run.info.experiment_id
        return run
