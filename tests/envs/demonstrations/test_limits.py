"""Every limit on files of others is asked, and the processes that open them first have theirs."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from envs.demonstrations import DemonstrationError, hdf5_probe, limits, open_source
from envs.demonstrations.children import run_child
from envs.demonstrations.files import read_json_file, read_npz, require_readable
from envs.demonstrations.readers import hdf5_layout
from tests.envs.demonstrations.files_of_others import (
    SCHEMA,
    toy_episode,
    write_dapg,
    write_flat,
    write_lerobot,
    write_npz,
)


def refusal(path: Path) -> str:
    with pytest.raises(DemonstrationError) as caught:
        open_source(path).load(SCHEMA)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# ---- what is read ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("write", "name"), [(write_flat, "d.h5"), (write_npz, "d.npz"), (write_dapg, "d.pickle")]
)
def test_a_file_that_is_too_large(
    write: Callable[..., Path], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = write(tmp_path / name, [toy_episode(0)])
    size = path.stat().st_size
    monkeypatch.setattr(limits, "MAX_FILE_BYTES", size - 1)
    with pytest.raises(DemonstrationError, match=f"has {size:,} bytes. At most {size - 1:,} are"):
        open_source(path).load(SCHEMA)
    monkeypatch.setattr(limits, "MAX_FILE_BYTES", size)
    assert len(open_source(path).load(SCHEMA)) == 1


def test_a_source_of_too_many_numbers_is_stopped_at_the_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # 6 rows of 3 observed and 5 of 2 actions are 28 numbers an episode.
    path = write_npz(tmp_path / "n.npz", [toy_episode(seed) for seed in range(3)])
    monkeypatch.setattr(limits, "MAX_TOTAL_ELEMENTS", 83)
    assert "n.npz, episode 2: brings the source to 84 numbers" in refusal(path)
    monkeypatch.setattr(limits, "MAX_TOTAL_ELEMENTS", 84)
    assert len(open_source(path).load(SCHEMA)) == 3


def test_a_pickle_of_too_many_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # Counted twice: as entries, and as the array that they become.
    demo = {key: np.zeros((5, width)) for key, width in (("observations", 3), ("actions", 2))}
    (tmp_path / "d.pickle").write_bytes(pickle.dumps([demo]))
    monkeypatch.setattr(limits, "MAX_ELEMENTS", 26)
    assert "0/actions brings the file to too many numbers" in refusal(tmp_path / "d.pickle")
    monkeypatch.setattr(limits, "MAX_ELEMENTS", 27)
    assert len(open_source(tmp_path / "d.pickle").load(SCHEMA)) == 1


def test_a_list_of_too_many_numbers_is_not_made_an_array(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    demo = {"observations": [[0.0] * 3] * 100, "actions": [[0.0] * 2] * 100}
    (tmp_path / "d.pickle").write_bytes(pickle.dumps([demo]))
    monkeypatch.setattr(limits, "MAX_ELEMENTS", 200)
    assert "0/observations is a list without end" in refusal(tmp_path / "d.pickle")


def test_an_hdf5_file_of_too_many_objects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = write_flat(tmp_path / "d.h5", [toy_episode(0)])  # five arrays
    monkeypatch.setattr(limits, "MAX_OBJECTS", 4)
    assert "lies 1 levels deep, behind 5 objects" in refusal(path)
    monkeypatch.setattr(limits, "MAX_OBJECTS", 5)
    assert len(open_source(path).load(SCHEMA)) == 1


def test_an_npz_file_of_too_many_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = write_npz(tmp_path / "n.npz", [toy_episode(0)])
    with zipfile.ZipFile(path) as archive:
        count = len(archive.namelist())
    monkeypatch.setattr(limits, "MAX_OBJECTS", count - 1)
    assert f"holds {count} arrays" in refusal(path)


def test_a_description_that_is_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pyarrow")
    write_lerobot(tmp_path / "d", [[toy_episode(0)]])
    size = (tmp_path / "d" / "meta" / "info.json").stat().st_size
    monkeypatch.setattr(limits, "MAX_JSON_BYTES", size - 1)
    assert "has a damaged description (too long)" in refusal(tmp_path / "d")


def test_a_card_that_is_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from envs.demonstrations import write_recording

    path = tmp_path / "r.h5"
    write_recording(path, [toy_episode(0)], {"made by": "x" * 100})
    monkeypatch.setattr(limits, "MAX_JSON_BYTES", 100)
    assert "has a damaged card" in refusal(path)


# ---- by whom ---------------------------------------------------------------------------------


def parquet(path: Path) -> Path:
    pytest.importorskip("pyarrow")
    write_lerobot(path, [[toy_episode(0)]])
    return next(path.glob("data/**/*.parquet"))


PROBES = {
    "hdf5_probe": lambda folder: write_flat(folder / "d.h5", [toy_episode(0)]),
    "parquet_probe": lambda folder: parquet(folder / "d"),
    "unpickling_worker": lambda folder: write_dapg(folder / "d.pickle", [toy_episode(0)]),
}


@pytest.mark.parametrize("name", PROBES)
def test_a_process_that_opens_a_file_has_limits_of_its_own(name: str, tmp_path: Path):
    """Of memory, of processor time, and of what it leaves behind when it crashes."""
    folder = Path(limits.__file__).parent
    size, seconds = 2**44, 77
    script = (
        f"import resource, sys; sys.path.insert(0, {str(folder)!r}); import {name}\n"
        f"{name}.main(sys.argv[1], {size}, {seconds}{', 16, 1000' if name[0] == 'u' else ''})\n"
        "of = (resource.RLIMIT_AS, resource.RLIMIT_CPU, resource.RLIMIT_CORE)\n"
        "print([resource.getrlimit(one) for one in of], file=sys.stderr)\n"
    )
    path = PROBES[name](tmp_path)
    done = subprocess.run([sys.executable, "-P", "-c", script, str(path)], capture_output=True)
    assert done.stderr.decode().strip() == str([(size, size), (seconds, seconds), (0, 0)])


def test_it_is_told_how_much(tmp_path: Path):
    (script := tmp_path / "script.py").write_text("import sys; print(sys.argv[1:])")
    (path := tmp_path / "file").write_bytes(b"x" * 1000)
    with (tmp_path / "told").open("wb") as output:
        assert run_child(str(script), path, 7, output=output) == 0
    told = [str(path), str(limits.CHILD_BYTES + 10_000), str(int(limits.CHILD_SECONDS) + 1), "7"]
    assert (tmp_path / "told").read_text().strip() == str(told)


def test_the_folder_of_its_script_shadows_nobodys_modules(tmp_path: Path):
    (script := tmp_path / "script.py").write_text("import zipfile")
    (tmp_path / "zipfile.py").write_text("raise SystemExit(5)")
    assert run_child(str(script), script) == 0


def external_link(file: h5py.File, fifo: Path) -> None:
    file["rewards"] = h5py.ExternalLink(str(fifo), "/rewards")


def external_storage(file: h5py.File, fifo: Path) -> None:
    file.create_dataset("rewards", (5,), "f8", external=[(fifo, 0, 40)])


def virtual_dataset(file: h5py.File, fifo: Path) -> None:
    layout = h5py.VirtualLayout((5,), "f8")
    layout[:] = h5py.VirtualSource(fifo, "rewards", (5,))
    file.create_virtual_dataset("rewards", layout)


@pytest.mark.parametrize(
    ("point", "problem"),
    [
        (external_link, "is a link into another file"),
        (external_storage, "keeps its data in another file"),
        (virtual_dataset, "keeps its data in another file"),
    ],
)
def test_it_follows_nothing_out_of_the_file_either(
    point: Callable[[h5py.File, Path], None], problem: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):  # fmt: skip
    """Opening a pipe waits for whoever writes into it, here for ever."""
    os.mkfifo(tmp_path / "pipe")
    path = write_flat(tmp_path / "d.h5", [toy_episode(0)], rewards=None)
    with h5py.File(path, "r+") as file:
        point(file, tmp_path / "pipe")
    monkeypatch.setattr(limits, "CHILD_SECONDS", 40.0)
    assert f"/rewards: {problem}" in refusal(path)


def test_it_reads_small_arrays_whole_and_the_ends_of_large_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = write_flat(tmp_path / "d.h5", [toy_episode(0)])
    read: list[tuple[str, object]] = []
    get = h5py.Dataset.__getitem__

    def watched(data: h5py.Dataset, key: object) -> object:
        read.append((data.name, key))
        return get(data, key)

    monkeypatch.setattr(h5py.Dataset, "__getitem__", watched)
    monkeypatch.setattr(hdf5_probe, "WHOLE", 10)
    with h5py.File(path, "r") as file:
        for name in ("actions", "observations"):  # 5 * 2 and 5 * 3 entries
            hdf5_probe.touch(file[name])
    ends = [("/observations", slice(None, 1)), ("/observations", slice(-1, None))]
    assert read == [("/actions", ()), *ends]


# ---- what is opened --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "read",
    [
        lambda path: read_npz(path, str(path)),
        lambda path: read_json_file(path, "description"),
        lambda path: require_readable(path, hdf5_probe.__file__),
    ],
    ids=["npz", "json", "hdf5"],
)
def test_nothing_is_read_out_of_a_pipe(
    read: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(limits, "CHILD_SECONDS", 20.0)
    # Without the look at it, reading would wait for ever: somebody writes into it and ends that.
    done = threading.Event()
    writer = threading.Thread(target=end_of_pipe, args=(tmp_path / "pipe", done))
    writer.start()
    try:
        with pytest.raises(DemonstrationError, match="is not a plain file"):
            read(tmp_path / "pipe")
    finally:
        done.set()
        writer.join()


def end_of_pipe(path: Path, done: threading.Event) -> None:
    while not done.wait(0.2):
        with contextlib.suppress(OSError):  # nobody reads
            os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))


def test_a_file_that_kills_its_reader_is_not_looked_into(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = write_flat(tmp_path / "d.h5", [toy_episode(0)])
    assert hdf5_layout.peek(path, lambda file: "actions" in file)
    (script := tmp_path / "probe.py").write_text("import os; os.kill(os.getpid(), 11)")
    monkeypatch.setattr(hdf5_probe, "__file__", str(script))
    assert not hdf5_layout.peek(path, lambda file: pytest.fail("opened"))


def test_names_behind_a_link_are_not_asked_for(tmp_path: Path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data/demo_0/actions"] = np.zeros(3)
    with h5py.File(tmp_path / "d.h5", "w") as file:
        file["data"] = h5py.ExternalLink("other.h5", "/data")
        file["own/demo_0/actions"] = np.zeros(3)
        assert list(file["data"]) == ["demo_0"]
        assert hdf5_layout.group_names(file, "data") == []
        assert hdf5_layout.group_names(file, "own") == ["demo_0"]
        assert hdf5_layout.group_names(file, "none") == []


def bomb(folder: Path) -> None:
    with h5py.File(folder / "main_data.hdf5", "w") as file:
        file.create_dataset("episode_0/actions", (10_000_000, 3), "f8", chunks=(1000, 3))


def pipe(folder: Path) -> None:
    (folder / "main_data.hdf5").write_bytes(b"")
    os.mkfifo(folder / "a_picture.png")


def torn(folder: Path) -> None:
    (folder / "metadata.json").write_text('{"total_episodes": ')


def test_a_parquet_file_that_declares_more_than_it_can_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = parquet(tmp_path / "d")
    monkeypatch.setattr(limits, "FREE_BYTES", 0)
    monkeypatch.setattr(limits, "MAX_EXPANSION", 0)
    assert f"{path}: declares " in refusal(tmp_path / "d")


@pytest.mark.parametrize(
    ("harm", "problem"),
    [
        (bomb, "episode_0/actions: declares 240,000,000 bytes and holds 0"),
        (pipe, "a_picture.png: is not a plain file"),
        (torn, "metadata.json: has a damaged description"),
    ],
)
def test_a_minari_dataset_is_looked_at_before_minari_opens_it(
    harm: Callable[[Path], None], problem: str, tmp_path: Path
):
    pytest.importorskip("minari")
    (tmp_path / "d" / "data").mkdir(parents=True)
    harm(tmp_path / "d" / "data")
    assert problem in refusal(tmp_path / "d")
