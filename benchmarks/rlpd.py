"""A frame of RLPD's size: ten critics with LayerNorm, twenty critic updates and an actor update."""

from __future__ import annotations

from typing import Any

from benchmarks import ours
from benchmarks.effort import Effort
from benchmarks.statistics import rounded, spread
from benchmarks.worker import Entry, race

WIDTH, BATCH, CRITICS, CRITIC_UPDATES = 256, 256, 10, 20

OVERRIDES = [
    # Half of the batch are demonstrations, and the critics see them too (arXiv:2302.02948).
    *ours.paper_size("bc_sac", WIDTH, BATCH // 2),
    "loss.rl_on_demos=true",
    "loss.entropy_in_target=false",
    "loss.target_subset=2",
    "loss.actor_value=mean",
    f"critic.num_critics={CRITICS}",
    "critic.layer_norm=true",
    f"optim.updates_per_frame={CRITIC_UPDATES}",
    f"optim.actor_period={CRITIC_UPDATES}",
    "optim.target_period=1",
]


def run(effort: Effort) -> dict[str, Any]:
    """Key ``rlpd_frame``: ms of a frame of ours and of the one built from ``REDQLoss``."""
    entries = [
        Entry(
            f"ours_{precision}",
            "benchmarks.ours:make_updater",
            {
                "overrides": OVERRIDES,
                "precision": precision,
                "replay_rows": effort.replay_rows,
                "demo_rows": effort.demo_rows,
                "updates": CRITIC_UPDATES,
                "frame": True,
            },
            effort.threads,
        )
        for precision in ours.PRECISIONS
    ]
    redq = Entry(
        "torchrl_redq",
        "benchmarks.redq:make_redq_frame",
        {
            "width": WIDTH,
            "batch": BATCH,
            "replay_rows": effort.replay_rows,
            "num_critics": CRITICS,
            "critic_updates": CRITIC_UPDATES,
        },
        effort.threads,
    )
    timings = race([*entries, redq], rounds=effort.rounds, block_s=effort.block_s)
    detail = {n: spread(t.seconds_per_unit, 1e3).as_json("ms") for n, t in timings.items()}
    fastest = min((e.name for e in entries), key=lambda name: float(detail[name]["median"]))
    mine, theirs = (float(detail[name]["median"]) for name in (fastest, redq.name))
    result = effort.as_json(
        unit="ms per frame",
        frame=f"{CRITIC_UPDATES} critic updates and 1 actor update with BC, {CRITICS} LayerNorm "
        f"critics {WIDTH}x{WIDTH}, batch {BATCH}, target subset 2, mean for the actor",
        redq="REDQLoss computes the actor's terms in each of its calls; the BC term is BCLoss",
        ours=mine,
        torchrl_redq=theirs,
        ratio=rounded(theirs / mine, 3),
        fastest=fastest,
        detail=detail,
    )
    return {"rlpd_frame": result}
