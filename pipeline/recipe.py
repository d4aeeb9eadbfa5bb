"""What a run is: everything that decides what it learns, in one value.

A recipe is composed from YAML and a command line (``configs``) or written in Python; both give the
same object, and a run directory holds it::

    recipe = compose("variant=bc_sac", "preset=smoke")
    recipe = recipe.changed(loss={"bc_weight": CosineWeight(init=1.0, final=0.1, duration=50)})
    build_run(recipe, "runs/mine").train()
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any, Final, Literal, Self

from pydantic.dataclasses import dataclass as settings
from pydantic.dataclasses import is_pydantic_dataclass

from envs import Task, find_task
from envs.options import EnvOptions, TaskOptions
from envs.registry import imports_of
from envs.rewards import rewarded
from pipeline.act.evaluation import EvaluationSettings
from pipeline.act.policy_wrappers import ProposalSettings
from pipeline.act.randomise import RandomiseSettings
from pipeline.budget import Budget, CollectorSettings
from pipeline.data.admission import GrowthSettings
from pipeline.data.curriculum import CurriculumSettings
from pipeline.data.demonstrations import DemosSettings
from pipeline.data.mixture import SamplerSettings
from pipeline.data.own_sources import SOURCES
from pipeline.hooks.backtrack import BacktrackSettings
from pipeline.learn.imitation import CloningSettings
from pipeline.learn.networks import ActorSettings, CriticSettings
from pipeline.learn.objective import LossSettings
from pipeline.learn.optimizers import OptimSettings
from pipeline.learn.own_terms import TERMS
from pipeline.own_parts import Entry, OwnParts
from pipeline.renamed import require_todays
from pipeline.settings import STRICT, Count, NotNegative, Seed, checked, plain
from pipeline.watch.loggers import LoggingSettings

SCHEDULE_KEY: Final = "loss.bc_weight.kind"
"""Names a file where the imitation weight's schedule is a user's own."""


@settings(frozen=True, kw_only=True, config=STRICT)
class TaskSettings:
    """Which task; what it offers is its own room's business (envs/task.py)."""

    name: str = "door"  # see `envs.registry.FORMS`
    # Of environments of gymnasium and dm_control (envs.task.TaskOptions):
    kwargs: dict[str, Any] = field(default_factory=dict)  # keyword arguments: task.kwargs.x=1
    wrappers: tuple[str, ...] = ()  # module:Class, ...; from the inside out
    success: str | None = None  # info:KEY | terminated | reward>=X | return>=X | path.py:function
    reward: str | None = None  # path.py:function(observation, action, next_observation)
    progress: str | None = None  # info:KEY | path.py:function(observation)
    # Of tasks that say what of them can be disturbed; noise and delays of any:
    randomise: RandomiseSettings = field(default_factory=RandomiseSettings)

    @property
    def options(self) -> TaskOptions:
        """What a user says about an environment."""
        return TaskOptions(
            kwargs=self.kwargs,
            wrappers=self.wrappers,
            success=self.success,
            reward=self.reward,
            progress=self.progress,
        )

    def find(self) -> Task:
        """The task of this name, with these options.

        Raises:
            UnknownTaskError: If nobody offers it.
            ValueError: If an option does not suit it.
        """
        task = find_task(self.name, self.options)
        self.randomise.require(task)
        return task


@settings(frozen=True, kw_only=True, config=STRICT)
class EnvSettings:
    """How many copies of the environment are stepped together, and for how long."""

    num_envs: Count = 1  # copies stepped in one batch
    num_threads: Count | None = None  # physics threads; None = one per core
    # Processes that step copies of a Python environment; 0 = none; None = if a step is over 1 ms.
    workers: NotNegative | None = None
    horizon: Count | None = None  # control steps per episode; None = the task's own
    success_steps: Count | None = None  # a training episode ends after so many steps of success
    # sparse pays success - 1 at every step, demonstrated ones included; None = the task's own.
    reward: Literal["dense", "sparse"] | None = None


@settings(frozen=True, kw_only=True, config=STRICT)
class Recipe:
    """A complete run.

    Values that differ between presets or variants are set in ``configs/preset`` and
    ``configs/variant``; the defaults are the paper's (section IV-B) where the paper states one and
    those of its base implementation (denisyarats/pytorch_sac) where it does not.
    """

    variant: str = "custom"
    preset: str = "none"
    seed: Seed = 0
    device: str = "cpu"
    torch_threads: Count | None = None  # intra-op threads; None = measured when the run starts
    # Of hidden layers; auto is bf16 where it is faster.
    precision: Literal["fp32", "bf16", "auto"] = "fp32"
    # Of a CPU, where None = in a run of 5,000 updates or more, if it can and if it pays:
    compile_updates: bool | None = None  # compile updates, Adam included
    onednn: bool | None = None  # multiply float32 matrices by oneDNN, not by MKL
    cuda_graphs: bool | None = None  # replay updates as CUDA graphs; None = if device is CUDA
    cache_dir: str = "runs/cache"  # BC models and multiplied demonstrations, by content hash
    offline: bool = False  # train on D alone, without an environment (the `bc` row)
    pretrain: bool = False  # start the actor from the BC model
    task: TaskSettings = field(default_factory=TaskSettings)
    env: EnvSettings = field(default_factory=EnvSettings)
    demos: DemosSettings = field(default_factory=DemosSettings)
    actor: ActorSettings = field(default_factory=ActorSettings)
    critic: CriticSettings = field(default_factory=CriticSettings)
    loss: LossSettings = field(default_factory=LossSettings)
    optim: OptimSettings = field(default_factory=OptimSettings)
    sampler: SamplerSettings = field(default_factory=SamplerSettings)
    proposal: ProposalSettings = field(default_factory=ProposalSettings)
    curriculum: CurriculumSettings = field(default_factory=CurriculumSettings)
    growth: GrowthSettings = field(default_factory=GrowthSettings)
    backtrack: BacktrackSettings = field(default_factory=BacktrackSettings)
    bc: CloningSettings = field(default_factory=CloningSettings)
    collector: CollectorSettings = field(default_factory=CollectorSettings)
    evaluation: EvaluationSettings = field(default_factory=EvaluationSettings)
    logging: LoggingSettings = field(default_factory=LoggingSettings)

    def find_task(self) -> Task:
        """The task of this recipe, with the reward that it names.

        Raises:
            UnknownTaskError: If nobody offers the task.
            ValueError: If an option, or the reward, does not suit it.
        """
        return rewarded(self.task.find(), self.env.reward)

    def env_options(self, **given: Any) -> EnvOptions:
        """How this run makes environments, whatever for; ``given`` says what this one is for.

        What belongs to training alone (`env.num_envs`, `env.success_steps`) is not in it.
        """
        env = self.env
        options = EnvOptions(
            device=self.device,
            num_threads=env.num_threads,
            workers=env.workers,
            horizon=env.horizon,
        )
        return replace(options, **given)

    @property
    def budget(self) -> Budget:
        """How far the run goes."""
        if self.offline:
            return Budget("bc.updates", self.bc.updates, "updates of cloning", False)
        return Budget("collector.total_frames", self.collector.total_frames, "frames", True)

    @property
    def uses_demonstrations(self) -> bool:
        """Whether anything of the run is made from D: else it is not even read."""
        return (
            self.offline
            or self.pretrain
            or self.sampler.demo_ratio > 0
            or self.sampler.demo_update_period > 0
            or self.sampler.preload
            or self.growth.bc_model
            or self.proposal.used
            or self.curriculum.reverse
            or self.actor.normalise_observations
            or self.critic.normalise_observations
        )

    @property
    def own_parts(self) -> list[tuple[OwnParts, tuple[Entry, ...]]]:
        """What stands in a user's own files for training alone, where there is any."""
        every = [(TERMS, self.loss.own_terms), (SOURCES, self.sampler.own_sources)]
        return [(kind, entries) for kind, entries in every if entries]

    @property
    def own_imports(self) -> dict[str, str]:
        """What a run imports of a user's own files for training alone, by the key that asks."""
        asked = {kind.key: ", ".join(map(kind.files, entries)) for kind, entries in self.own_parts}
        schedule = self.loss.bc_weight.own_file
        return asked if schedule is None else {**asked, SCHEDULE_KEY: schedule}

    def imports(self, *, training: bool) -> dict[str, str]:
        """What of somebody's code a run imports, by the key that asks for it.

        Args:
            training: Whether it is trained; its objective and batches are made for that alone.
        """
        asked = imports_of(self.task.name, self.task.options)
        return {**asked, **self.own_imports} if training else asked

    @classmethod
    def of(cls, values: Mapping[str, Any], where: str) -> Self:
        """The recipe with these values, by key; sections are mappings.

        Args:
            values: What is missing has its default.
            where: They come from, for messages.

        Raises:
            SettingsError: If a key is unknown, or a value is of another type or out of its range.
        """
        require_todays(values, where)
        return checked(cls, values, where)

    def plain(self) -> dict[str, Any]:
        """Plain values by key, for YAML: what :meth:`of` takes."""
        return plain(self)

    def changed(self, **changes: Any) -> Self:
        """A copy with other values; a mapping changes a section key by key.

        Raises:
            SettingsError: As :meth:`of`.
        """
        return self.of(_merged(self.plain(), changes), "changed recipe")

    def digest(self) -> str:
        """SHA-256 (hex) of all values."""
        return hashlib.sha256(json.dumps(self.plain(), sort_keys=True).encode()).hexdigest()


def _merged(values: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(values)
    for key, value in changes.items():
        if is_pydantic_dataclass(type(value)):
            merged[key] = plain(value)
        elif isinstance(value, Mapping) and isinstance(merged.get(key), dict):
            merged[key] = _merged(merged[key], value)
        else:
            merged[key] = value
    return merged
