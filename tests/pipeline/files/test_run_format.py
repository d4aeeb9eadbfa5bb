"""A run directory of a stranger runs no code and reaches no other file."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
import yaml
from tensordict import NonTensorData, TensorDict

from pipeline.build import build_run
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.run_files import CONFIG, TRUST, RunDirectoryError
from pipeline.files.run_format import RunFormatError, latest_of, verify_checkpoint
from pipeline.files.sums import DamagedError, write_sums
from pipeline.run_dir import load_recipe
from tests.pipeline.toys import built, tiny_config


class Evil:
    """Leaves a trace where it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = str(trace)

    def __reduce__(self):
        return os.system, (f"touch {self.trace}",)


def evil_memmap(folder: Path, trace: Path) -> None:
    TensorDict({"x": NonTensorData(Evil(trace))}, []).memmap(folder)


def zipped(folder: Path, archive: Path) -> None:
    with zipfile.ZipFile(archive, "w") as file:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                file.write(path, path.relative_to(folder).as_posix())


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    run = built(tiny_config("bc_sac", folder, demos))
    run.train()
    return run.run_dir


@pytest.fixture
def run_dir(trained: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(trained, tmp_path / "run"))


def checkpoint_of(run_dir: Path) -> Path:
    found = latest_of(run_dir)
    assert found is not None
    return found


def policy_of(run_dir: Path) -> Path:
    return next(checkpoint_of(run_dir).glob("components/*-policy"))


def pickle_in_place(run_dir: Path, trace: Path) -> None:
    evil_memmap(policy_of(run_dir) / "state", trace)


def archive_beside(run_dir: Path, trace: Path) -> None:
    evil_memmap(run_dir / "made", trace)
    zipped(run_dir / "made", policy_of(run_dir) / "state.tdz")


def archive_instead(run_dir: Path, trace: Path) -> None:
    policy = policy_of(run_dir)
    archive_beside(run_dir, trace)
    shutil.rmtree(policy / "state")


def manifest_leads_elsewhere(run_dir: Path, trace: Path) -> None:
    checkpoint, policy = checkpoint_of(run_dir), policy_of(run_dir)
    manifest = json.loads((checkpoint / "manifest.json").read_text())
    manifest["components"]["policy"]["path"] = "../../elsewhere"
    (checkpoint / "manifest.json").write_text(json.dumps(manifest))
    shutil.copytree(policy, run_dir / "elsewhere")
    shutil.rmtree(run_dir / "elsewhere" / "state")
    evil_memmap(run_dir / "elsewhere" / "state", trace)


def linked_state(run_dir: Path, trace: Path) -> None:
    policy = policy_of(run_dir)
    shutil.rmtree(policy / "state")
    evil_memmap(run_dir / "stuff", trace)
    (policy / "state").symlink_to(run_dir / "stuff")


def linked_file(run_dir: Path, trace: Path) -> None:
    tensor = next(policy_of(run_dir).glob("state/*.memmap"))
    trace.with_name("outside").write_bytes(tensor.read_bytes())
    tensor.unlink()
    tensor.symlink_to(trace.with_name("outside"))


def whole_archive(run_dir: Path, trace: Path) -> None:
    checkpoint = checkpoint_of(run_dir)
    evil_memmap(policy_of(run_dir) / "state", trace)
    zipped(checkpoint, checkpoint.with_name(checkpoint.name + ".torchrl"))
    shutil.rmtree(checkpoint)


def torch_file(run_dir: Path, trace: Path) -> None:
    policy = policy_of(run_dir)
    shutil.rmtree(policy / "state")
    torch.save(Evil(trace), policy / "state.pt")


def bare_pickle(run_dir: Path, trace: Path) -> None:
    (policy_of(run_dir) / "state.pt").write_bytes(pickle.dumps(Evil(trace)))


def named_pipe(run_dir: Path, trace: Path) -> None:
    tensor = next(policy_of(run_dir).glob("state/*.memmap"))
    tensor.unlink()
    os.mkfifo(tensor)


def key_leads_elsewhere(run_dir: Path, trace: Path) -> None:
    meta = policy_of(run_dir) / "state" / "meta.json"
    described = json.loads(meta.read_text())
    described["../../../outside"] = described["tensor_00000000"]
    meta.write_text(json.dumps(described))


def other_class(run_dir: Path, trace: Path) -> None:
    meta = policy_of(run_dir) / "state" / "meta.json"
    described = json.loads(meta.read_text())
    described["_type"] = "<class 'tensordict.tensorclass.NonTensorData'>"
    meta.write_text(json.dumps(described))


def linked_checkpoint(run_dir: Path, trace: Path) -> None:
    checkpoint = checkpoint_of(run_dir)
    shutil.move(checkpoint, run_dir / "moved")
    checkpoint.symlink_to(run_dir / "moved")


def linked_config(run_dir: Path, trace: Path) -> None:
    shutil.move(run_dir / CONFIG, run_dir / "moved.yaml")
    (run_dir / CONFIG).symlink_to(run_dir / "moved.yaml")


KINDS = [
    pickle_in_place, archive_beside, archive_instead, manifest_leads_elsewhere, linked_state,
    linked_file, whole_archive, torch_file, bare_pickle, named_pipe, key_leads_elsewhere,
    other_class, linked_checkpoint, linked_config,
]  # fmt: skip


@pytest.mark.parametrize("mutate", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("summed", [False, True], ids=["other_sums", "own_sums"])
def test_what_the_project_does_not_write_is_refused_before_it_is_read(
    mutate: Callable[[Path, Path], None], summed: bool, run_dir: Path, tmp_path: Path
):
    trace = tmp_path / "trace"
    checkpoint = checkpoint_of(run_dir)
    mutate(run_dir, trace)
    if summed and checkpoint.is_dir() and mutate is not named_pipe:  # which has no end to read
        write_sums(checkpoint)  # as whoever means harm does
    others = () if summed else (DamagedError,)
    with pytest.raises((RunFormatError, RunDirectoryError, *others)) as refused:
        evaluate_run(run_dir, episodes=1)
    assert not trace.exists()
    assert str(run_dir) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_untouched_run_passes_also_through_a_linked_parent(run_dir: Path, tmp_path: Path):
    (tmp_path / "data").mkdir()
    shutil.move(run_dir, tmp_path / "data" / "run")
    (tmp_path / "link").symlink_to(tmp_path / "data")
    assert evaluate_run(tmp_path / "link" / "run", episodes=1)["episodes"] == 1


def test_a_resumed_run_is_looked_at_as_well(run_dir: Path, tmp_path: Path):
    archive_beside(run_dir, tmp_path / "trace")
    recipe = load_recipe(run_dir, ["collector.total_frames=60"])
    with pytest.raises(RunFormatError, match=r"state\.tdz"):
        build_run(recipe, run_dir, resume=True)


def test_verification_changes_nothing(run_dir: Path):
    checkpoint = checkpoint_of(run_dir)
    files = [path for path in checkpoint.rglob("*") if path.is_file()]
    before = [(path.stat().st_mtime_ns, path.read_bytes()) for path in files]
    verify_checkpoint(checkpoint)
    assert before == [(path.stat().st_mtime_ns, path.read_bytes()) for path in files]


@pytest.fixture
def imports_a_module(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run whose environment is registered by a module that lies in the run directory."""
    (run_dir / "evil_module.py").write_text(f"open({str(run_dir / 'trace')!r}, 'w')\n")
    monkeypatch.syspath_prepend(str(run_dir))
    monkeypatch.delenv(TRUST, raising=False)
    config = yaml.safe_load((run_dir / CONFIG).read_text())
    config["task"]["name"] = "gymnasium:evil_module:X-v0"
    (run_dir / CONFIG).write_text(yaml.safe_dump(config))
    return run_dir


def test_a_module_that_only_the_run_names_is_not_imported(imports_a_module: Path):
    with pytest.raises(RunDirectoryError, match=r"import 'evil_module'.*TRUST=1"):
        evaluate_run(imports_a_module, episodes=1)
    assert not (imports_a_module / "trace").exists()


def test_trust_or_the_name_on_the_command_line_let_it_in(
    imports_a_module: Path, monkeypatch: pytest.MonkeyPatch
):
    assert load_recipe(imports_a_module, ["task.name=gymnasium:evil_module:X-v0"])
    monkeypatch.setenv(TRUST, "1")
    assert load_recipe(imports_a_module)


@pytest.fixture
def witness(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module that leaves a trace where it is imported, as a file and as a module."""
    (run_dir / "evil.py").write_text(f"open({str(run_dir / 'trace')!r}, 'w').close()\n")
    monkeypatch.syspath_prepend(str(run_dir))
    monkeypatch.delenv(TRUST, raising=False)
    return run_dir / "evil.py"


def with_task(run_dir: Path, **task: object) -> Path:
    config = yaml.safe_load((run_dir / CONFIG).read_text())
    config["task"] |= task
    (run_dir / CONFIG).write_text(yaml.safe_dump(config))
    return run_dir


PENDULUM = "gymnasium:Pendulum-v1"
ASKING = [
    ("name", "EVIL"),
    ("name", "EVIL:make"),
    ("wrappers", ["evil:Wrapper"]),
    ("success", "EVIL:f"),
    ("progress", "EVIL:f"),
    ("reward", "EVIL:f"),
]


@pytest.mark.parametrize(("key", "value"), ASKING)
def test_code_that_only_the_run_names_does_not_run(
    key: str, value: object, run_dir: Path, witness: Path, monkeypatch: pytest.MonkeyPatch
):
    if isinstance(value, str):
        value = value.replace("EVIL", str(witness))
    with_task(run_dir, **{"name": PENDULUM, key: value})
    with pytest.raises(RunDirectoryError, match=rf"asks to import .*task\.{key}=.*TRUST=1") as told:
        evaluate_run(run_dir, episodes=1)
    assert "\n" not in str(told.value)
    # Naming another key says nothing of this one.
    other = "task.success=terminated" if key != "success" else f"task.name={PENDULUM}"
    with pytest.raises(RunDirectoryError, match="TRUST=1"):
        evaluate_run(run_dir, [other], episodes=1)
    assert not (run_dir / "trace").exists()
    typed = value if isinstance(value, str) else f"[{','.join(value)}]"
    assert load_recipe(run_dir, [f"task.{key}={typed}"])
    monkeypatch.setenv(TRUST, "1")
    assert load_recipe(run_dir)


def test_trusted_code_does_run(run_dir: Path, witness: Path):
    """Else the test above would see no trace whatever happened."""
    with_task(run_dir, name=str(witness))
    with pytest.raises(ValueError, match=r"evil\.py: expected TASK"):
        evaluate_run(run_dir, [f"task.name={witness}"], episodes=1)
    assert (run_dir / "trace").exists()


def test_keyword_arguments_are_data(run_dir: Path):
    with_task(run_dir, name=PENDULUM, kwargs={"g": "evil.py:f"})
    assert load_recipe(run_dir).task.kwargs == {"g": "evil.py:f"}


@pytest.mark.parametrize("name", ["door", "gymnasium:Pendulum-v1", "dm_control:cheetah/run"])
def test_what_is_ours_or_a_librarys_needs_no_trust(run_dir: Path, name: str):
    config = yaml.safe_load((run_dir / CONFIG).read_text())
    config["task"]["name"] = name
    (run_dir / CONFIG).write_text(yaml.safe_dump(config))
    assert load_recipe(run_dir).task.name == name


def test_a_saved_interpolation_is_refused(run_dir: Path):
    config = yaml.safe_load((run_dir / CONFIG).read_text())
    config["demos"]["source"] = "${oc.env:HOME}"
    (run_dir / CONFIG).write_text(yaml.safe_dump(config))
    with pytest.raises(RunDirectoryError, match="interpolation"):
        load_recipe(run_dir)


def test_python_objects_in_yaml_are_refused(run_dir: Path, tmp_path: Path):
    text = (run_dir / CONFIG).read_text()
    trace = tmp_path / "trace"
    tagged = f"device: !!python/object/apply:os.system ['touch {trace}']"
    (run_dir / CONFIG).write_text(text.replace("device: cpu", tagged))
    with pytest.raises(RunDirectoryError):
        load_recipe(run_dir)
    assert not trace.exists()
