"""Whole runs on a GPU; where there is none, nothing here is claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.commands.evaluate_run import evaluate_run
from pipeline.machine.random_state import kept_random_state
from pipeline.playing import make_evaluator
from pipeline.trainer import Run
from tests.pipeline.resuming import (
    curve_of,
    differences,
    everything,
    long_config,
    whole_and_halved,
)
from tests.pipeline.toys import built, tiny_config

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")


def on_gpu(run: Run) -> bool:
    return all(p.device.type == "cuda" for p in run.trainer.loss_module.parameters())


@pytest.mark.parametrize("variant", ["bc", "bc_sac", "ila_dbc", "da_sac", "best"])
def test_a_variant_trains_and_is_evaluated(variant: str, tmp_path: Path, demos: Path):
    run = built(tiny_config(variant, tmp_path, demos, "device=cuda"))
    run.train()
    assert on_gpu(run)
    assert np.isfinite(evaluate_run(run.run_dir, ["evaluation.episodes=2"])["return_mean"])


@pytest.mark.parametrize("cuda_graphs", ["true", "false"])
def test_a_resumed_run_is_the_uninterrupted_one(cuda_graphs: str, tmp_path: Path, demos: Path):
    options = ("device=cuda", f"cuda_graphs={cuda_graphs}")
    whole, halved = whole_and_halved(tmp_path, demos, *options)
    assert differences(everything(halved), everything(whole)) == []
    assert curve_of(halved.run_dir) == curve_of(whole.run_dir)


def test_a_run_with_recordings_is_the_one_without(tmp_path: Path, demos: Path):
    # Rates that float32 holds exactly, as the recorded steps read them.
    rates = [f"{key}={2**-10}" for key in ("bc.lr", "optim.actor_lr", "optim.critic_lr")]
    rates += [f"optim.temperature_lr={2**-10}", "optim.anneal_actor=false", "bc.anneal=false"]
    runs = []
    for cuda_graphs in ("true", "false"):
        folder = tmp_path / cuda_graphs
        config = long_config(folder, demos, "device=cuda", f"cuda_graphs={cuda_graphs}", *rates)
        runs.append(built(config))
        runs[-1].train()
    graphs, plain = ({"loss": run.trainer.loss_module.state_dict()} for run in runs)
    assert differences(graphs, plain) == []


def test_an_evaluation_repeats_itself_and_leaves_the_random_state(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos, "device=cuda", "evaluation.exploration=sample")
    run = built(config)
    evaluator = make_evaluator(config, episodes=3)
    before = torch.cuda.get_rng_state()
    first, second = evaluator.run(run.actor), evaluator.run(run.actor)
    assert torch.equal(torch.cuda.get_rng_state(), before)
    np.testing.assert_array_equal(first.returns, second.returns)


def test_the_gpu_s_random_state_is_kept():
    before = torch.cuda.get_rng_state()
    with kept_random_state("cuda"):
        torch.manual_seed(1)
        torch.randn(3, device="cuda")
        assert not torch.equal(torch.cuda.get_rng_state(), before)
    assert torch.equal(torch.cuda.get_rng_state(), before)
