"""What must hold of the repository as a whole, whichever code is in it."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parents[1]

VARIANTS = ["sac", "bc", "bc_sac", "dbc_sac", "sid_bc", "sid_dbc", "ila_bc", "ila_dbc", "da_sac"]
INTERFACE = ["train", "eval", "table", "demos-check", "record", "video", "test", "check", "smoke"]
PACKAGES = ["configs", "envs", "losses", "pipeline"]

# Written in pieces, so that this file does not find itself.
MACHINE_FOLDERS = "|".join(["work", "root", "tmp", "home", "Users", "opt", "etc/xdg"])
MACHINE_PATH = re.compile(rf"(?<![\w.~$}}/-])/(?:{MACHINE_FOLDERS})/[\w.]")
PACKAGE_INDEX = re.compile(
    "|".join(["pythonhosted" + r"\.org", "pypi" + r"\.org/", r"\.pytorch" + r"\.org/whl"])
)


def run(*command: str) -> subprocess.CompletedProcess[str]:
    """Run a command at the root, apart from the make that may run these tests."""
    inherited = {"MAKEFLAGS", "MAKELEVEL", "MFLAGS"}
    variables = {name: value for name, value in os.environ.items() if name not in inherited}
    return subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True)


@pytest.fixture(scope="module")
def committed_texts() -> dict[str, str]:
    """Every text file that git has or would add, by its path."""
    listing = run("git", "ls-files", "--cached", "--others", "--exclude-standard", "-z")
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    texts = {}
    for name in filter(None, listing.stdout.split("\0")):
        content = (ROOT / name).read_bytes() if (ROOT / name).is_file() else b"\0"
        if b"\0" not in content:
            texts[name] = content.decode("utf-8", errors="replace")
    return texts


@pytest.fixture(scope="module")
def make_help() -> dict[str, str]:
    """Every target that `make` alone prints, with its line."""
    printed = run("make")
    assert printed.returncode == 0, printed.stderr
    return dict(re.findall(r"^  ([a-z-]+)\s+(\S.*)$", printed.stdout, flags=re.MULTILINE))


@pytest.fixture(scope="module")
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def pins() -> dict[str, Version]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = [line.split("==") for line in lines if not line.startswith("#")]
    return {normalised(name): Version(version) for name, version in pairs}


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize("pattern", [MACHINE_PATH, PACKAGE_INDEX], ids=["path", "package index"])
def test_no_file_names_one_machine(committed_texts: dict[str, str], pattern: re.Pattern[str]):
    found = [
        f"{name}:{number}: {line.strip()}"
        for name, text in committed_texts.items()
        for number, line in enumerate(text.splitlines(), start=1)
        if pattern.search(line)
    ]
    assert not found


@pytest.mark.parametrize(
    ("line", "names_a_machine"),
    [
        ("open('" + "/work" + "/main/x')", True),
        ("see " + "/root" + "/.cache", True),
        ("runs/home/x and ../work/y", False),
        ("$HOME/tmp/x", False),
    ],
)
def test_the_pattern_of_machine_paths(line: str, names_a_machine: bool):
    assert bool(MACHINE_PATH.search(line)) == names_a_machine


def test_every_variant_of_the_paper_has_its_file():
    assert {path.stem for path in (ROOT / "configs/variant").glob("*.yaml")} >= set(VARIANTS)


@pytest.mark.parametrize(
    "path", sorted((ROOT / "configs/variant").glob("*.yaml")), ids=lambda p: p.stem
)
def test_a_variant_begins_with_the_section_it_follows(path: Path):
    lines = path.read_text().splitlines()
    header = [line for line in lines[: next_setting(lines)] if line.startswith("#")]
    assert re.search(r"\b(III|IV)(-[A-Z])?\b", " ".join(header)), (
        f"{path.name}: the comment above the first key must cite the paper's section, as in 'III-D'"
    )


def next_setting(lines: list[str]) -> int:
    """The index of the first line that sets something; `# @package` is Hydra's."""
    return next(
        (i for i, line in enumerate(lines) if line and not line.startswith("#")), len(lines)
    )


@pytest.mark.parametrize("target", INTERFACE)
def test_make_alone_prints_the_interface(make_help: dict[str, str], target: str):
    assert make_help[target]


def test_every_target_has_its_line_in_the_help(make_help: dict[str, str]):
    makefile = (ROOT / "Makefile").read_text()
    phony = {
        name
        for line in re.findall(r"^\.PHONY:(.*)$", makefile, re.MULTILINE)
        for name in line.split()
    }
    assert phony == set(make_help)


def test_the_documents_name_only_targets_that_exist(
    committed_texts: dict[str, str], make_help: dict[str, str]
):
    command = re.compile(r"(?:^|`)make ([a-z][a-z-]*)", flags=re.MULTILINE)
    named = {
        (name, target)
        for name, text in committed_texts.items()
        if name.endswith((".md", ".yaml", ".ci/run"))
        for target in command.findall(text)
    }
    assert named, "no document shows how to use the Makefile"
    assert {(name, target) for name, target in named if target not in make_help} == set()


@pytest.mark.parametrize("target", ["eval", "record", "video", "table"])
def test_a_missing_variable_is_named_before_anything_is_installed(target: str, tmp_path: Path):
    stopped = run("make", target, f"VENV={tmp_path / 'venv'}")
    assert stopped.returncode == 2
    assert re.search(rf"make {target} needs (RUN|RUNS)=\.\.\., for example: ", stopped.stderr)
    assert not list(tmp_path.iterdir())


def test_train_hands_paths_to_hydra_unharmed():
    """A comma in an unquoted value is a sweep to Hydra, an equals sign an error."""
    planned = run(
        "make", "-n", "train", "RUN=runs/a=1,b", "ARGS=seed=3 loss.gamma=0.9", "VARIANT=bc"
    )
    assert "\"run_dir='runs/a=1,b'\"" in planned.stdout
    assert planned.stdout.rstrip().endswith("seed=3 loss.gamma=0.9")
    assert " variant=bc " in planned.stdout


def test_the_constraints_meet_every_requirement(project: dict, pins: dict[str, Version]):
    extras = project["optional-dependencies"]
    stated = [
        *project["dependencies"],
        *extras["dev"],
        *extras["minari"],
        *extras["video"],
        *extras["sweep"],
    ]
    requirements = [Requirement(line) for line in stated]
    unmet = [
        f"{requirement} against {pins.get(normalised(requirement.name))}"
        for requirement in requirements
        if requirement.name != project["name"]
        and pins.get(normalised(requirement.name)) not in requirement.specifier
    ]
    assert not unmet


def test_the_constraints_pin_public_versions_only(pins: dict[str, Version]):
    assert {name: str(version) for name, version in pins.items() if version.local} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_public_package_says_what_it_holds(package: str):
    first = (ROOT / package / "__init__.py").read_text().lstrip()
    assert first.startswith(('"""', 'r"""'))


def test_ci_runs_the_same_targets_everywhere(committed_texts: dict[str, str]):
    for name in [".ci/run", ".github/workflows/check.yaml"]:
        for target in ["make check", "make smoke"]:
            assert target in committed_texts[name], f"{name} does not call `{target}`"
