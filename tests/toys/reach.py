"""A point in the plane that must reach a goal: a whole task in milliseconds, without an engine."""

from collections.abc import Sequence

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from envs import EnvOptions, Stage, Task
from envs.demonstrations import Episode
from envs.demonstrations.schema import DemoSchema, StartKey
from pipeline.commands.demonstrator import Demonstrator
from pipeline.commands.record import record_demonstrations

HORIZON, SPEED, NEAR = 20, 0.15, 0.1
DONE = ("done", "terminated", "truncated")


def numbered(seed: int, episode: int) -> Tensor:
    """Point and goal of an episode, [4] in [-1, 1], whatever other episodes there are."""
    generator = torch.Generator().manual_seed(seed * 1_000_003 + episode)
    return torch.rand(4, generator=generator) * 2 - 1


class Reach(EnvBase):
    """N points as one batch; observes point and goal and pays progress, 1 minus their distance."""

    def __init__(self, options: EnvOptions) -> None:
        super().__init__(device=options.device, batch_size=[n := options.num_envs])
        flag, number = Binary(shape=(n, 1), dtype=torch.bool), Unbounded((n, 1))
        seen = {"observation": Unbounded((n, 4)), "progress": number, "success": flag}
        self.observation_spec = Composite(seen, shape=(n,))
        self.action_spec, self.reward_spec = Bounded(-1.0, 1.0, (n, 2)), number.clone()
        self.done_spec = Composite({key: flag.clone() for key in DONE}, shape=(n,))
        self.horizon = options.horizon or HORIZON
        self.until = options.success_steps or self.horizon + 1
        # Point and goal; steps of the episode, those of success in a row, episodes begun.
        self.state, self.counts = torch.zeros(n, 4), torch.zeros(n, 3, dtype=torch.int64)
        self._set_seed(options.seed)

    def _set_seed(self, seed: int | None) -> None:
        self.seed, self.counts[:, 2] = torch.seed() % 2**31 if seed is None else seed, 0

    def _reset(self, td: TensorDict | None, **_: object) -> TensorDict:
        td = TensorDict() if td is None else td
        chosen = td.get("_reset", torch.ones(len(self.state))).view(-1).nonzero().view(-1)
        for i in chosen.tolist():
            drawn = numbered(self.seed + 7919 * i, int(self.counts[i, 2]))
            self.state[i] = td["start"][i].float() if "start" in td.keys() else drawn  # noqa: SIM118
            self.counts[i] = torch.tensor([0, 0, self.counts[i, 2] + 1])
        return self._out()

    def _step(self, td: TensorDict) -> TensorDict:
        active = td.get("_step", torch.ones(len(self.state))).view(-1, 1).long()
        self.state[:, :2] += active * SPEED * td["action"].clamp(-1.0, 1.0)
        out, (steps, held, begun) = self._out(), self.counts.split(1, -1)
        held = torch.where(active > 0, (held + 1) * out["success"], held)
        self.counts = torch.cat([steps + active, held, begun], -1)
        ends = (self.counts[:, :1] >= self.horizon) | (held >= self.until)
        return out.update({"reward": out["progress"], "truncated": ends, "done": ends.clone()})

    def _out(self) -> TensorDict:
        far = (self.state[:, :2] - self.state[:, 2:]).norm(dim=-1, keepdim=True)
        seen = {"observation": self.state.clone(), "progress": 1 - far, "success": far < NEAR}
        return TensorDict(seen | {k: torch.zeros_like(far) > 0 for k in DONE}, self.batch_size)

    def get_extra_state(self) -> dict[str, Tensor]:
        return {"state": self.state, "counts": self.counts, "seed": torch.tensor(self.seed)}

    def set_extra_state(self, state: dict[str, Tensor]) -> None:
        self.state, self.counts = state["state"].clone(), state["counts"].clone()
        self.seed = int(state["seed"])


def controller(observation: Tensor) -> Tensor:
    """[N, 4] -> [N, 2]: straight to the goal."""
    return (5.0 * (observation[:, 2:] - observation[:, :2])).clamp(-1.0, 1.0)


def record(path: object, episodes: int = 6) -> None:
    demonstrator = Demonstrator.of_controller(f"{__file__}:controller", [f"task.name='{__file__}'"])
    record_demonstrations(demonstrator, str(path), episodes=episodes, attempts=2 * episodes, seed=1)


def starts(seed: int, first: int, count: int) -> TensorDict:
    """The list of evaluation episodes."""
    listed = torch.stack([numbered(seed, first + i) for i in range(count)])
    return TensorDict({"start": listed}, [count])


def states(episodes: Sequence[Episode], *, num_threads: int | None = None) -> list[TensorDict]:
    """Its observations are its states."""
    seen = [torch.as_tensor(episode.observations) for episode in episodes]
    return [TensorDict({"start": of_one}, [len(of_one)]) for of_one in seen]


TASK = Task(
    name="reach",
    make_env=Reach,
    stages=(Stage("there", lambda after: after["success"].squeeze(-1)),),
    starts=starts,
    states=states,
    demos=DemoSchema("the toy reach", 4, 2, start=(StartKey("start", 4),), horizon=HORIZON),
)
