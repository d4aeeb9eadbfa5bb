"""Torch's threads beside the simulator's."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from envs import EnvOptions
from envs.adroit.torchrl_env import HandEnv
from envs.door.definition import TASK
from pipeline.learn.stepper import BCSACStepper
from pipeline.machine.threads import OneThreadCollector
from tests.pipeline.toys import built, tiny_config


def test_torch_has_its_threads_for_updates_alone(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    """`ila_bc` steps doors in all ways there are: the BC model's, collected and evaluated."""
    threads: dict[str, list[int]] = {}

    def note(owner: type, method: str) -> None:
        plain, seen = getattr(owner, method), threads.setdefault(method, [])

        def noting(*arguments: object) -> object:
            seen.append(torch.get_num_threads())
            return plain(*arguments)

        monkeypatch.setattr(owner, method, noting)

    note(HandEnv, "_step")
    note(BCSACStepper, "step")
    options = ("torch_threads=2", "evaluation.interval=20")
    built(tiny_config("ila_bc", tmp_path, demos, *options)).train()
    # Ten steps each: the BC model's evaluation and episodes, two batches, three evaluations, the
    # first of them of the clone that the run begins with.
    assert threads["_step"] == [1] * 7 * 10
    assert set(threads["step"]) == {2}


def test_a_failed_collection_leaves_the_threads_as_they_were():
    def fail() -> None:
        raise RuntimeError("no frames")

    torch.set_num_threads(2)
    env = TASK.make_env(EnvOptions(seed=0))
    options = {"frames_per_batch": 1, "total_frames": 1, "pre_collect_hook": fail}
    collector = OneThreadCollector(env, None, **options, auto_register_policy_transforms=False)
    with pytest.raises(RuntimeError, match="no frames"):
        next(iter(collector))
    collector.shutdown()
    assert torch.get_num_threads() == 2
