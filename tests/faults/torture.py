"""Damages every file of a small finished run and looks what is read then.

    python -m tests.faults.torture --seed 0 --rounds 1

A round damages each file in each way, one at a time: of the newest checkpoint (the one before must
serve), of both checkpoints at the same place (it must be refused), of the run directory, of an
exported policy and of the caches. Reading must give what it gave before, or say in one line which
file is bad; anything else is counted as wrong, and the command fails.
"""

from __future__ import annotations

import argparse
import hashlib
import logging
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import torch
from tabulate import tabulate

from envs.demonstrations import DemonstrationError, MultiplyConfig, content_hash
from envs.demonstrations.multiplication_cache import multiply_cached
from envs.door.definition import TASK
from envs.door.resimulation import RESIMULATE
from envs.door.variation import VARY
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.checkpoint import latest_checkpoint, load_component, trained_frames
from pipeline.files.run_files import CONFIG, EVALUATION
from pipeline.policy import WEIGHTS, load_policy, save_weights
from pipeline.recipe import Recipe
from pipeline.results.evaluation_files import load_evaluation, save_evaluation
from pipeline.run_dir import load_recipe, save_recipe
from tests.envs.demonstrations.helpers import still_episode
from tests.faults.damaging import KINDS, Damage, damaged
from tests.pipeline.toys import built, tiny_config, write_demos

FRAMES = (20, 40)
OUTCOMES = ("same", "fallback", "made again", "refused", "wrong")


@dataclass(frozen=True)
class Target:
    """Files that belong together, and how they are read."""

    name: str
    places: tuple[tuple[Path, ...], ...]
    """Each is damaged at once: a file, or the same file of both checkpoints."""
    read: Callable[[], Any]
    fallback: Any = None
    """What reading gives when the one before serves."""


class Warnings(logging.Handler):
    """Keeps what is logged."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


def content(recipe: Recipe, policy: torch.nn.Module, frames: int) -> tuple[str, int, str]:
    """All that an evaluation depends on."""
    digest = hashlib.sha256()
    for name, tensor in policy.state_dict().items():
        digest.update(name.encode() + tensor.numpy().tobytes())
    return digest.hexdigest(), frames, str(recipe.plain())


def weights(run_dir: Path) -> tuple[str, int, str]:
    """What an evaluation of ``run_dir`` reads."""
    recipe = load_recipe(run_dir)
    policy, origin = load_policy(recipe, TASK, run_dir)
    return content(recipe, policy, origin.frames)


def weights_into(policy: torch.nn.Module, run_dir: Path) -> tuple[str, int, str]:
    """The same out of a checkpoint, without an environment to make the policy for."""
    recipe, checkpoint = load_recipe(run_dir), latest_checkpoint(run_dir)
    load_component(checkpoint, "policy", policy)
    return content(recipe, policy, trained_frames(checkpoint))


def finished_run(folder: Path) -> Path:
    """A run of two checkpoints, evaluated."""
    demos = write_demos(folder / "demos.h5")
    run = built(tiny_config("sid_dbc", folder, demos, "logging.checkpoint_interval=10"))
    run.train()
    save_evaluation(run.run_dir / EVALUATION, evaluate_run(run.run_dir, episodes=1))
    return run.run_dir


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def targets(folder: Path) -> Iterator[Target]:
    """Of a run, a policy and a cache that are made below ``folder``."""
    run_dir = finished_run(folder)
    before, newest = (run_dir / "checkpoints" / f"checkpoint-{f:012d}" for f in FRAMES)
    policy, _ = load_policy(load_recipe(run_dir), TASK, run_dir)

    def read() -> Any:
        return weights_into(policy, run_dir)

    assert read() == weights(run_dir)
    hidden = newest.rename(folder / "newest")
    fallback = read()
    hidden.rename(newest)

    pairs = [(before / p.relative_to(newest), p) for p in files(newest)]
    yield Target("newest checkpoint", tuple((p,) for _, p in pairs), read, fallback)
    yield Target("both checkpoints", tuple(pairs), read)
    yield Target("config.yaml of a run", ((run_dir / CONFIG,),), read)
    yield Target(
        EVALUATION, ((run_dir / EVALUATION,),), lambda: load_evaluation(run_dir / EVALUATION)
    )
    exported = folder / "exported"
    exported.mkdir()
    recipe = load_recipe(run_dir)
    save_recipe(exported, recipe)
    save_weights(load_policy(recipe, TASK, run_dir)[0], exported / WEIGHTS, frames=FRAMES[-1])
    yield Target("exported policy", tuple((p,) for p in files(exported)), lambda: weights(exported))
    sources = RESIMULATE([still_episode(i, steps=9) for i in range(3)], num_threads=1)
    config = MultiplyConfig(min_progress=-1.0, horizon=6, round_size=8, target_episodes=12)
    cache = folder / "multiplied"

    def multiplied() -> str:
        made = multiply_cached(sources, config, VARY, num_threads=1, cache_dir=cache)
        return content_hash(made)

    multiplied()
    yield Target("demonstration cache", tuple((p,) for p in files(cache)), multiplied)


def outcome(target: Target, whole: Any, place: tuple[Path, ...], kind: Damage, seed: str) -> str:
    """What comes of reading ``target`` while ``place`` is damaged."""
    told = Warnings()
    logging.getLogger().addHandler(told)
    rng = Random(seed)
    try:
        with ExitStack() as stack:
            for path in place:
                stack.enter_context(damaged(path, kind, rng))
            found = target.read()
    except (ValueError, FileNotFoundError, DemonstrationError) as error:
        names = any(str(path) in str(error) or path.name in str(error) for path in place)
        named = names or str(place[0].parent) in str(error)
        return "refused" if named and "\n" not in str(error) else f"wrong: {error!r}"
    except Exception as error:
        return f"wrong: {error!r}"
    finally:
        logging.getLogger().removeHandler(told)
    messages = "\n".join(told.messages)
    if found == whole:
        return "made again" if "replacing a damaged" in messages else "same"
    if target.fallback is not None and found == target.fallback:
        return "fallback" if "is used in its place" in messages else "wrong: silent fallback"
    return "wrong: another result"


def tortured(
    seed: int, rounds: int, *, each_kind: bool = True, every: int = 1
) -> tuple[dict[str, Counter[str]], list[str]]:
    """Counts of outcomes by target, and what went wrong.

    Args:
        seed: Of where and how files are damaged.
        rounds: How often.
        each_kind: Damage each file in each way, and not in one of them after the other.
        every: Damage only so many-th file.
    """
    counts: dict[str, Counter[str]] = {}
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        for target in targets(Path(folder)):
            whole = target.read()
            tally = counts.setdefault(target.name, Counter())
            for turn in range(rounds):
                for i, place in enumerate(target.places[turn % every :: every]):
                    kinds = KINDS if each_kind or len(target.places) < 10 else (KINDS[i % 6],)
                    for kind in kinds:
                        given = f"{seed} {turn} {target.name} {i} {kind.__name__}"
                        came = outcome(target, whole, place, kind, given)
                        tally[came.split(":")[0]] += 1
                        if came.startswith("wrong"):
                            wrong.append(f"{kind.__name__} {place[-1]}: {came}")
            assert target.read() == whole
    return counts, wrong


def table(counts: dict[str, Counter[str]]) -> str:
    """In Markdown."""
    rows = [[name, tally.total(), *(tally[o] for o in OUTCOMES)] for name, tally in counts.items()]
    total: Counter[str] = sum(counts.values(), Counter())
    rows.append(["all", total.total(), *(total[o] for o in OUTCOMES)])
    return tabulate(rows, headers=["damaged", "injected", *OUTCOMES], tablefmt="github")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=1)
    arguments = parser.parse_args()
    counts, wrong = tortured(arguments.seed, arguments.rounds)
    print(table(counts))
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
