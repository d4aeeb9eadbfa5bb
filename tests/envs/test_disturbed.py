"""Episodes that are disturbed: what is drawn, what is played, what is seen, and nothing else."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torch import nn

from envs import EnvOptions, find_task
from envs.disturbed import DisturbedEnv, disturbed, moved
from envs.disturbing import Box, Disturb, Disturbance, Factor
from tests.toys.reach import TASK as REACH
from tests.toys.reach import Reach

STEPS = 12


def reach(copies: int = 2, seed: int = 3, **asked) -> DisturbedEnv:
    env = disturbed(REACH, Disturbance(**asked)).make_env(EnvOptions(num_envs=copies, seed=seed))
    assert isinstance(env, DisturbedEnv)
    return env


def door(copies: int = 2, seed: int = 3, threads: int = 1, horizon: int = 8, **asked):
    options = EnvOptions(num_envs=copies, seed=seed, num_threads=threads, horizon=horizon)
    return disturbed(find_task("door"), Disturbance(**asked)).make_env(options)


def roll(env, actions, td=None):
    """Step with automatic resets; the steps [N, T] and the next root."""
    td = env.reset() if td is None else td
    steps = []
    for action in actions.unbind(1):
        stepped, td = env.step_and_maybe_reset(td.set("action", action))
        steps.append(stepped.clone())
    return torch.stack(steps, 1), td


def actions_of(env, steps: int = STEPS, seed: int = 0) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    shape = (env.batch_size[0], steps, env.action_spec.shape[-1])
    return torch.as_tensor(rng.uniform(-1, 1, shape), dtype=torch.float32)


def test_nothing_asked_is_the_task_itself():
    assert disturbed(REACH, Disturbance()) is REACH


def test_a_factor_of_one_changes_no_bit():
    plain = find_task("door").make_env(EnvOptions(num_envs=2, seed=3, num_threads=1, horizon=8))
    same = door(factors=dict.fromkeys(find_task("door").disturb.factors, (1.0, 1.0)))
    expected, _ = roll(plain, actions_of(plain))
    found, _ = roll(same, actions_of(same))
    for key in ("observation", "reward", "done", "success", "progress"):
        assert torch.equal(found["next", key], expected["next", key]), key


def test_a_delayed_action_is_played_so_many_steps_later():
    """The reference is the environment itself, given the actions two steps late, 0 before."""
    late, plain = reach(delay=(2, 2)), Reach(EnvOptions(num_envs=2, seed=3))
    actions = actions_of(late)
    shifted = torch.cat([torch.zeros(2, 2, 2), actions[:, :-2]], 1)
    found, expected = roll(late, actions)[0], roll(plain, shifted)[0]
    assert torch.equal(found["next", "observation"], expected["next", "observation"])
    # What was asked for is what a learner remembers.
    assert torch.equal(found["action"], actions)


def test_a_hand_rests_until_the_first_action_arrives():
    env = door(delay=(200, 200), horizon=40)
    found, _ = roll(env, actions_of(env, 30))
    # The targets of a resting hand are the angles 0, in which it begins: only gravity moves it.
    assert found["next", "observation"][..., :27].abs().max() < 0.1


def test_observation_noise_is_of_its_size_and_judges_nothing():
    env, plain = reach(200, observation_noise=(0.3, 0.3)), Reach(EnvOptions(num_envs=200, seed=3))
    actions = actions_of(env)
    found, expected = roll(env, actions)[0], roll(plain, actions)[0]
    noise = found["next", "observation"] - expected["next", "observation"]
    assert noise.std().item() == pytest.approx(0.3, rel=0.03)  # of 9,600 numbers: 3 sigma is 2 %
    assert noise.mean().item() == pytest.approx(0.0, abs=0.02)
    for key in ("reward", "success", "progress"):
        assert torch.equal(found["next", key], expected["next", key]), key
    first = found["observation"][:, 0] - expected["observation"][:, 0]
    assert first.std().item() == pytest.approx(0.3, rel=0.1)


def test_action_noise_is_of_its_size_and_stays_within_bounds():
    class Watched(Reach):
        def _step(self, td):
            self.played = td["action"].clone()
            return super()._step(td)

    options = EnvOptions(num_envs=200, seed=3)
    env = DisturbedEnv(Watched(options), Disturbance(action_noise=(0.2, 0.2)), None, seed=1)
    env.step(env.reset().set("action", torch.zeros(200, 2)))
    assert env.env.played.std().item() == pytest.approx(0.2, rel=0.12)  # 3 sigma of 400 numbers
    # A full action can only become less than full.
    env.step(env.reset().set("action", torch.ones(200, 2)))
    assert env.env.played.max().item() == 1.0
    assert env.env.played.min().item() < 1.0


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), low=st.floats(0.2, 1.0), width=st.floats(0.0, 2.0))
def test_what_is_drawn_lies_in_its_range(seed, low, width):
    given_factors: list[float] = []
    box = Box("start", (0.0,) * 4, (1.0,) * 4, ("a", "b", "", "d"), (-inf,) * 4, (inf,) * 4, "")
    disturb = Disturb(
        apply=lambda env, copy, factors: given_factors.append(factors["weight"]),
        factors={"weight": Factor("weight")},
        boxes=(box,),
    )
    asked = Disturbance(
        observation_noise=(low, low + width),
        delay=(1, 4),
        factors={"weight": (low, low + width)},
        outside={"a": (-width, width), "d": (low, low + width)},
    )
    env = DisturbedEnv(Reach(EnvOptions(num_envs=8)), asked, disturb, seed=seed)
    env.reset()
    start = env.env.state.numpy()
    assert len(given_factors) == 8
    assert all(low - 1e-9 <= factor <= low + width + 1e-9 for factor in given_factors)
    assert {episode.delay for episode in env._episodes} <= {1, 2, 3, 4}
    within = 1e-6
    assert ((start[:, 0] >= -width - within) & (start[:, 0] <= 1 + width + within)).all()
    assert ((start[:, 1:3] >= -within) & (start[:, 1:3] <= 1 + within)).all()
    assert ((start[:, 3] >= low - within) & (start[:, 3] <= 1 + low + width + within)).all()


def test_half_is_drawn_as_often_as_double():
    env = door(400, factors={"mass": (0.5, 2.0)})
    env.reset()
    factors = np.array([episode.factors["mass"] for episode in env._episodes])
    assert (factors < 1.0).mean() == pytest.approx(0.5, abs=0.08)  # 3 sigma of 400
    assert factors.min() < 0.55
    assert factors.max() > 1.8


def test_places_beyond_the_box_and_those_that_are_given():
    env = door(60, outside={"door_x": (-0.05, 0.05)})
    env.reset()
    x = env.env.simulator.placement["door_position"][:, 0]
    assert x.min() < -0.3  # the box is -0.3 to -0.2 m
    assert x.max() > -0.2
    assert ((x >= -0.35) & (x <= -0.15)).all()
    asked = find_task("door").starts(5, 0, 60)
    env.reset(asked.clone())
    stand = env.env.simulator.placement["door_position"]
    np.testing.assert_array_equal(stand, asked["door_position"].numpy())


def test_the_seed_and_the_number_of_an_episode_say_what_it_is():
    """Episode k of a list, in one wave of four copies or in two of two."""
    asked = {"observation_noise": (0.1, 0.5), "action_noise": (0.0, 0.3), "delay": (0, 3)}

    def waves(copies: int, seed: int) -> torch.Tensor:
        env = reach(copies, seed, **asked)
        actions = actions_of(reach(4, **asked))
        seen = []
        for first in range(0, 4, copies):
            td = env.reset(REACH.starts(9, first, copies))
            seen.append(roll(env, actions[first : first + copies], td)[0]["next", "observation"])
        return torch.cat(seen)

    assert torch.equal(waves(4, 3), waves(2, 3))
    assert torch.equal(waves(4, 3), waves(4, 3))
    assert not torch.equal(waves(4, 3), waves(4, 4))


@pytest.mark.parametrize(
    "asked",
    [
        {"observation_noise": (0.0, 0.1), "action_noise": (0.1, 0.2), "delay": (0, 3)},
        {"factors": {"mass": (0.5, 2.0), "contact_friction": (0.5, 2.0)}, "delay": (0, 2)},
        {"outside": {"door_x": (-0.02, 0.05)}, "action_noise": (0.0, 0.2)},
    ],
)
def test_resumes_bit_for_bit_from_a_file(asked, tmp_path):
    """In mid-episode, across later automatic resets, into an environment with another past."""
    env, other = door(**asked), door(seed=9, **asked)
    before, after = actions_of(env, 13), actions_of(env, 20, seed=1)
    _, td = roll(env, before)
    torch.save({"env": env.state_dict(), "root": td.to_dict()}, tmp_path / "env.pt")
    expected, _ = roll(env, after, td.clone())
    roll(other, after[:, :5])
    saved = torch.load(tmp_path / "env.pt", weights_only=True)
    other.load_state_dict(saved["env"])
    resumed, _ = roll(other, after, TensorDict(saved["root"], batch_size=[2]))
    for key in ("observation", "reward", "success", "progress", "done"):
        assert torch.equal(resumed["next", key], expected["next", key]), key


def test_it_goes_on_midway_only_where_the_environment_inside_does():
    class Forgetful(Reach):
        get_extra_state = nn.Module.get_extra_state
        set_extra_state = nn.Module.set_extra_state

    options = EnvOptions(num_envs=2, seed=3)
    asked = Disturbance(delay=(1, 1))
    assert DisturbedEnv(Reach(options), asked, None).resumes_midway
    assert not DisturbedEnv(Forgetful(options), asked, None).resumes_midway


def test_a_state_of_another_length_of_memory_is_refused():
    with pytest.raises(ValueError, match=r"task\.randomise\.delay"):
        reach(delay=(0, 2)).load_state_dict(reach(delay=(0, 3)).state_dict())


def test_copies_that_are_not_reset_keep_what_they_saw():
    env = reach(2, observation_noise=(0.5, 0.5))
    td = env.step_mdp(env.step(env.reset().set("action", torch.zeros(2, 2))))
    reset = env.reset(td.clone().set("_reset", torch.tensor([[True], [False]])))
    assert torch.equal(reset["observation"][1], td["observation"][1])
    assert not torch.equal(reset["observation"][0], td["observation"][0])


def test_starts_at_a_distance_from_the_box():
    plain, beyond = find_task("door"), moved(find_task("door"), "door_x", 0.02)
    below = moved(find_task("door"), "door_y", -0.05)
    was, found = (task.starts(7, 3, 4)["door_position"] for task in (plain, beyond))
    assert found[:, 0].tolist() == pytest.approx([-0.18] * 4)
    assert torch.equal(found[:, 1:], was[:, 1:])
    assert below.starts(7, 3, 4)["door_position"][:, 1].tolist() == pytest.approx([0.2] * 4)


def asked_for(env) -> torch.Tensor:
    """Where the pens are to point, unit vectors [N, 3]."""
    return env.reset()["observation"][:, 36:39].double()


def test_pens_are_asked_for_orientations_farther_than_in_training():
    plain, beyond = find_task("pen"), moved(find_task("pen"), "asked_x", 0.4)
    was, found = (task.starts(7, 3, 6)["asked_orientation"] for task in (plain, beyond))
    assert found.norm(dim=-1).tolist() == pytest.approx([1.0] * 6)
    # Pens that are turned by 1.4 rad about x, and then about their own y as they would have been.
    env = beyond.make_env(EnvOptions(num_envs=6))
    x, y, z = env.reset(beyond.starts(7, 3, 6))["observation"][:, 36:39].double().T
    assert torch.atan2(-y, z).tolist() == pytest.approx([1.4] * 6, abs=1e-5)
    w, i, j, _ = was.T
    assert x.tolist() == pytest.approx(torch.sin(2 * torch.atan2(j, w)).tolist(), abs=1e-5)
    assert torch.atan2(i, w).abs().max() < 0.5


def test_pens_of_training_are_asked_for_what_is_drawn():
    disturbance = Disturbance(outside={"asked_y": (0.0, 0.5)})
    task, options = disturbed(find_task("pen"), disturbance), EnvOptions(num_envs=100, seed=0)
    x, y, z = asked_for(task.make_env(options)).T
    about_y = torch.asin(x)
    assert -1.0 < about_y.min() < -0.8
    assert 1.3 < about_y.max() < 1.5
    assert torch.atan2(-y, z).abs().max() < 1.0


def test_orientations_that_no_hand_could_give_a_pen_are_refused():
    for distance in (0.58, -0.58):
        with pytest.raises(ValueError, match="a quarter turn"):
            moved(find_task("pen"), "asked_y", distance)
    assert moved(find_task("pen"), "asked_x", 0.57)


def test_a_box_of_other_numbers_says_both_ways():
    with pytest.raises(ValueError, match="asked: placed and numbers are given together"):
        Box("asked", (0.0,), (1.0,), ("a",), (-inf,), (inf,), "", placed=np.sin)


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"delay": (3, 1)}, "delay"),
        ({"action_noise": (-0.1, 0.1)}, "action_noise"),
        ({"factors": {"masses": (1.0, 2.0)}}, r"factors\.masses is unknown.*'mass'"),
        ({"factors": {"mass": (0.0, 1.0)}}, r"factors\.mass=\[0\.0, 1\.0\] is outside"),
        ({"factors": {"mass": (2.0, 1.0)}}, "the lower number comes first"),
        ({"outside": {"door_w": (0.0, 1.0)}}, r"outside\.door_w.*door_x"),
        ({"outside": {"door_z": (-0.01, 0.0)}}, r"penetrates the table"),
    ],
)
def test_settings_that_cannot_be_are_refused(asked, told):
    with pytest.raises(ValueError, match=told):
        disturbed(find_task("door"), Disturbance(**asked))


def test_a_task_without_a_model_of_its_own_takes_noise_only():
    with pytest.raises(ValueError, match=r"factors\.mass needs a task.*reach does not"):
        disturbed(REACH, Disturbance(factors={"mass": (1.0, 2.0)}))
    with pytest.raises(ValueError, match=r"outside\.x needs a task"):
        moved(REACH, "x", 0.1)
