"""Our packages beside a user's own folders of the same names, from a folder of the user's."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

import bcsac

ROOT = Path(__file__).parents[1]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A user's project: a package for each of our names, and a module of theirs in one."""
    for name in bcsac.NAMES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("THEIRS = True\n")
    # Of our packages `configs` is the one that is imported in no time.
    (tmp_path / "configs" / "my_own.py").write_text("NAME = 'theirs'\n")
    return tmp_path


def without(project: Path, name: str) -> Path:
    (project / name / "__init__.py").unlink()
    (project / name).rmdir()
    return project


def python(*arguments: str, at: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Python in folder `at`, which comes before ours on ``sys.path``."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=at, env=environment, capture_output=True, text=True)


def test_training_starts_beside_a_project_with_our_names(project: Path):
    started = python("-m", "pipeline.train", "--help", at=without(project, "pipeline"))
    assert started.returncode == 0, started.stderr
    assert "variant: " in started.stdout  # read from our configs/


def test_the_command_starts_beside_all_four(project: Path):
    started = python("-m", "bcsac", "train", "--help", at=project)
    assert started.returncode == 0, started.stderr
    assert "variant: " in started.stdout


def test_a_script_lists_its_commands_and_finds_the_modules_of_the_current_folder(project: Path):
    """As pip writes it: its own folder comes first on ``sys.path``, not the current one."""
    (project / "bin").mkdir()
    script = project / "bin" / "bcsac"
    script.write_text(
        "import bcsac\n"
        "try:\n    bcsac.main()\n"
        "except SystemExit:\n    import configs.my_own\n    print(configs.my_own.NAME)\n"
    )
    started = python(str(script), at=project)
    assert "bcsac train" in started.stdout
    assert "demos-check" in started.stdout
    assert started.stdout.endswith("theirs\n"), started.stderr


@pytest.mark.parametrize("is_package", [True, False])
def test_modules_of_a_users_folder_stay_importable(project: Path, is_package: bool):
    if not is_package:
        (project / "configs" / "__init__.py").unlink()
    code = "import pipeline, configs, configs.my_own as mine; print(mine.NAME, configs)"
    imported = python("-c", code, at=without(project, "pipeline"))
    assert imported.stdout.startswith("theirs "), imported.stderr
    assert str(ROOT / "configs" / "__init__.py") in imported.stdout


def test_ours_imported_before_the_claim_is_kept_and_extended(project: Path):
    code = (
        # losses, because it imports none of the packages that claim the names when imported
        "import sys, losses, bcsac; sys.path.insert(0, sys.argv[1])\n"
        "bcsac.claim(); print(losses.__path__)"
    )
    imported = python("-c", code, str(project), at=ROOT)
    assert imported.stdout.strip() == str([str(ROOT / "losses"), str(project / "losses")])


@pytest.mark.parametrize("name", bcsac.NAMES)
def test_a_package_of_theirs_that_came_first_is_named(project: Path, name: str):
    refused = python("-c", f"import {name}, bcsac; bcsac.claim()", at=project)
    last = refused.stderr.rstrip().splitlines()[-1]
    assert last.startswith(f"ImportError: {name} was imported from {project / name} before ")
    assert "start through the command bcsac" in last


def test_a_module_that_ours_hides_is_named(project: Path):
    (project / "configs" / "schema.py").touch()
    warned = python("-c", "import bcsac; bcsac.claim(); import configs", at=project)
    assert warned.returncode == 0, warned.stderr
    folder = project / "configs"
    assert f"same name in {folder} are not importable as configs.* (schema)" in warned.stderr


def test_another_copy_of_ours_is_no_users_folder(project: Path):
    """A checkout beside an installed wheel: modules of the other must not fill its gaps."""
    (project / "bcsac.py").touch()
    code = (
        "import sys, bcsac; sys.path.insert(0, sys.argv[1])\n"
        "bcsac.claim(); import configs; print(configs.__path__)"
    )
    imported = python("-c", code, str(project), at=ROOT)
    assert imported.stdout.strip() == str([str(ROOT / "configs")]), imported.stderr


def test_the_installed_command_is_the_function():
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert EntryPoint("bcsac", scripts["bcsac"], "console_scripts").load() is bcsac.main
