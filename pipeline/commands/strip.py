"""``make strip``: policies, and a demonstration, in one picture of rows over time."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from tqdm import tqdm

from envs import Task
from envs.pictures import Picture, Render
from pipeline.files.run_files import write_atomically
from pipeline.film.overlay import GREEN, SHADE, WHITE, fit, font
from pipeline.film.performers import LoadedRun, Opens, PolicyPerformer, performer
from pipeline.film.takes import Moment

MOST_BYTES: Final = 300_000
COLOURS: Final = (256, 128, 64, 32)
"""Of the palette; the first with which the picture fits."""
DARK: Final = (20, 24, 29)
GAP: Final = 3
"""Between pictures, px."""


@dataclass(frozen=True)
class Layout:
    """What a strip is asked to be.

    Attributes:
        episode: number in the task's list.
        columns: pictures in a row, at least 2.
        until: control step of the last one; None is the task's limit.
        size: of a picture, px.
        camera: its name; None is the task's own view.

    Raises:
        ValueError: a number is out of range.
    """

    episode: int = 0
    columns: int = 6
    until: int | None = None
    size: int = 180
    camera: str | None = None

    def __post_init__(self) -> None:
        if self.columns < 2 or self.episode < 0 or (self.until is not None and self.until < 1):
            raise ValueError(
                f"a strip has 2 columns or more, an episode from 0 and a last step from 1; got "
                f"{self.columns}, {self.episode} and {self.until}"
            )


def strip(
    runs: Sequence[Path],
    out: Path,
    layout: Layout | None = None,
    overrides: Sequence[str] = (),
    *,
    with_: str | None = None,
) -> int:
    """Writes one picture: a row for a demonstration, if asked for, and one for each run.

    Args:
        runs: Of one task.
        out: PNG file; its folder is made.
        layout: Of the picture.
        overrides: ``key=value`` on top of the recipes.
        with_: What stands in the first row, see :func:`pipeline.film.performers.performer`.

    Returns:
        Bytes of the file.

    Raises:
        RenderingUnavailableError: If there is no OpenGL.
        ValueError: If the runs are of several tasks, or ``out`` is no PNG.
    """
    layout = layout or Layout()
    if out.suffix.lower() != ".png":
        raise ValueError(f"OUT={out}: a strip is a .png")
    found = [LoadedRun.of(path, overrides) for path in runs]
    task = found[0].task
    names = {run.task.name for run in found}
    if len(names) > 1:
        raise ValueError(f"a strip is of one task, and these runs are of {sorted(names)}")
    render: Render = task.require("render", "make strip")
    every = _every(layout, found[0])
    openers: list[tuple[str, Opens]] = [(run.name, PolicyPerformer.opener(run)) for run in found]
    if with_ is not None:
        openers.insert(0, ("demonstration", performer(with_, found[0], overrides)))
    picture = Picture(2 * layout.size, 2 * layout.size, layout.camera)  # smoothed when halved
    rows = []
    for name, opened in tqdm(openers, unit=" rows", disable=None):
        with ExitStack() as stack:
            one = stack.enter_context(opened(picture, every))
            _, moments = one.play(layout.episode)
            seen = list(islice(moments, layout.columns))
        # An episode that has ended stands still.
        seen += [seen[-1]] * (layout.columns - len(seen))
        rows.append(row(seen, name, task, layout.size))
    seconds = [i * every / render.steps_per_second for i in range(layout.columns)]
    data = _png(np.concatenate([header(seconds, layout.size), *rows]))
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, data)
    return len(data)


def _every(layout: Layout, run: LoadedRun) -> int:
    """Control steps between two columns."""
    limits = (
        layout.until,
        run.recipe.env.horizon,
        None if run.task.demos is None else run.task.demos.horizon,
    )
    until = next((limit for limit in limits if limit is not None), None)
    if until is None:
        raise ValueError(
            f"task {run.task.name} names no limit of its episodes: say the last step (UNTIL=...)"
        )
    return max(1, round(until / (layout.columns - 1)))


def header(seconds: Sequence[float], size: int) -> NDArray[Any]:
    """Times above the columns, uint8 [height, width, 3]."""
    em = _em(size)
    image = Image.new("RGB", (len(seconds) * (size + GAP) - GAP, round(1.5 * em)), WHITE)
    draw = ImageDraw.Draw(image)
    for i, value in enumerate(seconds):
        middle = i * (size + GAP) + size // 2
        draw.text((middle, em // 5), f"{value:.2f} s", font=font(em), fill=DARK, anchor="ma")
    return np.asarray(image)


def row(moments: Sequence[Moment], name: str, task: Task, size: int) -> NDArray[Any]:
    """One episode from left to right, uint8 [height, width, 3]."""
    cells: list[NDArray[Any]] = []
    for i, moment in enumerate(moments):
        cells.append(_cell(moment, name if i == 0 else "", task.progress_unit, size))
        cells.append(np.full((size, GAP, 3), 255, dtype=np.uint8))
    below = np.full((GAP, len(moments) * (size + GAP) - GAP, 3), 255, dtype=np.uint8)
    return np.concatenate([np.concatenate(cells[:-1], axis=1), below])


def _cell(moment: Moment, name: str, unit: str, size: int) -> NDArray[Any]:
    em = _em(size)
    picture = fit(fit(moment.picture, (2 * size, 2 * size)), (size, size))
    if name:
        picture[: round(1.5 * em)] = picture[: round(1.5 * em)] * SHADE
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    if name:
        draw.text((em // 3, em // 5), name, font=font(em), fill=WHITE)
    if moment.progress is not None:
        told = f"{moment.progress:.2f} {unit}".rstrip()
        left, top, right, bottom = draw.textbbox(
            (size - em // 3, size - em // 3), told, font=font(em), anchor="rd"
        )
        # An area and not thin letters: a small palette keeps its colour.
        badge = GREEN if moment.success else DARK
        draw.rectangle((left - 4, top - 3, right + 4, bottom + 3), fill=badge)
        draw.text(
            (size - em // 3, size - em // 3),
            told,
            font=font(em),
            fill=DARK if moment.success else WHITE,
            anchor="rd",
        )
    return np.asarray(image)


def _em(size: int) -> int:
    return max(10, size // 13)


def _png(picture: NDArray[Any]) -> bytes:
    image = Image.fromarray(picture)
    for colours in COLOURS:
        data = io.BytesIO()
        image.quantize(colours, dither=Image.Dither.NONE).save(data, format="PNG", optimize=True)
        if len(data.getvalue()) <= MOST_BYTES:
            return data.getvalue()
    raise ValueError(
        f"the strip does not fit into {MOST_BYTES:,} bytes: fewer columns, or a smaller size"
    )
