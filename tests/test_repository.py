"""What must hold of the repository as a whole, whichever code is in it."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

from tests.pipeline.toys import write_demos

ROOT = Path(__file__).parents[1]

VARIANTS = ["sac", "bc", "bc_sac", "dbc_sac", "sid_bc", "sid_dbc", "ila_bc", "ila_dbc", "da_sac"]
INTERFACE = [
    *("train", "eval", "table", "demos-check", "record", "video", "play", "strip"),
    *("test", "check", "smoke"),
]
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


def test_the_help_can_be_read_at_100_columns():
    """Options stand on lines of their own, whole, below what a target does."""
    lines = run("make").stdout.splitlines()
    assert max(map(len, lines)) <= 100
    (place,) = (i for i, line in enumerate(lines) if line.startswith("  train "))
    assert lines[place] == "  train         train a policy"
    options = list(itertools.takewhile(lambda line: line.startswith(" " * 16), lines[place + 1 :]))
    assert options[0].startswith(" " * 16 + "[TASK=door|")
    (told,) = re.findall(r"^train:.*## train a policy (.*)$", (ROOT / "Makefile").read_text(), re.M)
    assert " ".join(option.strip() for option in options) == told


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


@pytest.mark.parametrize("target", ["eval", "record", "video", "play", "table", "strip"])
def test_a_missing_variable_is_named_before_anything_is_installed(target: str, tmp_path: Path):
    stopped = run("make", target, f"VENV={tmp_path / 'venv'}")
    assert stopped.returncode == 2
    assert re.search(rf"make {target} needs (RUN|RUNS)=\.\.\., for example: ", stopped.stderr)
    assert not list(tmp_path.iterdir())


ODD = 'run\'s a=1,b $HOME ${x} $(y) `z` "q" ü;&|*#%'


def environment(venv: Path, interpreter: str) -> Path:
    """One with everything installed, whose interpreter is this script."""
    (venv / "bin").mkdir(parents=True)
    python = venv / "bin" / "python"
    python.write_text(interpreter)
    python.chmod(0o755)
    stamp = re.search(r"touch (.*)$", run("make", "-n", "install", f"VENV={venv}").stdout)
    assert stamp
    Path(stamp[1]).touch()
    return venv


@pytest.fixture
def echoing(tmp_path: Path) -> Path:
    """An environment whose interpreter writes down its arguments."""
    echo = f"#!{sys.executable}\nimport json, sys\nprint(json.dumps(sys.argv[1:]))\n"
    return environment(tmp_path / "venv", echo)


@pytest.mark.parametrize(
    ("target", "variables", "arguments"),
    [
        ("train", ("RUN", "DEMOS"), [f"demos.source='{ODD}'", f"run_dir='{ODD}'"]),
        ("train", ("RESUME",), [f"resume='{ODD}'"]),
        ("eval", ("RUN", "OUT"), ["eval", ODD, "--out", ODD]),
        ("demos-check", ("DEMOS",), ["demos-check", ODD]),
        ("record", ("RUN", "OUT"), ["record", ODD, "--out", ODD]),
        (
            "video",
            ("RUN", "WITH", "CAMERA", "OUT"),
            ["video", ODD, "--with", ODD, "--camera", ODD, "--out", ODD],
        ),
        ("play", ("RUN",), ["play", ODD]),
        ("plot", ("RUN", "OUT"), ["plot", ODD, "--out", ODD]),
    ],
)
def test_paths_come_through_make_unharmed(
    target: str, variables: tuple[str, ...], arguments: list[str], echoing: Path
):
    done = run("make", target, f"VENV={echoing}", *(f"{name}={ODD}" for name in variables))
    assert done.returncode == 0, done.stderr
    module = "pipeline.train" if target == "train" else "pipeline.cli"
    assert json.loads(done.stdout) == ["-u", "-m", module, *arguments]


def audited(folder: Path, printed: str, code: int) -> subprocess.CompletedProcess[str]:
    """`make audit` with an auditor that says so."""
    auditor = folder / "audit" / "bin" / "pip-audit"
    auditor.parent.mkdir(parents=True)
    (folder / "told").write_text(printed)
    auditor.write_text(f"#!/bin/sh\ncat '{folder / 'told'}'\nexit {code}\n")
    auditor.chmod(0o755)
    return run("make", "audit", f"AUDIT={folder / 'audit'}")


def test_an_audit_that_was_told_nothing_is_none(tmp_path: Path, pins: dict[str, Version]):
    skipped = [f"{name}  could not be audited: {name} ({pins[name]})" for name in pins]
    clean = "No known vulnerabilities found"
    done = audited(tmp_path / "none", "\n".join([clean, *skipped]), 0)
    assert done.returncode == 2
    assert clean not in done.stdout
    assert f"{len(pins)} of {len(pins)} packages were not compared" in done.stderr
    some = audited(tmp_path / "some", "\n".join([clean, *skipped[:2]]), 0)
    assert some.returncode == 2
    assert skipped[1] in some.stdout
    assert f"2 of {len(pins)} packages were not compared" in some.stderr
    assert audited(tmp_path / "all", clean, 0).returncode == 0
    found = audited(tmp_path / "found", "torch 1.0 PYSEC-1", 1)
    assert (found.returncode, found.stdout) == (2, "torch 1.0 PYSEC-1")


def test_demonstrations_of_rows_come_through_make_unharmed(echoing: Path, tmp_path: Path):
    row = tmp_path / "rows" / "bc" / "seed0" / "evaluation.json"
    done = run("make", str(row), f"VENV={echoing}", f"ROW_RUNS={tmp_path / 'rows'}", f"DEMOS={ODD}")
    trained, evaluated = map(json.loads, done.stdout.splitlines())
    assert f"demos.source='{ODD}'" in trained
    assert evaluated[3:5] == ["eval", str(row.parent)]


@pytest.mark.parametrize(
    ("given", "folder"),
    [
        ((), "runs/rows"),
        (("TASK=door",), "runs/rows"),
        (("TASK=door", "REWARD=dense"), "runs/rows"),
        (("TASK=door", "REWARD=sparse"), "runs/tasks/door_sparse"),
        (("TASK=hammer",), "runs/tasks/hammer_dense"),
        (("TASK=dm_control:walker/walk",), "runs/tasks/dm_control_walker_walk_dense"),
        (("TASK=my dir/it's.py:N", "REWARD=sparse"), "runs/tasks/my_dir_it_s.py_N_sparse"),
        (("TASK=pen", "ROW_RUNS=elsewhere"), "elsewhere"),
    ],
)
def test_each_task_and_reward_has_a_folder_of_rows(given: tuple[str, ...], folder: str):
    planned = run("make", "-n", "rows", "ROWS=bc", "SEEDS=0 1", *given)
    assert planned.returncode == 0, planned.stderr
    listed = re.findall(r"for file in (.*); do test", planned.stdout)
    assert listed == [" ".join(f"{folder}/bc/seed{seed}/evaluation.json" for seed in (0, 1))]


def test_any_cell_comes_through_make_unharmed(echoing: Path, tmp_path: Path):
    def rows(*given: str) -> list[list[str]]:
        venv, runs = f"VENV={echoing}", f"ROW_RUNS={tmp_path / 'rows'}"
        done = run("make", "rows", venv, runs, "SEEDS=3", f"TASK={ODD}", *given)
        told = [line for line in done.stdout.splitlines() if line.startswith("[")]
        return [json.loads(line)[3:] for line in told]

    path = f"{tmp_path / 'rows'}/bc_sac_10/seed3"
    trained, judged = rows("ROWS=bc_sac_10", "REWARD=sparse", "EPISODES=7", "ARGS=loss.gamma=0.9")
    assert trained == [
        "variant=bc_sac", "loss.bc_weight.init=10", "preset=table", "seed=3", f"run_dir={path}",
        "loss.gamma=0.9", "env.reward=sparse", f"task.name='{ODD}'", "torch_threads=1",
        "env.num_threads=1", "logging.progress=false",
    ]  # fmt: skip
    assert judged == ["eval", path, "--task", ODD, "--episodes", "7", "env.num_threads=1"]
    # A run that is there goes on with its own reward; whose code it is, is said again.
    Path(path).mkdir(parents=True)
    (Path(path) / "config.yaml").touch()
    resumed, _ = rows("ROWS=bc_sac_10", "REWARD=sparse", f"DEMOS={ODD}")
    assert resumed[0] == f"resume={path}"
    assert not any(word.startswith(("env.reward", "demos.source", "variant")) for word in resumed)
    assert f"task.name='{ODD}'" in resumed
    assert not any(word.startswith("env.reward") for word in rows("ROWS=bc", "REWARD=dense")[0])


def test_a_reward_that_is_none_is_refused_before_anything_is_installed(tmp_path: Path):
    stopped = run("make", "rows", "REWARD=shaped", f"VENV={tmp_path / 'venv'}")
    assert stopped.returncode == 2
    assert "make rows takes REWARD=dense or REWARD=sparse, got shaped" in stopped.stderr
    assert not list(tmp_path.iterdir())


def test_results_are_of_the_rows_or_of_the_folders_that_are_named(echoing: Path):
    def published(*given: str) -> list[str]:
        return json.loads(run("make", "results", f"VENV={echoing}", *given).stdout)[3:]

    assert published() == ["results", "runs/rows"]
    assert published("ROW_RUNS=runs/trial", f"OUT={ODD}") == ["results", "runs/trial", "--out", ODD]
    assert published("RUNS=a b", "ARGS=--unclean") == ["results", "a", "b", "--unclean"]


def test_demonstrations_of_an_odd_name_are_checked(tmp_path: Path):
    venv = environment(tmp_path / "venv", f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    source = write_demos(tmp_path / f"{ODD}.h5")
    done = run("make", "demos-check", f"VENV={venv}", f"DEMOS={source}")
    assert done.returncode == 0, done.stderr
    assert f"{source.name}: 2 usable of 2 episodes" in done.stdout


def test_what_train_was_given_stays_as_it_was():
    planned = run("make", "-n", "train", "ARGS=seed=3 loss.gamma=0.9", "VARIANT=bc")
    assert planned.stdout.rstrip().endswith("seed=3 loss.gamma=0.9")
    assert " variant=bc " in planned.stdout


def test_the_environment_of_another_checkout_is_not_installed_into(tmp_path: Path):
    """A folder of packages with our name in it, installed from elsewhere, is all that it takes."""
    venv, elsewhere = tmp_path / "venv", tmp_path / "another checkout"
    elsewhere.mkdir()
    info = tmp_path / "site" / "bc_sac-0.1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bc-sac\nVersion: 0.1.0\n")
    (info / "direct_url.json").write_text(json.dumps({"url": elsewhere.as_uri(), "dir_info": {}}))
    (venv / "bin").mkdir(parents=True)
    python = venv / "bin" / "python"
    # It knows no package but ours, and would fail at pip.
    python.write_text(f'#!/bin/sh\nPYTHONPATH={info.parent} exec {sys.executable} -S "$@"\n')
    python.chmod(0o755)
    done = run("make", "install", f"VENV={venv}")
    assert done.returncode == 2
    assert f"VENV={venv} is of the checkout {elsewhere}; name another" in done.stderr
    assert "uninstall" not in done.stdout + done.stderr
    assert not list(venv.glob(".installed*"))


def test_the_constraints_meet_every_requirement(project: dict, pins: dict[str, Version]):
    extras = project["optional-dependencies"]
    stated = [
        *project["dependencies"],
        *extras["dev"],
        *extras["docs"],
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


def test_the_lowest_releases_are_the_lower_bounds(project: dict, pins: dict[str, Version]):
    """What `make check-lowest` runs is what `pyproject.toml` promises; torch's bound is not run."""
    part, _, asked_for = (ROOT / "constraints-lowest.txt").read_text().partition("# Not direct ")
    tested, theirs = (
        dict(line.split("==") for line in text.splitlines() if "==" in line)
        for text in (part, asked_for)
    )
    direct = {normalised(Requirement(line).name) for line in project["dependencies"]}
    assert not direct & {normalised(name) for name in theirs}
    assert all(
        f"{name}==" in (ROOT / "constraints.txt").read_text() for name in {**tested, **theirs}
    )
    bounds = {
        normalised(requirement.name): Version(clause.version)
        for requirement in map(Requirement, project["dependencies"])
        for clause in requirement.specifier
        if clause.operator in (">=", "==") and requirement.name != "torch"
    }
    lowest = {normalised(name): Version(version) for name, version in tested.items()}
    assert lowest.pop("torch") == pins["torch"]
    assert lowest == bounds


def test_the_constraints_pin_public_versions_only(pins: dict[str, Version]):
    assert {name: str(version) for name, version in pins.items() if version.local} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_public_package_says_what_it_holds(package: str):
    first = (ROOT / package / "__init__.py").read_text().lstrip()
    assert first.startswith(('"""', 'r"""'))


def of_the_code(texts: dict[str, str]) -> dict[str, str]:
    """Source and settings, without the tests of them and the documents."""
    return {
        name: text
        for name, text in texts.items()
        if name.endswith((".py", ".yaml", ".toml")) and not name.startswith(("tests/", "docs/"))
    }


def test_the_notes_and_pages_that_comments_name_exist(committed_texts: dict[str, str]):
    note, page = re.compile(r"(?<![\w-])(\d\d-[a-z-]+\.md)"), re.compile(r"\bdocs/[\w./-]+\.md")
    named = {
        (name, target)
        for name, text in of_the_code(committed_texts).items()
        for target in [f"docs/lab/notes/{file}" for file in note.findall(text)] + page.findall(text)
    }
    assert ("envs/door/defaults.py", "docs/lab/notes/27-success-steps.md") in named
    assert {(name, target) for name, target in named if target not in committed_texts} == set()


def test_a_section_that_comments_cite_by_number_is_of_a_paper(committed_texts: dict[str, str]):
    """The sections of our own documents move; their notes have names."""
    citing = {
        name: text
        for name, text in of_the_code(committed_texts).items()
        if re.search(r"\bsection \d", text)
    }
    assert "losses/self_imitation.py" in citing
    assert [name for name, text in citing.items() if "arXiv:" not in text] == []


def test_the_workflow_runs_the_gate_and_nothing_beside_it():
    """One list of targets, so that a push is judged by what `.ci/run` runs anywhere else."""
    workflow = yaml.safe_load((ROOT / ".github/workflows/check.yaml").read_text())
    steps = [step["run"] for step in workflow["jobs"]["check"]["steps"] if "run" in step]
    assert steps == ["make install", ".ci/run"]
    assert os.access(ROOT / ".ci/run", os.X_OK)


def test_the_gate_runs_every_kind_of_check(committed_texts: dict[str, str]):
    targets = re.findall(r"^make ([a-z-]+)", committed_texts[".ci/run"], flags=re.MULTILINE)
    assert targets == ["check", "test", "smoke", "report", "docs"]


def test_what_is_bundled_is_not_ignored():
    """A clone would lack it, and only there would tests tell."""
    bundled = sorted(ROOT.glob("envs/*/bundled/*.h5"))
    assert bundled
    ignored = run("git", "check-ignore", *map(str, bundled))
    assert ignored.stdout == ""
