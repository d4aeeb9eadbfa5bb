"""Misspelt keys of ``make train``."""

from __future__ import annotations

import pytest

from configs import prepare
from configs.known_keys import require_known


def test_a_misspelt_key_names_the_one_that_was_meant():
    with pytest.raises(
        ValueError, match=r"no key loss\.bc_wieght\.init: did you mean loss\.bc_wei"
    ):
        require_known(["seed=1", "loss.bc_wieght.init=2"])


def test_what_is_like_nothing_is_told_where_all_are():
    with pytest.raises(ValueError, match=r"no key zzz: all are in docs/reference/settings\.md"):
        require_known(["zzz=1"])


def test_what_may_be_typed_passes():
    require_known(prepare([
        "variant=bc_sac", "preset=smoke", "run_dir=runs/x", "seed=1,2", "loss.bc_weight={init: 2}",
        "loss={gamma: 0.9}", "task.name='gymnasium:Pendulum-v1'", "task.kwargs.g=9.0",
        "task.randomise.factors.mass=[0.9,1.1]", "task.success=return>=-200",
        "hydra.verbose=true", "+experiment=mine", "~logging", "--multirun",
    ]))  # fmt: skip
