"""What is written into a picture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pipeline.film.takes import Moment

WHITE: Final = (255, 255, 255)
GREY: Final = (150, 160, 170)
BLUE: Final = (90, 170, 240)
GREEN: Final = (70, 200, 120)
SHADE: Final = 0.35
"""What is left of the picture's brightness behind text."""


@dataclass(frozen=True)
class Scale:
    """How progress becomes a bar.

    Attributes:
        unit: of progress.
        full: where the bar is full; None draws no bar.
        empty: where it is empty.
    """

    unit: str = ""
    full: float | None = None
    empty: float = 0.0

    def from_(self, progress: float | None) -> Scale:
        """The scale of an episode that begins at this progress."""
        return self if progress is None else replace(self, empty=progress)

    def share(self, progress: float) -> float:
        """Of the bar, in [0, 1]."""
        if self.full is None or self.full == self.empty:
            return 0.0
        return min(max((progress - self.empty) / (self.full - self.empty), 0.0), 1.0)


def annotated(moment: Moment, title: str, scale: Scale, size: tuple[int, int]) -> NDArray[Any]:
    """The picture with what is known of the episode, uint8 [height, width, 3].

    Args:
        moment: of the episode.
        title: of it.
        scale: of its progress.
        size: width and height, px; a picture of another shape is fitted into the middle.
    """
    fitted = fit(moment.picture, size)
    width, height = size
    em = max(11, round(height / 34))
    left = em // 2
    lines = _lines(moment, scale)
    for note in moment.notes:  # of any length, where the others are short
        lines += wrapped(note, em, width - 2 * left)
    bar = moment.progress is not None and scale.full is not None
    top, bottom = round(1.7 * em), round(em * (1.35 * len(lines) + 0.5 + 0.6 * bar))
    fitted[:top] = fitted[:top] * SHADE
    fitted[height - bottom :] = fitted[height - bottom :] * SHADE
    image = Image.fromarray(fitted)
    draw = ImageDraw.Draw(image)
    draw.text((left, em // 4), title, font=font(em), fill=WHITE)
    if moment.success:
        draw.text((width - left, em // 4), "success", font=font(em), fill=GREEN, anchor="ra")
    for i, line in enumerate(lines):
        where = (left, height - bottom + round(em * (0.2 + 1.35 * i)))
        draw.text(where, line, font=font(em), fill=WHITE)
    if bar and moment.progress is not None:
        low, high = height - round(0.75 * em), height - round(0.35 * em)
        end = left + round((width - 2 * left) * scale.share(moment.progress))
        draw.rectangle((left, low, width - left, high), fill=GREY)
        if end > left:
            draw.rectangle((left, low, end, high), fill=GREEN if moment.success else BLUE)
    return np.asarray(image)


def beside(pictures: list[NDArray[Any]]) -> NDArray[Any]:
    """Pictures of one height side by side."""
    return np.concatenate(pictures, axis=1)


def fit(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """A copy of the picture as large as fits, in the middle, with black around it."""
    width, height = size
    if picture.shape[:2] == (height, width):
        return picture.copy()
    image = Image.fromarray(picture)
    image = image.resize(
        _scaled(image.size, min(width / image.width, height / image.height)),
        Image.Resampling.BILINEAR,
    )
    whole = Image.new("RGB", size)
    whole.paste(image, ((width - image.width) // 2, (height - image.height) // 2))
    return np.array(whole)


def _scaled(size: tuple[int, int], factor: float) -> tuple[int, int]:
    return max(1, round(size[0] * factor)), max(1, round(size[1] * factor))


def _lines(moment: Moment, scale: Scale) -> list[str]:
    told = [
        f"step {moment.step}",
        f"{moment.seconds:.2f} s",
        f"reward {moment.reward:.2f}",
        f"return {moment.return_:.0f}",
    ]
    further = []
    if moment.progress is not None:
        further.append(f"progress {moment.progress:.2f} {scale.unit}".rstrip())
    if moment.stage:
        further.append(f"stage: {moment.stage}")
    lines = ["   ".join(told), "   ".join(further)]
    return [line for line in lines if line]


def wrapped(line: str, size: int, width: int) -> list[str]:
    """The line in parts of at most ``width`` px, broken between words; wider words stand alone."""
    parts: list[str] = []
    for word in line.split(" "):
        longer = f"{parts[-1]} {word}" if parts else word
        if parts and font(size).getlength(longer) > width:
            parts.append(word)
        else:
            parts[-1:] = [longer]
    return [part.strip() for part in parts]


@cache
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own font, which needs no file of this machine."""
    return ImageFont.load_default(size)
