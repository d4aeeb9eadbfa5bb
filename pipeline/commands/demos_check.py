"""``make demos-check``: what a demonstration source holds, and what training would make of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from envs import EnvOptions, Task
from envs.demonstrations import (
    DemonstrationError,
    DemonstrationSet,
    DemoOptions,
    Episode,
    format_reports,
    load_demonstrations,
)
from envs.demonstrations.coverage import StartCoverage, least_covered, start_coverage
from pipeline.act.evaluation import reset_td

EVALUATION_STARTS: Final = 1000
FIRST_OBSERVATIONS: Final = 64
"""Episodes that are begun to see where they do, for tasks whose starts are no numbers."""
SHOWN_ENTRIES: Final = 10
SHOWN_REFUSALS: Final = 3
TO_KNOW: Final = "task.success=path.py:function says what it is, or terminated, or reward>=X"
SATURATED: Final = 0.2
"""Share of entries at their bounds beyond which the imitation error deserves a thought."""


@dataclass(frozen=True)
class Check:
    """What `check_demonstrations` found.

    Attributes:
        text: for people.
        usable: episodes that pass.
        refusal: why training does not start with the source, and what helps; None if it does.
    """

    text: str
    usable: int
    refusal: str | None


def check_demonstrations(
    source: str,
    task: Task,
    *,
    resimulate: bool | None = None,
    skip_refused: bool = False,
    env_options: EnvOptions | None = None,
) -> Check:
    """Read, check and describe demonstrations; single episodes that do not pass are listed.

    Args:
        source: see `envs.demonstrations.open_source`.
        task: what they are of.
        resimulate: replay them in the task; None does where the task can.
        skip_refused: whether training leaves out episodes that do not pass; else it stops at the
            first of them.
        env_options: how a run makes the task's environment.

    Raises:
        DemonstrationError: the source as a whole cannot be read.
    """
    replayed = task.resimulate is not None if resimulate is None else resimulate
    refused: list[DemonstrationError] = []
    loaded = load_demonstrations(source, task, DemoOptions(resimulate=replayed), refused=refused)
    parts = [format_reports(loaded.reports, task.progress_unit)] if loaded.episodes else []
    parts += [f"refused: {error}" for error in refused[:SHOWN_REFUSALS]]
    if (further := len(refused) - SHOWN_REFUSALS) > 0:
        parts.append(f"{further} more episodes are refused")
    if loaded.episodes:
        coverage = _coverage(task, loaded.episodes, env_options or EnvOptions())
        parts.append(_format_coverage(coverage))
    parts.append(_summary(loaded, len(refused)))
    refusal = None
    if refused and not (skip_refused and loaded.episodes):
        refusal = _refusal(source, task, replayed, refused[0], some=bool(loaded.episodes))
    parts += [refusal] if refusal is not None else []
    return Check("\n\n".join(part for part in parts if part), len(loaded.episodes), refusal)


def _refusal(source: str, task: Task, replayed: bool, first: DemonstrationError, some: bool) -> str:
    remedy = "no episode passes: repair the source"
    if some:
        remedy = (
            'repair these episodes, or leave them out: make train ARGS="demos.skip_refused=true"'
        )
    if replayed and _passes_as_recorded(source, task):
        remedy = 'without a replay it is accepted: make train ARGS="demos.resimulate=false"'
    return f"training refuses this source: {first}\n({remedy})"


def _passes_as_recorded(source: str, task: Task) -> bool:
    try:
        load_demonstrations(source, task, DemoOptions(resimulate=False))
    except DemonstrationError:
        return False
    return True


def _summary(loaded: DemonstrationSet, refused: int) -> str:
    usable = len(loaded.episodes)
    lines = [f"{loaded.source}: {usable} usable of {usable + refused} episodes"]
    if usable:
        told = [episode.succeeds for episode in loaded.episodes if episode.succeeds is not None]
        success = f"{np.mean(told):.0%}" if told else f"unknown ({TO_KNOW})"
        lines[0] += f", {loaded.transitions:,} steps, success {success}"
        share = loaded.saturated_share
        advice = "; a squared imitation error suits them" if share > SATURATED else ""
        lines.append(f"actions at their bounds: {share:.1%} of the entries{advice}")
    found = [f"  {line}" for line in str(loaded.findings).splitlines()]
    return "\n".join([*lines, *(["found on the way:", *found] if found else [])])


def _coverage(task: Task, episodes: Sequence[Episode], env_options: EnvOptions) -> StartCoverage:
    starts: dict[str, NDArray[Any]] = {}
    if task.starts is not None:
        listed = task.starts(0, 0, EVALUATION_STARTS)
        starts = {
            str(key): listed[key].flatten(1).cpu().numpy()
            for key in listed.keys()  # noqa: SIM118 - a TensorDict is not a mapping
            # A seed begins an episode too, and says nothing of where.
            if listed[key].is_floating_point()
            if all(key in episode.start for episode in episodes)
        }
    if starts:
        demos = {name: np.stack([e.start[name] for e in episodes]) for name in starts}
        return start_coverage(starts, demos)
    demos = {"observation": np.stack([episode.observations[0] for episode in episodes])}
    return start_coverage({"observation": _first_observations(task, env_options)}, demos)


def _first_observations(task: Task, env_options: EnvOptions) -> NDArray[Any]:
    """[N, O] of as few copies as the task is made in, each reset again and again."""
    copies = task.copies(FIRST_OBSERVATIONS)
    env = task.make_env(replace(env_options, num_envs=copies, seed=0))
    try:
        with torch.no_grad():
            first = [
                env.reset(reset_td(task, env, 0, begun))["observation"]
                for begun in range(0, FIRST_OBSERVATIONS, copies)
            ]
    finally:
        env.close()
    observations: NDArray[Any] = torch.cat(first)[:FIRST_OBSERVATIONS].cpu().numpy()
    return observations


def _format_coverage(coverage: StartCoverage) -> str:
    lines = [
        f"starts: {coverage.share:.0%} of the evaluation's lie within the demonstrations' in all "
        f"{len(coverage.entries)} entries that vary"
    ]
    lines += [
        f"  {entry.name}: {entry.share:.0%} (evaluation {entry.low:.3g} to {entry.high:.3g}, "
        f"demonstrations {entry.demo_low:.3g} to {entry.demo_high:.3g})"
        for entry in least_covered(coverage, SHOWN_ENTRIES)
    ]
    hidden = len(coverage.entries) - SHOWN_ENTRIES
    if hidden > 0:
        lines.append(f"  ({hidden} more are covered as well or better)")
    return "\n".join(lines)
