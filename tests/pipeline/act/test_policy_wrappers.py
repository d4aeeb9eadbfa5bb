"""Policies around an actor: whose action is taken, and that noise belongs to the actor."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from envs import EnvOptions
from losses import Proposal
from pipeline.act.chosen_starts import ChosenStartsEnv
from pipeline.act.exploration import EpisodeNoise
from pipeline.act.policy_wrappers import ChunkedPolicy, ProposingPolicy, through, unwrapped
from pipeline.learn.networks import make_actor
from tests.toys import reach

SEEN = 3.0 * torch.randn(64, 3, generator=torch.Generator().manual_seed(3))


SIDE = torch.sign(SEEN[:, :1])


class LikesItsSide(nn.Module):
    """Two critics, ``[2, B, 1]``: the action's first entry on the state's side, and 10 more."""

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        value = torch.sign(observation[:, :1]) * action[:, :1]
        return torch.stack([value, value + 10.0])


def mean(actor) -> Tensor:
    with torch.no_grad():
        return actor.get_dist(TensorDict({"observation": SEEN}, [64])).deterministic_sample


def acted(policy) -> Tensor:
    with torch.no_grad():
        return policy(TensorDict({"observation": SEEN}, [64]))["action"]


def test_it_acts_with_the_better_of_two_rows_apart():
    own, clone = make_actor(3, 2, [8]), make_actor(3, 2, [8])
    policy = ProposingPolicy(own, Proposal(clone), LikesItsSide())
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        action = acted(policy)
    better = SIDE * mean(clone)[:, :1] > SIDE * mean(own)[:, :1]
    assert better.any()
    assert not better.all()
    assert torch.equal(action, torch.where(better, mean(clone), mean(own)))


def test_its_weights_are_those_of_both_and_of_the_critic():
    own, clone = make_actor(3, 2, [8]), make_actor(3, 2, [8])
    policy = ProposingPolicy(own, Proposal(clone), nn.Linear(2, 1))
    again = ProposingPolicy(make_actor(3, 2, [8]), Proposal(make_actor(3, 2, [8])), nn.Linear(2, 1))
    again.load_state_dict(policy.state_dict())
    assert torch.equal(mean(again.core), mean(own))
    assert torch.equal(mean(again.proposal.actor), mean(clone))
    assert torch.equal(again.critic.weight, policy.critic.weight)


def test_noise_is_the_actors_and_a_policy_is_the_same_around_it():
    own, clone = make_actor(3, 2, [8]), make_actor(3, 2, [8])
    policy = ProposingPolicy(own, Proposal(clone), LikesItsSide())
    assert unwrapped(policy) is own
    assert unwrapped(own) is own
    noisy = EpisodeNoise(own, seed=1)
    assert through(own, noisy) is noisy
    judged = through(policy, noisy)
    assert unwrapped(judged) is noisy
    assert unwrapped(policy) is own, "the policy itself is as it was"
    noisy.begin(0, 64)
    drawn = acted(noisy)
    noisy.begin(0, 64)
    better = SIDE * mean(clone)[:, :1] > SIDE * drawn[:, :1]
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(acted(judged), torch.where(better, mean(clone), drawn))


class Numbered(TensorDictModuleBase):
    """Gives k = 3 actions at once: 10 times the observation, then 1 and 2 more."""

    in_keys = ("observation",)
    out_keys = ("action",)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        first = 10.0 * tensordict["observation"]
        return tensordict.set("action", torch.cat([first, first + 1, first + 2], dim=-1))


def steps_of(policy: ChunkedPolicy, *seen: list[float], begun: dict[int, list[bool]]) -> list:
    """Actions for observations of two copies, one step after the other; ``begun`` by step."""
    td, actions = TensorDict({}, [2]), []
    for step, observation in enumerate(seen):
        td["observation"] = torch.tensor(observation)[:, None]
        td["is_init"] = torch.tensor(begun.get(step, [False, False]))[:, None]
        td = policy(td)
        actions.append(td["action"].squeeze(-1).tolist())
    return actions


def test_a_chunk_is_executed_without_looking():
    """Observations 1, 2, 3 and 4 of the first copy: 10, 11, 12 of the first, then 40."""
    seen = ([1.0, 5.0], [2.0, 6.0], [3.0, 7.0], [4.0, 8.0])
    actions = steps_of(ChunkedPolicy(Numbered(), 3), *seen, begun={0: [True, True]})
    assert actions == [[10, 50], [11, 51], [12, 52], [40, 80]]


def test_an_episode_begins_with_a_chunk_of_its_own():
    """The second copy begins again at the third step: 70, 71, where the first goes on."""
    seen = ([1.0, 5.0], [2.0, 6.0], [3.0, 7.0], [4.0, 8.0])
    actions = steps_of(ChunkedPolicy(Numbered(), 3), *seen, begun={2: [False, True]})
    assert actions == [[10, 50], [11, 51], [12, 70], [40, 71]]


def test_a_chunk_goes_on_in_an_environment_that_tells_its_beginnings():
    """Episodes of two steps: a chunk's third action is never reached."""
    env = ChosenStartsEnv(reach.Reach(EnvOptions(num_envs=2, seed=1, horizon=2)))
    given = []

    class Given(Numbered):
        def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
            number = float(len(given))
            given.append(number)
            action = torch.tensor([number, number, number + 0.25, number, number + 0.5, number])
            return tensordict.set("action", (action / 100).expand(2, 6))

    policy, td, firsts = ChunkedPolicy(Given(), 3), env.reset(), []
    for _ in range(5):
        step, td = env.step_and_maybe_reset(policy(td))
        firsts.append(round(100 * step["action"][0, 0].item(), 2))
    assert firsts == [0.0, 0.25, 2.0, 2.25, 4.0]
