"""What a resumed run may change, what its files hold then, and who else may write to them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from configs import compose
from envs.demonstrations import DemonstrationError
from pipeline.build import build_run
from pipeline.files.curves import read_lines
from pipeline.files.run_files import RunDirectoryError
from pipeline.recipe import Recipe
from pipeline.resuming import changes
from pipeline.run_dir import existing, load_recipe
from pipeline.trainer import Run
from tests.toys import reach

FILE = str(Path(reach.__file__))
HALF, WHOLE = 60, 120


def recipe_of(*overrides: str) -> Recipe:
    """Plain SAC on the toy: a portion of 20 frames takes milliseconds."""
    return compose(
        "variant=sac", "preset=smoke", f"task.name='{FILE}'", f"collector.total_frames={WHOLE}",
        "collector.frames_per_batch=20", "evaluation.interval=40", "logging.interval=1",
        f"logging.checkpoint_interval={HALF - 1}", "optim.actor_delay=0", *overrides,
    )  # fmt: skip


def stopped(run_dir: Path, *overrides: str, at: int = HALF) -> Path:
    """A run that ended at its checkpoint, with an evaluation and logs."""
    run = build_run(recipe_of(*overrides), run_dir)
    run.trainer.total_frames = at
    run.train()
    return run_dir


def resumed(run_dir: Path, *overrides: str) -> Run:
    return build_run(
        load_recipe(run_dir, [f"task.name='{FILE}'", *overrides]), run_dir, resume=True
    )


def frames_of(run_dir: Path) -> list[float]:
    return [row["frames"] for row in read_lines(run_dir / "learning_curve.jsonl")]


@pytest.mark.parametrize(
    ("change", "table"),
    [
        ("loss.gamma=0.5", r"loss\.gamma +0\.99 +0\.5"),
        ("sampler.batch_size=7", r"sampler\.batch_size +32 +7"),
        ("env.num_envs=5", r"env\.num_envs +2 +5"),
        ("actor.hidden=[16]", r"actor\.hidden +\[32, 32\] +\[16\]"),
        ("bc.lr=0.5", r"bc\.lr +0\.001 +0\.5"),
        ("backtrack.level=0.5", r"backtrack\.level +null +0\.5"),
    ],
)
def test_a_change_that_makes_another_run_is_refused(change: str, table: str, tmp_path: Path):
    run_dir = stopped(tmp_path / "run")
    before = (run_dir / "config.yaml").read_text()
    with pytest.raises(RunDirectoryError, match=rf"(?s)cannot change them:\nkey .*{table}.*RUN="):
        resumed(run_dir, change)
    assert (run_dir / "config.yaml").read_text() == before


def test_what_may_change_acts_and_is_recorded(tmp_path: Path):
    run_dir = stopped(tmp_path / "run")
    run = resumed(
        run_dir, "optim.critic_lr=0.5", "evaluation.interval=20", "logging.interval=7",
        "logging.loggers=[tensorboard,csv]", "logging.checkpoint_interval=17",
        "collector.total_frames=160", "evaluation.interval_episodes=3",
    )  # fmt: skip
    stepper = run.trainer.optimization_stepper
    assert stepper.optimizers["critic"].param_groups[0]["lr"] == 0.5
    assert (run.trainer._log_interval, run.trainer.save_trainer_interval) == (7, 17)
    assert run.evaluation.evaluator.episodes == 3
    run.train()
    assert run.trainer.collected_frames == 160
    # 20 (the first), 40; then in the new interval.
    assert frames_of(run_dir) == [20, 40, 60, 80, 100, 120, 140, 160]
    (entry,) = yaml.safe_load((run_dir / "config.yaml").read_text())["history"]
    assert entry["frames"] == HALF
    assert entry["changed"]["optim.critic_lr"] == [3e-4, 0.5]
    assert entry["changed"]["logging.loggers"] == [["csv"], ["tensorboard", "csv"]]
    assert load_recipe(run_dir, [f"task.name='{FILE}'"]).optim.critic_lr == 0.5
    resumed(run_dir, "collector.total_frames=200")
    history = yaml.safe_load((run_dir / "config.yaml").read_text())["history"]
    assert [sorted(one["changed"]) for one in history[1:]] == [["collector.total_frames"]]


def test_what_a_run_has_decided_is_no_change(tmp_path: Path):
    run_dir = stopped(tmp_path / "run")
    saved = load_recipe(run_dir, [f"task.name='{FILE}'"])
    again = build_run(recipe_of(), run_dir, resume=True)
    assert changes(saved, again.recipe) == {}
    assert "history" not in (run_dir / "config.yaml").read_text()


def test_fewer_frames_than_there_are_are_refused(tmp_path: Path):
    run_dir = stopped(tmp_path / "run")
    with pytest.raises(RunDirectoryError, match=r"has 60 frames already, and .*=40 asks for fewer"):
        resumed(run_dir, "collector.total_frames=40")
    run = resumed(run_dir, "collector.total_frames=80")
    run.train()
    assert run.trainer.collected_frames == 80


def test_rows_behind_the_checkpoint_are_written_once(tmp_path: Path):
    """As after a kill: the files are ahead of the only checkpoint that is left."""
    loggers = "logging.loggers=[csv,tensorboard]"
    whole = build_run(recipe_of(loggers), tmp_path / "whole")
    whole.train()
    run_dir = stopped(tmp_path / "run", loggers)
    run = resumed(run_dir)
    run.trainer.save_trainer = lambda force_save=False: None
    run.train()
    curve = run_dir / "learning_curve.jsonl"
    assert frames_of(run_dir)[-1] == WHOLE
    curve.write_text(curve.read_text() + '{"frames": 140, "retu')
    again = resumed(run_dir)
    assert frames_of(run_dir) == [20, 40, 60]
    assert again.trainer.collected_frames == HALF
    again.train()
    lines = [json.loads(line)["frames"] for line in curve.read_text().splitlines()]
    assert lines == [20, 40, 60, 80, 120]
    for path in (tmp_path / "whole/logs/csv").rglob("*.csv"):
        if path.stem == "wall_s":
            continue  # another one each time
        theirs = path.read_text().splitlines()
        ours = run_dir / path.relative_to(tmp_path / "whole")
        assert ours.read_text().splitlines() == theirs, path
    steps = {}
    for folder in (tmp_path / "whole", run_dir):
        events = EventAccumulator(str(folder / "logs/tensorboard"), purge_orphaned_data=False)
        events.Reload()
        steps[folder] = {
            tag: [(event.step, str(event.value)) for event in events.Scalars(tag)]
            for tag in events.Tags()["scalars"]
            if not tag.endswith("wall_s")
        }
    assert steps[run_dir] == steps[tmp_path / "whole"]
    walls = [row["wall_s"] for row in read_lines(curve)]
    assert walls == sorted(walls)


def test_wall_time_goes_on_from_the_last_row_that_is_kept(tmp_path: Path):
    """A row may be younger than the checkpoint: here by an hour."""
    run_dir = stopped(tmp_path / "run")
    curve = run_dir / "learning_curve.jsonl"
    *rows, last = read_lines(curve)
    kept = [*rows, last | {"wall_s": last["wall_s"] + 3600}]
    curve.write_text("".join(f"{json.dumps(row)}\n" for row in kept))
    resumed(run_dir).train()
    walls = [row["wall_s"] for row in read_lines(curve)]
    assert len(walls) > len(kept)
    assert walls == sorted(walls)


def test_an_evaluation_that_a_kill_prevented_is_made_up_for(tmp_path: Path):
    run_dir = stopped(tmp_path / "run", "evaluation.interval=50", at=WHOLE)
    curve = run_dir / "learning_curve.jsonl"
    *others, last = curve.read_text().splitlines(keepends=True)
    curve.write_text("".join(others))
    assert frames_of(run_dir) == [20, 60, 100]
    for _ in range(2):  # the second time there is nothing to do
        resumed(run_dir).train()
        assert frames_of(run_dir) == [20, 60, 100, 120]
    again = json.loads(curve.read_text().splitlines()[-1])
    assert {**json.loads(last), "wall_s": again["wall_s"]} == again


def test_without_a_checkpoint_a_run_starts_again(tmp_path: Path):
    whole = build_run(recipe_of(), tmp_path / "whole")
    whole.train()
    run_dir = stopped(tmp_path / "run")
    for path in (run_dir / "checkpoints").iterdir():
        path.rename(run_dir / f".{path.name}")  # as if it had never been written
    run = resumed(run_dir)
    assert run.trainer.collected_frames == 0
    assert frames_of(run_dir) == []
    run.train()
    ours, theirs = (read_lines(d / "learning_curve.jsonl") for d in (run_dir, tmp_path / "whole"))
    for row in (*ours, *theirs):
        del row["wall_s"]
    assert ours == theirs


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ("empty", "exists and is no run directory: remove it, or choose another with RUN="),
        ("begun", "ended before its first checkpoint. Start it again with RESUME="),
        ("half", "a run at 60 of 120 frames. Continue it with RESUME="),
        ("complete", "a complete run of 120 frames. Evaluate it with make eval RUN="),
    ],
)
def test_a_directory_in_the_way_is_described(state: str, message: str, tmp_path: Path):
    run_dir = tmp_path / "run"
    if state == "empty":
        run_dir.mkdir()
    else:
        stopped(run_dir, at=WHOLE if state == "complete" else HALF)
    if state == "begun":
        (run_dir / "checkpoints").rename(tmp_path / "gone")
    with pytest.raises(RunDirectoryError) as error:
        build_run(recipe_of(), run_dir)
    assert message in str(error.value)


def test_a_clone_counts_updates(tmp_path: Path):
    """100 of 200 updates of cloning, and then all of them."""
    reach.record(tmp_path / "reach.h5")
    recipe = compose(
        "variant=bc", "preset=smoke", f"task.name='{FILE}'", "bc.updates=200",
        f"demos.source='{tmp_path / 'reach.h5'}'", f"cache_dir='{tmp_path / 'cache'}'",
        "evaluation.interval=0", "logging.checkpoint_interval=99",
    )  # fmt: skip
    run = build_run(recipe, tmp_path / "run")
    run.trainer.total_frames = 100
    run.train()
    with pytest.raises(RunDirectoryError, match=r": a run at 100 of 200 updates of cloning\. Cont"):
        build_run(recipe, tmp_path / "run")
    few = "has 100 updates of cloning already, and bc.updates=50 asks for fewer: ask for at least"
    with pytest.raises(RunDirectoryError, match=few):
        resumed(tmp_path / "run", "bc.updates=50")
    resumed(tmp_path / "run").train()
    with pytest.raises(RunDirectoryError, match=r": a complete run of 200 updates of cloning\. Ev"):
        build_run(recipe, tmp_path / "run")


def test_the_commands_for_a_complete_run_name_its_task(tmp_path: Path):
    run_dir = stopped(tmp_path / "run", at=WHOLE)
    told = existing(run_dir)
    assert f"Evaluate it with make eval RUN={run_dir} TASK={FILE}, train it" in told
    longer = f"make train RESUME={run_dir} TASK={FILE} ARGS=collector.total_frames=..., or"
    assert longer in told


HOLD = """
import sys, time
from pathlib import Path
from pipeline.files.run_lock import lock_run
lock = lock_run(Path(sys.argv[1]))
print("locked", flush=True)
time.sleep(60)
"""


def test_a_directory_in_use_is_refused_until_its_process_is_gone(tmp_path: Path):
    run_dir = stopped(tmp_path / "run")
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(run_dir)], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    with holder, holder.stdout:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(RunDirectoryError, match="is in use: another process trains in it"):
            resumed(run_dir)
        with pytest.raises(RunDirectoryError, match="a run is under way in it"):
            build_run(recipe_of(), run_dir)
        holder.kill()
    resumed(run_dir).train()


def test_a_run_that_cannot_be_composed_leaves_no_directory(tmp_path: Path):
    wrong = recipe_of("sampler.demo_ratio=0.5", f"demos.source='{tmp_path / 'nowhere'}'")
    with pytest.raises(DemonstrationError, match="nowhere: does not exist"):
        build_run(wrong, tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_the_bar_of_a_resumed_run_begins_where_the_run_does(tmp_path: Path):
    run = build_run(recipe_of("logging.progress=true"), tmp_path / "run")
    run.trainer.total_frames = 40
    run.train()
    assert (run.trainer._pbar.initial, run.trainer._pbar.n) == (0, 40)
    again = resumed(tmp_path / "run")
    again.train()
    bar = again.trainer._pbar
    assert (bar.initial, bar.n, bar.unit) == (40, again.recipe.collector.total_frames, " frames")
    assert bar.disable, "a closed bar writes no more"
