"""Files that are made to do harm: refused in one line, before anything is allocated or followed."""

from __future__ import annotations

import pickle
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from envs.demonstrations import DemonstrationError, limits, open_source, write_recording
from envs.demonstrations.readers import lerobot
from tests.envs.demonstrations.files_of_others import (
    SCHEMA,
    assert_same,
    toy_episode,
    write_dapg,
    write_flat,
    write_lerobot,
)


def refusal(path: Path) -> str:
    """What loading ``path`` says, which must be one line that names it."""
    with pytest.raises(DemonstrationError) as caught:
        open_source(path).load(SCHEMA)
    assert "\n" not in str(caught.value)
    assert path.name in str(caught.value)
    return str(caught.value)


def changed(change: Callable[[h5py.File], None], path: Path) -> Path:
    write_flat(path, [toy_episode(0)])
    with h5py.File(path, "r+") as file:
        change(file)
    return path


# ---- HDF5 ------------------------------------------------------------------------------------


def replace(key: str, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[key]
        file[key] = value

    return change


def test_a_link_into_another_file_is_not_followed(tmp_path: Path):
    write_flat(tmp_path / "other.h5", [toy_episode(1)])
    path = changed(replace("rewards", h5py.ExternalLink("other.h5", "/rewards")), tmp_path / "d.h5")
    assert "/rewards: is a link into another file ('other.h5')" in refusal(path)


@pytest.mark.parametrize("key", ["terminals", "data"])
def test_a_link_in_a_circle(tmp_path: Path, key: str):
    def change(file: h5py.File) -> None:
        file.pop(key, None)
        file[key] = h5py.SoftLink(f"/{key}")

    assert f"/{key}: leads nowhere" in refusal(changed(change, tmp_path / "d.h5"))


def test_a_link_within_the_file_is_followed(tmp_path: Path):
    def change(file: h5py.File) -> None:
        file.move("rewards", "kept")
        file["rewards"] = h5py.SoftLink("/kept")

    episodes = open_source(changed(change, tmp_path / "d.h5")).load(SCHEMA)
    assert_same(episodes, [toy_episode(0).first_steps(4)], "rewards")


def test_a_group_that_holds_itself_ends(tmp_path: Path):
    def change(file: h5py.File) -> None:
        file.create_group("infos")
        file["infos/again"] = file["infos"]

    assert len(open_source(changed(change, tmp_path / "d.h5")).load(SCHEMA)) == 1


def test_data_in_another_file(tmp_path: Path):
    (tmp_path / "raw.bin").write_bytes(np.zeros(5).tobytes())

    def change(file: h5py.File) -> None:
        del file["rewards"]
        file.create_dataset("rewards", (5,), "f8", external=[(tmp_path / "raw.bin", 0, 40)])

    path = changed(change, tmp_path / "d.h5")
    assert "/rewards: keeps its data in another file" in refusal(path)


def test_a_virtual_dataset(tmp_path: Path):
    write_flat(tmp_path / "other.h5", [toy_episode(1)])

    def change(file: h5py.File) -> None:
        del file["rewards"]
        layout = h5py.VirtualLayout((5,), "f4")
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "rewards", (5,))
        file.create_virtual_dataset("rewards", layout)

    path = changed(change, tmp_path / "d.h5")
    assert "/rewards: keeps its data in another file" in refusal(path)


def test_references(tmp_path: Path):
    def change(file: h5py.File) -> None:
        reference = file["actions"].ref
        replace("rewards", np.array([reference] * 5, dtype=h5py.ref_dtype))(file)

    assert "/rewards: holds references" in refusal(changed(change, tmp_path / "d.h5"))


def test_too_deep(tmp_path: Path):
    deep = "/".join(["g"] * (limits.MAX_DEPTH + 2))
    path = changed(lambda file: file.create_group(deep), tmp_path / "d.h5")
    assert f"lies {limits.MAX_DEPTH + 1} levels deep" in refusal(path)


@pytest.mark.parametrize(
    ("shape", "problem"),
    [
        # 10^9 rows are beyond the limit of 2^29 entries; 3 * 10^7 float64 are 240 MB, not stored.
        ((1_000_000_000, 3), r"has shape [1000000000, 3]"),
        ((10_000_000, 3), "declares 240,000,000 bytes and holds 0"),
    ],
)
def test_a_shape_without_data(tmp_path: Path, shape: tuple[int, int], problem: str):
    def change(file: h5py.File) -> None:
        del file["observations"]
        file.create_dataset("observations", shape, "f8", chunks=(1000, 3))

    assert problem in refusal(changed(change, tmp_path / "d.h5"))


@pytest.mark.parametrize(
    ("attribute", "value", "problem"),
    [
        ("format_version", None, "format version None"),
        ("format_version", np.arange(3), "format version [0 1 2]"),
        ("format", np.arange(3), "a layout that nobody knows"),
        ("card", "[" * 100_000, "has a damaged card"),
        ("card", "[]", "has a damaged card"),
    ],
)
def test_a_recording_with_damaged_attributes(
    tmp_path: Path, attribute: str, value: object, problem: str
):
    path = tmp_path / "r.h5"
    write_recording(path, [toy_episode(0)], {})
    with h5py.File(path, "r+") as file:
        del file.attrs[attribute]
        if value is not None:
            # Beyond 64 KiB an attribute needs the dense storage of new files.
            text = isinstance(value, str) and len(value) > 60_000
            file.attrs[attribute] = value[:60_000] if text else value
    assert problem in refusal(path)


@pytest.mark.parametrize(
    "provenance",
    ['{"source": 1, "episode": 0, "kind": "recorded"}',
     '{"source": "x", "episode": 0, "kind": "recorded", "details": {"a": [1]}}',
     '{"source": "x", "episode": 0, "kind": "made up"}'],
)  # fmt: skip
def test_a_recording_with_a_damaged_provenance(tmp_path: Path, provenance: str):
    path = tmp_path / "r.h5"
    write_recording(path, [toy_episode(0)], {})
    with h5py.File(path, "r+") as file:
        file["episode_00000"].attrs["provenance"] = provenance
    assert "has a damaged provenance" in refusal(path)


# ---- npz -------------------------------------------------------------------------------------


def npy(header: str, body: bytes = b"") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + body


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 2)}"), "has shape"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (20000000, 2)}"), "declares 320,"),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (9, 2)}"), "is shorter than"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (9, 2)}"), "has dtype object"),
        (npy("__import__('os').system('true')"), "is not a readable npz file"),
        (b"nothing", "is not a readable npz file"),
    ],
)
def test_npz_members(tmp_path: Path, content: bytes, problem: str):
    path = tmp_path / "n.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("actions.npy", content)
    assert problem in refusal(path)


# ---- DAPG ------------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_dapg_of_python_3(tmp_path: Path, protocol: int):
    written = [toy_episode(0), toy_episode(1, steps=7)]
    path = write_dapg(tmp_path / "d.pickle", written, protocol)
    assert_same(open_source(path).load(SCHEMA), written, "observations", "actions", "rewards")


def test_dapg_of_another_numpy_names_its_functions_by_another_module(tmp_path: Path):
    path = write_dapg(tmp_path / "d.pickle", [toy_episode(0)], protocol=2)
    content = path.read_bytes()
    ours, other = (b"numpy._core.multiarray", b"numpy.core.multiarray")  # since NumPy 2, before
    if ours not in content:
        ours, other = other, ours
    assert ours in content
    path.write_bytes(content.replace(ours, other))
    assert_same(open_source(path).load(SCHEMA), [toy_episode(0)], "observations")


def test_dapg_with_names_scalars_and_nested_states(tmp_path: Path):
    from envs.demonstrations import DemoSchema, StartKey

    episode = toy_episode(0)
    demo = {
        "observations": episode.observations,
        "actions": episode.actions.tolist(),
        "rewards": [np.float64(r) for r in episode.rewards],
        "env_name": "pen-v0",
        "init_state_dict": {"qpos": np.arange(4.0), "desired_orien": np.ones(4)},
    }
    (tmp_path / "d.pickle").write_bytes(pickle.dumps([demo], protocol=2))
    schema = DemoSchema(
        describes="the toy",
        observation_size=3,
        action_size=2,
        start=(StartKey("orientation", 4, ("desired_orien",)), StartKey("qpos", 4)),
    )
    (read,) = open_source(tmp_path / "d.pickle").load(schema)
    assert_same([read], [episode], "observations", "actions", "rewards")
    assert read.start["qpos"].tolist() == [0, 1, 2, 3]
    assert read.start["orientation"].tolist() == [1, 1, 1, 1]


def crashing() -> bytes:
    """An array of 1,872 bytes whose dtype calls each of its 234 entries 10^6 numbers."""
    dtype = b"cnumpy\ndtype\nX\x02\x00\x00\x00f8\x89\x88\x87R"
    rest = b"NNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    plain = dtype + b"(K\x03X\x01\x00\x00\x00<N" + rest
    # The state names a subarray, (float64, (10^6,)), in a dtype that stays 8 bytes long.
    lying = dtype + b"(K\x03X\x01\x00\x00\x00<" + plain + b"J\x40\x42\x0f\x00\x85\x86" + rest
    memory = b"c_codecs\nencode\nX\x50\x07\x00\x00" + b"A" * 1872
    memory += b"X\x06\x00\x00\x00latin1\x86R"
    array = b"cnumpy\nndarray\nK\x06K\x27\x86" + lying + memory + b"\x87R"
    return b"\x80\x02]}X\x0c\x00\x00\x00observations" + array + b"sa."


def test_a_pickle_that_takes_its_process_down_takes_down_no_other(tmp_path: Path):
    (tmp_path / "d.pickle").write_bytes(crashing())
    assert "ends the process that reads it (SIGSEGV)" in refusal(tmp_path / "d.pickle")


def test_a_list_that_holds_itself(tmp_path: Path):
    endless: list = []
    endless += [endless, endless]
    demo = {"observations": endless, "actions": np.zeros((5, 2))}
    (tmp_path / "d.pickle").write_bytes(pickle.dumps([demo]))
    assert "episode 0/observations is a list without end" in refusal(tmp_path / "d.pickle")


def test_a_dict_that_holds_itself(tmp_path: Path):
    endless: dict = {"observations": np.zeros((6, 3)), "actions": np.zeros((5, 2))}
    endless["init_state_dict"] = endless
    (tmp_path / "d.pickle").write_bytes(pickle.dumps([endless]))
    assert "is nested too deeply" in refusal(tmp_path / "d.pickle")


def test_a_pickle_that_never_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(limits, "CHILD_SECONDS", 1.0)
    # Each list holds the one before twice: 2^60 hashes for a frozenset of tuples.
    nested = b"\x80\x04(K\x01t\x94" + b"".join(
        b"h" + bytes([i]) + b"h" + bytes([i]) + b"\x86\x94" for i in range(60)
    )
    (tmp_path / "d.pickle").write_bytes(nested + b"}h\x3cK\x00s.")
    assert "is not read within 1 s" in refusal(tmp_path / "d.pickle")


def test_a_pickle_that_takes_all_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(limits, "CHILD_BYTES", 2**30)
    # One zero, announced to numpy as 2^28 of them: 2 GiB.
    dtype = b"cnumpy\ndtype\nX\x02\x00\x00\x00f8\x89\x88\x87R"
    array = b"cnumpy\nndarray\nJ\x00\x00\x00\x10\x85" + dtype + b"\x86R"
    (tmp_path / "d.pickle").write_bytes(b"\x80\x02]}X\x07\x00\x00\x00actions" + array + b"sa.")
    assert "is not a complete pickle (" in (told := refusal(tmp_path / "d.pickle"))
    assert "MemoryError" in told


def test_an_hdf5_file_is_first_read_by_a_process_that_may_die(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = write_flat(tmp_path / "d.h5", [toy_episode(0)])
    monkeypatch.setattr(limits, "CHILD_SECONDS", 0.001)
    assert "is not read within" in refusal(path)


def test_a_parquet_file_is_first_read_by_a_process_that_may_die(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("pyarrow")
    write_lerobot(tmp_path / "d", [[toy_episode(0)]])
    (script := tmp_path / "probe.py").write_text("import os; os.kill(os.getpid(), 11)")
    monkeypatch.setattr(lerobot, "_PROBE", str(script))
    assert "ends the process that reads it (SIGSEGV)" in refusal(tmp_path / "d")
