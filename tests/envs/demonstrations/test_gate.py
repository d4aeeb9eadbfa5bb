"""Units, shapes and keys: what the one gate makes of a file's arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from envs.demonstrations import DemonstrationError, DemoSchema, Kind, Notes, Provenance
from envs.demonstrations.flattening import flatten_columns
from envs.demonstrations.matrices import in_file_units, observation_matrix
from envs.demonstrations.validation import RawEpisode, build_episode
from envs.flatten import Flattener, Leaf
from tests.envs.test_flatten import PROPERTY, SPACES, stacked

PROVENANCE = Provenance("test", 0, "recorded")
# Two joints: one from -2 to 2 N m, one from 0 to 10.
UNITS = DemoSchema(
    describes="two joints",
    observation_size=3,
    action_size=2,
    action_low=(-2.0, 0.0),
    action_high=(2.0, 10.0),
)


def built(schema: DemoSchema = UNITS, notes: Notes | None = None, **arrays: Any):
    fields: dict[str, Any] = {
        "observations": np.zeros((4, 3)),
        "actions": np.zeros((3, 2)),
        "rewards": np.zeros(3),
    }
    raw = RawEpisode(**(fields | arrays))
    return build_episode(raw, PROVENANCE, "file.h5, episode 3", schema, notes)


def test_actions_are_brought_to_the_bounds_of_the_policy():
    # 2 (a - low) / (high - low) - 1: -2 and 0 to -1, 0 and 5 to 0, 1 and 10 to 0.5 and 1.
    episode = built(actions=[[-2.0, 0.0], [0.0, 5.0], [1.0, 10.0]])
    assert episode.actions.tolist() == [[-1, -1], [0, 0], [0.5, 1]]


def test_and_back():
    episode = built(actions=[[-2.0, 0.0], [0.0, 5.0], [1.0, 10.0]])
    assert in_file_units(episode.actions, UNITS).tolist() == [[-2, 0], [0, 5], [1, 10]]


def test_recordings_of_ours_are_not_rescaled_again():
    episode = built(actions=[[-1.0, 0.0], [0.0, 0.5], [1.0, 1.0]], normalised=True)
    assert episode.actions.tolist() == [[-1, 0], [0, 0.5], [1, 1]]


def test_a_little_beyond_is_clipped_and_counted():
    notes = Notes()
    # 2.1 N m is 1.05 of the bound, within the tolerance of a tenth; 10 + 1e-6 was rounded.
    episode = built(notes=notes, actions=[[2.1, 0.0], [0.0, 10.000001], [0.0, 0.0]])
    assert episode.actions[0, 0] == pytest.approx(1.05)
    assert episode.actions[1, 1] == 1.0
    assert notes.findings("f").count(Kind.CLIPPED) == 1


def test_far_beyond_is_refused_with_value_and_bounds():
    with pytest.raises(DemonstrationError) as caught:
        built(actions=[[0.0, 0.0], [0.0, 12.0], [0.0, 0.0]])
    # 2 * 12 / 10 - 1 = 1.4
    assert "file.h5, episode 3: has an action entry of magnitude 1.4, beyond 1.1" in str(
        caught.value
    )
    assert "actions[1, 1] is 12, its bounds are 0 and 10" in str(caught.value)


def test_any_shape_of_actions_and_observations_is_flattened():
    actions = np.arange(6.0).reshape(3, 1, 2) / 10
    observations = np.arange(12.0).reshape(4, 3, 1)
    episode = built(DemoSchema("toy", 3, 2), actions=actions, observations=observations)
    np.testing.assert_allclose(episode.actions, actions.reshape(3, 2), rtol=1e-6)
    assert episode.observations[1].tolist() == [3, 4, 5]


@pytest.mark.parametrize("name", ["observations", "rewards", "actions"])
def test_what_float32_cannot_hold(name: str):
    arrays = {"observations": np.zeros((4, 3)), "actions": np.zeros((3, 2)), "rewards": np.zeros(3)}
    arrays[name].flat[2] = 1e300
    with pytest.raises(DemonstrationError, match=rf"{name}\[.*\] is 1e\+300, infinite in float32"):
        built(**arrays)


def test_a_picture_alone_is_refused():
    with pytest.raises(
        DemonstrationError, match=r"observations is a picture \(uint8 \[4, 1, 3\]\)"
    ):
        built(observations=np.zeros((4, 1, 3), dtype=np.uint8))


def test_structured_actions_are_refused_by_name():
    with pytest.raises(DemonstrationError, match=r"structured actions \(arm, hand\)"):
        built(actions={"arm": np.zeros((3, 1)), "hand": np.zeros((3, 1))})


def test_what_is_behind_a_terminal_observation_is_counted():
    notes = Notes()
    episode = built(notes=notes, terminated=[False, True, False])
    assert episode.length == 2
    assert notes.findings("f").count(Kind.AFTER_END) == 1


@pytest.mark.parametrize(
    ("success", "expected"),
    [
        ([True, False, True], [False, True, False, True]),  # after each action
        ([True, False, True, True], [True, False, True, True]),  # at each observation
        ([True, False], None),
    ],
)
def test_success_is_aligned_or_not_used(success: list, expected: list | None):
    notes = Notes()
    episode = built(notes=notes, success=success)
    assert (None if episode.success is None else episode.success.tolist()) == expected
    assert notes.findings("f").count(Kind.UNALIGNED) == (expected is None)


def test_success_after_each_action_where_the_last_observation_is_missing():
    # Three observations, three actions: two transitions, whose flags are the first two.
    episode = built(observations=np.zeros((3, 3)), success=[True, False, True])
    assert episode.success.tolist() == [False, True, False]


GRIP = Leaf("grip", ("grip",), (), values=(3,), first=(0,))


def test_discrete_columns_become_one_hot():
    schema = DemoSchema("toy", 4, 2, discrete=(GRIP,))
    columns = {"pose": np.full((4, 1), 7.0), "grip": np.array([0, 2, 1, 0])}
    episode = built(schema, observations=columns)
    assert episode.observations.tolist() == [[1, 0, 0, 7], [0, 0, 1, 7], [0, 1, 0, 7], [1, 0, 0, 7]]


@PROPERTY
@given(SPACES, st.integers(1, 4), st.booleans())
def test_files_and_environments_write_observations_alike(space, rows, encoded):
    """As a recording of the space holds them, or as an environment has written them already."""
    flattener = Flattener.of(space)
    schema = DemoSchema(
        "any",
        flattener.size,
        2,
        observation_keys=tuple(leaf.name for leaf in flattener.leaves),
        discrete=tuple(leaf for leaf in flattener.leaves if leaf.values),
    )
    # Integers of one value each cannot be told from their one-hot numbers.
    assume(not encoded or all(leaf.size != len(leaf.values) for leaf in schema.discrete))
    observations = stacked(space, [space.sample() for _ in range(rows)])
    expected = flattener(observations)
    held = expected if encoded else observations
    assert observation_matrix(held, "f", schema, Notes()).tolist() == expected.tolist()


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ([0, 3, 1, 0], r"grip: holds 3, expected one whole number of 0\.\.2 per step"),
        ([0, 1, 0.5, 0], r"grip: holds 0\.5, expected one whole number of 0\.\.2 per step"),
        ([[0, 1]] * 4, r"grip: holds 2 numbers per step, expected one whole number of 0\.\.2"),
    ],
)
def test_a_discrete_value_out_of_range(values: list, told: str):
    schema = DemoSchema("toy", 3, 2, discrete=(GRIP,))
    with pytest.raises(DemonstrationError, match=told):
        built(schema, observations={"grip": np.array(values)})


def test_bounds_of_another_size_are_refused():
    with pytest.raises(ValueError, match="need 2 numbers each, got 1 and 1"):
        DemoSchema("toy", 3, 2, action_low=(-1.0,), action_high=(1.0,))
    with pytest.raises(ValueError, match="together or not at all"):
        DemoSchema("toy", 3, 2, action_low=(-1.0, -1.0))
    with pytest.raises(ValueError, match="must be below"):
        DemoSchema("toy", 3, 2, action_low=(-1.0, 1.0), action_high=(1.0, 1.0))


# ---- flattening ------------------------------------------------------------------------------


def test_columns_are_sorted_by_their_path_and_kept_in_c_order():
    columns = {
        "b": np.array([1.0, 2.0]),
        "a": {
            "z": np.arange(8).reshape(2, 2, 2),
            "c": (np.array([[9.0], [8.0]]), np.array([0, 1])),
        },
    }
    # a/c/0, a/c/1, a/z (four entries), b
    assert flatten_columns(columns).tolist() == [[9, 0, 0, 1, 2, 3, 1], [8, 1, 4, 5, 6, 7, 2]]


def test_the_order_is_that_of_whole_paths():
    # "a-b" < "a/b" < "ab", as characters: "-" < "/" < "b".
    columns = {"ab": np.array([3.0]), "a": {"b": np.array([2.0])}, "a-b": np.array([1.0])}
    assert flatten_columns(columns).tolist() == [[1, 2, 3]]


def test_columns_of_different_lengths():
    with pytest.raises(DemonstrationError, match=r"different lengths \(a 2, b 3\)"):
        flatten_columns({"a": np.zeros(2), "b": np.zeros(3)})
