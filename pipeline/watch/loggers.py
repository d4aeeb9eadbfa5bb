"""Loggers of a run: TorchRL's own, several at a time."""

from __future__ import annotations

import re
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic.dataclasses import dataclass as settings
from torchrl.record.loggers import Logger, get_logger

from pipeline.files.run_files import RunDirectoryError, write_atomically
from pipeline.machine.extras import require_extras
from pipeline.settings import STRICT, Count

KNOWN = ("csv", "tensorboard", "wandb", "mlflow")
WANDB_ID = "wandb.id"
"""Beside the logs: what wandb calls the run. A run that goes on must go on under it."""


@settings(frozen=True, kw_only=True, config=STRICT)
class LoggingSettings:
    """Loggers and checkpoints."""

    loggers: tuple[str, ...] = ("csv", "tensorboard")  # + wandb, mlflow
    project: str = "bc-sac"  # wandb / mlflow project
    interval: Count = 500  # frames between logged scalars
    checkpoint_interval: Count = 10_000  # frames
    checkpoints: Count = 2  # the newest are kept: if the last is damaged, the one before serves
    progress: bool = True


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
        RunDirectoryError: If the run's name on wandb is damaged.
    """
    require_loggers(names)
    log_dir = run_dir / "logs"
    wandb = {"project": project, "id": _wandb_id(log_dir)} if "wandb" in names else {}
    loggers = {
        name: get_logger(
            name,
            str(log_dir),
            f"{name}",
            wandb_kwargs=wandb,
            mlflow_kwargs={"tracking_uri": (log_dir / "mlflow").absolute().as_uri()},
        )
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
    name = path.read_text(errors="replace")
    if re.fullmatch(r"[0-9a-f]{32}", name) is None:
        raise RunDirectoryError(
            f"{path} is damaged: restore it, or remove it and log to another run of wandb's with "
            "RUN=<new directory>."
        )
    return name
