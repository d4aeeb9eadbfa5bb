"""Evaluation of a policy over a fixed list of episodes (paper, section IV-D)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self, get_args

import torch
from pydantic.dataclasses import dataclass as settings
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from envs import EnvOptions, Stage, Task
from envs.task import PROGRESS, SUCCESS, has_column
from pipeline.act.exploration import EpisodeNoise, require_noise_scale
from pipeline.act.metrics import Rollouts, plain, summarise
from pipeline.act.policy_wrappers import through, unwrapped
from pipeline.act.recorder import SeesSteps
from pipeline.finite import require_finite_step
from pipeline.machine.random_state import kept_random_state
from pipeline.machine.threads import one_torch_thread
from pipeline.settings import STRICT, Count, NotNegative, Positive, Seed

Exploration = Literal["mean", "sample"]
Acting = Callable[[int, int], TensorDictModuleBase]
"""The policy for these episodes of the list: the first one's number, and how many."""
_BEHIND_THE_END: dict[str, float | bool] = {SUCCESS: False, PROGRESS: torch.nan}


@settings(frozen=True, kw_only=True, config=STRICT)
class EvaluationSettings:
    """Evaluation during and after training."""

    seed: Seed = 20_000  # of the list of episodes
    episodes: Count = 1000
    batch: Count = 250  # episodes stepped together
    exploration: Exploration = "mean"  # the policy's tanh(loc), or a draw
    noise_scale: Positive = 1.0  # of a draw: factor on the policy's standard deviation
    interval: NotNegative = 10_000  # frames between evaluations during training; 0 = never
    interval_episodes: Count = 50
    keep_best: bool = True  # the weights of the best of these evaluations, in RUN/best


@dataclass(frozen=True)
class Evaluator:
    """Runs a policy on the same episodes every time.

    Episode i starts where the task's list with this ``seed`` says, and its noise is its own, so
    neither depends on ``batch``. A task without such a list is seeded with ``seed``, and its
    episodes depend on ``batch``. Tasks whose copies are dear limit it (`Task.max_copies`).

    Args:
        task: Whose episodes.
        episodes: How many.
        seed: Of the list.
        batch: Episodes stepped together.
        exploration: ``mean`` takes the policy's tanh(loc), ``sample`` draws; the policy must be one
            of ``pipeline.learn.networks.make_actor``.
        noise_scale: Of a draw: factor on the standard deviation before the tanh.
        env_options: How the copies are made; their number and seed are set here.
        keep_env: Whether the copies are kept from one run to the next, until ``close``.
        between_steps: Called before each step; what it raises ends the evaluation.

    Raises:
        ValueError: If ``exploration`` is unknown, ``noise_scale`` not positive or a count below 1.
    """

    task: Task
    episodes: int
    seed: int
    batch: int = 250
    exploration: Exploration = "mean"
    noise_scale: float = 1.0
    env_options: EnvOptions = field(default_factory=EnvOptions)
    keep_env: bool = False
    between_steps: Callable[[], None] | None = None
    _kept: list[EnvBase] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.exploration not in get_args(Exploration):
            raise ValueError(
                f"evaluation.exploration must be one of {sorted(get_args(Exploration))}, "
                f"got {self.exploration!r}."
            )
        require_noise_scale(self.noise_scale)
        if self.episodes < 1 or self.batch < 1:
            raise ValueError(
                f"evaluation.episodes and evaluation.batch must be at least 1, "
                f"got {self.episodes} and {self.batch}."
            )

    def run(self, policy: TensorDictModuleBase, recorder: SeesSteps | None = None) -> Rollouts:
        """Runs all episodes; the random state of the caller is left as it was.

        Whole waves of ``batch`` are run, of which the first ``episodes`` are kept. A ``recorder``
        sees every step.
        """
        env = self._env()
        waves = []
        try:
            with self.acting(policy) as acting:
                for first in range(0, self.episodes, env.batch_size[0]):
                    start = reset_td(self.task, env, self.seed, first)
                    judged = acting(first, env.batch_size[0])
                    limit = self.episodes - first
                    rollouts = run_wave(
                        env,
                        judged,
                        start,
                        self.task.stages,
                        limit,
                        self.between_steps,
                        recorder,
                    )
                    waves.append(rollouts)
        finally:
            if not self.keep_env:
                self.close()
        return Rollouts.join(waves)

    def close(self) -> None:
        """Closes the copies, if there are any."""
        while self._kept:
            self._kept.pop().close()

    def _env(self) -> EnvBase:
        if not self._kept:
            copies = self.task.copies(min(self.batch, self.episodes))
            options = replace(self.env_options, num_envs=copies, seed=self.seed)
            self._kept.append(self.task.make_env(options))
        # A task without a list of starts draws the same episodes every time.
        self._kept[0].set_seed(self.seed)
        return self._kept[0]

    def metrics(self, rollouts: Rollouts) -> dict[str, Any]:
        """The figures that every task has, and the task's own, for JSON."""
        figures = summarise(rollouts).as_plain()
        if self.task.summary is not None:
            of_the_task = self.task.summary(
                rollouts.progress, rollouts.returns, rollouts.lengths, rollouts.stages
            )
            figures |= plain(of_the_task)
        return figures

    @contextmanager
    def acting(self, policy: TensorDictModuleBase) -> Iterator[Acting]:
        """The policy as it is judged: in evaluation mode, without gradients, with its noise.

        Gives ``acting(first, count)``, which acts in episodes ``first``, ``first + 1``, ... from
        their first step on. The random state of the caller and the policy's mode come back.
        """
        was_training = policy.training
        policy.eval()
        try:
            with (
                kept_random_state(self.env_options.device),
                torch.no_grad(),
                one_torch_thread(),
                set_exploration_type(ExplorationType.DETERMINISTIC),
            ):
                torch.manual_seed(self.seed)  # of tasks that draw from torch's generator
                yield self._sampled(policy) if self.exploration == "sample" else lambda *_: policy
        finally:
            policy.train(was_training)

    def _sampled(self, policy: TensorDictModuleBase) -> Acting:
        noisy = EpisodeNoise(unwrapped(policy), self.seed, self.noise_scale)
        judged = through(policy, noisy)

        def begun(first: int, count: int) -> TensorDictModuleBase:
            noisy.begin(first, count)
            return judged

        return begun


def reset_td(task: Task, env: EnvBase, seed: int, first: int) -> TensorDict | None:
    """What to reset ``env`` with so that its copies hold episodes ``first``, ``first + 1``, ...

    None for tasks that do not number their episodes.
    """
    if task.starts is None:
        return None
    return task.starts(seed, first, env.batch_size[0]).to(env.device)


def run_wave(
    env: EnvBase,
    policy: TensorDictModuleBase,
    start: TensorDictBase | None,
    stages: Sequence[Stage] = (),
    limit: int | None = None,
    between_steps: Callable[[], None] | None = None,
    recorder: SeesSteps | None = None,
) -> Rollouts:
    """One episode in each copy of ``env`` [N]; the first ``limit`` of them are returned.

    Copies that are done are left alone (``_step`` mask) until the last one has finished.
    """
    td = env.reset(start)
    n = env.batch_size[0]
    active = torch.ones(n, 1, dtype=torch.bool, device=td.device)
    returns = torch.zeros(n, 1, dtype=torch.float64, device=td.device)
    lengths = torch.zeros(n, 1, dtype=torch.int64, device=td.device)
    columns = _Columns.of(env)
    reached = {stage.label: torch.zeros_like(active.squeeze(-1)) for stage in stages}
    while active.any():
        if between_steps is not None:
            between_steps()
        td = env.step(policy(td))
        after = td["next"]
        require_finite_step(td, active)
        if recorder is not None:
            recorder(td, active)
        returns += after["reward"].double() * active
        lengths += active
        columns.append(after, active)
        for stage in stages:
            reached[stage.label] |= stage.reached(after) & active.squeeze(-1)
        active = active & ~after["done"]
        td = env.step_mdp(td)
        td["_step"] = active.squeeze(-1)
    if recorder is not None:
        recorder.finish_wave()
    kept = slice(0, limit)
    return Rollouts(
        returns=returns.squeeze(-1).cpu().numpy()[kept],
        lengths=lengths.squeeze(-1).cpu().numpy()[kept],
        success=columns.joined(SUCCESS, kept),
        progress=columns.joined(PROGRESS, kept),
        stages={label: flags.cpu().numpy()[kept] for label, flags in reached.items()},
    )


@dataclass(frozen=True)
class _Columns:
    """What an environment told after each step, with nothing behind an episode's end."""

    seen: dict[str, list[Tensor]]

    @classmethod
    def of(cls, env: EnvBase) -> Self:
        return cls({key: [] for key in _BEHIND_THE_END if has_column(env, key)})

    def append(self, after: TensorDictBase, active: Tensor) -> None:
        for key, steps in self.seen.items():
            steps.append(after[key].masked_fill(~active, _BEHIND_THE_END[key]))

    def joined(self, key: str, kept: slice) -> Any:
        if key not in self.seen:
            return None
        return torch.cat(self.seen[key], dim=-1).cpu().numpy()[kept]
