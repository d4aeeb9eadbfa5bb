"""Checkpoints: a resumed run is the uninterrupted one, and no checkpoint can run code."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import pytest
import torch
import yaml

from envs.door.definition import TASK
from envs.library.vector_env import VectorEnv
from pipeline.build import build_run
from pipeline.commands.evaluate_run import evaluate_run
from pipeline.files.checkpoint import latest_checkpoint, load_component
from pipeline.files.run_files import CONFIG, RunDirectoryError
from pipeline.policy import load_policy
from pipeline.run_dir import load_recipe
from pipeline.trainer import Run
from tests.pipeline.resuming import (
    HALF,
    WHOLE,
    curve_of,
    differences,
    everything,
    interrupted,
    long_config,
)
from tests.pipeline.toys import built, tiny_config, where


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> tuple[dict, list[dict]]:
    run = built(long_config(tmp_path_factory.mktemp("whole"), demos))
    run.train()
    return everything(run), curve_of(run.run_dir)


@pytest.fixture(scope="module")
def half(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    """The directory of an interrupted run; copy it, do not write to it."""
    return interrupted(long_config(tmp_path_factory.mktemp("half"), demos)).run_dir


@pytest.fixture
def stopped(half: Path, tmp_path: Path) -> Path:
    folder = tmp_path / half.name
    shutil.copytree(half, folder)
    return folder


def resumed(folder: Path, demos: Path, *overrides: str) -> Run:
    config = long_config(folder.parent, demos, *overrides)
    assert Path(where(config)) == folder
    torch.manual_seed(4321)  # whatever happened before must not matter
    return built(config, resume=True)


def test_a_resumed_run_is_the_uninterrupted_one(
    uninterrupted: tuple[dict, list[dict]], stopped: Path, demos: Path
):
    run = resumed(stopped, demos)
    assert run.trainer.collected_frames == HALF
    assert part_open(run), "the cut must be in the middle of episodes for this to say anything"
    run.train()
    expected, curve = uninterrupted
    assert len(expected["records"]["records"]) == 5  # the ring of 150 rows has evicted some
    assert differences(everything(run), expected) == []
    assert curve_of(stopped) == curve


def test_a_run_of_before_with_two_keys_of_alpha_goes_on_as_it_did(
    uninterrupted: tuple[dict, list[dict]], stopped: Path
):
    """What was typed then can be typed again."""
    saved = yaml.safe_load((stopped / CONFIG).read_text())
    saved["loss"]["bc_decay"] = alpha = saved["loss"]["bc_weight"]["decay"]
    (stopped / CONFIG).write_text(yaml.safe_dump(saved))
    recipe = load_recipe(stopped, [f"loss.bc_decay={alpha}"], training=True)
    torch.manual_seed(4321)
    run = build_run(recipe, stopped, resume=True)
    run.train()
    assert alpha < 1
    assert differences(everything(run), uninterrupted[0]) == []
    with pytest.raises(RunDirectoryError, match=r"loss\.bc_weight\.decay +0\.9999 +0\.5"):
        build_run(load_recipe(stopped, ["loss.bc_decay=0.5"]), stopped, resume=True)


def part_open(run: Run) -> dict:
    return run.trainer._modules["episodes"].assembler.state_dict()


def test_a_finished_run_can_be_trained_for_longer(stopped: Path, demos: Path):
    run = resumed(stopped, demos, f"collector.total_frames={WHOLE + 100}")
    run.train()
    assert run.trainer.collected_frames == WHOLE + 100
    assert len(run.trainer._modules["main_buffer"]) == WHOLE + 100


def test_resuming_a_run_that_is_complete_changes_nothing(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos)
    built(config).train()
    before = [path.stat().st_mtime_ns for path in sorted((tmp_path / "sac").rglob("*.json"))]
    again = built(config, resume=True)
    again.train()
    assert again.trainer.collected_frames == 40
    after = [path.stat().st_mtime_ns for path in sorted((tmp_path / "sac").rglob("*.json"))]
    assert after == before


def test_a_checkpoint_may_come_before_the_first_good_episode(tmp_path: Path, demos: Path):
    config = tiny_config("sid_bc", tmp_path, demos, "growth.admission.min_return=1e9")
    run = built(config)
    run.trainer.total_frames = 20
    run.train()
    again = built(config, resume=True)
    again.train()
    assert again.trainer.collected_frames == 40
    assert len(again.trainer._modules["grown_buffer"]) == 0


@pytest.mark.parametrize(("kept", "frames"), [(1, [WHOLE]), (2, [HALF, WHOLE])])
def test_the_newest_checkpoints_are_kept(kept: int, frames: list[int], stopped: Path, demos: Path):
    options = [f"logging.checkpoints={kept}", "logging.checkpoint_interval=1000"]
    resumed(stopped, demos, *options).train()
    names = sorted(path.name for path in (stopped / "checkpoints").iterdir())
    assert names == [f"checkpoint-{count:012d}" for count in frames]


def test_a_checkpoint_holds_no_pickles(stopped: Path):
    names = {path.name for path in latest_checkpoint(stopped).rglob("*") if path.is_file()}
    assert {name for name in names if name.endswith((".pkl", ".pickle", ".pt"))} == set()


class Evil:
    """Leaves a trace when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple:
        return (Path.touch, (self.trace,))


@pytest.mark.parametrize("component", ["trainer_module.main_buffer", "policy"])
@pytest.mark.parametrize("name", ["prefetch.pkl", "other.pickle"])
def test_a_pickle_in_a_checkpoint_is_refused_and_not_read(
    component: str, name: str, stopped: Path, demos: Path, tmp_path: Path
):
    trace = tmp_path / "trace"
    (folder,) = latest_checkpoint(stopped).glob(f"components/*-{component}")
    (folder / name).write_bytes(pickle.dumps(Evil(trace)))
    with pytest.raises(ValueError, match=rf"{name}: does not belong to a checkpoint"):
        resumed(stopped, demos)
    assert not trace.exists()


def test_nothing_is_unpickled(stopped: Path, demos: Path, monkeypatch: pytest.MonkeyPatch):
    def forbidden(*_arguments: object, **_options: object) -> None:
        raise AssertionError("unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, forbidden)
    resumed(stopped, demos)
    evaluate_run(stopped, episodes=1)


def test_another_architecture_is_named_with_the_remedy(stopped: Path, demos: Path):
    with pytest.raises(
        ValueError, match=r"(?s)does not fit .*\(config\.yaml beside its checkpoints\)"
    ):
        evaluate_run(stopped, ["actor.hidden=[16,16]"])


def test_a_damaged_checkpoint_is_named(stopped: Path):
    latest = latest_checkpoint(stopped)
    (latest / "manifest.json").write_text("{")
    with pytest.raises(ValueError, match=rf"{latest}/manifest\.json: holds 1 bytes, and \d+ were"):
        load_component(latest, "policy", torch.nn.Linear(1, 1))


def test_a_run_without_a_checkpoint_is_named(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos)
    run = built(config)
    with pytest.raises(FileNotFoundError, match=r"sac holds no checkpoint .* is it a run"):
        load_policy(config, TASK, run.run_dir)


def test_an_offline_run_resumes(tmp_path: Path, demos: Path):
    def trained(folder: str, stop_at: int | None) -> Run:
        config = tiny_config("bc", tmp_path / folder, demos, "bc.updates=200")
        run = built(config)
        if stop_at is not None:
            run.trainer.total_frames = stop_at
            run.train()
            torch.manual_seed(4321)
            run = built(config, resume=True)
        run.train()
        return run

    whole, halved = trained("whole", None), trained("halved", 100)
    assert differences(halved.actor.state_dict(), whole.actor.state_dict()) == []


SPACES = "task.name='gymnasium:tests.envs.library.toys:Toys/Spaces-v0'"
"""An environment whose state cannot be saved."""
DRIFTS = "task.name='gymnasium:tests.envs.library.toys:Toys/Drifts-v0'"
"""One that offers it itself."""


def test_a_task_that_cannot_be_restored_starts_fresh_episodes(tmp_path: Path, demos: Path):
    options = [SPACES, "collector.total_frames=80"]
    config = tiny_config("sac", tmp_path, demos, *options)
    run = built(config)
    run.trainer.total_frames = 40
    run.train()
    again = built(config, resume=True)
    again.train()
    assert again.trainer.collected_frames == 80
    assert len(again.trainer._modules["main_buffer"]) == 80


def test_an_environment_without_a_state_starts_fresh_episodes(tmp_path: Path, demos: Path):
    config = tiny_config(
        "sac",
        tmp_path,
        demos,
        SPACES,
        "env.horizon=15",
        "actor.normalise_observations=false",
        "growth.admission.min_return=0.0",
    )
    run = built(config)
    run.trainer.total_frames = 20  # ten steps of each copy: in the middle of the episodes
    run.train()
    assert part_open(run), "the cut must be in the middle of episodes for this to say anything"
    again = built(config, resume=True)
    assert not part_open(again)
    collector = again.trainer.collector
    fresh = collector._carrier["observation"].clone()
    batch = next(iter(collector))
    assert torch.equal(batch["observation"][:, 0], fresh)
    # Episodes of 15 steps that begin with the batch: none ends within its ten, one within 20.
    assert not batch["next", "done"].any()
    assert next(iter(collector))["next", "done"].any()


def test_an_environment_that_offers_its_state_goes_on_bit_for_bit(tmp_path: Path, demos: Path):
    def trained(folder: str, stop_at: int | None) -> Run:
        # 40 frames are 20 steps of each copy: in the middle of a second episode.
        options = (DRIFTS, "collector.total_frames=60", "env.horizon=15")
        config = tiny_config("sac", tmp_path / folder, demos, *options)
        run = built(config)
        if stop_at is not None:
            run.trainer.total_frames = stop_at
            run.train()
            torch.manual_seed(4321)
            run = built(config, resume=True)
        run.train()
        return run

    whole, halved = trained("whole", None), trained("halved", 40)
    assert differences(buffer_of(halved), buffer_of(whole)) == []
    assert differences(halved.actor.state_dict(), whole.actor.state_dict()) == []


def buffer_of(run: Run) -> dict:
    return run.trainer._modules["main_buffer"][:].to_dict()


def test_a_run_that_was_saved_without_its_environment_s_state_goes_on(
    tmp_path: Path, demos: Path, monkeypatch: pytest.MonkeyPatch
):
    """As Pendulum's were before it could be saved."""
    config = tiny_config("sac", tmp_path, demos, DRIFTS, "collector.total_frames=60")
    whole = VectorEnv.get_extra_state
    with monkeypatch.context() as before:
        before.setattr(
            VectorEnv,
            "get_extra_state",
            lambda env: {key: whole(env)[key] for key in ("seed", "episodes")},
        )
        run = built(config)
        run.trainer.total_frames = 40
        run.train()
    again = built(config, resume=True)
    collector = again.trainer.collector
    shown = collector.env.copies.buffers.observation
    assert collector._carrier["observation"].tolist() == shown.tolist()
    again.train()
    assert again.trainer.collected_frames == 60


def test_an_evaluation_says_how_far_the_run_really_got(stopped: Path):
    made_from = evaluate_run(stopped, ["evaluation.episodes=1"])["made_from"]
    assert made_from["frames"] == HALF  # of the WHOLE that its configuration asks for


def test_overrides_of_a_resumed_run_are_saved_with_it(stopped: Path, demos: Path):
    resumed(stopped, demos, f"collector.total_frames={WHOLE + 100}")
    assert load_recipe(stopped).collector.total_frames == WHOLE + 100
