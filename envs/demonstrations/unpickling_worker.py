"""Opens one DAPG pickle in a process of its own and writes its arrays to the standard output.

A script, ``python unpickling_worker.py FILE BYTES SECONDS DEPTH ELEMENTS``, that needs NumPy only.
What a pickle says may crash the interpreter, loop or take all memory although it names no forbidden
function (a dtype whose state does not fit its array); here it takes this process down, not the
training.

The output is an npz of the arrays ``EPISODE/KEY`` (``3/init_state_dict/qpos``). In place of it, an
error is one JSON line, ``problem`` with the flags ``whole`` and ``refused``, and exit code 3.
"""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import resource
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

FAILED = 3
_NUMBERS = ("observations", "actions", "rewards")


class ContentError(ValueError):
    """The pickle is whole but does not hold demonstrations."""


def _encode_latin1(text: str, encoding: str) -> bytes:
    # Python 3 spells the bytes of an array so in protocol 2. The real `_codecs.encode` takes any
    # codec name, decompressors among them; arrays need this one only.
    if encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError(f"refused global _codecs.encode with {encoding!r}")
    return text.encode("latin1")


# numpy itself says what rebuilds its arrays, up to pickle protocol 4 and from 5 on, and what its
# scalars. The files name these functions by the module they lived in at the time of writing
# (numpy.core became _core).
_RECONSTRUCT = np.empty(0).__reduce__()[0]
_FROM_BUFFER = np.empty(1).__reduce_ex__(5)[0]
_SCALAR = np.float64(0).__reduce__()[0]

# Anything else a pickle can name it can also call: that is how opening a file runs somebody's code.
_ALLOWED_GLOBALS: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _encode_latin1,
    **{(f"numpy.{c}.multiarray", "_reconstruct"): _RECONSTRUCT for c in ("core", "_core")},
    **{(f"numpy.{c}.multiarray", "scalar"): _SCALAR for c in ("core", "_core")},
    **{(f"numpy.{c}.numeric", "_frombuffer"): _FROM_BUFFER for c in ("core", "_core")},
}


class RestrictedUnpickler(pickle.Unpickler):
    """Unpickler that refuses every global except those that rebuild a numpy array.

    Raises:
        pickle.UnpicklingError: from `load`, when the stream names any other global.
    """

    def find_class(self, module: str, name: str) -> Any:
        """Resolve an allowed global; see `pickle.Unpickler.find_class`."""
        try:
            return _ALLOWED_GLOBALS[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"refused global {module}.{name}") from None


def load_restricted(stream: BinaryIO) -> Any:
    """Unpickle ``stream`` (Python 2 strings as latin1) with `RestrictedUnpickler`."""
    # A Python 2 pickle keeps array bytes in str objects: only latin1 maps them one to one.
    return RestrictedUnpickler(stream, encoding="latin1").load()


def arrays_of(content: Any, depth: int, elements: int) -> dict[str, NDArray[Any]]:
    """Arrays of the episodes by ``EPISODE/KEY``.

    Args:
        content: of the pickle.
        depth: of lists and dicts at most.
        elements: of all lists at most.

    Raises:
        ContentError: it is no list of dicts of arrays.
    """
    if not isinstance(content, list | tuple) or not content:
        raise ContentError(f"holds {_describe(content)} instead of episodes")
    found: dict[str, NDArray[Any]] = {}
    for index, episode in enumerate(content):
        if not isinstance(episode, Mapping):
            raise ContentError(f"episode {index} is {_describe(episode)}")
        if not episode:
            raise ContentError(f"episode {index} is empty")
        for path, value in _leaves(episode, str(index), depth):
            elements -= _size(value, path, depth, elements)
            array = _array(value, path)
            if array is None:
                continue
            found[path] = array
            elements -= array.size
            if elements < 0:
                raise ContentError(f"episode {path} brings the file to too many numbers")
    return found


def _leaves(value: Any, path: str, depth: int) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, Mapping):
        yield path, value
    elif depth == 0:
        raise ContentError(f"episode {path} is nested too deeply")
    else:
        for key, entry in value.items():
            yield from _leaves(entry, f"{path}/{key}", depth - 1)


def _size(value: Any, path: str, depth: int, elements: int) -> int:
    """Entries of nested lists, counted until there are too many: numpy would not stop."""
    if not isinstance(value, list | tuple):
        return 1
    if depth == 0 or elements <= 0:
        raise ContentError(f"episode {path} is a list without end")
    count = 0
    for entry in value:
        count += _size(entry, path, depth - 1, elements - count)
    return count


def _array(value: Any, path: str) -> NDArray[Any] | None:
    """``value`` as numbers, None for what nobody asks for and is none (a name, a comment)."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ContentError(f"episode {path} is ragged ({error})") from error
    if array.dtype.kind in "fiub":
        return array
    if path.rpartition("/")[2] in _NUMBERS:
        raise ContentError(f"episode {path} has dtype {array.dtype}")
    return None


def _describe(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of shape {list(value.shape)}"
    return f"a {type(value).__name__}" + (" of length 0" if value in ([], (), {}) else "")


def _limit(size: int, seconds: int) -> None:
    # Not every system lets a process lower these; the parent's clock remains.
    for what, value in ((resource.RLIMIT_AS, size), (resource.RLIMIT_CPU, seconds)):
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(what, (value, value))
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main(path: str, size: int, seconds: int, depth: int, elements: int) -> int:
    """Write the arrays of the pickle ``path``; see the module's docstring."""
    _limit(size, seconds)
    try:
        with Path(path).open("rb") as stream:
            arrays = arrays_of(load_restricted(stream), depth, elements)
        output = io.BytesIO()
        named: dict[str, Any] = {f"_{key}": array for key, array in arrays.items()}
        np.savez(output, **named)
    # A damaged pickle fails in whatever opcode comes next: numpy's, the codecs', pickle's own.
    except Exception as error:
        text = str(error)
        whole = isinstance(error, ContentError)
        problem = text if whole else f"{type(error).__name__}: {text}"
        sys.stdout.write(
            json.dumps(
                {"problem": problem[:500], "whole": whole, "refused": "refused global" in text}
            )
        )
        return FAILED
    sys.stdout.buffer.write(output.getbuffer())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(int, sys.argv[2:6])))
