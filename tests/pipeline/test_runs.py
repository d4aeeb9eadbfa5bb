"""Whole runs, composed from configuration and trained for a few frames."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
import yaml

from envs.door import task
from envs.door.definition import TASK
from losses import CosineWeight
from pipeline.act.evaluation import EvaluationSettings
from pipeline.budget import CollectorSettings
from pipeline.build import build_run
from pipeline.cloning import behaviour_cloned
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.conversion import make_rows
from pipeline.data.demonstrations import Demonstrations, DemosSettings, make_demonstrations
from pipeline.data.mixture import SamplerSettings
from pipeline.files.run_files import (
    CONFIG,
    LEARNING_CURVE,
    VERSIONS,
    RunDirectoryError,
    write_atomically,
)
from pipeline.learn.networks import ActorSettings, CriticSettings
from pipeline.learn.objective import LossSettings
from pipeline.learn.weights import WeightSettings
from pipeline.playing import make_training_env
from pipeline.policy import load_policy
from pipeline.recipe import EnvSettings, Recipe
from pipeline.run_dir import load_recipe
from pipeline.trainer import Run
from pipeline.watch.loggers import LoggingSettings
from tests.pipeline.toys import built, parameters_of, same, tiny_config, where

VARIANTS = [
    "sac", "bc", "bc_sac", "dbc_sac", "sid_bc", "sid_dbc", "ila_bc", "ila_dbc", "da_sac", "best",
]  # fmt: skip


def part(run: Run, name: str):
    """What the trainer checkpoints under ``name``."""
    return run.trainer._modules[name]


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_trains_and_is_evaluated(variant: str, tmp_path: Path, demos: Path):
    run = built(tiny_config(variant, tmp_path, demos, "evaluation.interval=20"))
    before = parameters_of(run.actor)
    run.train()
    assert not same(before, parameters_of(run.actor))
    assert all(parameter.isfinite().all() for parameter in run.actor.parameters())
    lines = (run.run_dir / LEARNING_CURVE).read_text().splitlines()
    curve = [json.loads(line)["frames"] for line in lines]
    # A run that begins with a clone judges it first.
    assert curve == ([100] if run.recipe.offline else [0] * run.recipe.pretrain + [20, 40])

    result = evaluate_run(run.run_dir, episodes=2)
    assert result["episodes"] == 2
    assert result["made_from"]["variant"] == variant
    loaded, _ = load_policy(run.recipe, TASK, run.run_dir)
    assert same(parameters_of(run.actor), parameters_of(loaded))


@pytest.mark.parametrize("env", ["gymnasium:Pendulum-v1", "dm_control:cheetah/run"])
def test_sac_runs_on_other_tasks_without_a_change(env: str, tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos, f"task.name='{env}'", "demos.source=nowhere.h5")
    run = built(config)
    run.train()
    assert len(part(run, "main_buffer")) == 40
    result = evaluate_run(run.run_dir, episodes=2)
    assert result["length_mean"] == 10.0


def test_training_doors_get_their_options(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos, "env.success_steps=7", "env.num_envs=3")
    env = make_training_env(config, TASK)
    assert (env.success_steps, env.horizon, env.num_copies) == (7, config.env.horizon, 3)
    env.close()


def test_the_average_over_a_share_of_the_run_is_the_policy(tmp_path: Path, demos: Path):
    """It lags behind the actor, which goes on alone."""
    averaged = ("optim.actor_average=null", "optim.actor_average_share=0.5")
    run = built(tiny_config("bc_sac", tmp_path, demos, *averaged))
    assert run.actor is not run.trainer.loss_module.actor
    run.train()
    assert not same(parameters_of(run.actor), parameters_of(run.trainer.loss_module.actor))


def test_the_trainer_keeps_no_history_of_what_it_logged(tmp_path: Path, demos: Path):
    """A tensor kept per update is a leak: gigabytes in a run of the paper's size."""
    run = built(tiny_config("bc_sac", tmp_path, demos))
    run.train()
    kept = {name: len(values) for name, values in run.trainer._log_dict.items()}
    assert kept["loss_qvalue"] == 1
    assert set(kept.values()) == {1}


def test_the_random_frames_are_kept(tmp_path: Path, demos: Path):
    """The trap: TorchRL's own storing hooks do not run until the random frames are collected."""
    run = built(tiny_config("sac", tmp_path, demos, "collector.random_frames=20"))
    run.train()
    buffer = part(run, "main_buffer")
    assert len(buffer) == 40
    # Uniform actions: |a| is 1/2 on average, and the largest of many is close to 1.
    actions = buffer[:20]["action"].abs()
    assert actions.mean() == pytest.approx(0.5, abs=0.05)
    # Learning begins with the batch that completes them.
    assert part(run, "optimization_stepper").critic_updates == 4


def test_da_sac_updates_on_the_demonstrations_every_other_time(tmp_path: Path, demos: Path):
    plain = built(tiny_config("sac", tmp_path, demos))
    with_demos = built(tiny_config("da_sac", tmp_path, demos))
    for run in (plain, with_demos):
        run.train()
    ordinary = part(plain, "optimization_stepper").critic_updates
    assert ordinary == 4  # 40 frames, 0.1 updates per frame
    assert part(with_demos, "optimization_stepper").critic_updates == ordinary + ordinary // 2


@pytest.mark.parametrize("variant", ["sac", "da_sac", "bc"])
def test_an_annealed_rate_reaches_zero_with_the_last_update(
    variant: str, tmp_path: Path, demos: Path
):
    options = ["optim.anneal_actor=true", "bc.anneal=true", "bc.updates=200"]
    rhythm = ["optim.updates_per_frame=0.4", "optim.actor_delay=3", "optim.actor_period=2"]
    run = built(tiny_config(variant, tmp_path, demos, *options, *rhythm))
    stepper = part(run, "optimization_stepper")
    optimizer = stepper.optimizer if variant == "bc" else stepper.optimizers["actor"]
    start = optimizer.param_groups[0]["lr"]
    rates = []
    run.trainer.register_op("post_steps", lambda: rates.append(optimizer.param_groups[0]["lr"]))
    run.train()
    halfway, end = rates
    assert halfway > 0.45 * start
    assert end == pytest.approx(0.0, abs=0.05 * start)


def test_sid_admits_the_policys_own_episodes(tmp_path: Path, demos: Path):
    run = built(tiny_config("sid_bc", tmp_path, demos))
    run.train()
    records = part(run, "grown").grown.records
    # 2 doors, episodes of 10 steps, 40 frames: both doors end one with each batch of 20.
    assert [(record.source, record.length, record.frame) for record in records] == [
        ("policy", 10, frame) for frame in (20, 20, 40, 40)
    ]
    assert len(part(run, "grown_buffer")) == 40


def test_ild_admits_the_bc_models_episodes_before_training(tmp_path: Path, demos: Path):
    run = built(tiny_config("ila_bc", tmp_path, demos))
    records = list(part(run, "grown").grown.records)
    assert [(record.source, record.frame) for record in records] == [("bc_model", 0)] * 2
    run.train()
    assert list(part(run, "grown").grown.records) == records


def test_ild_without_a_good_episode_says_what_to_do(tmp_path: Path, demos: Path):
    config = tiny_config("ila_bc", tmp_path, demos, "growth.admission.min_return=1e9")
    with pytest.raises(ValueError, match=r"None of 2 episodes .* growth\.admission; lower"):
        built(config)


def made_demonstrations(recipe: Recipe, cache_dir: Path | None) -> Demonstrations:
    rows = make_rows(recipe)
    return make_demonstrations(recipe.demos, TASK, rows, cache_dir=cache_dir, num_threads=1)


def bc_models(folder: Path) -> list[Path]:
    return [path for path in (folder / "cache").glob("bc-*") if path.is_dir()]


def test_the_bc_model_is_trained_once_and_then_cached(tmp_path: Path, demos: Path):
    config = tiny_config("bc_sac", tmp_path, demos)
    loaded = made_demonstrations(config, tmp_path / "cache")
    trained = behaviour_cloned(config, TASK, loaded)
    (model,) = bc_models(tmp_path)
    checkpoint = {path: path.stat().st_mtime_ns for path in model.rglob("*")}
    torch.manual_seed(99)
    before = torch.get_rng_state()
    cached = behaviour_cloned(config, TASK, loaded)
    assert same(parameters_of(trained), parameters_of(cached))
    assert {path: path.stat().st_mtime_ns for path in model.rglob("*")} == checkpoint
    assert torch.equal(torch.get_rng_state(), before)
    behaviour_cloned(config.changed(bc={"lr": 0.5}), TASK, loaded)
    assert len(bc_models(tmp_path)) == 2


def test_demonstrations_may_end_where_the_door_is_open(tmp_path: Path, demos: Path):
    changes = ("demos.source=bundled", "demos.limit=1", "demos.held_out=0", "loss.n_step=1")

    def hinges(*more: str) -> torch.Tensor:
        config = tiny_config("bc", tmp_path, demos, *changes, *more)
        loaded = made_demonstrations(config, None)
        return loaded.rows["next", "observation"][:, task.HINGE]

    whole, ended = hinges(), hinges("demos.end_progress=1.0")
    assert len(ended) < len(whole) == task.HORIZON
    assert (ended[:-1] <= 1.0).all()
    assert ended[-1] > 1.0


def test_without_a_progress_bonus_the_task_alone_rewards(tmp_path: Path, demos: Path):
    assert make_rows(tiny_config("sac", tmp_path, demos)).bonus is None


@pytest.mark.parametrize("pretrain", [True, False])
def test_pretraining_starts_from_the_bc_model(pretrain: bool, tmp_path: Path, demos: Path):
    config = tiny_config("bc_sac", tmp_path, demos, f"pretrain={str(pretrain).lower()}")
    run = built(config)
    loaded = made_demonstrations(config, tmp_path / "cache")
    model = behaviour_cloned(config, TASK, loaded)
    assert same(parameters_of(run.actor), parameters_of(model)) is pretrain


def test_the_seed_decides_the_run(tmp_path: Path, demos: Path):
    def trained(folder: str, seed: int) -> list[torch.Tensor]:
        run = built(tiny_config("sac", tmp_path / folder, demos, f"seed={seed}"))
        run.train()
        return parameters_of(run.actor)

    first = trained("a", 1)
    torch.manual_seed(1234)
    assert same(first, trained("b", 1))
    assert not same(first, trained("c", 2))


def test_the_run_directory_says_what_was_run(tmp_path: Path, demos: Path):
    config = tiny_config("dbc_sac", tmp_path, demos, "seed=7", "loss.bc_weight.init=3")
    run = built(config)
    saved = yaml.safe_load((run.run_dir / CONFIG).read_text())
    assert saved["torch_threads"] >= 1  # measured, and the others decided
    decided = ("torch_threads", "compile_updates", "onednn")
    assert saved | dict.fromkeys(decided) == config.plain()
    assert "${" not in (run.run_dir / CONFIG).read_text()
    assert load_recipe(run.run_dir) == run.recipe
    versions = json.loads((run.run_dir / VERSIONS).read_text())
    assert versions["packages"]["torch"] == torch.__version__
    assert {"python", "git", "git_dirty"} <= set(versions)


def test_a_run_directory_that_exists_is_left_alone(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos)
    Path(where(config)).mkdir(parents=True)
    with pytest.raises(RunDirectoryError, match=r"exists and is no run directory.*or choose"):
        built(config)
    assert list(Path(where(config)).iterdir()) == []


def test_a_run_directory_that_cannot_be_written_names_the_remedy(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    config = tiny_config("sac", tmp_path, demos)

    def refused(self: Path, *_arguments: object, **_options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refused)
    with pytest.raises(RunDirectoryError, match=r"sac cannot be written \(Permission denied\)"):
        built(config)


def test_writing_is_all_or_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "evaluation.json"
    write_atomically(path, "old")

    def torn(self: Path, content: bytes) -> None:
        with self.open("wb") as file:
            file.write(content[:1])
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_bytes", torn)
    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("variant", "override", "message"),
    [
        ("sac", "optim.updates_per_frame=0.01", r"optim\.updates_per_frame \(0\.01\) times"),
        ("sac", "optim.updates_per_frame=0.33", "must be a whole number of at least 1, got 6.6"),
        ("sac", "evaluation.noise_scale=-1", r"evaluation\.noise_scale=-1: must be more than 0"),
        ("sac", "evaluation.exploration=random", r"evaluation\.exploration='random': .* 'mean' or"),
        ("sac", "optim.actor_lr=-1e-3", r"optim\.actor_lr=-0\.001: must be 0 or more"),
        ("sac", "optim.max_grad_norm=0", r"optim\.max_grad_norm=0: must be more than 0"),
        ("sac", "loss.reward_scale=0", r": loss\.reward_scale=0: must be more than 0, or 'auto'$"),
        ("sac", "task.randomise.delay=[1]", r": task\.randomise\.delay\.1=.*: Field required"),
        ("sac", "loss.gamma=nan", r"loss\.gamma=nan: .* finite"),
        ("sac", "actor.hidden=[]", r"actor\.hidden=\[\]: .* at least 1"),
        ("sac", "precision=fp8", r"precision='fp8': .* 'fp32', 'bf16' or 'auto'"),
        ("sac", "collector.total_frames=-1", r"collector\.total_frames=-1"),
        ("sac", "logging.loggers=[csv,neptune]", r"logging\.loggers: unknown \['neptune'\]"),
        ("sac", "loss.actor_value=max", "loss\\.actor_value='max': .* 'min' or 'mean'"),
        ("sac", "loss.target_action=mode", "loss\\.target_action='mode'"),
        ("sac", "loss.imitation=l1", "loss\\.imitation='l1'"),
        (
            "sac",
            "task.name=window",
            "unknown task 'window'; valid: door, hammer, pen, .*gymnasium:ID",
        ),
        ("sac", "loss.bc_weight.kind=quadratic", "quadratic"),
        (
            "bc_sac",
            "loss.bc_weight.decay=0.99",
            r"^loss\.bc_weight\.decay=0\.99 is not read by loss\.bc_weight\.kind=constant, which "
            r"has init: leave it out \(loss\.bc_weight\.decay=null\) or name another kind$",
        ),
        ("bc_sac", "loss.bc_decay=0.99", r"^loss\.bc_weight\.decay=0\.99 is not read by"),
        ("bc_sac", "loss.bc_weight.kind=exponential", r"^loss\.bc_weight: .*exactly init, decay;"),
        ("sac", "optim.target_period=0", r"optim\.target_period=0"),
        ("sid_bc", "growth.admission.min_return=null", r"growth\.admission admits every episode"),
        ("ila_bc", "growth.admission.quantile=0.5", r"quantile judges .*self_imitation=true: set"),
        ("sid_bc", "growth.admission.quantile=1.0", r"quantile must be in \[0, 1\), got 1\.0"),
        ("dbc_sac", "growth.share=0.5", r"growth\.share is for .* grow: set growth\.self_imi"),
        ("sid_bc", "growth.share=1.5", r"growth\.share=1\.5"),
        ("sac", "sampler.batch_size=0", r"sampler\.batch_size=0"),
        ("sac", "sampler.capacity=19", r"sampler\.capacity \(19\) must hold .*, 28: .* is 20"),
    ],
)
def test_values_that_make_no_sense_are_named(
    variant: str, override: str, message: str, tmp_path: Path, demos: Path
):
    with pytest.raises(ValueError, match=message):
        built(tiny_config(variant, tmp_path, demos, override))


@pytest.mark.parametrize(
    ("kind", "values", "at", "expected"),
    [
        ("constant", {"init": 3.0}, 5, 3.0),
        ("exponential", {"init": 2.0, "decay": 0.5}, 3, 0.25),
        ("linear", {"init": 1.0, "final": 0.0, "duration": 4}, 1, 0.75),
        ("cosine", {"init": 1.0, "final": 0.0, "duration": 4}, 2, 0.5),
        ("piecewise", {"init": "null", "milestones": "[2,4]", "values": "[1,2,3]"}, 4, 3.0),
    ],
)
def test_every_schedule_can_be_configured(
    kind: str, values: dict, at: int, expected: float, tmp_path: Path, demos: Path
):
    overrides = [f"loss.bc_weight.{key}={value}" for key, value in values.items()]
    config = tiny_config("bc_sac", tmp_path, demos, f"loss.bc_weight.kind={kind}", *overrides)
    loss = built(config).trainer.loss_module
    loss.updates = at
    assert loss.current_bc_weight == pytest.approx(expected)


def test_a_run_composed_without_hydra(tmp_path: Path, demos: Path):
    """Plain values will do: nothing in the pipeline needs a YAML file."""
    recipe = Recipe(
        variant="mine",
        cache_dir=str(tmp_path / "cache"),
        env=EnvSettings(num_threads=1, horizon=10),
        demos=DemosSettings(source=str(demos)),
        actor=ActorSettings(hidden=(8,)),
        critic=CriticSettings(hidden=(8,)),
        loss=LossSettings(bc_weight=WeightSettings(init=0.5)),
        sampler=SamplerSettings(batch_size=8, demo_ratio=0.5),
        collector=CollectorSettings(total_frames=10, frames_per_batch=10, random_frames=0),
        evaluation=EvaluationSettings(interval=0),
        logging=LoggingSettings(loggers=("csv",), progress=False),
    )
    run = built(recipe)
    run.train()
    assert run.trainer.loss_module.current_bc_weight == 0.5
    assert part(run, "optimization_stepper").critic_updates == 10
    assert not (run.run_dir / LEARNING_CURVE).exists()


@pytest.mark.parametrize(
    ("capacity", "total", "kept"),
    [(None, 40, 40), (30, 40, 30), (60, 40, 40), (None, 30, 40)],  # the last: whole portions of 20
)
@pytest.mark.filterwarnings("ignore:.*is not exactly a multiple")
@pytest.mark.filterwarnings("ignore:.*is not exactly divisible")
def test_the_main_buffer_holds_the_last_frames(
    capacity: int | None, total: int, kept: int, tmp_path: Path, demos: Path
):
    options = (f"sampler.capacity={capacity or 'null'}", f"collector.total_frames={total}")
    config = tiny_config("sac", tmp_path, demos, *options)
    run, seen = built(config), []
    run.trainer.register_op("batch_process", lambda batch: seen.append(batch.clone()) or batch)
    run.train()
    held = part(run, "main_buffer")[:]["observation"]
    # Two batches of ten episodes' steps, one after another; the ring overwrites its beginning.
    rows = torch.cat([batch["observation"].flatten(0, 1) for batch in seen])
    assert len(held) == kept
    assert {tuple(row) for row in held.tolist()} == {tuple(row) for row in rows[-kept:].tolist()}


FALLING = ("loss.bc_weight.kind=cosine", "loss.bc_weight.init=0.8", "loss.bc_weight.final=0.4")


def test_a_weight_without_a_duration_moves_over_the_whole_run(tmp_path: Path, demos: Path):
    config = tiny_config("bc_sac", tmp_path, demos, *FALLING, "optim.updates_per_frame=0.5")
    run = built(config)
    first = run.trainer.loss_module.current_bc_weight
    run.train()
    # 40 frames at half an update, the actor in every second of them.
    assert run.trainer.loss_module.updates == 10
    assert first == config.loss.bc_weight.init
    assert run.trainer.loss_module.current_bc_weight == pytest.approx(config.loss.bc_weight.final)


def test_a_duration_that_is_given_is_kept(tmp_path: Path, demos: Path):
    config = tiny_config("bc_sac", tmp_path, demos, *FALLING, "loss.bc_weight.duration=7")
    assert built(config).trainer.loss_module.bc_weight.duration == 7


def test_a_weight_that_python_set_is_there_after_a_resume(tmp_path: Path, demos: Path):
    weight = CosineWeight(init=1.0, final=0.1, duration=8)
    recipe = tiny_config("bc_sac", tmp_path, demos).changed(loss={"bc_weight": weight})
    run = built(recipe)
    run.train()
    resumed = build_run(load_recipe(run.run_dir), run.run_dir, resume=True)
    loss = resumed.trainer.loss_module
    assert loss.bc_weight == CosineWeight(init=1.0, final=0.1, duration=8)
    # A quarter of the cosine after two of its eight updates: 0.1 + 0.9 (1 + cos(pi/4)) / 2.
    assert loss.updates == 2
    assert loss.current_bc_weight == pytest.approx(0.8682, abs=1e-4)


def test_a_weight_that_cannot_be_saved_is_refused():
    with pytest.raises(ValueError, match=r"is none of ConstantWeight.* can save and go on with"):
        WeightSettings.of(lambda _updates: 1.0)
