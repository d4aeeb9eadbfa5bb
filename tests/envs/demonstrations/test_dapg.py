"""The DAPG pickle: what is kept of it, and what is refused."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from envs.demonstrations import DemonstrationError
from envs.demonstrations.readers.dapg import DapgSource
from envs.door.demos import SCHEMA
from tests.envs.demonstrations.helpers import DOOR, raw_demo, write_pickle


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_keeps_the_task_part_of_every_episode(tmp_path: Path, protocol: int) -> None:
    demos = [raw_demo(0), raw_demo(1, steps=7)]
    first, second = DapgSource(write_pickle(tmp_path / "d.pickle", demos, protocol)).load(SCHEMA)
    assert (first.length, second.length) == (11, 6)
    np.testing.assert_array_equal(first.observations, np.float32(demos[0]["observations"][:, :38]))
    np.testing.assert_array_equal(first.actions, np.float32(demos[0]["actions"][:-1]))
    np.testing.assert_array_equal(second.rewards, np.float32(demos[1]["rewards"][:-1]))
    np.testing.assert_array_equal(second.start["door_position"], DOOR + 0.01)
    np.testing.assert_array_equal(first.start["qpos"], np.zeros(30))
    assert second.provenance.source == "d.pickle"
    assert second.provenance.episode == 1
    assert second.provenance.kind == "recorded"


def test_reads_python_2_strings(tmp_path: Path) -> None:
    # Python 2 wrote array bytes as 8-bit strings (opcode U), which Python 3 never writes.
    array = np.arange(3, dtype="<f8")
    body = array.tobytes()
    stream = (
        b"\x80\x02cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        b"(K\x01K\x03\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xff"
        b"J\xff\xff\xff\xffK\x00tb\x89U" + bytes([len(body)]) + body + b"tb."
    )
    path = tmp_path / "d.pickle"
    path.write_bytes(stream)
    with pytest.raises(DemonstrationError, match=r"an array of shape \[3\] instead of episodes"):
        DapgSource(path).load(SCHEMA)


class _Bomb:
    def __init__(self, marker: Path, function: object) -> None:
        self.marker, self.function = marker, function

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return self.function, (f"touch {self.marker}",)


@pytest.mark.parametrize("function", [os.system, eval, exec, print])
def test_malicious_pickle_is_refused_and_does_not_run(
    tmp_path: Path, function: object, capsys: pytest.CaptureFixture[str]
) -> None:
    marker = tmp_path / "executed"
    demo = raw_demo() | {"extra": [_Bomb(marker, function)]}
    path = write_pickle(tmp_path / "d.pickle", [demo])
    with pytest.raises(DemonstrationError, match="would run code when opened") as caught:
        DapgSource(path).load(SCHEMA)
    assert str(path) in str(caught.value)
    assert "refused global" in str(caught.value)
    assert not marker.exists()
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("module", "name"),
    [("numpy", "load"), ("numpy", "core.multiarray"), ("builtins", "getattr"), ("numpy", "memmap")],
)
def test_every_other_global_is_refused(tmp_path: Path, module: str, name: str) -> None:
    path = tmp_path / "d.pickle"
    path.write_bytes(b"\x80\x02c" + f"{module}\n{name}\n".encode() + b".")
    with pytest.raises(DemonstrationError, match=f"refused global {module}.{name}"):
        DapgSource(path).load(SCHEMA)


def test_codecs_are_limited_to_latin1(tmp_path: Path) -> None:
    path = tmp_path / "d.pickle"
    path.write_bytes(b"\x80\x02c_codecs\nencode\nX\x01\x00\x00\x00aX\x05\x00\x00\x00rot13\x86R.")
    with pytest.raises(DemonstrationError, match=r"refused global _codecs\.encode with 'rot13'"):
        DapgSource(path).load(SCHEMA)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.999])
def test_truncated_pickle(tmp_path: Path, share: float) -> None:
    whole = pickle.dumps([raw_demo()], protocol=2)
    path = tmp_path / "d.pickle"
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DemonstrationError, match="is not a complete pickle"):
        DapgSource(path).load(SCHEMA)


def test_not_a_pickle_at_all(tmp_path: Path) -> None:
    path = tmp_path / "d.pickle"
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(DemonstrationError, match="is not a complete pickle"):
        DapgSource(path).load(SCHEMA)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ({}, "a dict"),
        ([], "a list of length 0"),
        ([3], "is a int"),
        ([{"actions": np.zeros((3, 28))}], "lacks observations"),
    ],
)
def test_wrong_content(tmp_path: Path, content: object, problem: str) -> None:
    path = write_pickle(tmp_path / "d.pickle", content)
    with pytest.raises(DemonstrationError, match=problem):
        DapgSource(path).load(SCHEMA)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DemonstrationError, match="No such file"):
        DapgSource(tmp_path / "absent.pickle").load(SCHEMA)


def test_the_bad_episode_is_named(tmp_path: Path) -> None:
    bad = raw_demo(1)
    bad["actions"][4, 7] = np.nan
    path = write_pickle(tmp_path / "d.pickle", [raw_demo(0), bad])
    with pytest.raises(DemonstrationError, match=r"episode 1: actions\[4, 7\] is nan"):
        DapgSource(path).load(SCHEMA)
