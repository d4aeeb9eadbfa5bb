"""Wall time of the 1000-door evaluation against the physics of the very same steps alone.

The policy is a behaviour-cloned one, whose hand reaches the door: contacts are what costs time.
Its actions are recorded in the first evaluation; the bare physics replays them door by door, as
many doors at a time as there are threads, with nothing around ``mj_step``.
"""

from __future__ import annotations

import tempfile
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from benchmarks.effort import Effort
from benchmarks.raw_door import RawDoor
from benchmarks.statistics import rounded, spread
from benchmarks.worker import available_cores, run_once
from configs import compose
from envs import find_task
from envs.adroit.scene import HandScene
from envs.adroit.starts import placement_of
from envs.door.hand import DOOR, DOOR_POSITION, build_scene
from pipeline.cloning import behaviour_cloned
from pipeline.conversion import make_rows
from pipeline.data.demonstrations import make_demonstrations
from pipeline.playing import make_evaluator
from pipeline.recipe import Recipe

BC_UPDATES = 1_000


class Recorder(TensorDictModuleBase):
    """Hands the actions of a policy on and keeps them."""

    def __init__(self, policy: TensorDictModuleBase) -> None:
        super().__init__()
        self.policy = policy
        self.in_keys = policy.in_keys
        self.out_keys = policy.out_keys
        self.actions: list[NDArray[np.float32]] = []

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The policy's own result."""
        result: TensorDictBase = self.policy(tensordict)
        self.actions.append(result["action"].numpy().copy())
        return result


def by_episode(
    actions: list[NDArray[np.float32]], lengths: NDArray[np.int64], batch: int
) -> list[NDArray[np.float32]]:
    """Actions [T, A] of each episode from those of the waves' steps [batch, A].

    Each wave took as many steps as its longest episode.
    """
    episodes = []
    first_step = 0
    for first in range(0, len(lengths), batch):
        wave = lengths[first : first + batch]
        steps = actions[first_step : first_step + int(wave.max())]
        episodes += [np.stack([step[i] for step in steps[:n]]) for i, n in enumerate(wave)]
        first_step += int(wave.max())
    return episodes


def replay(scene: HandScene, seed: int, episodes: list[NDArray[np.float32]], threads: int) -> float:
    """Seconds of the physics of all episodes."""
    controls = [scene.control_middle + scene.control_half_range * a for a in episodes]
    doors = [RawDoor(scene) for _ in range(threads)]
    # A shared queue: episodes with more contacts take longer.
    queue = deque(range(len(controls)))

    def work(door: RawDoor) -> None:
        while True:
            try:
                index = queue.popleft()
            except IndexError:
                return
            door.reset(placement_of(DOOR, seed, index, 0)[DOOR_POSITION])
            for control in controls[index]:
                door.step(control)

    with ThreadPoolExecutor(threads) as pool:
        began = time.perf_counter()
        list(pool.map(work, doors))
        return time.perf_counter() - began


def compare(doors: int, rounds: int) -> dict[str, Any]:
    """Evaluates and replays in turn, on as many threads as this worker may use."""
    threads = available_cores()
    with tempfile.TemporaryDirectory() as folder:
        recipe: Recipe = compose(
            "variant=bc_sac",
            "preset=default",
            "demos.multiply.enabled=false",
            f"bc.updates={BC_UPDATES}",
            f"env.num_threads={threads}",
            "logging.progress=false",
            "logging.loggers=[csv]",
            "evaluation.interval=0",
            f"cache_dir={folder}",
        )
        task = find_task(recipe.task.name)
        demos = make_demonstrations(
            recipe.demos,
            task,
            make_rows(recipe),
            cache_dir=Path(folder),
            num_threads=threads,
        )
        policy = behaviour_cloned(recipe, task, demos)
    evaluator = make_evaluator(recipe, task, episodes=doors)
    recorder = Recorder(policy)
    rollouts = evaluator.run(recorder)
    episodes = by_episode(recorder.actions, rollouts.lengths, min(evaluator.batch, doors))
    scene = build_scene()
    evaluation_s, physics_s = [], []
    for _ in range(rounds):
        began = time.perf_counter()
        evaluator.run(policy)
        evaluation_s.append(time.perf_counter() - began)
        physics_s.append(replay(scene, evaluator.seed, episodes, threads))
    return {
        "evaluation_s": evaluation_s,
        "physics_s": physics_s,
        "steps": int(rollouts.lengths.sum()),
    }


def run(effort: Effort) -> dict[str, Any]:
    """Keys ``evaluation_1000_s`` (seconds) and ``evaluation_1000`` (against the physics)."""
    threads = min(2, available_cores())
    measured = run_once(
        "benchmarks.evaluation:compare",
        threads=threads,
        doors=effort.evaluation_doors,
        rounds=effort.evaluation_rounds,
    )
    evaluation, physics = spread(measured["evaluation_s"]), spread(measured["physics_s"])
    detail = effort.as_json(
        threads=threads,
        precision="fp32",
        doors=effort.evaluation_doors,
        steps=measured["steps"],
        evaluation=evaluation.as_json("s"),
        raw_physics=physics.as_json("s"),
        ratio=rounded(evaluation.median / physics.median, 3),
    )
    # Only the full effort evaluates as many doors as the key says.
    seconds = None if effort.quick else rounded(evaluation.median)
    return {"evaluation_1000_s": seconds, "evaluation_1000": detail}
