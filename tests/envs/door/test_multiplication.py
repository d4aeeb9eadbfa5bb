"""Multiplication: reproducible, balanced, honest about what it kept, and cached."""

from __future__ import annotations

import collections
import dataclasses
import logging
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from envs.adroit.attempts import Attempt, AttemptFactory
from envs.adroit.multiplication import play_attempts
from envs.adroit.simulator import HandSimulator
from envs.adroit.varying import Varying
from envs.demonstrations import (
    DemonstrationError,
    DemoOptions,
    Episode,
    MultiplyConfig,
    content_hash,
    load_demonstrations,
    multiplication_cache,
    multiply,
)
from envs.demonstrations.multiplication_cache import cache_key, multiply_cached
from envs.demonstrations.selection import ended_at
from envs.door import task
from envs.door.definition import TASK
from envs.door.hand import DOOR, build_scene
from envs.door.resimulation import RESIMULATE
from envs.door.variation import VARY, VARYING
from envs.steps import counted_steps
from tests.envs.demonstrations.helpers import door_of, still_episode

# An angle that every closed door passes: the bookkeeping can be tested without a door opener.
ANY_ANGLE = {"min_progress": -1.0, "horizon": 6, "round_size": 8, "target_episodes": 12}


def config(**changes: Any) -> MultiplyConfig:
    return MultiplyConfig(**(ANY_ANGLE | changes))


def attempt_of(
    episodes: list[Episode], settings: MultiplyConfig, varying: Varying = VARYING
) -> Attempt:
    factory = AttemptFactory.prepare(episodes, settings, build_scene(), varying, VARY.scale)
    return factory.draw(0, np.ones(len(episodes)))


@pytest.fixture(scope="module")
def sources() -> list[Episode]:
    return RESIMULATE([still_episode(i, steps=9) for i in range(3)], num_threads=1)


@pytest.fixture(scope="module")
def kept(sources: list[Episode]) -> list[Episode]:
    return multiply(sources, config(), VARY, num_threads=1)


def test_the_number_of_threads_changes_nothing(sources, kept) -> None:
    assert content_hash(multiply(sources, config(), VARY, num_threads=3)) == content_hash(kept)


def test_the_seed_changes_everything(sources, kept) -> None:
    other = multiply(sources, config(seed=1), VARY)
    assert {door_of(e).tobytes() for e in other}.isdisjoint(door_of(e).tobytes() for e in kept)


def test_keeps_as_many_as_asked_for_with_provenance(kept) -> None:
    assert len(kept) == 12
    attempts = [e.provenance.details["attempt"] for e in kept]
    assert attempts == sorted(set(attempts))
    assert len({door_of(e).tobytes() for e in kept}) == 12
    for episode in kept:
        details = episode.provenance.details
        assert episode.provenance.kind == "multiplied"
        assert episode.provenance.source == "synthetic"
        assert 1.1 <= details["speed"] <= 1.6
        assert 0 <= details["noise_scale"] <= 0.08
        assert set(details) == {"attempt", "speed", "noise_scale", "door_offset_m"}


def test_doors_come_from_the_reset_distribution(kept) -> None:
    doors = np.stack([door_of(e) for e in kept])
    assert (doors >= task.DOOR_POSITION_LOW).all()
    assert (doors <= task.DOOR_POSITION_HIGH).all()
    for episode, door in zip(kept, doors, strict=True):
        offset = episode.observations[0, task.HANDLE] - door
        np.testing.assert_allclose(offset, [0.29, -0.15, -0.025], atol=1e-4)


def test_without_noise_the_recorded_actions_are_the_executed_ones(sources) -> None:
    quiet = multiply(sources, config(noise_scale=0.0), VARY)
    for episode, again in zip(quiet, RESIMULATE(quiet), strict=True):
        # The actions are stored as float32, hence not bit for bit.
        np.testing.assert_allclose(again.observations, episode.observations, atol=1e-4)
        np.testing.assert_array_equal(task.reward(episode.observations[1:]), episode.rewards)


def test_noise_is_executed_but_the_clean_action_is_recorded(sources) -> None:
    attempt = attempt_of(sources, config(noise_scale=0.5))
    noisy = attempt.executed_actions - attempt.clean_actions
    assert np.abs(noisy).max() > 0.05
    quiet = attempt_of(sources, config(noise_scale=0.0))
    np.testing.assert_array_equal(attempt.clean_actions, quiet.clean_actions)
    with HandSimulator(DOOR, 1) as simulator:
        (observations,) = play_attempts(simulator, [attempt], config(), VARYING).observations
        simulator.start({name: at[None] for name, at in attempt.placement.items()})
        expected = [simulator.step(a[None])[0] for a in attempt.executed_actions]
    np.testing.assert_array_equal(observations[1:], np.stack(expected))


def test_what_was_executed_is_kept_beside_what_is_imitated(sources) -> None:
    for episode in multiply(sources, config(noise_scale=0.5), VARY, num_threads=1):
        executed = episode.executed_actions
        assert executed is not None
        assert executed.shape == episode.actions.shape
        assert executed.dtype == np.float32
        assert np.abs(executed).max() <= 1
        assert np.abs(executed - episode.actions).max() > 1e-3
        (again,) = RESIMULATE([episode], num_threads=1)
        np.testing.assert_allclose(again.observations, episode.observations, atol=1e-4)
        np.testing.assert_array_equal(again.executed_actions, executed)


def test_without_noise_there_is_one_action(sources) -> None:
    quiet = multiply(sources, config(noise_scale=0.0), VARY, num_threads=1)
    assert all(episode.executed_actions is None for episode in quiet)


def test_the_arm_is_guided_by_the_offset_between_the_doors(sources) -> None:
    still = [dataclasses.replace(e, actions=np.zeros_like(e.actions)) for e in sources]
    unguided = dataclasses.replace(VARYING, guided=None)
    drawn = [attempt_of(still, config(), varying) for varying in (VARYING, unguided)]
    assert not drawn[1].clean_actions.any()
    hand = drawn[0].clean_actions[:, 4:]
    assert not hand.any()
    # Early in the ramp, but away from zero: the displacement grows with time.
    reach = np.abs(drawn[0].clean_actions[:, :4]).sum(axis=1)
    assert (np.diff(reach) > 0).all()


def opened_at(episode: Episode, step: int) -> Episode:
    observations = episode.observations.copy()
    observations[step + 1 :, task.HINGE] = 0.3
    return dataclasses.replace(episode, observations=observations)


def test_attempts_whose_door_stays_closed_are_given_up(sources) -> None:
    settings = config(horizon=60, speed_low=2.0, speed_high=2.0)
    attempt = attempt_of([opened_at(sources[0], 8)], settings)
    # The recorded door moves in step 8, so at double speed in step 4; then patience begins.
    assert attempt.under_way_by == 4 + 30
    stepped: list[int] = []
    with HandSimulator(DOOR, 1) as simulator:
        step = simulator.step
        simulator.step = lambda *a, **k: (stepped.append(1), step(*a, **k))[1]
        result = play_attempts(simulator, [attempt], settings, VARYING)
    assert result.steps == [attempt.under_way_by + 1]
    assert len(stepped) == attempt.under_way_by + 1


@pytest.fixture(scope="module")
def openers() -> list[Episode]:
    return list(load_demonstrations("bundled", TASK, DemoOptions(limit=4)).episodes)


OPENS = {"target_episodes": 3, "round_size": 8, "min_progress": 1.0, "horizon": 200}


@pytest.mark.parametrize("end", [0.5, 1.3])
def test_kept_episodes_are_played_only_as_far_as_they_are_read(openers, end: float) -> None:
    """The same as whole episodes that are cut there, for fewer steps of the simulator."""
    with counted_steps() as all_steps:
        whole = multiply(openers, config(**OPENS), VARY)
    with counted_steps() as steps:
        ended = multiply(openers, config(**OPENS, end_progress=end), VARY)
    played = [episode.length for episode in ended]
    assert [episode.success[-1] for episode in whole] == [True] * 3
    assert steps.taken < all_steps.taken
    assert max(played) < 200
    assert content_hash(ended_at(ended, end)) == content_hash(ended_at(whole, end))
    # One that is beyond the end goes on until it has done what is asked of it.
    assert all(e.progress.max() > 1.0 for e in ended)


def test_what_never_comes_to_the_end_is_played_whole(openers) -> None:
    whole = multiply(openers, config(**OPENS), VARY)
    ended = multiply(openers, config(**OPENS, end_progress=3.0), VARY)
    assert content_hash(ended) == content_hash(whole)


@pytest.mark.parametrize(
    ("keep_best", "hold", "end"), [(1.0, False, 1.2), (0.5, False, None), (1.0, True, None)]
)
def test_loading_says_how_far_to_play_unless_whole_episodes_are_judged(
    keep_best: float, hold: bool, end: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[MultiplyConfig] = []

    def multiplied(episodes: list[Episode], settings: MultiplyConfig, *_: Any, **__: Any):
        asked.append(settings)
        return episodes

    monkeypatch.setattr("envs.demonstrations.loading.multiply_cached", multiplied)
    options = DemoOptions(
        limit=2, multiply=MultiplyConfig(hold=hold), keep_best=keep_best, end_progress=1.2
    )
    load_demonstrations("bundled", TASK, options)
    assert [settings.end_progress for settings in asked] == [end]


def test_a_source_that_never_opens_gives_no_deadline(sources) -> None:
    assert attempt_of(sources, config(horizon=60)).under_way_by == 60


def test_no_source_gives_more_than_its_share(sources) -> None:
    # Only one source is near the doors; without the cap it would give nearly everything.
    near, *others = sources
    far = [
        dataclasses.replace(e, start={"door_position": door_of(e) + np.array([0, 0.3, 0])})
        for e in others
    ]
    kept = multiply([near, *far], config(balance=1.5), dataclasses.replace(VARY, scale=0.02))
    counts = collections.Counter(e.provenance.episode for e in kept)
    assert counts[0] == 6
    assert sum(counts.values()) == 12


def test_failures_are_not_kept(sources) -> None:
    with pytest.raises(DemonstrationError, match=r"none of 10 attempts succeeded"):
        multiply(sources, config(min_progress=None, max_attempts=10), VARY)


def test_running_out_of_attempts_is_said(sources, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        kept = multiply(sources, config(max_attempts=5), VARY)
    assert len(kept) == 5
    assert "kept 5 of 12 multiplied episodes in 5 attempts" in caplog.text


def test_long_work_says_how_far_it_is(sources, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        multiply(sources, config(round_size=5), VARY)
    assert [r.message for r in caplog.records if "attempts" in r.message] == [
        "5 of 12 episodes after 5 attempts",
        "10 of 12 episodes after 10 attempts",
        "12 of 12 episodes after 13 attempts",
    ]


def test_the_cache_returns_the_same_episodes(
    sources, kept, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = multiply_cached(sources, config(), VARY, cache_dir=tmp_path)
    monkeypatch.setattr(multiplication_cache, "multiply", None)
    second = multiply_cached(sources, config(), VARY, cache_dir=tmp_path)
    assert content_hash(first) == content_hash(second) == content_hash(kept)
    assert len(list(tmp_path.iterdir())) == 1


def torn(file: Path) -> None:
    file.write_bytes(b"torn")


def one_other_reward(file: Path) -> None:
    with h5py.File(file, "r+") as content:
        content["episode_00000/rewards"][2] += 0.5


@pytest.mark.parametrize("harm", [torn, one_other_reward])
def test_a_damaged_cache_file_is_replaced(
    harm, sources, kept, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    multiply_cached(sources, config(), VARY, cache_dir=tmp_path)
    (file,) = tmp_path.iterdir()
    harm(file)
    with caplog.at_level(logging.WARNING):
        again = multiply_cached(sources, config(), VARY, cache_dir=tmp_path)
    assert content_hash(again) == content_hash(kept)
    assert file.stat().st_size > 1000
    assert f"replacing a damaged cache file: {file}" in caplog.text


def test_the_cache_key_holds_all_that_matters(sources, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {cache_key(sources, config(), VARY), cache_key(sources[:2], config(), VARY)}
    keys.add(cache_key(sources, config(), dataclasses.replace(VARY, scale=0.1)))
    keys.add(cache_key(sources, config(), dataclasses.replace(VARY, guide_arm=False)))
    for field in dataclasses.fields(MultiplyConfig):
        value = getattr(config(), field.name)
        changed = 1.0 if value is None else value * 1.001 + (value == 0)
        if isinstance(value, int):
            changed = value + 1
        keys.add(cache_key(sources, config(**{field.name: changed}), VARY))
    monkeypatch.setattr(multiplication_cache, "CODE_VERSION", -1)
    keys.add(cache_key(sources, config(), VARY))
    assert len(keys) == 5 + len(dataclasses.fields(MultiplyConfig))


def test_needs_door_positions() -> None:
    with pytest.raises(DemonstrationError, match="has no door position"):
        multiply([still_episode(door_position=None)], config(), VARY)


def test_needs_episodes() -> None:
    with pytest.raises(DemonstrationError, match="got no episodes"):
        multiply([], config(), VARY)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("target_episodes", 0),
        ("max_attempts", 0),
        ("speed_low", 0.0),
        ("speed_high", 1.0),
        ("speed_bins", 0),
        ("noise_scale", -0.1),
        ("noise_correlation", 1.0),
        ("balance", 0.9),
        ("horizon", 0),
        ("round_size", 0),
        ("seed", -1),
        ("end_progress", 1.0),
    ],
)
def test_settings_are_checked(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} = {value}"):
        MultiplyConfig(**{"hold": True, name: value})


def test_the_doors_own_settings_are_checked(sources) -> None:
    with pytest.raises(ValueError, match=r"position_scale_m must be positive, got 0\.0"):
        dataclasses.replace(VARY, scale=0.0)
    with pytest.raises(ValueError, match=r"min_progress is a hinge angle in rad below 1\.57"):
        multiply(sources, config(min_progress=1.57), VARY)
