"""``make demos-check`` on a task that is not ours: what it prints and when it fails."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from typer.testing import CliRunner

from envs import EnvOptions, Task, find_task
from envs.demonstrations import (
    DemonstrationError,
    DemoSchema,
    Episode,
    Provenance,
    StartKey,
    load_demonstrations,
    write_demonstrations,
)
from envs.demonstrations.loading import DemoOptions
from pipeline import cli
from pipeline.commands import demos_check
from pipeline.commands.demos_check import check_demonstrations
from pipeline.recipe import Recipe
from tests.envs.demonstrations.files_of_others import toy_episode, write_flat, write_npz
from tests.toys import reach


def no_env(_: object):
    raise AssertionError("needs no environment")


def starts(seed: int, first: int, count: int) -> TensorDict:
    return TensorDict({"seat": torch.arange(count).reshape(-1, 1) / count}, [count])


SCHEMA = DemoSchema(
    describes="the toy", observation_size=3, action_size=2, start=(StartKey("seat", 1),)
)
TASK = Task(name="toy", make_env=no_env, demos=SCHEMA, starts=starts)


def seated(path: Path, seats: list[float], bad: int | None = None) -> Path:
    episodes = [toy_episode(i, success=np.arange(6) == 5 * (i == 0)) for i in range(len(seats))]
    if bad is not None:
        episodes[bad].actions[0, 1] = 7.0
    return write_npz(path, episodes, **{"start/seat": np.array(seats)[:, None]})


def test_summary_coverage_and_refusals(tmp_path: Path):
    path = seated(tmp_path / "n.npz", [0.2, 0.8, 0.5], bad=2)
    check = check_demonstrations(str(path), TASK)
    assert check.usable == 2
    # Of 0, 0.001, ..., 0.999 those from 0.2 to 0.8 are 601 of 1,000.
    assert "starts: 60% of the evaluation's" in check.text
    assert "seat[0]: 60% (evaluation 0 to 0.999, demonstrations 0.2 to 0.8)" in check.text
    assert "n.npz: 2 usable of 3 episodes, 10 steps, success 50%" in check.text
    assert "refused: " in check.text
    assert "actions[0, 1] is 7, its bounds are -1 and 1" in check.text
    assert "1 episodes refused (first: " in check.text


def test_seeds_begin_episodes_and_say_nothing_of_where(tmp_path: Path):
    """As environments of gymnasium have them, recorded or not: first observations are compared."""
    pendulum = find_task("gymnasium:Pendulum-v1")
    demos = tmp_path / "n.h5"
    env = pendulum.make_env(EnvOptions(num_envs=1, seed=0))
    first = env.reset(pendulum.starts(0, 0, 1))["observation"].numpy()
    episode = Episode(
        observations=np.repeat(first, 3, axis=0),
        actions=np.zeros((2, 1), dtype=np.float32),
        rewards=np.zeros(2, dtype=np.float32),
        terminated=np.zeros(2, dtype=bool),
        provenance=Provenance("n", 0, "recorded"),
        start={"start_seed": np.array([float(pendulum.starts(0, 0, 1)["start_seed"][0])])},
    )
    write_demonstrations(demos, [episode], {}, schema=pendulum.demos)
    check = check_demonstrations(str(demos), pendulum, resimulate=False)
    assert check.usable == 1
    assert "observation[0]" in check.text
    assert "start_seed" not in check.text


def test_of_many_refusals_three_are_shown(tmp_path: Path):
    episodes = [toy_episode(i) for i in range(6)]
    for episode in episodes[1:]:
        episode.actions[0, 1] = 7.0
    starts = {"start/seat": np.full((6, 1), 0.5)}
    check = check_demonstrations(str(write_npz(tmp_path / "n.npz", episodes, **starts)), TASK)
    assert check.text.count("refused: ") == 3
    assert "2 more episodes are refused" in check.text


def test_nothing_usable(tmp_path: Path):
    check = check_demonstrations(str(seated(tmp_path / "n.npz", [0.2], bad=0)), TASK)
    assert check.usable == 0
    assert "n.npz: 0 usable of 1 episodes" in check.text


def test_saturated_actions_are_told(tmp_path: Path):
    actions = np.ones((5, 2), dtype=np.float32)
    path = write_npz(tmp_path / "n.npz", [toy_episode(0, actions=actions)])
    task = dataclasses.replace(TASK, starts=None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demos_check, "_first_observations", lambda *_: np.zeros((4, 3)))
        check = check_demonstrations(str(path), task)
    assert "actions at their bounds: 100.0% of the entries; a squared imitation error" in check.text


def test_rewards_of_another_formula_are_replaced_and_counted(tmp_path: Path):
    schema = dataclasses.replace(SCHEMA, reward=lambda observations: observations[..., 0] * 0 + 0.5)
    task = dataclasses.replace(TASK, demos=schema)
    rewards = np.float32([0.5, 0.5, 0.2, 0.5, -1.0])
    path = write_npz(
        tmp_path / "n.npz", [toy_episode(0, rewards=rewards)], **{"start/seat": np.ones((1, 1))}
    )
    check = check_demonstrations(str(path), task)
    assert "2 rewards of another formula than the task's, replaced" in check.text
    loaded = load_demonstrations(path, task, DemoOptions(resimulate=False))
    assert loaded.episodes[0].rewards.tolist() == [0.5] * 5


def test_no_rewards_anywhere_is_refused_and_a_replay_or_a_function_gives_them(tmp_path: Path):
    path = write_flat(tmp_path / "d.hdf5", [toy_episode(0)], rewards=None)
    options = DemoOptions(resimulate=False)
    with pytest.raises(DemonstrationError, match=r"no rewards.*task\.reward=path\.py:function"):
        load_demonstrations(path, TASK, options)
    function = dataclasses.replace(SCHEMA, reward=lambda observations: observations[..., 0])
    computed = load_demonstrations(path, dataclasses.replace(TASK, demos=function), options)
    np.testing.assert_array_equal(computed.episodes[0].rewards, toy_episode(0).observations[1:5, 0])

    def replay(episodes, *, num_threads=None):
        return [dataclasses.replace(e, rewards=np.float32([1, 2, 3, 4])) for e in episodes]

    replayed = load_demonstrations(path, dataclasses.replace(TASK, resimulate=replay))
    assert replayed.episodes[0].rewards.tolist() == [1, 2, 3, 4]


def test_an_episode_that_cannot_be_replayed_is_left_out_and_told(tmp_path: Path):
    def replay(episodes, *, num_threads=None):
        for episode in episodes:
            if episode.provenance.episode == 1:
                raise DemonstrationError(episode.provenance, "diverges", "Remove it")
        return list(episodes)

    task = dataclasses.replace(TASK, resimulate=replay)
    path = seated(tmp_path / "n.npz", [0.0, 0.5, 1.0])
    check = check_demonstrations(str(path), task)
    assert "2 usable of 3 episodes" in check.text
    assert "refused: n.npz, episode 1: diverges. Remove it" in check.text
    with pytest.raises(DemonstrationError, match="diverges"):
        load_demonstrations(path, task)


@pytest.mark.parametrize(("bad", "usable", "code"), [(0, 0, 1), (None, 1, 0)])
def test_the_command_fails_where_nothing_is_usable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: int | None, usable: int, code: int
):
    path = seated(tmp_path / "n.npz", [0.2], bad=bad)
    monkeypatch.setattr(Recipe, "find_task", lambda _: TASK)
    result = CliRunner().invoke(cli.app, ["demos-check", str(path), "--task", "toy"])
    assert result.exit_code == code
    assert f"n.npz: {usable} usable of 1 episodes" in result.output


def test_the_command_fails_where_training_refuses_one_of_several_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = seated(tmp_path / "n.npz", [0.2, 0.8, 0.5], bad=1)
    with pytest.raises(DemonstrationError) as training:
        load_demonstrations(str(path), TASK, DemoOptions(resimulate=False))
    monkeypatch.setattr(Recipe, "find_task", lambda _: TASK)
    result = CliRunner().invoke(cli.app, ["demos-check", str(path), "--task", "toy"])
    assert result.exit_code == 1
    assert f"training refuses this source: {training.value}" in result.output
    assert 'leave them out: make train ARGS="demos.skip_refused=true"' in result.output


def test_what_passes_as_it_was_recorded_names_the_setting(tmp_path: Path):
    def replay(episodes, *, num_threads=None):
        raise DemonstrationError(episodes[0].provenance, "diverges", "Remove it")

    task = dataclasses.replace(TASK, resimulate=replay)
    check = check_demonstrations(str(seated(tmp_path / "n.npz", [0.2, 0.8])), task)
    assert check.refusal is not None
    assert 'ARGS="demos.resimulate=false"' in check.refusal
    assert check.refusal in check.text


@pytest.mark.parametrize(
    ("reach", "largest", "told"), [(5.0, 0.9, True), (5.0, 1.2, False), (1.5, 0.9, False)]
)
def test_actions_that_look_normalised_are_remarked_and_used(
    tmp_path: Path, reach: float, largest: float, told: bool
):
    schema = dataclasses.replace(SCHEMA, action_low=(-1.0, -reach), action_high=(1.0, reach))
    actions = np.full((5, 2), 0.5, dtype=np.float32)
    actions[2, 1] = largest
    path = write_npz(
        tmp_path / "n.npz", [toy_episode(0, actions=actions)], **{"start/seat": np.ones((1, 1))}
    )
    check = check_demonstrations(str(path), dataclasses.replace(TASK, demos=schema))
    assert check.refusal is None
    remark = "n.npz: all actions lie within [-1, 1], and the task's within [-5, 5]: if they were"
    assert (remark in check.text) is told


def test_actions_of_a_refused_episode_forbid_the_remark(tmp_path: Path):
    schema = dataclasses.replace(SCHEMA, action_low=(-5.0, -5.0), action_high=(5.0, 5.0))
    path = seated(tmp_path / "n.npz", [0.2, 0.8], bad=1)
    check = check_demonstrations(str(path), dataclasses.replace(TASK, demos=schema))
    assert check.usable == 1
    assert "all actions lie within" not in check.text


def test_a_recording_of_this_project_needs_no_remark_on_its_units(tmp_path: Path):
    schema = dataclasses.replace(SCHEMA, action_low=(-5.0, -5.0), action_high=(5.0, 5.0))
    start = {"seat": np.ones(1)}
    write_demonstrations(tmp_path / "n.h5", [toy_episode(0, start=start)], {}, schema=schema)
    check = check_demonstrations(str(tmp_path / "n.h5"), dataclasses.replace(TASK, demos=schema))
    assert "all actions lie within" not in check.text


def test_few_copies_show_where_episodes_begin():
    """Those of Python environments are dear."""
    made: list[int] = []

    def make(options: EnvOptions) -> EnvBase:
        made.append(options.num_envs)
        assert options.horizon == 9
        return reach.TASK.make_env(options)

    task = dataclasses.replace(TASK, starts=None, make_env=make, max_copies=5)
    env_options = EnvOptions(horizon=9)
    found = demos_check._first_observations(task, env_options)
    assert made == [5]
    assert found.shape == (demos_check.FIRST_OBSERVATIONS, 4)
    assert len(np.unique(found, axis=0)) == len(found)


def test_episodes_that_do_not_pass_can_be_left_out(tmp_path: Path):
    path = seated(tmp_path / "n.npz", [0.2, 0.8], bad=1)
    assert check_demonstrations(str(path), TASK).refusal is not None
    check = check_demonstrations(str(path), TASK, skip_refused=True)
    assert (check.usable, check.refusal) == (1, None)
    bad = seated(tmp_path / "b.npz", [0.2], bad=0)
    refusal = check_demonstrations(str(bad), TASK, skip_refused=True).refusal
    assert refusal is not None
    assert "no episode passes" in refusal


@pytest.mark.parametrize("named", [True, False])
def test_settings_are_taken_with_or_without_a_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: bool
):
    path = seated(tmp_path / "n.npz", [0.2, 0.8], bad=1)
    asked: list[Recipe] = []
    monkeypatch.setattr(Recipe, "find_task", lambda recipe: asked.append(recipe) or TASK)
    source = [str(path)] if named else [f"demos.source={path}"]
    typed = ["demos-check", *source, "demos.skip_refused=true", "task.success=reward>=1"]
    result = CliRunner().invoke(cli.app, [*typed, "env.horizon=9"])
    assert result.exit_code == 0
    assert "n.npz: 1 usable of 2 episodes" in result.output
    assert (asked[0].task.success, asked[0].env.horizon) == ("reward>=1", 9)
