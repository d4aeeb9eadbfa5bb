"""What is written in any format is read as the same episodes."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from envs.demonstrations import (
    DemonstrationError,
    DemoSchema,
    Notes,
    StartKey,
    find_writer,
    open_source,
    read_card,
    write_demonstrations,
)
from tests.envs.demonstrations.files_of_others import assert_same, toy_episode

SCHEMA = DemoSchema(
    describes="the toy", observation_size=3, action_size=2, start=(StartKey("seat", 2),)
)
EVERYTHING = ("observations", "actions", "rewards", "terminated", "success", "progress")


def some_episodes():
    ended = toy_episode(1, steps=7, success=np.arange(8) == 0)
    ended.terminated[-1] = True
    starts = [{"seat": np.array([i, 0.5])} for i in range(3)]
    return [
        toy_episode(0, start=starts[0]),
        toy_episode(1, steps=7, start=starts[1], terminated=ended.terminated),
        # Succeeds at the beginning only: the format must not forget the first observation's flag.
        toy_episode(2, steps=1, start=starts[2], success=np.array([True, False])),
    ]


def outs(tmp_path: Path) -> dict[str, str]:
    return {
        "recording": str(tmp_path / "a" / "x.h5"),
        "d4rl": str(tmp_path / "b" / "x.hdf5"),
        "minari": "minari:toy/mine-v0",
    }


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("form", ["recording", "d4rl", "minari"])
def test_round_trip(form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if form == "minari":
        pytest.importorskip("minari", reason="the minari extra is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    written, notes = some_episodes(), Notes()
    out = outs(tmp_path)[form]
    write_demonstrations(out, written, {"made_by": "a test"}, SCHEMA)
    read = open_source(out).load(SCHEMA, notes)
    assert_same(read, written, *EVERYTHING)
    assert [e.start["seat"].tolist() for e in read] == [[0, 0.5], [1, 0.5], [2, 0.5]]
    assert not notes.findings(out).found


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("form", ["d4rl", "minari"])
def test_others_get_the_environments_units(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    if form == "minari":
        pytest.importorskip("minari", reason="the minari extra is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    schema = DemoSchema("toy", 3, 2, action_low=(-2.0, 0.0), action_high=(2.0, 10.0))
    episode = toy_episode(0, steps=2, actions=np.float32([[-1, 0.5], [0.25, 1]]))
    out = outs(tmp_path)[form]
    write_demonstrations(out, [episode], {}, schema)
    data = tmp_path / "toy" / "mine-v0" / "data" / "main_data.hdf5"
    with h5py.File(data if form == "minari" else out) as file:
        found = file["episode_0/actions" if form == "minari" else "actions"][:].tolist()
    # low + (a + 1) / 2 (high - low): -1 is -2, 0.5 is 7.5, 0.25 is 0.5 and 1 is 10.
    assert found == [[-2.0, 7.5], [0.5, 10.0]]
    (read,) = open_source(out).load(schema)
    np.testing.assert_allclose(read.actions, episode.actions, atol=1e-6)


def test_a_recording_stays_in_the_units_of_policies(tmp_path: Path):
    schema = DemoSchema("toy", 3, 2, action_low=(-2.0, 0.0), action_high=(2.0, 10.0))
    written = [toy_episode(0)]
    write_demonstrations(tmp_path / "x.h5", written, {"made_by": "a test"}, schema)
    assert_same(open_source(tmp_path / "x.h5").load(schema), written, "actions")
    assert read_card(tmp_path / "x.h5") == {"made_by": "a test"}


def test_d4rl_episodes_that_know_less_are_written_with_less(tmp_path: Path):
    written = [toy_episode(0, success=None, progress=None), toy_episode(1)]
    write_demonstrations(tmp_path / "x.hdf5", written, {}, SCHEMA)
    read = open_source(tmp_path / "x.hdf5").load(SCHEMA)
    assert_same(read, written, "observations", "actions")
    assert all(e.success is None and e.progress is None for e in read)


@pytest.mark.filterwarnings("ignore")
def test_a_minari_id_that_exists_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("minari", reason="the minari extra is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    write_demonstrations("minari:toy/mine-v0", [toy_episode(0)], {})
    with pytest.raises(DemonstrationError, match=r"minari:toy/mine-v0: cannot be written .*delete"):
        write_demonstrations("minari:toy/mine-v0", [toy_episode(1)], {})


def test_an_unknown_form_names_those_that_are_written():
    with pytest.raises(DemonstrationError, match=r"OUT=x.csv: .*FILE\.hdf5.*minari:ID.*FILE\.h5"):
        find_writer("x.csv")


def test_nothing_is_not_written(tmp_path: Path):
    with pytest.raises(ValueError, match="without episodes"):
        write_demonstrations(tmp_path / "x.hdf5", [], {})
    assert not list(tmp_path.iterdir())
