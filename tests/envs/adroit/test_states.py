"""An episode may begin anywhere in a demonstration of the hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from envs import EnvOptions, find_task
from envs.demonstrations import DemonstrationError, Episode, Provenance

STEPS = 12


def played(name: str) -> Episode:
    """Gentle random actions from the task's own start, as its simulator plays them."""
    task = find_task(name)
    env = task.make_env(EnvOptions(seed=0, num_threads=1))
    td = env.reset()
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (STEPS, env.action_spec.shape[-1]))
    start = {key: value[0].copy() for key, value in env.simulator.placement.items()}
    nothing = np.zeros(STEPS)
    episode = Episode(
        observations=td["observation"].repeat(STEPS + 1, 1).numpy(),
        actions=actions.astype(np.float32),
        rewards=nothing.astype(np.float32),
        terminated=nothing.astype(bool),
        provenance=Provenance("synthetic", 0, "recorded"),
        start=start,
    )
    env.close()
    (found,) = task.resimulate([episode], num_threads=1)
    return found


@pytest.mark.parametrize("name", ["door", "hammer", "pen", "relocate"])
def test_it_shows_what_the_demonstration_showed_there(name: str):
    task, episode = find_task(name), played(name)
    (states,) = task.states([episode], num_threads=1)
    assert states.batch_size == (STEPS + 1,)
    env = task.make_env(EnvOptions(num_envs=3, seed=5, num_threads=1))
    where = [0, 5, STEPS]
    begun = env.reset(states[where])
    seen = begun["observation"]
    # Site positions of a running hand may be one simulation step older than its joints.
    np.testing.assert_allclose(seen, episode.observations[where], atol=2e-2)
    assert np.abs(np.diff(episode.observations[where], axis=0)).max() > 0.1, "they differ"
    # Only the copy that begins is moved.
    only = torch.tensor([False, True, False])[:, None]
    moved = begun.clone().update(states[[3, 3, 3]]).set("_reset", only)
    again = env.reset(moved)["observation"]
    assert torch.equal(again[0], seen[0])
    np.testing.assert_allclose(again[1], episode.observations[3], atol=2e-2)
    env.close()


def test_an_episode_that_leads_elsewhere_is_refused():
    episode = played("door")
    other = replace(episode, observations=episode.observations + 0.1)
    with pytest.raises(DemonstrationError, match=r"not what the simulator plays.*resimulate=true"):
        find_task("door").states([other], num_threads=1)


def test_no_episodes_have_no_states():
    assert find_task("pen").states([]) == []
