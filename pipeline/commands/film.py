"""``make video``: a trained policy at work, alone or beside another or a demonstration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray
from tqdm import tqdm

from envs import Task
from envs.pictures import Picture, Render
from pipeline.film.choice import Choice
from pipeline.film.overlay import Scale, annotated, beside
from pipeline.film.performers import LoadedRun, Performer, PolicyPerformer, performer
from pipeline.film.takes import Moment, stride
from pipeline.film.writers import open_film, require_format

PICTURES_PER_SECOND: Final = 50.0
"""Of the film; a picture for every so many control steps that it runs in real time."""
HELD_S: Final = 0.6
"""For which the last picture of an episode stands."""


@dataclass(frozen=True)
class Filmed:
    """What a film shows.

    Attributes:
        numbers: of the episodes.
        pictures: how many.
    """

    numbers: tuple[int, ...]
    pictures: int


def film(
    run_dir: Path,
    out: Path,
    choice: Choice | None = None,
    overrides: Sequence[str] = (),
    *,
    with_: str | None = None,
    picture: Picture | None = None,
) -> Filmed:
    """Films the policy, as it is evaluated, in chosen episodes, one after the other.

    Args:
        run_dir: A run of a task that can be filmed.
        out: MP4 or GIF file to write; its folder is made.
        choice: Of the episodes.
        overrides: ``key=value`` on top of its recipe.
        with_: Who stands beside it, see :func:`pipeline.film.performers.performer`.
        picture: Of each.

    Raises:
        RenderingUnavailableError: If there is no OpenGL.
        MissingCapabilityError: If the task cannot be filmed, or its episodes have no numbers.
        RunDirectoryError: If the worst are asked for, and nothing says which these are.
        ValueError: If ``out`` has another ending, or there is no such camera.
    """
    require_format(out)
    choice = choice or Choice()
    picture = picture or Picture()
    run = LoadedRun.of(run_dir, overrides)
    render: Render = run.task.require("render", "make video")
    if choice.needs_list:
        run.task.require("starts", choice.needs_list)
    numbers = choice.numbers(run_dir, run.recipe)
    every = stride(render, PICTURES_PER_SECOND)
    openers = [PolicyPerformer.opener(run)]
    if with_ is not None:
        openers.append(performer(with_, run, overrides))
    per_second = render.steps_per_second / every
    scale, size = scale_of(run.task), (picture.width, picture.height)
    count = 0
    with ExitStack() as stack:
        performers = [stack.enter_context(opened(picture, every)) for opened in openers]
        made = stack.enter_context(open_film(out, per_second))
        bar = stack.enter_context(tqdm(unit=" pictures", disable=None))
        for i, number in enumerate(numbers, 1):
            bar.set_description(f"episode {number} ({i} of {len(numbers)})")
            shown: NDArray[Any] | None = None
            for shown in panels(performers, number, scale, size):
                made.append(shown)
                bar.update()
                count += 1
            for _ in range(round(HELD_S * per_second)):
                assert shown is not None
                made.append(shown)
    return Filmed(tuple(numbers), count)


def panels(
    performers: Sequence[Performer], number: int, scale: Scale, size: tuple[int, int]
) -> Iterator[NDArray[Any]]:
    """Pictures of one episode by all performers; who is done first stands still."""
    played = [one.play(number) for one in performers]
    titles = [title for title, _ in played]
    last: list[Moment | None] = [None] * len(played)
    scales: list[Scale] = []
    for moments in zip_longest(*(moments for _, moments in played)):
        last = [new or old for new, old in zip(moments, last, strict=True)]
        shown = [moment for moment in last if moment is not None]
        # A bar begins where the episode does: not every progress begins at 0.
        scales = scales or [scale.from_(moment.progress) for moment in shown]
        yield beside([
            annotated(*of_one, size) for of_one in zip(shown, titles, scales, strict=True)
        ])  # fmt: skip


def scale_of(task: Task) -> Scale:
    """How a task's progress is drawn."""
    full = None if task.demos is None else task.demos.full_progress
    return Scale(task.progress_unit, full)
