"""What the check for numbers that are not finite takes of an update: with and without it, in turns.

    python -m benchmarks.guards [--width 256] [--rows 256] [--rounds 30] [--compile]

One process, one set of batches; each round times a block of updates of either kind, and the median
over rounds of the ratio is what counts.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time

import torch
from tensordict import TensorDict

from losses import BCSACLoss
from pipeline.learn.critics import BatchedCritics
from pipeline.learn.networks import make_actor
from pipeline.learn.stepper import BCSACStepper, UpdateSchedule

OBSERVATION, ACTION = 38, 28
"""Of the door."""


def batch_of(rows: int) -> TensorDict:
    """Half of the rows are demonstrations."""
    return TensorDict(
        {
            "observation": torch.randn(rows, OBSERVATION),
            "action": torch.rand(rows, ACTION) * 1.6 - 0.8,
            "steps_to_next_obs": torch.ones(rows, 1, dtype=torch.int64),
            "is_demo": torch.arange(rows).unsqueeze(-1) >= rows // 2,
            "next": {
                "observation": torch.randn(rows, OBSERVATION),
                "reward": torch.randn(rows, 1),
                "terminated": torch.zeros(rows, 1, dtype=torch.bool),
            },
        },
        [rows],
    )


def stepper_of(width: int, rows: int, *, compiled: bool, guarded: bool) -> BCSACStepper:
    """`default`'s: three critics with layer norm, a target that always moves."""
    torch.manual_seed(0)
    actor = make_actor(OBSERVATION, ACTION, [width, width])
    critic = BatchedCritics(OBSERVATION, ACTION, [width, width], 3, layer_norm=True)
    loss = BCSACLoss(
        actor, critic, target_entropy=-float(ACTION), bc_weight=1.0, main_rows=rows // 2
    )
    return BCSACStepper(
        loss,
        actor_lr=3e-5,
        critic_lr=3e-4,
        temperature_lr=3e-4,
        schedule=UpdateSchedule(target_period=1),
        compile_updates=compiled,
        guarded=guarded,
    )


def measure(width: int, rows: int, rounds: int, block: int, *, compiled: bool) -> dict[str, float]:
    """Seconds of an update of either kind, and the share that the check adds."""
    batch = batch_of(rows)
    kinds = {g: stepper_of(width, rows, compiled=compiled, guarded=g) for g in (True, False)}
    for stepper in kinds.values():
        for _ in range(2 * block):
            stepper.step(None, batch)
    seconds: dict[bool, list[float]] = {True: [], False: []}
    for number in range(rounds):
        for guarded in (True, False) if number % 2 else (False, True):
            began = time.perf_counter()
            for _ in range(block):
                kinds[guarded].step(None, batch)
            seconds[guarded].append((time.perf_counter() - began) / block)
    shares = [g / u - 1.0 for g, u in zip(seconds[True], seconds[False], strict=True)]
    return {
        "guarded_s": statistics.median(seconds[True]),
        "unguarded_s": statistics.median(seconds[False]),
        "share": statistics.median(shares),
    }


def main() -> None:
    """Prints a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--rows", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--block", type=int, default=20)
    parser.add_argument("--compile", action="store_true")
    given = parser.parse_args()
    torch.set_num_threads(1)
    found = measure(given.width, given.rows, given.rounds, given.block, compiled=given.compile)
    sys.stdout.write(json.dumps({**vars(given), **found}) + "\n")


if __name__ == "__main__":
    main()
