from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from envs import find_task
from envs.library import Batched
from envs.library.workers import Workers
from envs.options import EnvOptions, TaskOptions
from envs.task import TaskFailedError
from tests.envs.library.making import make


def test_workers_give_what_one_process_gives():
    actions = torch.linspace(-1, 1, 20)

    def played(workers):
        env = make("Clock", num_envs=3, workers=workers, success_steps=4)
        td, seen = env.reset(), []
        for action in actions:
            td.set("action", torch.stack([action, -action, action / 2])[:, None])
            step, td = env.step_and_maybe_reset(td)
            seen.append(step)
        env.close()
        return torch.stack(seen)

    one, two = played(0), played(2)
    for key in ("observation", "reward", "success", "terminated", "truncated"):
        assert torch.equal(one["next", key], two["next", key]), key
    assert one["next", "truncated"].any()


def test_a_worker_that_dies_is_named():
    env = make("Clock", num_envs=4, workers=2)
    assert isinstance(env.copies, Workers)
    env.reset()
    os.kill(env.copies.processes[1].pid, signal.SIGKILL)
    with pytest.raises(TaskFailedError, match=r"process of copies 2 to 3 died \(exit code -9\)"):
        env.rollout(2)
    env.close()


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_all_processes_leaves_the_workers_to_their_parent(signum):
    """As from a terminal, or from a cluster that ends a job."""
    env = make("Clock", num_envs=4, workers=2)
    env.reset()
    for process in env.copies.processes:
        os.kill(process.pid, signum)
    assert env.rollout(2)["next", "reward"].shape == (4, 2, 1)
    env.close()


def test_workers_that_nobody_closed_end_with_the_program(tmp_path):
    program = "\n".join([
        "from tests.envs.library.making import make",
        "if __name__ == '__main__':",
        "    env = make('Clock', num_envs=2, workers=2)",
        "    print(*[process.pid for process in env.copies.processes])",
    ])  # fmt: skip
    (tmp_path / "left.py").write_text(program)
    done = subprocess.run(
        [sys.executable, tmp_path / "left.py"], capture_output=True, text=True, timeout=120,
        env={**os.environ, "PYTHONPATH": os.getcwd()}, check=True,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    numbers = [int(number) for number in done.stdout.split()[-2:]]
    assert not any(Path(f"/proc/{number}").exists() for number in numbers)


def test_workers_that_are_closed_in_the_midst_of_a_step_end_in_silence(capfd):
    env = make("Clock", num_envs=2, workers=2)
    env.reset()
    processes = env.copies.processes
    for connection in env.copies.connections:
        for _ in range(100):
            connection.send(("step", [0]))  # and nobody waits for the answers
    env.close()
    for process in processes:
        process.join(20)
    assert [process.exitcode for process in processes] == [0, 0]
    assert "Traceback" not in capfd.readouterr().err


def test_closing_ends_the_processes():
    env = make("Clock", num_envs=2, workers=2)
    processes = env.copies.processes
    env.close()
    assert [process.is_alive() for process in processes] == [False, False]


@pytest.mark.parametrize(
    ("step_s", "count", "cores", "asked", "expected"),
    [
        (5e-5, 8, 4, None, 0),
        (2e-3, 8, 4, None, 4),
        (2e-3, 3, 4, None, 3),
        (2e-3, 1, 4, None, 0),
        (2e-3, 8, 1, None, 0),
        (2e-3, 8, 4, 0, 0),
        (5e-5, 8, 4, 2, 2),
        (5e-5, 2, 4, 9, 2),
    ],
)
def test_workers_by_default(monkeypatch, step_s, count, cores, asked, expected):
    """Where a step takes more than a millisecond, as many as there are cores."""
    import dataclasses

    made = find_task("gymnasium:Pendulum-v1").make_env
    slow = Batched(made.single, dataclasses.replace(made.found, step_s=step_s))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(cores))
    assert slow._workers(EnvOptions(num_envs=count, workers=asked)) == expected


def test_the_memory_of_all_workers_counts():
    options = TaskOptions(kwargs={"ballast": 1 << 30})
    with pytest.raises(ValueError, match=r"64 copies of .* need .* MiB are free"):
        make("Clock", options, num_envs=64, workers=1)
