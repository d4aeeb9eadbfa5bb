"""``make robust``: a run directory in, its policy under ladders of disturbances out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tensordict.nn import TensorDictModuleBase

from envs import Task
from envs.disturbed import disturbed, moved
from envs.disturbing import Box, Disturbance, Factor
from envs.intervals import wilson
from pipeline.act.evaluation import Evaluator
from pipeline.commands.evaluate_run import made_from
from pipeline.compute import require_device
from pipeline.playing import make_evaluator
from pipeline.policy import load_policy
from pipeline.results.robustness import BAR, EPISODES, Ladder, Measured, Robustness
from pipeline.run_dir import load_recipe

OBSERVATION_NOISE: Final = (0.005, 0.01, 0.02, 0.05)
ACTION_NOISE: Final = (0.05, 0.1, 0.2)
DELAYS: Final = (1, 2, 3, 4, 5)
MORE: Final = (1.2, 1.5, 2.0)
LESS: Final = (0.8, 0.65, 0.5)
BEYOND: Final = (0.01, 0.02, 0.05)
"""Of the box from which starts are drawn, in its unit, where the box says nothing else."""


@dataclass(frozen=True)
class Rung:
    """A setting: its name, and how it changes a task."""

    setting: str
    change: Callable[[Task], Task]


@dataclass(frozen=True)
class Plan:
    """A ladder that is not measured yet."""

    kind: str
    what: str
    rungs: tuple[Rung, ...]


def plans(task: Task) -> list[Plan]:
    """The ladders that a task can be put on: noise and delays always, its own where it says so."""
    found = [
        Plan("observation_noise", "noise on observations", _observation_noises()),
        Plan("action_noise", "noise on actions", _action_noises()),
        Plan("delay", "delay of actions", tuple(_delay(steps) for steps in DELAYS)),
    ]
    if task.disturb is not None:
        for name, factor in task.disturb.factors.items():
            found += _factors(name, factor)
        for box in task.disturb.boxes if task.starts is not None else ():
            found += _boxes(box)
    return found


def robustness(
    run_dir: Path,
    overrides: Sequence[str] = (),
    *,
    episodes: int = EPISODES,
    bar: float = BAR,
    kinds: Sequence[str] = (),
    report: Callable[[str], None] = lambda _: None,
) -> Robustness:
    """Plays the same episodes under every setting.

    Args:
        run_dir: A run directory, or a published policy.
        overrides: ``key=value`` on top of its recipe.
        episodes: Of each setting.
        bar: Success below which a setting breaks the policy, in (0, 1].
        kinds: Of ladders to climb; none names all.
        report: Takes a line for each setting.

    Raises:
        RunDirectoryError, FileNotFoundError, ValueError: As ``load_recipe`` and ``load_policy`` do;
            a kind is unknown, the bar is no share, or the task tells no success.
    """
    if not 0.0 < bar <= 1.0:
        raise ValueError(f"BAR={bar} must be a share of episodes in (0, 1]")
    recipe = load_recipe(run_dir, list(overrides))
    require_device(recipe.device)
    task = recipe.find_task()
    chosen = _chosen(plans(task), kinds)
    policy, origin = load_policy(recipe, task, run_dir)

    def measured(setting: str, changed: Task) -> Measured:
        evaluator = make_evaluator(recipe, changed, episodes=episodes)
        found = _measure(setting, evaluator, policy)
        report(f"{setting}: {found.text}")
        return found

    undisturbed = measured("undisturbed", task)
    ladders = []
    for plan in chosen:
        report(plan.what)
        rungs = [_climbed(rung, task, measured) for rung in plan.rungs]
        ladders.append(Ladder(plan.kind, plan.what, tuple(rungs)))
    return Robustness(
        bar=bar,
        episodes=episodes,
        undisturbed=undisturbed,
        ladders=tuple(ladders),
        made_from=made_from(recipe, task, run_dir, origin, overrides),
        kinds=tuple(kinds),
    )


def _climbed(rung: Rung, task: Task, measured: Callable[[str, Task], Measured]) -> Measured:
    try:
        changed = rung.change(task)
    except ValueError as refusal:
        return Measured(rung.setting, refused=str(refusal))
    return measured(rung.setting, changed)


def _measure(setting: str, evaluator: Evaluator, policy: TensorDictModuleBase) -> Measured:
    rollouts = evaluator.run(policy)
    if rollouts.success is None:
        raise ValueError(
            f"make robust counts successes, and task {evaluator.task.name} tells none: say what "
            "success is (task.success=...)"
        )
    once = rollouts.success.any(axis=1)
    return Measured(setting, float(once.mean()), wilson(once), float(rollouts.returns.mean()))


def _chosen(known: list[Plan], kinds: Sequence[str]) -> list[Plan]:
    names = list(dict.fromkeys(plan.kind for plan in known))
    unknown = [kind for kind in kinds if kind not in names]
    if unknown:
        raise ValueError(f"{unknown[0]} is no disturbance of this task; it has {', '.join(names)}")
    return [plan for plan in known if not kinds or plan.kind in kinds]


def _observation_noises() -> tuple[Rung, ...]:
    levels = OBSERVATION_NOISE
    return tuple(_rung(f"{x:g}", Disturbance(observation_noise=(x, x))) for x in levels)


def _action_noises() -> tuple[Rung, ...]:
    return tuple(_rung(f"{x:g}", Disturbance(action_noise=(x, x))) for x in ACTION_NOISE)


def _delay(steps: int) -> Rung:
    return _rung(f"{steps} steps" if steps > 1 else "1 step", Disturbance(delay=(steps, steps)))


def _factors(name: str, factor: Factor) -> Iterator[Plan]:
    for way, levels in (("more", MORE), ("less", LESS)):
        rungs = (_rung(f"x{x:g}", Disturbance(factors={name: (x, x)})) for x in levels)
        yield Plan(name, f"{factor.what}, {way}", tuple(rungs))


def _boxes(box: Box) -> Iterator[Plan]:
    for name in filter(None, box.names):
        for way, sign in (("above", 1), ("below", -1)):
            distances = BEYOND if box.beyond is None else box.beyond
            rungs = (_place(name, sign * distance, box.unit) for distance in distances)
            yield Plan(name, f"{name} {way} its box", tuple(rungs))


def _rung(setting: str, disturbance: Disturbance) -> Rung:
    return Rung(setting, lambda task: disturbed(task, disturbance))


def _place(name: str, distance: float, unit: str) -> Rung:
    return Rung(f"{distance:+g} {unit}", lambda task: moved(task, name, distance))
