"""A small finished run with two checkpoints."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.pipeline.toys import built, tiny_config, write_demos


@pytest.fixture(scope="session")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_demos(tmp_path_factory.mktemp("demos") / "demos.h5")


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    """Its directory; copy it, do not write to it."""
    folder = tmp_path_factory.mktemp("finished")
    run = built(tiny_config("sid_dbc", folder, demos, "logging.checkpoint_interval=10"))
    run.train()
    return run.run_dir


@pytest.fixture
def run_dir(finished: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / finished.name))
