"""Every source passes one gate; these are the things it stops."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from envs.demonstrations import DemonstrationError, Provenance
from envs.demonstrations.validation import RawEpisode, build_episode, reward_agreement
from envs.door import task
from envs.door.demos import SCHEMA

PROVENANCE = Provenance("test", 0, "recorded")


def raw(**changes: Any) -> RawEpisode:
    fields: dict[str, Any] = {
        "observations": np.zeros((6, 38)),
        "actions": np.zeros((5, 28)),
        "rewards": np.arange(5.0),
    }
    return RawEpisode(**(fields | changes))


def with_entry(shape: tuple[int, ...], index: tuple[int, ...], value: float) -> np.ndarray:
    array = np.zeros(shape)
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"observations": np.zeros((6, 37))}, r"observations has shape \[6, 37\]"),
        ({"observations": np.zeros(38)}, r"observations has shape \[38\]"),
        ({"observations": np.zeros((4, 38))}, "4 observations for 5 actions"),
        ({"observations": np.zeros((7, 38))}, "7 observations for 5 actions"),
        ({"actions": np.zeros((5, 27))}, r"actions has shape \[5, 27\]"),
        ({"rewards": np.zeros(4)}, r"rewards has shape \[4\], expected \[5\]"),
        ({"observations": with_entry((6, 38), (2, 3), np.nan)}, r"observations\[2, 3\] is nan"),
        ({"actions": with_entry((5, 28), (4, 0), np.inf)}, r"actions\[4, 0\] is inf"),
        ({"rewards": with_entry((5,), (1,), np.nan)}, r"rewards\[1\] is nan"),
        # Finite as float64, infinite as the float32 that an episode holds.
        (
            {"observations": with_entry((6, 38), (2, 3), 1e300)},
            r"observations\[2, 3\] is 1e\+300, infinite in float32",
        ),
        (
            {"rewards": with_entry((5,), (1,), -4e38)},
            r"rewards\[1\] is -4e\+38, infinite in float32",
        ),
        ({"start": {"door_position": [0.0, np.nan, 0.0]}}, r"door_position\[1\] is nan"),
        (
            {"start": {"door_position": [0.0, 0.0]}},
            r"door_position has shape \[2\], expected \[3\]",
        ),
        ({"start": {"qpos": np.zeros(29)}}, r"qpos has shape \[29\]"),
        ({"actions": with_entry((5, 28), (0, 0), -20.0)}, "magnitude 20, beyond 3"),
        ({"actions": np.full((5, 28), "a")}, "actions has dtype"),
        ({"actions": [[0.0] * 28, [0.0]]}, "actions is ragged"),
        ({"observations": np.zeros((1, 38)), "actions": np.zeros((1, 28))}, "at least one trans"),
    ],
)
def test_refused(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(DemonstrationError, match=problem) as caught:
        build_episode(raw(**changes), PROVENANCE, "some/file.h5, episode 3", SCHEMA)
    assert "some/file.h5, episode 3" in str(caught.value)
    assert caught.value.remedy


def test_slight_excess_is_kept_as_recorded() -> None:
    actions = with_entry((5, 28), (1, 2), 1.37)
    episode = build_episode(raw(actions=actions), PROVENANCE, "x", SCHEMA)
    assert episode.actions[1, 2] == np.float32(1.37)
    assert episode.clipped_entries == 1


def test_ends_at_the_first_terminal_observation() -> None:
    observations = np.zeros((6, 38))
    observations[3:, task.PALM_TO_HANDLE] = [0.0, 1.2, 0.0]
    episode = build_episode(raw(observations=observations), PROVENANCE, "x", SCHEMA)
    assert episode.length == 3
    assert episode.terminated.tolist() == [False, False, True]
    assert episode.rewards.tolist() == [0.0, 1.0, 2.0]
    assert len(episode.observations) == 4


def test_missing_rewards_are_the_tasks() -> None:
    observations = np.zeros((6, 38))
    observations[4, task.HINGE] = 1.4
    episode = build_episode(raw(observations=observations, rewards=None), PROVENANCE, "x", SCHEMA)
    assert episode.rewards[3] > 19
    assert (episode.rewards[[0, 1, 2, 4]] < 0).all()
    assert episode.max_progress == pytest.approx(1.4)


def test_reward_columns_are_accepted() -> None:
    episode = build_episode(raw(rewards=np.arange(5.0)[:, None]), PROVENANCE, "x", SCHEMA)
    assert episode.rewards.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_reward_agreement_counts_steps() -> None:
    episode = build_episode(raw(rewards=None), PROVENANCE, "x", SCHEMA)
    assert reward_agreement(episode, SCHEMA) == 1.0
    wrong = episode.rewards + np.array([0.0, 0.5, 0.0, -0.5, 0.01], dtype=np.float32)
    assert reward_agreement(dataclasses.replace(episode, rewards=wrong), SCHEMA) == pytest.approx(
        0.6
    )
