"""``path/to/file.py[:NAME]`` as a task: what a file may hold, and what is said else."""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import dedent

import pytest
import torch

from envs import EnvOptions, Task, find_task
from envs.options import TaskOptions
from envs.registry import imports_of, task_defaults
from envs.user_files import import_file

ENV = """
import gymnasium
import numpy as np
from gymnasium.spaces import Box


class Still(gymnasium.Env):
    observation_space = Box(-9.0, 9.0, (1,), np.float32)
    action_space = Box(-2.0, 2.0, (1,), np.float32)

    def __init__(self, seen=1.0):
        self.seen = np.full(1, seen, np.float32)

    def reset(self, *, seed=None, options=None):
        return self.seen, {}

    def step(self, action):
        return self.seen, float(action[0]), False, False, {"success": bool(action[0] > 1)}
"""
OPTIONS = EnvOptions(num_envs=2, seed=0, horizon=3, workers=0)


@pytest.fixture
def write(tmp_path: Path):
    def written(text: str, name: str = "mine.py") -> str:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text))
        return str(path)

    return written


def seen_by(name: str, options: TaskOptions | None = None) -> float:
    made = find_task(name, options or TaskOptions()).make_env(OPTIONS)
    try:
        return float(made.reset()["observation"][1, 0])
    finally:
        made.close()


def test_the_only_environment_class_of_a_file(write):
    name = write(ENV)
    task = find_task(name)
    assert task.name == name
    env = task.make_env(OPTIONS)
    # 0.25 of [-2, 2] is 0.5; three steps are the horizon.
    steps = env.rollout(9, lambda td: td.set("action", torch.full((2, 1), 0.25)))
    assert steps["next", "reward"].flatten().tolist() == [0.5] * 6
    assert steps["next", "truncated"][:, -1].all()
    assert "success" in steps["next"].keys()  # noqa: SIM118 - a TensorDict is not a mapping
    assert task_defaults(name) == {"preset/default": {"env.num_envs": 4}}


def test_a_function_and_its_keyword_arguments(write):
    text = ENV + "\n\ndef make(seen: float = 2.0) -> gymnasium.Env:\n    return Still(seen)\n"
    assert seen_by(write(text) + ":make") == 2.0
    assert seen_by(write(text) + ":make", TaskOptions(kwargs={"seen": 5.0})) == 5.0
    assert seen_by(write(text) + ":Still") == 1.0


def test_an_annotated_function_is_found_by_itself(write):
    text = "import gymnasium\n\ndef helper(x): ...\n\ndef make() -> gymnasium.Env:\n"
    name = write(text + '    return gymnasium.make("Pendulum-v1")\n')
    assert find_task(name).demos.observation_size == 3


def test_a_task_is_taken_as_it_is_and_before_environments(write):
    text = ENV + "\nfrom envs.task import Task\nOTHER = Task('mine', Still, defaults={'a': {}})\n"
    task = find_task(write(text))
    assert isinstance(task, Task)
    assert task.name == "mine"
    assert task_defaults(write(text)) == {"a": {}}
    with pytest.raises(ValueError, match=r"task.success=terminated .*holds a Task"):
        find_task(write(text), TaskOptions(success="terminated"))


def test_files_of_one_name_do_not_collide(write):
    one = write(ENV, "a/env.py")
    two = write(ENV.replace("seen=1.0", "seen=7.0"), "b/env.py")
    assert (seen_by(one), seen_by(two)) == (1.0, 7.0)


def test_a_file_imports_what_lies_beside_it(write):
    write("SEEN = 4.0\n", "beside_of_mine.py")
    text = "from beside_of_mine import SEEN\n" + ENV.replace("seen=1.0", "seen=SEEN")
    assert seen_by(write(text)) == 4.0


def test_worker_processes_import_the_file_too(write, tmp_path, monkeypatch):
    write(ENV)
    monkeypatch.chdir(tmp_path)
    task = find_task("mine.py")
    monkeypatch.chdir("/")
    env = task.make_env(EnvOptions(num_envs=2, seed=0, horizon=3, workers=2))
    assert env.reset()["observation"].flatten().tolist() == [1.0, 1.0]
    env.close()


BROKEN = {
    "raises": ("x = 1\n\ny = {}['x']\n", "", r"cannot import mine.py, line 3 \(KeyError: 'x'\)"),
    "syntax": ("x = 1\ndef f(:\n", "", r"cannot import mine.py, line 2 \(SyntaxError"),
    "exits": ("import sys\nsys.exit(3)\n", "", r"cannot import mine.py, line 2 \(SystemExit: 3\)"),
    "relative": ("from .constants import STEP\n", "",
                 r"line 1 \(ImportError: attempted rel.*PYTHONPATH=.*TASK=gymnasium:MODULE:ID"),
    "missing": ("import x_missing\n", "", r"line 1 \(ModuleNotFoundError: No module named 'x_mi"),
    "no_name": ("\ndef f(): ...\n", ":g", r"'g' is not there; .*found: f \(line 2\)"),
    "no_task": ("TASK = 3\n", "", r"'TASK' is of type int; expected a Task, .*found: nothing"),
    "nothing": ("def f(): ...\n", "", r"expected TASK, or exactly one .*found: f \(line 1\)"),
    "two": (ENV + "\nclass More(Still): ...\n", "",
            r"exactly one .*found: Still \(line 7\), More \(line 20\); name one: path"),
    "no_env": ("def f(): return 3\n", ":f", r"mine.py:f'.*it made a int; expected a gymnasium.Env"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_is_one_line(case: str, write):
    text, named, message = BROKEN[case]
    with pytest.raises(ValueError, match=message) as refused:
        find_task(write(text) + named)
    assert "\n" not in str(refused.value)
    assert "mine.py" in str(refused.value)


def test_a_missing_file_is_named():
    with pytest.raises(ValueError, match=re.escape("there is no file 'gone/away.py'")):
        find_task("gone/away.py:make")


def test_a_file_that_failed_is_tried_again(write):
    name = write("1 / 0\n")
    with pytest.raises(ValueError, match="ZeroDivisionError"):
        find_task(name)
    write(ENV + "\n# mended, and of another size\n")
    assert seen_by(name) == 1.0


def test_what_is_imported_is_told_by_key():
    options = TaskOptions(
        kwargs={"x": "evil.py:f"},
        wrappers=("m:W", "n:V"),
        success="s.py:f",
        reward="r.py:f",
        progress="info:x",
    )
    assert imports_of("a/b.py:NAME", options) == {
        "task.name": "a/b.py",
        "task.wrappers": "m:W, n:V",
        "task.success": "s.py",
        "task.reward": "r.py",
    }
    assert imports_of("gymnasium:module:X-v0") == {"task.name": "module"}
    assert imports_of("gymnasium:X-v0") == imports_of("door") == {}


def test_a_missing_module_of_one_of_our_names_tells_the_remedy(tmp_path):
    (tmp_path / "envs").mkdir()
    file = tmp_path / "envs" / "peg.py"
    file.write_text("import envs.geometry\n")
    with pytest.raises(ValueError, match="cannot import") as caught:
        import_file(file, "TASK=peg.py", "path.py")
    told = str(caught.value)
    assert "No module named 'envs.geometry'" in told
    assert f"PYTHONPATH={tmp_path} before the command, or start bcsac in {tmp_path}" in told
    file.write_text("import no_such_thing\n")
    with pytest.raises(ValueError, match="no_such_thing") as caught:
        import_file(file, "TASK=peg.py", "path.py")
    assert "PYTHONPATH" not in str(caught.value)
