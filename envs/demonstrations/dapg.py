"""The published DAPG pickle (Rajeswaran et al., 2018), read without running what is inside it."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.validation import RawEpisode, build_episode, require_keys

_EXPECTED = "Expected the DAPG format: a list of dicts with observations, actions and rewards"


def _encode_latin1(text: str, encoding: str) -> bytes:
    # Python 3 spells the bytes of an array so in protocol 2. The real `_codecs.encode` takes any
    # codec name, decompressors among them; arrays need this one only.
    if encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError(f"refused global _codecs.encode with {encoding!r}")
    return text.encode("latin1")


# numpy itself says what rebuilds its arrays, up to pickle protocol 4 and from 5 on. The files name
# these functions by the module they lived in at the time of writing (numpy.core became _core).
_RECONSTRUCT = np.empty(0).__reduce__()[0]
_FROM_BUFFER = np.empty(1).__reduce_ex__(5)[0]

# Anything else a pickle can name it can also call: that is how opening a file runs somebody's code.
_ALLOWED_GLOBALS: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("_codecs", "encode"): _encode_latin1,
    ("numpy.core.multiarray", "_reconstruct"): _RECONSTRUCT,
    ("numpy._core.multiarray", "_reconstruct"): _RECONSTRUCT,
    ("numpy.core.numeric", "_frombuffer"): _FROM_BUFFER,
    ("numpy._core.numeric", "_frombuffer"): _FROM_BUFFER,
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


class DapgSource:
    """Episodes of a DAPG demonstration pickle.

    The file is a list of dicts with ``observations`` [T, 39], ``actions`` [T, 28], ``rewards`` [T]
    and ``init_state_dict`` (``qpos`` [30], ``qvel`` [30], ``door_body_pos`` [3]); see
    `envs.demonstrations.validation.build_episode` for what is kept of it.

    Args:
        path: the ``.pickle`` or ``.pkl`` file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = self.path.name

    def load(self) -> list[Episode]:
        """Read, check and return all episodes.

        Raises:
            DemonstrationError: the file is missing, truncated, refuses the restricted unpickler, or
                does not hold episodes of the door task.
        """
        content = self._unpickle()
        if not isinstance(content, list | tuple) or not content:
            raise DemonstrationError(
                self.path, f"holds {_describe(content)} instead of episodes", _EXPECTED
            )
        return [self._episode(index, entry) for index, entry in enumerate(content)]

    def _unpickle(self) -> Any:
        try:
            with self.path.open("rb") as stream:
                return load_restricted(stream)
        except OSError as error:
            raise DemonstrationError(
                self.path, f"cannot be read ({error.strerror})", "Check the path in DEMOS"
            ) from error
        except pickle.UnpicklingError as error:
            if "refused global" not in str(error):
                raise self._corrupt(error) from error
            raise DemonstrationError(
                self.path,
                f"would run code when opened: {error}",
                "Only numpy arrays in plain containers are accepted; get the file from its "
                "publisher, or convert it to HDF5 if you trust it",
            ) from error
        # A damaged pickle fails in whatever opcode comes next: numpy's, the codecs', pickle's own.
        except Exception as error:
            raise self._corrupt(error) from error

    def _corrupt(self, error: Exception) -> DemonstrationError:
        return DemonstrationError(
            self.path,
            f"is not a complete pickle ({type(error).__name__}: {error})",
            "Download it again and compare its checksum",
        )

    def _episode(self, index: int, entry: Any) -> Episode:
        where = f"{self.path}, episode {index}"
        if not isinstance(entry, Mapping):
            raise DemonstrationError(where, f"is {_describe(entry)}", _EXPECTED)
        require_keys(entry, ("observations", "actions"), where, _EXPECTED)
        state = entry.get("init_state_dict")
        state = state if isinstance(state, Mapping) else {}
        raw = RawEpisode(
            observations=entry["observations"],
            actions=entry["actions"],
            rewards=entry.get("rewards"),
            door_position=state.get("door_body_pos"),
            qpos=state.get("qpos"),
            qvel=state.get("qvel"),
        )
        return build_episode(raw, Provenance(self.name, index, "recorded"), where)


def _describe(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of shape {list(value.shape)}"
    return f"a {type(value).__name__}" + (" of length 0" if value in ([], ()) else "")
