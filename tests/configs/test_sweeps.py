"""Where the runs of a sweep are kept."""

from __future__ import annotations

import pytest

from configs.sweeps import with_run_dirs


@pytest.mark.parametrize(
    ("typed", "ends"),
    [
        (["loss.gamma=0.9,0.99"], "-seed${seed}-loss.gamma-${loss.gamma}"),
        (["seed=0,1", "loss.n_step=1,5"], "-seed${seed}-loss.n_step-${loss.n_step}"),
        (["seed=range(0,2)", "optim.tau=choice(0.1,0.2)"], "-optim.tau-${optim.tau}"),
        # A slash or a bracket would make a folder within, or one that a shell reads as a pattern.
        (["demos.source=a/b.h5,c.h5"], "-job${hydra:job.num}"),
        (["actor.hidden=[64],[64,64]", "loss.gamma=0.9,0.99"], "-job${hydra:job.num}"),
    ],
)
def test_a_run_directory_says_what_the_sweep_varies(typed: list[str], ends: str):
    *kept, run_dir = with_run_dirs(["--multirun", *typed])
    assert kept == ["--multirun", *typed]
    assert run_dir.startswith("run_dir=runs/${hydra:runtime.choices.variant}-")
    assert run_dir.endswith(ends)


@pytest.mark.parametrize(
    "typed",
    [
        ["variant=best,sac", "preset=smoke,table", "seed=0,1"],  # of which the default tells
        ["loss.gamma=0.9,0.99", "run_dir='runs/mine-${loss.gamma}'"],
        ["loss.gamma=0.9,0.99", "run_dir=a,b"],
        ["run_dir=runs/mine", "loss.gamma=0.9"],  # one run
        ["loss.gamma=0.9,"],  # which Hydra itself refuses
        ["hydra.launcher.n_jobs=1,2"],
    ],
)
def test_where_runs_differ_anyway_nothing_is_added(typed: list[str]):
    assert with_run_dirs(["-m", *typed]) == ["-m", *typed]


def test_one_directory_for_several_runs_is_refused():
    with pytest.raises(ValueError, match="run_dir=runs/mine is one directory, and a sweep has sev"):
        with_run_dirs(["-m", "loss.gamma=0.9,0.99", "run_dir=runs/mine"])
