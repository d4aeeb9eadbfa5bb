"""Entry point of ``make train``: Hydra composes the configuration, ``build.py`` the run."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from configs import Config, register_schema
from envs.demonstrations import DemonstrationError
from pipeline.build import build_run
from pipeline.run_dir import RunDirectoryError, load_config

logger = logging.getLogger(__name__)
register_schema()

IDENTITY = {"variant", "preset", "run_dir"}
"""Overrides that say which run it is; a resumed run brings its own."""


def resolve(config: Config) -> tuple[Config, bool]:
    """The configuration to run and whether it continues an earlier run.

    With ``resume=DIR`` the run's own configuration is read and only the overrides that were typed
    on the command line are put on top of it.

    Raises:
        ValueError: If a resumed run is also told what it is.
        RunDirectoryError: If there is no run to resume.
    """
    if config.resume is None:
        OmegaConf.resolve(config)  # type: ignore[arg-type]
        return config, False
    run_dir = Path(config.resume)
    typed = [o for o in HydraConfig.get().overrides.task if not o.startswith("resume=")]
    chosen = [o for o in typed if o.split("=")[0] in IDENTITY]
    if chosen:
        raise ValueError(
            f"resume={run_dir} continues that run as what it is; leave out {', '.join(chosen)}."
        )
    resumed = load_config(run_dir, typed)
    resumed.run_dir = str(run_dir)
    return resumed, True


@hydra.main(version_base="1.3", config_path="pkg://configs", config_name="train")
def main(config: Config) -> None:
    """Trains one run (or, with ``--multirun``, one of several)."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports each buffer it allocates
    try:
        resolved, resume = resolve(config)
        run = build_run(resolved, resume=resume)
    except (DemonstrationError, RunDirectoryError, ValueError, FileNotFoundError) as error:
        sys.exit(f"error: {error}")
    except OmegaConfBaseException as error:
        sys.exit(f"error in the configuration: {error}")
    logger.info("run directory: %s", run.run_dir)
    run.train()
    logger.info("done; evaluate it with: make eval RUN=%s", run.run_dir)


if __name__ == "__main__":
    main()
