"""The tables over tasks: what each row reached at each task and reward, and what it cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from docs.site import cells
from docs.site.tables import code, table
from envs.reference import Column
from envs.registry import OURS
from pipeline.results.cells import OWN
from pipeline.results.rows import in_published_order, published_names
from pipeline.results.run_tables import RETURN, SPENT, cell, with_interval
from pipeline.results.runs import RunGroup
from pipeline.results.statistics import SEVERAL, over_tasks

ONCE: Final = Column("success_once", "success once", percent=True)
SUCCESS: Final = (ONCE, Column("success_at_end", "at the end", percent=True))
OUTCOME: Final = (*SUCCESS, Column(RETURN, "return"))
STEPS: Final = (
    Column("steps_to_success_median", "steps to success"),
    Column("success_share", "share of the horizon in success", percent=True),
)
COST: Final = {
    "simulator_steps": ("simulator steps", 1.0),
    "frames": ("frames", 1.0),
    "updates": ("updates", 1.0),
    "wall_s": ("wall time, min", 1 / 60),
}
"""Header of a condition, and what turns its unit into the header's."""


def render() -> str:
    """A heading and two tables for each task."""
    return "\n\n".join(_task(task) for task in cells.tasks())


def rows_of(names: Sequence[str]) -> str:
    """The cells of these variants at every task but those of the door's own tables."""
    found = [
        (place, row)
        for place in cells.listed()
        if (row := cells.result(*place)) is not None and cells.variant(row) in names
    ]
    if not found:
        return (
            "No cell of this method at another task or reward is published yet: "
            f"`make rows TASK=hammer ROWS={names[0]}` makes one."
        )
    head = (
        "task", "reward", "row", "seeds", *SPENT.values(),
        *(c.header for c in (*OUTCOME, STEPS[0])),
    )  # fmt: skip
    return table(
        head,
        (
            (
                code(task), reward, code(name), len(row.runs),
                *(_cost(task, reward, name, key) for key in SPENT),
                *cells.figures(row, OUTCOME), cells.middle(row, STEPS[0]),
            )
            for (task, reward, name), row in found
        ),
    )  # fmt: skip


def aggregate() -> str:
    """Success over our tasks together, of the rows that have a cell at each of them."""
    lines = []
    for reward in dict.fromkeys(r for task in OURS for r in cells.rewards(task)):
        for name, scores in complete(reward).items():
            estimate = over_tasks({name: scores})[name]
            several = len(scores) >= SEVERAL
            interval = (float(estimate.low[0]), float(estimate.high[0])) if several else None
            figure = with_interval(ONCE, float(estimate.iqm[0]), interval)
            least = cell(ONCE, float(scores.mean(axis=0).min()))
            cost = [_mean_cost(reward, name, key) for key in SPENT]
            lines.append((code(name), reward, len(scores), *cost, figure, least))
    if not lines:
        return f"No row has a cell at each of {', '.join(OURS)} yet."
    spent = (f"{header} a task" for header in SPENT.values())
    return table(
        ("row", "reward", "seeds", *spent, "success once, IQM", "at the worst task"), lines
    )


def complete(reward: str) -> dict[str, np.ndarray]:
    """Success once [S, N] of the rows that have S seeds at each of our N tasks, S being at least 1.

    Where tasks have different numbers of seeds, the first ones count.
    """
    found = {}
    for name in in_published_order(
        {row for _, r, row in cells.published() if r == reward}, published_names()
    ):
        of_tasks = [cells.result(task, reward, name) for task in OURS]
        values = [
            [run.evaluation.figure(ONCE.key) for run in row.runs]
            for row in of_tasks
            if row is not None
        ]
        if len(values) == len(OURS) and not any(v is None for of_one in values for v in of_one):
            seeds = min(map(len, values))
            found[name] = np.array([of_one[:seeds] for of_one in values], dtype=np.float64).T
    return found


def _task(task: str) -> str:
    names, rewards = cells.rows(task), cells.rewards(task)
    heading = f"### {task}"
    if not names:
        return f"{heading}\n\nNo cell is published yet: `make rows TASK={task}` makes some."
    found = {
        (name, reward): cells.result(task, reward, name) for name in names for reward in rewards
    }
    made = [row for row in found.values() if row is not None]
    tells = not made or any(_tells(row, ONCE.key) for row in made)
    outcome = OUTCOME if tells else OUTCOME[len(SUCCESS) :]
    beside = {reward: cells.reference().get((task, reward)) for reward in rewards}
    reached = table(
        ["row", f"seeds{_beside(rewards)}",
         *(f"{c.header}{_of(reward)}" for c in outcome for reward in rewards)],
        [
            *(
                [
                    code(name),
                    _joined([_seeds(found[name, reward]) for reward in rewards]),
                    *_figures([found[name, reward] for reward in rewards], outcome),
                ]
                for name in names
            ),
            *([[cells.DAPG, "", *_figures(list(beside.values()), outcome)]] if any(beside.values())
              else []),
        ],
    )  # fmt: skip
    steps = STEPS if tells else ()
    ways = any(_tells(row, "strategies") for row in made)
    cost = table(
        ["row", *(f"{c.header}{_beside(rewards)}" for c in steps),
         *(f"{header}{_beside(rewards)}" for header, _ in COST.values()),
         "preset", "demonstrations", *(["how, mostly"] if ways else [])],
        [
            *(
                [
                    code(name),
                    *(_joined([cells.middle(found[name, r], c) for r in rewards]) for c in steps),
                    *(
                        _joined([_cost(task, reward, name, key) for reward in rewards])
                        for key in COST
                    ),
                    _joined(
                        dict.fromkeys(_preset(task, r, name) for r in rewards if found[name, r])
                    ),
                    _joined(
                        dict.fromkeys(_demos(task, r, name) for r in rewards if found[name, r])
                    ),
                    *([_joined([_way(found[name, r]) for r in rewards])] if ways else []),
                ]
                for name in names
            ),
            *([[cells.DAPG, *(_joined([cells.middle(row, c) for row in beside.values()])
                              for c in steps), *["-"] * (len(COST) + 2 + ways)]]
              if any(beside.values()) else []),
        ],
    )  # fmt: skip
    return f"{heading}\n\n{reached}\n\n{cost}"


def _figures(rows: Sequence[RunGroup | None], columns: Sequence[Column]) -> list[str]:
    """Of a row by reward: those of one column beside each other."""
    by_reward = [cells.figures(row, columns) for row in rows]
    return [figure for of_column in zip(*by_reward, strict=True) for figure in of_column]


def _of(reward: str) -> str:
    return "" if reward == OWN else f", {reward}"


def _beside(rewards: Sequence[str]) -> str:
    return f", {' / '.join(rewards)}" if len(rewards) > 1 else ""


def _joined(told: Sequence[str] | dict[str, None]) -> str:
    return " / ".join(told) or "-"


def _tells(row: RunGroup, key: str) -> bool:
    return any(run.evaluation.content.get(key) is not None for run in row.runs)


def _seeds(row: RunGroup | None) -> str:
    return "-" if row is None else str(len(row.runs))


def _cost(task: str, reward: str, name: str, key: str) -> str:
    value = cells.condition(task, reward, name, key)
    _, scale = COST[key]
    return "-" if value is None else f"{value * scale:,.{1 if scale < 1 else 0}f}"


def _mean_cost(reward: str, name: str, key: str) -> str:
    """Over our tasks; a dash where one does not tell it."""
    found = [cells.condition(task, reward, name, key) for task in OURS]
    known = [value for value in found if value is not None]
    return f"{np.mean(known):,.0f}" if len(known) == len(found) else "-"


def _preset(task: str, reward: str, name: str) -> str:
    return code(cells.published()[task, reward, name][0].conditions["preset"])


def _demos(task: str, reward: str, name: str) -> str:
    told = cells.published()[task, reward, name][0].conditions
    by, count = told["demonstrations_by"], told["demonstrations"]
    parts = [str(part) for part in (count, by) if part is not None]
    parts += ["multiplied"] if told["demonstrations_multiplied"] else []
    return ", ".join(parts) or "-"


def _way(row: RunGroup | None) -> str:
    """The commonest way of its episodes, over seeds."""
    told = [] if row is None else [run.evaluation.strategies for run in row.runs]
    shares = [one.shares for one in told if one is not None]
    if not shares or len(shares) < len(told):
        return "-"
    means = {way: float(np.mean([of_one.get(way, 0.0) for of_one in shares])) for way in shares[0]}
    way = max(means, key=lambda name: means[name])
    return f"{way} {100 * means[way]:.0f} %"
