"""GIF films that fit into a README or a report."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray
from PIL import Image

MOST_BYTES: Final = 3_000_000
FASTEST: Final = 25.0
"""Pictures a second at most: browsers show GIFs hardly faster."""
KEPT: Final = 600
"""Pictures that are held in memory; with more, every second one is left out."""
WIDEST: Final = 640
"""Of a picture, px."""
SAMPLED: Final = 12
"""Pictures that the palette is made from."""


@dataclass(frozen=True)
class Saving:
    """A way to a smaller GIF.

    Attributes:
        scale: factor on width and height.
        every: only so many-th picture is kept.
        colours: of the palette.
    """

    scale: float
    every: int
    colours: int


SAVINGS: Final = (
    Saving(1.0, 1, 128),
    Saving(1.0, 2, 96),
    Saving(0.75, 2, 64),
    Saving(0.75, 3, 48),
    Saving(0.5, 3, 48),
    Saving(0.5, 5, 32),
    Saving(0.35, 6, 24),
)
"""Tried in this order; the first that fits is written."""


class Gif:
    """The best GIF that fits into ``MOST_BYTES``, by the first of ``SAVINGS`` that does.

    Args:
        out: file.
        pictures_per_second: of what is appended.
    """

    def __init__(self, out: Path, pictures_per_second: float) -> None:
        self._out = out
        self._every = max(1, math.ceil(pictures_per_second / FASTEST))
        self._milliseconds = 1000.0 / pictures_per_second
        self._count = 0
        self._kept: list[Image.Image] = []

    def append(self, picture: NDArray[Any]) -> None:
        """The next picture, uint8 [height, width, 3]."""
        if self._count % self._every == 0:
            image = Image.fromarray(picture)
            if image.width > WIDEST:
                image = _smaller(image, WIDEST / image.width)
            self._kept.append(image)
        self._count += 1
        if len(self._kept) > KEPT:
            self._kept = self._kept[::2]
            self._every *= 2

    def finish(self) -> None:
        """Nothing follows.

        Raises:
            ValueError: If none of the savings makes it fit.
        """
        if not self._kept:
            return
        for saving in SAVINGS:
            found = self._encoded(saving)
            if len(found) <= MOST_BYTES:
                self._out.write_bytes(found)
                return
        raise ValueError(
            f"a GIF of {self._count} pictures does not fit into {MOST_BYTES:,} bytes: name fewer "
            "episodes, or OUT=....mp4"
        )

    def abandon(self) -> None:
        """Nobody wants it any more."""
        self._kept = []

    def _encoded(self, saving: Saving) -> bytes:
        chosen = self._kept[:: saving.every]
        if saving.scale != 1.0:
            chosen = [_smaller(image, saving.scale) for image in chosen]
        palette = _palette(chosen, saving.colours)
        # One palette and no dithering: what does not move stays the same, and costs nothing.
        first, *rest = (
            image.quantize(palette=palette, dither=Image.Dither.NONE) for image in chosen
        )
        data = io.BytesIO()
        first.save(
            data,
            format="GIF",
            save_all=True,
            append_images=rest,
            duration=round(self._milliseconds * self._every * saving.every),
            loop=0,
            optimize=False,
        )
        return data.getvalue()


def _palette(images: list[Image.Image], colours: int) -> Image.Image:
    """A palette for all of them."""
    sampled = images[:: max(1, len(images) // SAMPLED)]
    width, height = sampled[0].size
    together = Image.new("RGB", (width, height * len(sampled)))
    for i, image in enumerate(sampled):
        together.paste(image, (0, i * height))
    return together.quantize(colours)


def _smaller(image: Image.Image, factor: float) -> Image.Image:
    size = max(1, round(image.width * factor)), max(1, round(image.height * factor))
    return image.resize(size, Image.Resampling.LANCZOS)
