from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.flatten import Flattener, UnsupportedSpaceError

PROPERTY = settings(max_examples=60)

BOXES = st.builds(
    lambda shape, dtype: spaces.Box(0, 9, tuple(shape), dtype),
    st.lists(st.integers(1, 3), max_size=2),
    st.sampled_from([np.float32, np.float64, np.int64]),
)
LEAVES = st.one_of(
    BOXES,
    st.builds(spaces.Discrete, st.integers(1, 4), start=st.integers(-2, 3)),
    st.builds(spaces.MultiDiscrete, st.lists(st.integers(1, 4), min_size=1, max_size=3)),
    st.builds(spaces.MultiBinary, st.integers(1, 4)),
)
# Keys without characters below "/", under which order by joined path is order by level.
SPACES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.dictionaries(st.text("abcAB1", min_size=1, max_size=2), inner, min_size=1, max_size=4)
        .map(spaces.Dict),
        st.lists(inner, min_size=1, max_size=3).map(lambda found: spaces.Tuple(tuple(found))),
    ),
    max_leaves=6,
)  # fmt: skip


@PROPERTY
@given(SPACES, st.integers(0, 1000))
def test_single_observations_equal_gymnasium_s_flatten(space, seed):
    """Its dictionaries are sorted by key at each level, which is the same order for such keys."""
    space.seed(seed)
    observation = space.sample()
    found = Flattener.of(space)(observation)
    assert found.dtype == np.float32
    assert found.tolist() == spaces.flatten(space, observation).astype(np.float32).tolist()
    assert Flattener.of(space).size == len(Flattener.of(space).names) == len(found)


def stacked(space, observations):
    if isinstance(space, spaces.Dict):
        return {k: stacked(s, [o[k] for o in observations]) for k, s in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(stacked(s, [o[i] for o in observations]) for i, s in enumerate(space.spaces))
    return np.stack([np.asarray(o) for o in observations])


@PROPERTY
@given(SPACES, st.integers(1, 3))
def test_batches_and_back(space, count):
    flattener = Flattener.of(space)
    observations = [space.sample() for _ in range(count)]
    rows = flattener(stacked(space, observations))
    assert rows.shape == (count, flattener.size)
    for row, observation in zip(rows, observations, strict=True):
        back = spaces.unflatten(space, row)
        assert flattener(back).tolist() == row.tolist()
        assert row.tolist() == flattener(observation).tolist()


def test_the_order_and_the_names():
    """b/x, b/y, then c: 2 of x in C order, one-hot 2 and 3 values of y, c out of 1, 2, 3."""
    space = spaces.Dict({
        "c": spaces.Discrete(3, start=1),
        "b": spaces.Dict({"y": spaces.MultiDiscrete([2, 3]), "x": spaces.Box(0, 9, (2, 2))}),
        "a": spaces.Tuple([spaces.Box(0, 9), spaces.MultiBinary(2)]),
    })  # fmt: skip
    observation = {
        "c": 3,
        "b": {"y": np.array([1, 0]), "x": np.array([[1.0, 2.0], [3.0, 4.0]])},
        "a": (np.array([7.0]), np.array([0, 1])),
    }
    flattener = Flattener.of(space)
    assert flattener(observation).tolist() == [7, 0, 1, 1, 2, 3, 4, 0, 1, 1, 0, 0, 0, 0, 1]
    assert flattener.names == (
        *("a/0[0]", "a/1[0]", "a/1[1]", "b/x[0,0]", "b/x[0,1]", "b/x[1,0]", "b/x[1,1]"),
        *("b/y[0]=0", "b/y[0]=1", "b/y[1]=0", "b/y[1]=1", "b/y[1]=2", "c=1", "c=2", "c=3"),
    )


def test_the_path_as_a_whole_is_what_sorts():
    """ "a b" precedes "a/x", as a space precedes a slash; by level, "a" would precede "a b"."""
    box = spaces.Box(0, 9)
    space = spaces.Dict({"a": spaces.Dict({"x": box}), "a b": box})
    assert Flattener.of(space).names == ("a b[0]", "a/x[0]")


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (
            spaces.Dict({"eye": spaces.Box(0, 255, (4, 4, 3), np.uint8)}),
            r"'eye' is an image \(uint8",
        ),
        (spaces.Box(0, 255, (4, 4), np.uint8), "'observation' is an image"),
        (spaces.Box(0, 1, (2, 4, 4)), "'observation' is an image"),
        (spaces.Tuple([spaces.Box(0, 1), spaces.Text(3)]), "'1' is a Text"),
        (spaces.Dict({"g": spaces.Graph(spaces.Box(0, 1), None)}), "'g' is a Graph"),
        (spaces.Dict({}), "observations are empty"),
    ],
)
def test_what_is_no_vector_is_refused_by_name(space, message):
    with pytest.raises(UnsupportedSpaceError, match=message):
        Flattener.of(space)


def test_integers_outside_of_their_range():
    with pytest.raises(ValueError, match=r"observation is 4, outside"):
        Flattener.of(spaces.Discrete(4))(4)
