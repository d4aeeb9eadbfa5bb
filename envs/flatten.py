"""Observations of any space as one float32 vector, the same for environments and recordings.

The order is documented and does not depend on how a space was written down: the arrays of a nested
observation are sorted by their path, the keys joined by ``/`` (entries of a tuple are ``0``, ``1``,
...), and each is laid out in C order. An integer out of n becomes n numbers of which one is 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

Path = tuple[str | int, ...]
SEPARATOR: Final = "/"
ROOT: Final = "observation"
"""What the array of an observation that is not nested is called."""
SUPPORTED: Final = (
    "vectors and matrices of numbers, MultiBinary, Discrete, MultiDiscrete, Dict, Tuple"
)


class UnsupportedSpaceError(ValueError):
    """A space of observations that cannot be a vector of numbers; the message names its key."""


@dataclass(frozen=True)
class Leaf:
    """One array of an observation.

    Attributes:
        name: its path, joined by ``/``.
        path: keys and positions that lead to it.
        shape: of the array, without batch dimensions.
        values: of entries that are integers out of a few: how many; empty for numbers.
        first: the smallest of those integers, each.
    """

    name: str
    path: Path
    shape: tuple[int, ...]
    values: tuple[int, ...] = ()
    first: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Numbers it takes in the vector."""
        return sum(self.values) if self.values else int(np.prod(self.shape, dtype=np.int64))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """A name for each of those numbers."""
        if self.shape == () and len(self.values) <= 1:
            return tuple(f"{self.name}={i}" for i in self._choices(0)) or (self.name,)
        places = [",".join(map(str, place)) for place in np.ndindex(self.shape)]
        if not self.values:
            return tuple(f"{self.name}[{place}]" for place in places)
        return tuple(
            f"{self.name}[{place}]={i}" for k, place in enumerate(places) for i in self._choices(k)
        )

    def holds(self, integers: NDArray[Any]) -> NDArray[np.bool_]:
        """Which of the integers [..., I], I of them a step, are among its values."""
        counted = integers - np.asarray(self.first)
        return np.asarray((counted >= 0) & (counted < np.asarray(self.values)))

    def write(self, value: Any, out: NDArray[np.float32]) -> None:
        """Write ``value`` [..., *shape] into ``out`` [..., size].

        Raises:
            ValueError: an integer is outside of its range.
        """
        if not self.values:
            out[...] = np.reshape(value, out.shape)
            return
        integers = np.reshape(value, (*out.shape[:-1], len(self.values)))
        inside = self.holds(integers)
        if not inside.all():
            strange = integers[~inside].flat[0]
            raise ValueError(f"{self.name} is {strange}, outside of its {self.values} values")
        offsets = np.cumsum((0, *self.values[:-1])) - np.asarray(self.first, np.int64)
        out[...] = 0.0
        np.put_along_axis(out, integers + offsets, 1.0, axis=-1)

    def _choices(self, entry: int) -> range:
        if not self.values:
            return range(0)
        return range(self.first[entry], self.first[entry] + self.values[entry])


@dataclass(frozen=True)
class Flattener:
    """Turns nested observations into vectors.

    Attributes:
        leaves: the arrays, in the order of the vector.
    """

    leaves: tuple[Leaf, ...]

    @classmethod
    def of(cls, space: gymnasium.Space[Any]) -> Self:
        """The flattener of observations in ``space``.

        Raises:
            UnsupportedSpaceError: it holds an image, text, a sequence, a graph, or nothing at all.
        """
        leaves = tuple(sorted(_leaves(space, ()), key=lambda leaf: leaf.name))
        if not sum(leaf.size for leaf in leaves):
            raise UnsupportedSpaceError(f"observations are empty: {space}")
        return cls(leaves)

    @cached_property
    def size(self) -> int:
        """O, numbers of the vector."""
        return sum(leaf.size for leaf in self.leaves)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """A name for each number of the vector: ``goal/position[2]``, ``mode=3``."""
        return tuple(name for leaf in self.leaves for name in leaf.names)

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """Observations, with the same batch dimensions in front of each array, as [..., O]."""
        first = self.leaves[0]
        batch = np.shape(_at(observation, first.path))
        out = np.empty((*batch[: len(batch) - len(first.shape)], self.size), np.float32)
        self.write(observation, out)
        return out

    def write(self, observation: Any, out: NDArray[np.float32]) -> None:
        """The same, into ``out`` [..., O]."""
        for (low, high), leaf in zip(self._ranges, self.leaves, strict=True):
            leaf.write(_at(observation, leaf.path), out[..., low:high])

    @cached_property
    def _ranges(self) -> tuple[tuple[int, int], ...]:
        ends = np.cumsum([leaf.size for leaf in self.leaves]).tolist()
        return tuple(zip([0, *ends[:-1]], ends, strict=True))


def _at(observation: Any, path: Path) -> Any:
    for key in path:
        observation = observation[key]
    return observation


def _leaves(space: gymnasium.Space[Any], path: Path) -> Iterator[Leaf]:
    for kind, read in _READERS.items():
        if isinstance(space, kind):
            yield from read(space, path)
            return
    raise UnsupportedSpaceError(
        f"observation {_name(path)!r} is a {type(space).__name__}, which is no vector of numbers; "
        f"supported: {SUPPORTED}. Change it in a wrapper (task.wrappers=[module:Class])"
    )


def _name(path: Path) -> str:
    return SEPARATOR.join(map(str, path)) or ROOT


def _dict(space: Any, path: Path) -> Iterator[Leaf]:
    for key, inner in space.spaces.items():
        yield from _leaves(inner, (*path, key))


def _tuple(space: Any, path: Path) -> Iterator[Leaf]:
    for position, inner in enumerate(space.spaces):
        yield from _leaves(inner, (*path, position))


def _numbers(space: Any, path: Path) -> Iterator[Leaf]:
    rank = len(space.shape)
    if rank > 2 or (rank == 2 and space.dtype == np.uint8):
        raise UnsupportedSpaceError(
            f"observation {_name(path)!r} is an image ({space.dtype} {list(space.shape)}), and "
            f"networks here take vectors; supported: {SUPPORTED}. Leave it out or encode it in a "
            "wrapper (task.wrappers=[module:Class])"
        )
    yield Leaf(_name(path), path, space.shape)


def _discrete(space: Any, path: Path) -> Iterator[Leaf]:
    yield Leaf(_name(path), path, (), (int(space.n),), (int(space.start),))


def _multi_discrete(space: Any, path: Path) -> Iterator[Leaf]:
    values, first = _integers(space.nvec), _integers(space.start)
    yield Leaf(_name(path), path, space.shape, values, first)


def _integers(array: Sequence[int] | NDArray[np.integer]) -> tuple[int, ...]:
    return tuple(int(n) for n in np.ravel(array))


_READERS: Final[Mapping[type, Callable[[Any, Path], Iterator[Leaf]]]] = {
    spaces.Dict: _dict,
    spaces.Tuple: _tuple,
    spaces.Box: _numbers,
    spaces.MultiBinary: _numbers,
    spaces.Discrete: _discrete,
    spaces.MultiDiscrete: _multi_discrete,
}
