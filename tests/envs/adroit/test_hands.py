"""What every task of the hand does: resume, number its starts, pay sparsely, replay, read files."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase

from envs import EnvOptions, find_task
from envs.demonstrations import DemonstrationError
from envs.demonstrations.episode import Episode, Provenance
from envs.demonstrations.loading import DemoOptions, load_demonstrations
from envs.rewards import rewarded
from tests.envs.adroit.conftest import ACCOMPLISHED, HANDS, OTHERS, STOCK, held_actions

STEPS = 60


def make(task: str, copies: int = 2, reward: str | None = None, **options) -> EnvBase:
    found = rewarded(find_task(task), reward)
    return found.make_env(EnvOptions(num_envs=copies, **{"seed": 1, **options}))


def roll(env: EnvBase, actions: np.ndarray, td: TensorDict | None = None):
    """Step with automatic resets; returns the stacked steps [N, T] and the next root."""
    td = env.reset() if td is None else td
    steps = []
    for action in torch.as_tensor(actions, dtype=torch.float32).clamp(-1, 1).unbind(1):
        stepped, td = env.step_and_maybe_reset(td.set("action", action))
        steps.append(stepped.clone())
    return torch.stack(steps, 1), td


@pytest.mark.parametrize("task", OTHERS)
def test_resumes_bit_for_bit_from_a_file(task, tmp_path):
    """In mid-episode, across later automatic resets, into an environment with another past."""
    before, after = held_actions(task, 2, 30), held_actions(task, 2, STEPS, seed=1)
    env, other = make(task, horizon=40), make(task, horizon=40, seed=9, num_threads=1)
    _, td = roll(env, before)
    torch.save({"env": env.state_dict(), "root": td.to_dict()}, tmp_path / "env.pt")
    expected, _ = roll(env, after, td.clone())
    roll(other, after)
    saved = torch.load(tmp_path / "env.pt", weights_only=True)
    other.load_state_dict(saved["env"])
    # What is observed now came with it, before another step is made.
    np.testing.assert_array_equal(
        other.simulator.observation(), saved["root"]["observation"].numpy()
    )
    resumed, _ = roll(other, after, TensorDict(saved["root"], batch_size=[2]))
    for key in ("observation", "reward", "success", "progress", "done"):
        assert torch.equal(resumed["next", key], expected["next", key]), key


@pytest.mark.parametrize("task", OTHERS)
def test_a_trajectory_depends_on_neither_neighbours_nor_threads(task):
    actions = held_actions(task, 3, STEPS)
    many, _ = roll(make(task, 3, num_threads=2), actions)
    few, _ = roll(make(task, 1), actions[:1])
    assert torch.equal(many["next", "observation"][:1], few["next", "observation"])
    # Copies that are left out stay as they are.
    env = make(task, 3)
    td = env.reset().set("action", torch.zeros(3, HANDS[task].action_size))
    mask = torch.tensor([True, False, True])
    moved = env.step(td.clone().set("_step", mask))["next", "observation"] != td["observation"]
    assert torch.equal(moved.any(-1), mask)


@pytest.mark.parametrize("task", sorted(HANDS))
def test_starts_are_numbered(task):
    """Episode k of the list is the same however many are stepped together, and k is the seed's."""
    found = find_task(task)
    env, alone = make(task, 3), make(task, 1)
    together = env.reset(found.starts(5, 0, 3))["observation"]
    for k in range(3):
        assert torch.equal(alone.reset(found.starts(5, k, 1))["observation"][0], together[k])
    assert len(torch.unique(together, dim=0)) == 3
    assert not torch.equal(env.reset(found.starts(6, 0, 3))["observation"], together)
    # Without a list, copy k of an environment with this seed begins there too.
    assert torch.equal(make(task, 3, seed=5).reset()["observation"], together)


@pytest.mark.parametrize("task", sorted(HANDS))
def test_a_sparse_reward_is_success_minus_one(task):
    actions = held_actions(task, 2, STEPS)
    sparse, _ = roll(make(task, reward="sparse"), actions)
    dense, _ = roll(make(task), actions)
    own, _ = roll(make(task, reward="dense"), actions)
    assert torch.equal(sparse["next", "reward"], sparse["next", "success"].float() - 1)
    assert torch.equal(sparse["next", "observation"], dense["next", "observation"])
    assert torch.equal(own["next", "reward"], dense["next", "reward"])
    assert not torch.equal(sparse["next", "reward"], dense["next", "reward"])


@pytest.mark.parametrize("task", sorted(HANDS))
def test_success_pays_ends_and_is_a_stage(task):
    found, env = find_task(task), make(task, reward="sparse", success_steps=2)
    td = env.reset().set("action", torch.zeros(2, HANDS[task].action_size))
    qpos = env.simulator.qpos[[1]]
    where = {name: values[[1]] for name, values in env.simulator.placement.items()}
    ACCOMPLISHED[task].put(qpos[0], where)
    env.simulator.start(where, [1], qpos)
    first = env.step(td.clone())["next"]
    second = env.step(td.clone())["next"]
    assert first["success"].tolist() == [[False], [True]]
    assert first["reward"].tolist() == [[-1.0], [0.0]]
    assert second["truncated"].tolist() == [[False], [True]]
    before, then = make(task).reset(), first[1:]
    (stage,) = (one for one in found.stages if one.label == ACCOMPLISHED[task].stage)
    assert stage.reached(then).tolist() == [True]
    assert not stage.reached(before).any()


def test_a_task_without_a_sparse_reward_says_so():
    with pytest.raises(
        ValueError, match=r"env\.reward=sparse needs .*gymnasium:Pendulum-v1.*env\.reward=null"
    ):
        rewarded(find_task("gymnasium:Pendulum-v1"), "sparse")


def recorded(task: str, steps: int = STEPS) -> tuple[Episode, TensorDict]:
    """An episode as a file may hold it, and what the environment said."""
    env, actions = make(task, 1), held_actions(task, 1, steps).clip(-1, 1)
    env.reset()
    start = {name: values[0] for name, values in env.simulator.placement.items()}
    qpos = env.simulator.qpos
    qpos[:, 3:8] += 0.1  # not the pose in which the task begins
    where = {name: values[None] for name, values in start.items()}
    first = env.simulator.start(where, qpos=qpos)
    given = torch.as_tensor(actions, dtype=torch.float32).unbind(1)
    said = torch.stack([env.step(TensorDict(action=one, batch_size=[1])) for one in given], 1)
    observations = np.concatenate([first, said["next", "observation"][0].numpy()])
    episode = Episode(
        observations=observations,
        actions=actions[0].astype(np.float32),
        rewards=np.zeros(steps, np.float32),
        terminated=np.zeros(steps, bool),
        provenance=Provenance("somewhere", 3, "recorded"),
        start=start | {"qpos": qpos[0], "qvel": np.zeros(env.simulator.qvel.shape[1])},
    )
    return episode, said[0]


@pytest.mark.parametrize("task", OTHERS)
def test_resimulation_equals_the_environment(task):
    episode, said = recorded(task)
    shorter = dataclasses.replace(
        episode, actions=episode.actions[:20], observations=episode.observations[:21]
    )
    long, short = find_task(task).resimulate([episode, shorter], num_threads=1)
    for key, found in (("reward", long.rewards), ("success", long.success[1:]),
                       ("progress", long.progress[1:])):  # fmt: skip
        np.testing.assert_array_equal(found, said["next", key][:, 0].numpy(), err_msg=key)
    np.testing.assert_array_equal(long.observations, episode.observations)
    np.testing.assert_array_equal(short.observations, episode.observations[:21])
    assert (long.provenance.kind, long.provenance.episode) == ("resimulated", 3)
    sparse = rewarded(find_task(task), "sparse").resimulate([episode])[0]
    np.testing.assert_array_equal(sparse.rewards, sparse.success[1:].astype(np.float32) - 1)


@pytest.mark.parametrize("task", OTHERS)
def test_what_does_not_say_where_things_stand_cannot_be_replayed(task):
    episode, _ = recorded(task, 10)
    with pytest.raises(
        DemonstrationError, match=r"somewhere, episode 3: has no \w+.*demos\.resimulate=false"
    ):
        find_task(task).resimulate([dataclasses.replace(episode, start={})])


@pytest.mark.parametrize("task", OTHERS)
def test_reads_the_published_format(task, tmp_path):
    """DAPG's pickles, under the suite's names; played again or not, they pay the task's reward."""
    episode, said = recorded(task)
    theirs = STOCK[task].keys
    state = {theirs.get(name, name): value for name, value in episode.start.items()}
    entry = {
        "observations": episode.observations,
        "actions": np.append(episode.actions, episode.actions[-1:], 0),
        "rewards": np.full(len(episode.observations), 7.0),
        "init_state_dict": state,
    }
    path = tmp_path / "episodes.pickle"
    path.write_bytes(pickle.dumps([entry], protocol=2))
    for resimulate, tolerance in ((True, 0.0), (False, find_task(task).demos.reward_tolerance)):
        loaded = load_demonstrations(path, find_task(task), DemoOptions(resimulate=resimulate))
        (found,) = loaded.episodes
        np.testing.assert_allclose(
            found.rewards, said["next", "reward"][:, 0], rtol=0, atol=tolerance
        )
        np.testing.assert_array_equal(found.success[1:], said["next", "success"][:, 0])
    sparse = load_demonstrations(
        path, rewarded(find_task(task), "sparse"), DemoOptions(resimulate=False)
    )
    assert set(sparse.episodes[0].rewards.tolist()) <= {-1.0, 0.0}
