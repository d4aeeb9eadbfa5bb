"""Ways in which a file goes bad."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

Damage = Callable[[Path, Random], None]


def truncate(path: Path, rng: Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(len(content))])


def empty(path: Path, rng: Random) -> None:
    path.write_bytes(b"")


def flip(path: Path, rng: Random) -> None:
    """One bit."""
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def delete(path: Path, rng: Random) -> None:
    path.unlink()


def append(path: Path, rng: Random) -> None:
    with path.open("ab") as file:
        file.write(rng.randbytes(rng.randint(1, 64)))


def link(path: Path, rng: Random) -> None:
    """To a copy of itself that lies elsewhere."""
    elsewhere = path.with_name(f"{path.name}.elsewhere")
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


KINDS: tuple[Damage, ...] = (truncate, empty, flip, delete, append, link)


@contextmanager
def damaged(path: Path, kind: Damage, rng: Random) -> Iterator[None]:
    """The file in that state; as it was afterwards."""
    content = path.read_bytes()
    if content or kind in (delete, append, link):
        kind(path, rng)
    try:
        yield
    finally:
        path.with_name(f"{path.name}.elsewhere").unlink(missing_ok=True)
        path.unlink(missing_ok=True)
        path.write_bytes(content)
