"""A gripper that must lift a block to a goal: sparse, 28 observations, 5 actions, no engine.

A stand-in for manipulation with a reward for success alone. Its controller moves as fast as it may,
so that about a third of the demonstrated entries are at their bounds.
"""

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from envs import EnvOptions, Task
from envs.demonstrations.schema import DemoSchema, StartKey
from pipeline.commands.demonstrator import Demonstrator
from pipeline.commands.record import record_demonstrations

HORIZON, EPISODES = 45, 25
SPEED, TURN, LAG = 0.02, 0.25, 0.6  # m and rad a step at full action, share of it that follows
HOVER, GRASP, TILT, NEAR = 0.06, 0.010, 0.15, 0.03  # m, m, rad, m
CLOSED = 0.5  # aperture below which the gripper holds what is between its fingers
DONE = ("done", "terminated", "truncated")
# Columns of the state.
HAND, SPIN, APERTURE, BLOCK, YAW, HELD, GOAL, MOVED = (
    slice(0, 3), 3, 4, slice(5, 8), 8, 9, slice(10, 13), slice(13, 16),
)  # fmt: skip


def numbered(seed: int, episode: int) -> Tensor:
    """State [16] that an episode starts in, whatever other episodes there are."""
    u = torch.rand(9, generator=torch.Generator().manual_seed(seed * 1_000_003 + episode)) * 2 - 1
    state = torch.zeros(16)
    state[HAND] = torch.stack([0.05 * u[0], 0.05 * u[1], 0.15 + 0.03 * u[2]])
    state[APERTURE] = 1.0
    state[BLOCK] = torch.stack([0.15 * u[3], 0.15 * u[4], torch.zeros(())])
    state[YAW] = 0.8 * u[5]
    state[GOAL] = torch.stack([0.15 * u[6], 0.15 * u[7], 0.15 + 0.08 * u[8]])
    return state


class Pick(EnvBase):
    """N grippers as one batch; pays 1 for each step in which the block is at its goal."""

    def __init__(self, options: EnvOptions) -> None:
        super().__init__(device=options.device, batch_size=[n := options.num_envs])
        flag = Binary(shape=(n, 1), dtype=torch.bool)
        self.observation_spec = Composite(
            {"observation": Unbounded((n, 28)), "success": flag}, shape=(n,)
        )
        self.action_spec, self.reward_spec = Bounded(-1.0, 1.0, (n, 5)), Unbounded((n, 1))
        self.done_spec = Composite({key: flag.clone() for key in DONE}, shape=(n,))
        self.horizon = options.horizon or HORIZON
        self.until = options.success_steps or self.horizon + 1
        # Steps of the episode, those of success in a row, episodes begun.
        self.state, self.counts = torch.zeros(n, 16), torch.zeros(n, 3, dtype=torch.int64)
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
        active = td.get("_step", torch.ones(len(self.state))).view(-1, 1).bool()
        self.state = torch.where(active, moved(self.state, td["action"]), self.state)
        out, (steps, held, begun) = self._out(), self.counts.split(1, -1)
        held = torch.where(active, (held + 1) * out["success"], held)
        self.counts = torch.cat([steps + active, held, begun], -1)
        ends = (self.counts[:, :1] >= self.horizon) | (held >= self.until)
        reward = out["success"].float()
        return out.update({"reward": reward, "truncated": ends, "done": ends.clone()})

    def _out(self) -> TensorDict:
        far = (self.state[:, BLOCK] - self.state[:, GOAL]).norm(dim=-1, keepdim=True)
        seen = {"observation": observed(self.state), "success": far < NEAR}
        return TensorDict(seen | {k: torch.zeros_like(far) > 0 for k in DONE}, self.batch_size)

    def get_extra_state(self) -> dict[str, Tensor]:
        return {"state": self.state, "counts": self.counts, "seed": torch.tensor(self.seed)}

    def set_extra_state(self, state: dict[str, Tensor]) -> None:
        self.state, self.counts = state["state"].clone(), state["counts"].clone()
        self.seed = int(state["seed"])


def moved(state: Tensor, action: Tensor) -> Tensor:
    """The states [N, 16] after an action [N, 5]: three of motion, a turn, and the gripper's."""
    action, new = action.clamp(-1.0, 1.0), state.clone()
    new[:, MOVED] = (1 - LAG) * state[:, MOVED] + LAG * SPEED * action[:, :3]
    new[:, HAND] += new[:, MOVED]
    new[:, 2].clamp_(min=0.0)  # the table
    new[:, SPIN] += TURN * action[:, 3]
    new[:, APERTURE] = (state[:, APERTURE] + 0.3 * action[:, 4]).clamp(0.0, 1.0)
    closed = new[:, APERTURE] < CLOSED
    between = (state[:, HAND] - state[:, BLOCK]).norm(dim=-1) < GRASP
    between &= (state[:, SPIN] - state[:, YAW]).abs() < TILT
    closing = closed & (state[:, APERTURE] >= CLOSED)
    held = closed & ((state[:, HELD] > 0) | (closing & between))
    carried = torch.where(held[:, None], new[:, HAND], state[:, BLOCK])
    new[:, BLOCK] = carried
    falls = torch.where(held, carried[:, 2], (carried[:, 2] - 0.05).clamp(min=0.0))
    new[:, BLOCK.stop - 1] = falls
    new[:, HELD] = held.float()
    return new


def observed(state: Tensor) -> Tensor:
    """[N, 16] -> [N, 28], in units of about 1."""
    hand, block, goal = state[:, HAND], state[:, BLOCK], state[:, GOAL]
    angles = torch.stack([state[:, SPIN], state[:, YAW], state[:, SPIN] - state[:, YAW]], -1)
    lengths = torch.cat([hand, block, goal, block - hand, goal - block, state[:, MOVED]], -1)
    rest = torch.stack([state[:, APERTURE], state[:, HELD]], -1)
    turned = torch.stack([state[:, SPIN].sin(), state[:, SPIN].cos()], -1)
    turns = torch.stack([state[:, YAW].sin(), state[:, YAW].cos()], -1)
    far = (goal - block).norm(dim=-1, keepdim=True)
    return torch.cat([10 * lengths, angles, rest, turned, turns, 10 * far], -1)


def controller(observation: Tensor) -> Tensor:
    """[N, 28] -> [N, 5]: above the block, down, close, to the goal; at full speed until near."""
    to_block, to_goal, turn = (
        observation[:, 9:12] / 10,
        observation[:, 12:15] / 10,
        observation[:, 20],
    )
    held = observation[:, 22] > 0.5
    across = to_block[:, :2].norm(dim=-1)
    aligned = (across < 0.8 * GRASP) & (turn.abs() < 0.8 * TILT)
    there = aligned & (to_block.norm(dim=-1) < 0.9 * GRASP)
    hover = torch.where(aligned, to_block[:, 2], to_block[:, 2] + HOVER)
    move = torch.cat([to_block[:, :2], hover[:, None]], -1)
    move = torch.where(held[:, None], to_goal, move)
    grip = torch.where(held | there, -1.0, 1.0)
    action = torch.cat([30.0 * move, -2.0 * turn[:, None], grip[:, None]], -1)
    return action.clamp(-1.0, 1.0)


def record(path: object, episodes: int = EPISODES) -> None:
    demonstrator = Demonstrator.of_controller(f"{__file__}:controller", [f"task.name='{__file__}'"])
    record_demonstrations(demonstrator, str(path), episodes=episodes, attempts=4 * episodes, seed=1)


def starts(seed: int, first: int, count: int) -> TensorDict:
    """The list of evaluation episodes."""
    listed = torch.stack([numbered(seed, first + i) for i in range(count)])
    return TensorDict({"start": listed}, [count])


TASK = Task(
    name="pick",
    make_env=Pick,
    starts=starts,
    demos=DemoSchema("the toy pick", 28, 5, start=(StartKey("start", 16),), horizon=HORIZON),
)
