"""A run that can be interrupted half-way, and all that it is made of, to compare with another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file

from pipeline.best import BEST
from pipeline.policy import WEIGHTS
from pipeline.recipe import Recipe
from pipeline.trainer import Run
from tests.pipeline.toys import built, tiny_config

HALF, WHOLE = 400, 800


def long_config(folder: Path, demos: Path, *overrides: str) -> Recipe:
    """Self-imitation, 3-step returns; episodes of 30 steps, cut by batches of 25 per door."""
    return tiny_config(
        "sid_dbc",
        folder,
        demos,
        "env.horizon=30",
        "loss.n_step=3",
        f"collector.total_frames={WHOLE}",
        "collector.frames_per_batch=50",
        "evaluation.interval=200",
        "optim.actor_period=2",
        "optim.target_period=3",
        "optim.actor_delay=3",
        "optim.anneal_actor=true",
        "optim.actor_average=0.9",
        "growth.capacity=150",
        "growth.admission.quantile=0.5",
        "growth.admission.window=2",
        "backtrack.level=0.02",
        "backtrack.window=3",
        *overrides,
    )


def everything(run: Run) -> dict[str, Any]:
    """All tensors and numbers that make a run what it is."""
    modules = run.trainer._modules
    stepper = modules["optimization_stepper"]
    return {
        "policy": run.actor.state_dict(),
        "loss": run.trainer.loss_module.state_dict(),
        "stepper": stepper.state_dict(),
        "waiting": modules["store"].state_dict(),
        "main": modules["main_buffer"][:].to_dict(),
        "grown": modules["grown_buffer"][:].to_dict(),
        "records": modules["grown"].state_dict(),
        "bound": modules["moving_bound"].state_dict(),
        "episodes": modules["episodes"].state_dict(),
        "backtrack": modules["backtrack"].state_dict(),
        "evaluation": modules["evaluation"].state_dict(),
        "best": load_file(run.run_dir / BEST / WEIGHTS),
        "frames": run.trainer.collected_frames,
        "rng": torch.get_rng_state(),
        "cuda_rng": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
    }


def differences(left: Any, right: Any, where: str = "") -> list[str]:
    """Paths at which two nested states differ in a single bit, on whichever devices they lie."""
    if isinstance(left, dict):
        if set(left) != set(right):
            return [f"{where}: {set(left) ^ set(right)}"]
        return [
            found for key in left for found in differences(left[key], right[key], f"{where}.{key}")
        ]
    if isinstance(left, (list, tuple)):
        if len(left) != len(right):
            return [f"{where}: {len(left)} and {len(right)} entries"]
        pairs = zip(left, right, strict=True)
        return [
            found for i, pair in enumerate(pairs) for found in differences(*pair, f"{where}[{i}]")
        ]
    if isinstance(left, torch.Tensor):
        ours, theirs = left.cpu().nan_to_num(-7), right.cpu().nan_to_num(-7)
        return [] if ours.shape == theirs.shape and torch.equal(ours, theirs) else [where]
    return [] if left == right else [where]


def curve_of(run_dir: Path) -> list[dict[str, Any]]:
    """The learning curve without the time it took, which is another every time."""
    lines = (run_dir / "learning_curve.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    assert all(row.pop("wall_s") > 0 for row in rows)
    return rows


def interrupted(config: Recipe) -> Run:
    """A run that is stopped half-way, as by a power cut just after its checkpoint."""
    run = built(config)
    run.trainer.total_frames = HALF
    run.train()
    return run


def whole_and_halved(folder: Path, demos: Path, *options: str) -> tuple[Run, Run]:
    """An uninterrupted run and one that was stopped half-way and resumed, both at their end."""
    whole = built(long_config(folder / "whole", demos, *options))
    whole.train()
    config = long_config(folder / "halved", demos, *options)
    interrupted(config)
    torch.manual_seed(4321)  # whatever happened before must not matter
    halved = built(config, resume=True)
    assert halved.trainer.collected_frames == HALF
    halved.train()
    return whole, halved
