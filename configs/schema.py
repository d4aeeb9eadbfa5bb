"""Typed schema of a run: every key, its unit, its default and where the value comes from.

Hydra validates YAML files and command-line overrides against these dataclasses, so an unknown
key or a value of the wrong type fails before anything is built.  Values that differ between
presets or variants are set in ``configs/preset`` and ``configs/variant``; the defaults below are
the paper's (section IV-B) where the paper states one and those of its base implementation
(denisyarats/pytorch_sac) where it does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING


@dataclass
class EnvConfig:
    """Which environment, and how many copies of it are stepped together."""

    name: str = "door"  # door | gymnasium:ID | dm_control:domain/task
    num_envs: int = 1  # copies stepped in one batch
    num_threads: int | None = None  # physics threads; null = one per core
    horizon: int | None = None  # control steps per episode; null = the task's own (door: 200)
    open_steps: int | None = None  # a training episode ends after so many steps with an open door


@dataclass
class MultiplyConfig:
    """Demonstration multiplication: replay at other speeds and doors, keep what succeeds."""

    enabled: bool = False
    target_episodes: int = 350  # episodes to keep
    max_attempts: int = 4000  # give up after so many
    seed: int = 0
    noise_scale: float = 0.08  # largest AR(1) action noise that is executed but not recorded
    speed_low: float = 1.1  # slowest playback speed (1 = as recorded)
    speed_high: float = 1.6
    min_angle: float = 1.35  # rad; an attempt below this hinge angle is dropped


@dataclass
class DemosConfig:
    """Where the demonstrations D come from and what is done to them on loading."""

    source: str = "bundled"  # bundled | path | minari:ID
    resimulate: bool = True  # replay in our simulator from the reset pose: states a policy will see
    limit: int | None = None  # use only the first N demonstrations
    held_out: int = 0  # episodes, after multiplication, that only diagnostics see
    multiply: MultiplyConfig = field(default_factory=MultiplyConfig)
    keep_best: float = 1.0  # share of the episodes, after multiplication: those of highest return
    end_angle: float | None = None  # rad; episodes end where the hinge passes it, null: whole ones


@dataclass
class ActorConfig:
    """Diagonal Gaussian policy squashed by tanh (paper IV-B: 38 x 1024 x 1024 x 56)."""

    hidden: list[int] = field(default_factory=lambda: [1024, 1024])
    log_std_min: float = -5.0
    log_std_max: float = 2.0
    layer_norm: bool = False
    normalise_observations: bool = False  # by the mean and std of the demonstrations


@dataclass
class CriticConfig:
    """Ensemble of Q networks (paper IV-B: two of 66 x 1024 x 1024 x 1)."""

    hidden: list[int] = field(default_factory=lambda: [1024, 1024])
    num_critics: int = 2
    layer_norm: bool = False
    normalise_observations: bool = False


@dataclass
class WeightConfig:
    """Weight of the imitation term as a function of the number n of updates (III-C, III-D)."""

    kind: str = "constant"  # constant | exponential | linear | cosine | piecewise
    init: float | None = 0.0  # lambda, or lambda_0; null for piecewise
    decay: float | None = None  # exponential: alpha in lambda_0 * alpha**n
    final: float | None = None  # linear, cosine: value after `duration`
    duration: int | None = None  # linear, cosine: updates; null = all of the run's
    milestones: list[int] | None = None  # piecewise: updates
    values: list[float] | None = None  # piecewise: one more than milestones


@dataclass
class EmphasisConfig:
    """Door: factors on the imitation error of demonstrated steps, by how far the door is open."""

    closed: float = 1.0  # up to the angle
    open: float = 1.0
    angle: float = 0.02  # rad


@dataclass
class LossConfig:
    """Terms of BCSACLoss."""

    gamma: float = 0.99
    n_step: int = 1  # steps of reward before the bootstrap
    reward_scale: float = 1.0
    angle_bonus: float = 0.0  # door, training only: reward per rad of hinge angle up to 1.5 rad
    init_temperature: float = 0.1
    target_entropy: float | None = None  # null = -(action size)
    learn_temperature: bool = True
    entropy_in_target: bool = True
    target_subset: int | None = None  # critics in the target's minimum; null = all
    actor_value: str = "min"  # min | mean over the ensemble
    target_action: str = "sample"  # sample | mean: the policy's next action in the critic's target
    rl_on_demos: bool = False  # do the RL terms also see the demonstration rows?
    q_filter: bool = False  # imitate only actions that the critics value above the policy's own
    imitation: str = "nll"  # nll (paper III-B) | mse
    action_margin: float = 1e-2  # demonstrated actions are clamped to +-(1 - action_margin)
    tau: float = 0.005
    bc_weight: WeightConfig = field(default_factory=WeightConfig)
    bc_emphasis: EmphasisConfig = field(default_factory=EmphasisConfig)
    bc_decay: float = 0.999  # alpha that the DBC variants give to bc_weight (paper IV-C.4)
    bc_gradient_ratio: float | None = None  # if set: bc_weight(n) * ratio * |g_RL| / |g_BC|


@dataclass
class OptimConfig:
    """Optimizers and the rhythm of updates."""

    actor_lr: float = 1e-5
    critic_lr: float = 1e-5
    temperature_lr: float = 1e-5
    updates_per_frame: float = 1.0
    actor_period: int = 1  # critic updates per actor and temperature update
    target_period: int = 2  # critic updates per target update
    actor_delay: int = 0  # critic updates before the first actor update (critic warm-up)
    max_grad_norm: float | None = None
    actor_average: float | None = None  # evaluate an average of the weights; kept per update
    actor_average_share: float | None = None  # instead: the share of the run's updates it spans
    anneal_actor: bool = False  # cosine from actor_lr to 0 over the run
    diagnostics_period: int = 100  # actor updates between gradient diagnostics


@dataclass
class SamplerConfig:
    """Exact row counts of one batch."""

    batch_size: int = 1024  # rows from the replay buffer
    capacity: int | None = None  # rows the replay buffer holds, the newest; null = the whole run
    demo_ratio: float = 0.0  # rows from the demonstration distribution D per row of batch_size
    demo_update_period: int = 0  # f of Algorithm 1: an extra update on D every f updates; 0 = never


@dataclass
class AdmissionConfig:
    """Which whole episodes may join D."""

    min_angle: float | None = 1.35  # rad, the episode's largest hinge angle
    min_return: float | None = None
    quantile: float | None = None  # of the last `window` training returns, to be reached as well
    window: int = 50  # training episodes


@dataclass
class GrowthConfig:
    """Demonstrations that grow: SID (paper III-E) and ILD (paper III-E.1)."""

    self_imitation: bool = False  # admit the policy's own good training episodes
    bc_model: bool = False  # admit the good episodes of the BC model, before training starts
    bc_model_episodes: int = 250  # doors it is rolled out on
    capacity: int = 100_000  # rows; the oldest grown episode leaves first, the core never does
    share: float | None = None  # of the demonstration rows, once full; null = by number of rows
    admission: AdmissionConfig = field(default_factory=AdmissionConfig)


@dataclass
class BacktrackConfig:
    """Return to the last good policy when training episodes begin to fail."""

    level: float | None = None  # of the test for it, in (0, 1); null = never go back
    window: int = 10  # episodes that are judged together
    memory: int = 100  # episodes before them that say what is usual


@dataclass
class BehaviourCloningConfig:
    """Offline behaviour cloning: one recipe for the `bc` row, the ILD demonstrator, pretraining."""

    updates: int = 100_000
    lr: float = 1e-5
    anneal: bool = False  # cosine from lr to 0 over the updates
    batch_size: int = 1024


@dataclass
class CollectorConfig:
    """How much experience, collected in which portions."""

    total_frames: int = 100_000
    frames_per_batch: int = 1
    random_frames: int = 10_000  # seed steps with uniformly random actions
    greedy_envs: int = 0  # of env.num_envs: those that act with the mean action, without noise


@dataclass
class EvaluationConfig:
    """Evaluation during and after training."""

    seed: int = 20_000  # of the list of doors
    episodes: int = 1000
    batch: int = 250  # doors stepped together
    exploration: str = "mean"  # mean | sample: the policy's tanh(loc) or a draw
    noise_scale: float = 1.0  # of a draw: factor on the policy's standard deviation
    interval: int = 10_000  # frames between evaluations during training; 0 = never
    interval_episodes: int = 50


@dataclass
class LoggingConfig:
    """Loggers and checkpoints."""

    loggers: list[str] = field(default_factory=lambda: ["csv", "tensorboard"])  # + wandb, mlflow
    project: str = "bc-sac"  # wandb / mlflow project
    interval: int = 500  # frames between logged scalars
    checkpoint_interval: int = 10_000  # frames
    progress: bool = True


@dataclass
class Config:
    """A complete run."""

    variant: str = MISSING
    preset: str = MISSING
    seed: int = 0
    device: str = "cpu"
    torch_threads: int | None = None  # intra-op threads; null = measured when the run starts
    precision: str = "fp32"  # of hidden layers: fp32 | bf16 | auto (bf16 where it is faster)
    # Of a CPU, where null = in a run of 5,000 updates or more, if it can and if it pays:
    compile_updates: bool | None = None  # compile updates, Adam included
    onednn: bool | None = None  # multiply float32 matrices by oneDNN, not by MKL
    cuda_graphs: bool | None = None  # replay updates as CUDA graphs; null = if device is CUDA
    run_dir: str = MISSING
    resume: str | None = None  # a run directory to continue
    cache_dir: str = "runs/cache"  # BC models and multiplied demonstrations, by content hash
    offline: bool = False  # train on D alone, without an environment (the `bc` row)
    pretrain: bool = False  # start the actor from the BC model
    env: EnvConfig = field(default_factory=EnvConfig)
    demos: DemosConfig = field(default_factory=DemosConfig)
    actor: ActorConfig = field(default_factory=ActorConfig)
    critic: CriticConfig = field(default_factory=CriticConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optim: OptimConfig = field(default_factory=OptimConfig)
    sampler: SamplerConfig = field(default_factory=SamplerConfig)
    growth: GrowthConfig = field(default_factory=GrowthConfig)
    backtrack: BacktrackConfig = field(default_factory=BacktrackConfig)
    bc: BehaviourCloningConfig = field(default_factory=BehaviourCloningConfig)
    collector: CollectorConfig = field(default_factory=CollectorConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    logging: LoggingConfig = field(default_factory=LoggingConfig)


def register_schema() -> None:
    """Makes the schema known to Hydra under the name that ``train.yaml`` builds on."""
    ConfigStore.instance().store(name="schema", node=Config)
