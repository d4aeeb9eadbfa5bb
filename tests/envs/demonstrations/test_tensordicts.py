"""Episodes become tensordicts whose flags, clipping and alignment are right for any episode."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from envs.demonstrations import Episode, to_tensordict
from tests.envs.demonstrations.helpers import still_episode


@st.composite
def episodes(draw: st.DrawFn) -> Episode:
    steps = draw(st.integers(1, 6))
    number = st.floats(-3, 3, width=32)
    terminated = np.zeros(steps, dtype=bool)
    terminated[-1] = draw(st.booleans())
    return still_episode(
        steps=steps,
        observations=draw(hnp.arrays(np.float32, (steps + 1, 38), elements=number)),
        actions=draw(hnp.arrays(np.float32, (steps, 28), elements=number)),
        rewards=draw(hnp.arrays(np.float32, (steps,), elements=number)),
        terminated=terminated,
    )


@given(episodes())
def test_invariants(episode: Episode) -> None:
    (td,) = to_tensordict([episode])
    assert td.batch_size == (episode.length,)
    assert td["action"].abs().max() <= 1
    inside = np.abs(episode.actions) <= 1
    np.testing.assert_array_equal(td["action"].numpy()[inside], episode.actions[inside])
    np.testing.assert_array_equal(td["observation"].numpy(), episode.observations[:-1])
    np.testing.assert_array_equal(td["next", "observation"].numpy(), episode.observations[1:])
    np.testing.assert_array_equal(td["next", "reward"].numpy()[:, 0], episode.rewards)
    done, terminated = td["next", "done"], td["next", "terminated"]
    assert done[-1].all()
    assert not done[:-1].any()
    assert bool(terminated[-1]) == bool(episode.terminated[-1])
    # Exactly one reason for the end, so that a truncated episode is bootstrapped.
    assert torch.equal(td["next", "truncated"], done ^ terminated)
    for key in ("observation", "action", ("next", "observation"), ("next", "reward")):
        assert td[key].dtype == torch.float32
    for key in ("done", "terminated", "truncated"):
        assert td["next", key].dtype == torch.bool
        assert td["next", key].shape == (episode.length, 1)


def test_shares_no_memory_with_the_episode() -> None:
    episode = still_episode()
    before = dataclasses.replace(
        episode, observations=episode.observations.copy(), actions=episode.actions.copy()
    )
    (td,) = to_tensordict([episode])
    td.zero_()
    np.testing.assert_array_equal(episode.observations, before.observations)
    np.testing.assert_array_equal(episode.actions, before.actions)


def test_one_per_episode_in_order() -> None:
    lengths = [3, 1, 5]
    tds = to_tensordict(still_episode(seed=i, steps=n) for i, n in enumerate(lengths))
    assert [td.shape[0] for td in tds] == lengths


def test_the_executed_action_is_the_action_and_the_clean_one_is_to_be_imitated() -> None:
    noisy = still_episode(steps=2, executed_actions=np.full((2, 28), 1.5, np.float32))
    plain = still_episode(seed=1, steps=3)
    found, other = to_tensordict([noisy, plain])
    assert (found["action"] == 1.0).all()  # as the simulator clips it
    np.testing.assert_array_equal(found["imitated_action"].numpy(), noisy.actions)
    # Of one set, all have both, so that they can be joined.
    assert torch.equal(other["imitated_action"], other["action"])
    np.testing.assert_array_equal(other["action"].numpy(), plain.actions)


def test_clean_actions_alone() -> None:
    noisy = still_episode(steps=2, executed_actions=np.full((2, 28), 0.5, np.float32))
    (found,) = to_tensordict([noisy], executed=False)
    np.testing.assert_array_equal(found["action"].numpy(), noisy.actions)
    assert "imitated_action" not in found
    (plain,) = to_tensordict([still_episode()])
    assert "imitated_action" not in plain
