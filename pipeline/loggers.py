"""Loggers of a run: TorchRL's own, several at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchrl.record.loggers import Logger, get_logger

KNOWN = ("csv", "tensorboard", "wandb", "mlflow")


class LoggerGroup(Logger):
    """Hands every call to each of several loggers; the trainer takes only one.

    Args:
        loggers: The members, in order.
        log_dir: Directory of the run.
    """

    def __init__(self, loggers: Sequence[Logger], log_dir: str) -> None:
        self.loggers = list(loggers)
        super().__init__(exp_name="group", log_dir=log_dir)

    def _create_experiment(self) -> list[Logger]:
        return self.loggers

    def flush(self, timeout: float | None = None) -> None:
        """Flushes every member."""
        for logger in self.loggers:
            logger.flush(timeout)

    def _checkpoint_state(self) -> dict[str, Any]:
        return {str(i): logger.state_dict() for i, logger in enumerate(self.loggers)}

    def _load_checkpoint_state(self, state_dict: Mapping[str, Any]) -> None:
        for i, logger in enumerate(self.loggers):
            logger.load_state_dict(state_dict[str(i)])

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


def make_loggers(names: Sequence[str], run_dir: Path, project: str) -> LoggerGroup:
    """Builds the loggers called ``names`` below ``run_dir / "logs"``.

    Raises:
        ValueError: If a name is unknown.
    """
    unknown = sorted(set(names) - set(KNOWN))
    if unknown:
        raise ValueError(f"logging.loggers: unknown {unknown}; choose from {list(KNOWN)}.")
    log_dir = run_dir / "logs"
    loggers = [
        get_logger(
            name,
            str(log_dir),
            f"{name}",
            wandb_kwargs={"project": project},
            mlflow_kwargs={"tracking_uri": (log_dir / "mlflow").absolute().as_uri()},
        )
        for name in names
    ]
    return LoggerGroup(loggers, str(log_dir))
