"""Films as files: MP4, or GIF of a bounded size."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Protocol

import imageio.v2 as imageio
from numpy.typing import NDArray

from envs.whole_files import whole_file
from pipeline.film.gif import Gif

MACRO_BLOCK: Final = 16
"""Sides of an MP4 are multiples of it, px."""


class Film(Protocol):
    """Takes one picture after the other."""

    def append(self, picture: NDArray[Any]) -> None:
        """The next picture, uint8 [height, width, 3]; all have one size."""
        ...


class Mp4:
    """H.264, which browsers play."""

    def __init__(self, out: Path, pictures_per_second: float) -> None:
        open_film: Any = imageio.get_writer  # its annotations lack append_data
        self._writer = open_film(
            out, fps=pictures_per_second, macro_block_size=MACRO_BLOCK, format="FFMPEG"
        )

    def append(self, picture: NDArray[Any]) -> None:
        """The next picture."""
        self._writer.append_data(picture)

    def finish(self) -> None:
        """Nothing follows."""
        self._writer.close()

    def abandon(self) -> None:
        """Nobody wants it any more."""
        self._writer.close()


FORMATS: Final[MappingProxyType[str, Callable[[Path, float], Any]]] = MappingProxyType(
    {".mp4": Mp4, ".gif": Gif}
)


def require_format(out: Path) -> None:
    """Raises ``ValueError`` unless a film can be written under this name."""
    if out.suffix.lower() not in FORMATS:
        raise ValueError(f"OUT={out}: a film is {' or '.join(FORMATS)}, by the end of its name")


def open_film(out: Path, pictures_per_second: float) -> AbstractContextManager[Film]:
    """The film ``out``, which is there once it is complete; its folder is made.

    Raises:
        ValueError: if its name has another ending.
    """
    require_format(out)
    return _written(out, pictures_per_second)


@contextmanager
def _written(out: Path, pictures_per_second: float) -> Iterator[Film]:
    out.parent.mkdir(parents=True, exist_ok=True)
    suffix = out.suffix.lower()
    with whole_file(out, suffix) as temporary:
        film = FORMATS[suffix](temporary, pictures_per_second)
        try:
            yield film
        except BaseException:
            film.abandon()
            raise
        film.finish()
