"""The project's own recordings: what is written comes back, whole or not at all."""

from __future__ import annotations

import errno
import json
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from envs.demonstrations import (
    DemonstrationError,
    Provenance,
    content_hash,
    read_card,
    read_recording,
    write_recording,
)
from envs.door.demos import SCHEMA
from tests.envs.demonstrations.helpers import still_episode


@contextmanager
def at_most(size: int) -> Iterator[None]:
    """No file can grow beyond ``size`` bytes: writing fails in its middle, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [0, 1000, 20_000])
def test_a_recording_that_cannot_be_written_whole_is_one_error_that_names_it(
    tmp_path: Path, size: int
):
    """HDF5 would go on, and could end the process."""
    path = tmp_path / "a.h5"
    path.touch()
    with at_most(size), pytest.raises(OSError, match="too large") as failed:
        write_recording(path, [far_episode()] * 20, {})
    assert (failed.value.errno, failed.value.filename) == (errno.EFBIG, str(path))
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_size == 0


def far_episode():
    """An episode that ends at a terminal observation."""
    episode = still_episode(seed=3, door_position=None, qpos=np.linspace(0, 1, 30))
    episode.observations[-1, 35:38] = 2.0
    episode.terminated[-1] = True
    return episode


def test_comes_back_bit_for_bit(tmp_path: Path) -> None:
    noisy = still_episode(2, steps=3, executed_actions=np.full((3, 28), 0.25, np.float32))
    written = [still_episode(0, steps=4), still_episode(1, steps=9), far_episode(), noisy]
    write_recording(tmp_path / "new" / "r.h5", written, {"checkpoint": "abc", "return": 1.5})
    read = read_recording(tmp_path / "new" / "r.h5", SCHEMA)
    assert content_hash(read) == content_hash(written)
    assert [e.provenance for e in read] == [e.provenance for e in written]
    assert read_card(tmp_path / "new" / "r.h5") == {"checkpoint": "abc", "return": 1.5}


def test_more_than_ten_episodes_keep_their_order(tmp_path: Path) -> None:
    written = [still_episode(i, steps=2) for i in range(12)]
    write_recording(tmp_path / "r.h5", written, {})
    assert [e.provenance.episode for e in read_recording(tmp_path / "r.h5", SCHEMA)] == list(
        range(12)
    )


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_recording(path, [still_episode()], {"version": 1})
    with pytest.raises(TypeError):
        write_recording(path, [still_episode(1)], {"version": object()})
    assert read_card(path) == {"version": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_is_compressed(tmp_path: Path) -> None:
    zeros = np.zeros((1001, 38), dtype=np.float32)
    write_recording(tmp_path / "r.h5", [still_episode(steps=1000, observations=zeros)], {})
    raw_size = zeros.nbytes + 1000 * 28 * 4
    assert (tmp_path / "r.h5").stat().st_size < 0.9 * raw_size


def test_refuses_to_write_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="without episodes"):
        write_recording(tmp_path / "r.h5", [], {})


@pytest.mark.parametrize("share", [0.0, 0.1, 0.6, 0.95])
def test_truncated_file(tmp_path: Path, share: float) -> None:
    path = tmp_path / "r.h5"
    write_recording(path, [still_episode(steps=200)], {})
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DemonstrationError, match="not a readable HDF5 file"):
        read_recording(path, SCHEMA)


def test_damaged_data(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_recording(path, [still_episode(steps=200)], {})
    with h5py.File(path) as file:
        chunk = file["episode_00000/observations"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    start = chunk.byte_offset
    content[start : start + chunk.size] = bytes(chunk.size)
    path.write_bytes(content)
    with pytest.raises(DemonstrationError, match=r"episode_00000.*cannot read observations"):
        read_recording(path, SCHEMA)


def test_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_recording(path, [still_episode()], {})
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 99
    with pytest.raises(DemonstrationError, match="format version 99"):
        read_recording(path, SCHEMA)


@pytest.mark.parametrize("text", ["not json", json.dumps({"source": "x"}), json.dumps([1, 2])])
def test_damaged_provenance_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "r.h5"
    write_recording(path, [still_episode()], {})
    with h5py.File(path, "r+") as file:
        file["episode_00000"].attrs["provenance"] = text
    with pytest.raises(DemonstrationError, match="provenance"):
        read_recording(path, SCHEMA)


def test_missing_array_is_named(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    write_recording(path, [still_episode()], {})
    with h5py.File(path, "r+") as file:
        del file["episode_00000/actions"]
    with pytest.raises(DemonstrationError, match=r"episode_00000.*lacks actions"):
        read_recording(path, SCHEMA)


def test_content_hash_sees_every_field() -> None:
    base = still_episode()
    observations = base.observations.copy()
    observations[3, 3] += 1e-3
    variants = [
        base,
        still_episode(observations=observations),
        still_episode(rewards=base.rewards + 1),
        still_episode(actions=-base.actions),
        still_episode(door_position=None),
        still_episode(qpos=np.zeros(30)),
        still_episode(qvel=np.zeros(30)),
        still_episode(executed_actions=base.actions),
        still_episode(provenance=Provenance("synthetic", 0, "policy", {"seed": 0})),
        still_episode(provenance=Provenance("synthetic", 0, "recorded", {"seed": 1})),
    ]
    assert len({content_hash([variant]) for variant in variants}) == len(variants)
    assert content_hash([base, variants[1]]) != content_hash([variants[1], base])


def test_the_hash_of_an_episode_is_the_same_on_every_machine() -> None:
    """Caches are filed under it."""
    assert content_hash([still_episode()]).startswith("1372c691abc295d3")


@pytest.mark.parametrize(
    ("executed", "message"),
    [
        (np.zeros((9, 28)), "has 9 executed_actions for 10 actions"),
        (np.full((10, 28), 7.0), "magnitude 7"),
        (np.zeros((10, 3)), r"actions has shape \[10, 3\]"),
    ],
)
def test_executed_actions_are_checked(tmp_path: Path, executed: np.ndarray, message: str) -> None:
    write_recording(tmp_path / "r.h5", [still_episode(executed_actions=executed)], {})
    with pytest.raises(DemonstrationError, match=message):
        read_recording(tmp_path / "r.h5", SCHEMA)
