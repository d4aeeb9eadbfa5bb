"""Every format gives the episodes that were written, and says what it had to leave out."""

from __future__ import annotations

import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from envs.demonstrations import (
    DemonstrationError,
    DemoSchema,
    Kind,
    Notes,
    StartKey,
    open_source,
    write_recording,
)
from envs.demonstrations.reading import FileSource, Reader, Record
from envs.demonstrations.validation import RawEpisode
from tests.envs.demonstrations.files_of_others import (
    ROBOMIMIC_SCHEMA,
    SCHEMA,
    assert_same,
    following,
    toy_episode,
    write_dapg,
    write_flat,
    write_lerobot,
    write_minari,
    write_npz,
    write_robomimic,
    write_roboset,
)

WHOLE = ("observations", "actions", "rewards", "terminated")


def episodes_and_notes(path: Path, schema: DemoSchema = SCHEMA):
    notes = Notes()
    episodes = open_source(path).load(schema, notes)
    return episodes, notes.findings(path.name)


# ---- D4RL ------------------------------------------------------------------------------------


def test_d4rl_without_next_observations_loses_the_last_action_of_each_and_says_so(tmp_path: Path):
    written = [toy_episode(0), toy_episode(1, steps=7)]
    episodes, findings = episodes_and_notes(write_flat(tmp_path / "d.hdf5", written))
    assert_same(episodes, [e.first_steps(e.length - 1) for e in written], *WHOLE)
    assert findings.count(Kind.LAST_ACTION) == 2


def test_d4rl_next_observations_give_the_last_one(tmp_path: Path):
    written = [toy_episode(0), toy_episode(1, steps=7)]
    path = write_flat(tmp_path / "d.hdf5", written, next_observations=following(written))
    episodes, findings = episodes_and_notes(path)
    assert_same(episodes, written, *WHOLE)
    assert not findings.found


@pytest.mark.parametrize("timeouts", [None, np.zeros(12, dtype=bool)])
def test_d4rl_that_does_not_tell_its_ends_is_refused(tmp_path: Path, timeouts: np.ndarray | None):
    path = write_flat(
        tmp_path / "d.hdf5", [toy_episode(0), toy_episode(1, steps=7)], timeouts=timeouts
    )
    with pytest.raises(
        DemonstrationError, match=r"does not say where its episodes end.*`timeouts`"
    ):
        open_source(path).load(SCHEMA)


def test_d4rl_ends_are_found_by_next_observations_and_reported(tmp_path: Path):
    written = [toy_episode(0), toy_episode(1, steps=7), toy_episode(2, steps=3)]
    path = write_flat(
        tmp_path / "d.hdf5", written, timeouts=None, next_observations=following(written)
    )
    episodes, findings = episodes_and_notes(path)
    assert_same(episodes, written, *WHOLE)
    assert findings.count(Kind.ENDS_FOUND) == 2  # the third ends with the file
    assert "row 4" in findings.found[Kind.ENDS_FOUND].first  # the last of five


def test_d4rl_next_observations_of_another_order_are_refused(tmp_path: Path):
    written = [toy_episode(0, steps=9)]
    path = write_flat(tmp_path / "d.hdf5", written, next_observations=following(written)[::-1])
    with pytest.raises(DemonstrationError, match="not the next row's observations in"):
        open_source(path).load(SCHEMA)


def test_d4rl_terminals_without_timeouts_are_reported(tmp_path: Path):
    terminals = np.array([0, 0, 0, 0, 1, 0, 0, 0, 0, 1], dtype=bool)
    path = write_flat(
        tmp_path / "d.hdf5", [toy_episode(0), toy_episode(1)], timeouts=None, terminals=terminals
    )
    episodes, findings = episodes_and_notes(path)
    assert [e.length for e in episodes] == [4, 4]
    assert findings.count(Kind.NO_TIMEOUTS) == 1


def test_d4rl_pieces_without_a_transition_are_counted(tmp_path: Path):
    timeouts = np.array([0, 0, 1, 1, 1], dtype=bool)
    path = write_flat(tmp_path / "d.hdf5", [toy_episode(0)], timeouts=timeouts)
    episodes, findings = episodes_and_notes(path)
    assert [e.length for e in episodes] == [2]
    assert findings.count(Kind.SHORT) == 2


def test_d4rl_cuts_are_joined_where_the_task_says_so_but_not_behind_a_terminal_state(
    tmp_path: Path,
):
    schema = DemoSchema(
        describes="the toy", observation_size=3, action_size=2, continues=lambda before, after: True
    )
    timeouts = np.array([0, 1, 0, 0, 0, 0, 0, 0, 0, 1], dtype=bool)
    terminals = np.arange(10) == 4
    path = write_flat(
        tmp_path / "d.hdf5",
        [toy_episode(0), toy_episode(1)],
        timeouts=timeouts,
        terminals=terminals,
    )
    episodes, findings = episodes_and_notes(path, schema)
    assert [e.length for e in episodes] == [4, 4]
    assert findings.count(Kind.JOINED) == 1
    assert episodes[0].provenance.details["pieces"] == 2


def test_d4rl_without_rewards_is_counted_and_nan(tmp_path: Path):
    path = write_flat(tmp_path / "d.hdf5", [toy_episode(0)], rewards=None)
    episodes, findings = episodes_and_notes(path)
    assert np.isnan(episodes[0].rewards).all()
    assert findings.count(Kind.NO_REWARDS) == 1


# ---- robomimic, RoboSet ----------------------------------------------------------------------


def test_robomimic_takes_the_keys_of_the_schema_in_the_order_of_their_names(tmp_path: Path):
    written = [toy_episode(i, steps=3 + i) for i in range(11)]  # demo_10 comes last
    path = write_robomimic(tmp_path / "r.hdf5", written)
    episodes, findings = episodes_and_notes(path, ROBOMIMIC_SCHEMA)
    # joint before tip: the first two columns and the third, as they were.
    assert_same(episodes, written, "observations", "actions", "rewards")
    assert findings.count(Kind.KEYS_UNUSED) == 11
    assert "front_image" in findings.found[Kind.KEYS_UNUSED].first
    # dones are 1 at every step here: they tell no terminal state.
    assert findings.count(Kind.ENDS_UNTOLD) == 11
    assert not any(e.terminated.any() for e in episodes)


def test_robomimic_without_next_obs(tmp_path: Path):
    written = [toy_episode(0)]
    path = write_robomimic(tmp_path / "r.hdf5", written, next_obs=False)
    episodes, findings = episodes_and_notes(path, ROBOMIMIC_SCHEMA)
    assert_same(episodes, [written[0].first_steps(4)], "observations", "actions")
    assert findings.count(Kind.LAST_ACTION) == 1


def test_robomimic_states_are_the_start(tmp_path: Path):
    schema = DemoSchema(
        describes="the toy",
        observation_size=3,
        action_size=2,
        observation_keys=("tip", "joint"),
        start=(StartKey("state", 4, ("states",)),),
    )
    path = write_robomimic(tmp_path / "r.hdf5", [toy_episode(0), toy_episode(1)])
    first, second = open_source(path).load(schema)
    assert first.start["state"].tolist() == [0, 1, 2, 3]
    assert second.start["state"].tolist() == [1, 2, 3, 4]


def test_robomimic_pictures_are_refused_by_name(tmp_path: Path):
    path = write_robomimic(tmp_path / "r.hdf5", [toy_episode(0)])
    with pytest.raises(DemonstrationError, match=r"demo_0: front_image is a picture"):
        open_source(path).load(SCHEMA)


def test_robomimic_missing_key_lists_what_there_is(tmp_path: Path):
    schema = DemoSchema(
        describes="the toy", observation_size=3, action_size=2, observation_keys=("elbow",)
    )
    path = write_robomimic(tmp_path / "r.hdf5", [toy_episode(0)])
    with pytest.raises(DemonstrationError, match=r"elbow \(found: front_image, joint, tip\)"):
        open_source(path).load(schema)


def test_roboset(tmp_path: Path):
    written = [toy_episode(i, steps=2 + i) for i in range(11)]
    episodes, _ = episodes_and_notes(write_roboset(tmp_path / "r.h5", written))
    assert_same(episodes, written, "observations", "actions", "rewards")


# ---- npz -------------------------------------------------------------------------------------


def test_npz_stacked(tmp_path: Path):
    written = [toy_episode(0), toy_episode(1, steps=7), toy_episode(2, steps=2)]
    episodes, findings = episodes_and_notes(write_npz(tmp_path / "n.npz", written))
    assert_same(episodes, written, *WHOLE, "success", "progress")
    assert not findings.found


def test_npz_of_one_episode_by_names(tmp_path: Path):
    written = toy_episode(0)
    np.savez(
        tmp_path / "n.npz",
        **{"observations/b": written.observations[:, 2:]},
        **{"observations/a/x": written.observations[:, :2]},
        actions=written.actions,
        rewards=written.rewards,
        **{"start/height": np.array([7.0])},
    )  # fmt: skip
    schema = DemoSchema(
        describes="the toy", observation_size=3, action_size=2, start=(StartKey("height", 1),)
    )
    episodes, _ = episodes_and_notes(tmp_path / "n.npz", schema)
    assert_same(episodes, [written], "observations", "actions", "rewards")
    assert episodes[0].start["height"].tolist() == [7.0]


def test_npz_with_starts_of_stacked_episodes_and_missing_last_observations(tmp_path: Path):
    written = [toy_episode(0), toy_episode(1, steps=7)]
    path = write_npz(
        tmp_path / "n.npz",
        written,
        observations=np.concatenate([e.observations[:-1] for e in written]),
        **{"start/height": np.array([[7.0], [8.0]])},
    )
    schema = DemoSchema(
        describes="the toy", observation_size=3, action_size=2, start=(StartKey("height", 1),)
    )
    episodes, findings = episodes_and_notes(path, schema)
    assert_same(episodes, [e.first_steps(e.length - 1) for e in written], *WHOLE, "success")
    assert [e.start["height"].item() for e in episodes] == [7.0, 8.0]
    assert findings.count(Kind.LAST_ACTION) == 2


@pytest.mark.parametrize("ends", [[5, 11], [5, 5, 12], [-1, 12], [5.0, 12.0], [[12]], []])
def test_npz_ends_that_do_not_rise_to_the_actions(tmp_path: Path, ends: list):
    written = [toy_episode(0), toy_episode(1, steps=7)]
    path = write_npz(tmp_path / "n.npz", written, episode_ends=np.array(ends))
    with pytest.raises(DemonstrationError, match="does not rise to the 12 actions"):
        open_source(path).load(SCHEMA)


def test_npz_with_objects_is_refused(tmp_path: Path):
    np.savez(tmp_path / "n.npz", actions=np.array([{}]), observations=np.zeros((2, 3)))
    with pytest.raises(DemonstrationError, match=r"actions.npy: has dtype object"):
        open_source(tmp_path / "n.npz").load(SCHEMA)


# ---- Minari ----------------------------------------------------------------------------------


@pytest.fixture
def minari_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    pytest.importorskip("minari", reason="the minari extra is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    monkeypatch.setenv("MINARI_OFFLINE", "1")
    return tmp_path


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("spec", ["minari:toy/goal-v0", "folder"])
def test_minari_with_goals_nested_and_discrete(minari_root: Path, spec: str):
    from gymnasium.spaces import Box, Dict, Discrete

    box = Box(-1.0, 1.0, (1,), np.float32)
    space = Dict(
        {"observation": box, "desired_goal": Dict({"z": box}), "grip": Discrete(3, start=1)}
    )
    written = [toy_episode(0), toy_episode(1, steps=7)]
    grips = [np.arange(e.length + 1) % 3 + 1 for e in written]
    observed = [
        {"observation": o[:, 1:2], "desired_goal": {"z": o[:, :1]}, "grip": g}
        for o, g in zip([e.observations for e in written], grips, strict=True)
    ]  # fmt: skip
    write_minari("toy/goal-v0", written, observed, space)
    schema = DemoSchema(
        describes="the goal toy",
        observation_size=5,
        action_size=2,
        start=(StartKey("height", 1, ("seat/height",)),),
    )
    source = minari_root / "toy" / "goal-v0" if spec == "folder" else spec
    episodes = open_source(source).load(schema)
    assert_same(episodes, written, "actions", "rewards", "success")
    for episode, one, grip in zip(episodes, written, grips, strict=True):
        # desired_goal/z, then grip as three numbers, then observation.
        np.testing.assert_array_equal(episode.observations[:, 0], one.observations[:, 0])
        np.testing.assert_array_equal(episode.observations[:, 1:4], np.eye(3)[grip - 1])
        np.testing.assert_array_equal(episode.observations[:, 4], one.observations[:, 1])
        assert episode.start["height"].tolist() == [7.0]


@pytest.mark.filterwarnings("ignore")
def test_minari_data_that_links_elsewhere_is_refused(minari_root: Path):
    from gymnasium.spaces import Box

    episode = toy_episode(0)
    space = Box(-1.0, 1.0, (3,), np.float32)
    write_minari("toy/flat-v0", [episode], [episode.observations], space)
    folder = minari_root / "toy" / "flat-v0"
    with h5py.File(folder / "data" / "main_data.hdf5", "r+") as file:
        del file["episode_0/actions"]
        file["episode_0/actions"] = h5py.ExternalLink("other.h5", "/actions")
    with pytest.raises(DemonstrationError, match="episode_0/actions: is a link into another file"):
        open_source(folder).load(SCHEMA)


# ---- LeRobot ---------------------------------------------------------------------------------


@pytest.fixture
def parquet() -> None:
    pytest.importorskip("pyarrow", reason="the lerobot extra is not installed")


@pytest.mark.usefixtures("parquet")
def test_lerobot(tmp_path: Path):
    written = [toy_episode(0), toy_episode(1, steps=7), toy_episode(2, steps=3)]
    path = write_lerobot(tmp_path / "set", [written[:2], written[2:]])
    episodes, findings = episodes_and_notes(path)
    cut = [e.first_steps(e.length - 1) for e in written]
    assert_same(episodes, cut, "observations", "actions", "rewards", "success")
    assert findings.count(Kind.LAST_ACTION) == findings.count(Kind.ENDS_UNTOLD) == 3


@pytest.mark.usefixtures("parquet")
def test_lerobot_with_missing_frames_is_refused(tmp_path: Path):
    frames = [0, 1, 2, 4, 5]
    path = write_lerobot(tmp_path / "set", [[toy_episode(0)]], frame_index=frames)
    with pytest.raises(DemonstrationError, match="episode 0: has missing or repeated frames"):
        open_source(path).load(SCHEMA)


@pytest.mark.usefixtures("parquet")
@pytest.mark.parametrize(
    ("action", "problem"),
    [
        ([[0.0, 0.0]] * 4 + [None], "1 empty cells"),
        ([[0.0, 0.0]] * 4 + [[0.0]], "lists of different lengths"),
        ([[0.0, 0.0]] * 4 + [[0.0, None]], "1 empty entries"),
    ],
)
def test_lerobot_damaged_columns(tmp_path: Path, action: list, problem: str):
    path = write_lerobot(tmp_path / "set", [[toy_episode(0)]], action=action)
    with pytest.raises(DemonstrationError, match=rf"file-000.parquet, action: has {problem}"):
        open_source(path).load(SCHEMA)


def test_lerobot_without_pyarrow_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "meta").mkdir()
    features = {key: {"dtype": "int64"} for key in ("action", "episode_index", "frame_index")}
    (tmp_path / "meta" / "info.json").write_text(f'{{"features": {features}}}'.replace("'", '"'))
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "file-000.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(DemonstrationError, match=r"pip install 'bc-sac\[lerobot\]'"):
        open_source(tmp_path).load(SCHEMA)


# ---- folders and names -----------------------------------------------------------------------


def test_a_folder_of_any_of_these(tmp_path: Path):
    write_recording(tmp_path / "a.h5", [toy_episode(0)], {})
    write_npz(tmp_path / "b.npz", [toy_episode(1, steps=7)])
    write_dapg(tmp_path / "c.pickle", [toy_episode(2, steps=4)])
    write_flat(tmp_path / "d.hdf5", [toy_episode(3, steps=9)])
    (tmp_path / "notes.txt").write_text("by hand")
    episodes, findings = episodes_and_notes(tmp_path)
    assert [e.length for e in episodes] == [5, 7, 4, 8]
    assert findings.count(Kind.IGNORED_FILES) == 1


def test_a_damaged_file_of_a_folder_is_not_passed_over(tmp_path: Path):
    write_npz(tmp_path / "b.npz", [toy_episode(1)])
    (tmp_path / "d.h5").write_bytes(b"plain text")
    with pytest.raises(DemonstrationError, match=r"d.h5: is not a readable HDF5 file"):
        open_source(tmp_path).load(SCHEMA)


def test_files_are_known_by_their_content(tmp_path: Path):
    write_flat(tmp_path / "flat", [toy_episode(0)])
    write_dapg(tmp_path / "dapg", [toy_episode(0)])
    write_npz(tmp_path / "n.npz", [toy_episode(0)]).rename(tmp_path / "stacked")
    for name, length in (("flat", 4), ("dapg", 5), ("stacked", 5)):
        assert open_source(tmp_path / name).load(SCHEMA)[0].length == length


@pytest.mark.parametrize("name", ["pipe", "pipe.h5", "pipe.npz", "pipe.pickle"])
def test_a_fifo_is_refused_before_it_is_opened(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    with pytest.raises(DemonstrationError, match="is not a plain file"):
        open_source(tmp_path / name)
    if name != "pipe":
        with pytest.raises(DemonstrationError, match="is not a plain file"):
            open_source(tmp_path).load(SCHEMA)


def test_the_second_episode_is_left_out_and_reported_where_that_is_asked_for(tmp_path: Path):
    bad = toy_episode(1)
    bad.observations[2, 1] = np.nan
    path = write_npz(tmp_path / "n.npz", [toy_episode(0), bad, toy_episode(2)])
    refused: list[DemonstrationError] = []
    notes = Notes()
    episodes = open_source(path).load(SCHEMA, notes, refused)
    assert_same(episodes, [toy_episode(0), toy_episode(2)], *WHOLE)
    assert [e.provenance.episode for e in episodes] == [0, 2]
    assert "episode 1: observations[2, 1] is nan" in str(refused[0])
    assert notes.findings("n").count(Kind.REFUSED) == 1
    with pytest.raises(DemonstrationError, match=r"episode 1: observations\[2, 1\] is nan"):
        open_source(path).load(SCHEMA)


@pytest.mark.parametrize("error", [KeyError("a\nb"), RecursionError("deep"), MemoryError()])
def test_whatever_a_reader_raises_is_told_in_one_line(tmp_path: Path, error: Exception):
    def read(path: Path, schema: DemoSchema, notes: Notes):
        for _ in range(2):
            yield Record(RawEpisode(np.zeros((3, 3)), np.zeros((2, 2)), np.zeros(2)), "x")
        raise error

    source = FileSource(Reader("a toy format", lambda _: True, read), tmp_path / "x.toy")
    with pytest.raises(DemonstrationError, match=r"x\.toy, behind episode 2: cannot") as told:
        source.load(SCHEMA)
    assert "\n" not in str(told.value)


def test_a_source_without_episodes_is_refused(tmp_path: Path):
    source = FileSource(Reader("a toy format", lambda _: True, lambda *_: iter(())), tmp_path)
    with pytest.raises(DemonstrationError, match=r"holds no episodes\. Expected a toy format"):
        source.load(SCHEMA)
