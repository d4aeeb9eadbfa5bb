"""Misspelt keys and names of ``make train``."""

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
    with pytest.raises(ValueError, match=r"no key zzz: all are listed by: make settings"):
        require_known(["zzz=1"])


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("variant=bcsac", r"no variant bcsac: did you mean bc_sac\b.*? All: bc, bc_sac, best, "),
        ("preset=smok", r"no preset smok: did you mean smoke\? All: control, default, "),
        ("variant=best,qqq", r"no variant qqq: bc, bc_sac, "),
    ],
)
def test_a_variant_or_preset_that_does_not_exist_is_refused_in_one_line(typed: str, said: str):
    with pytest.raises(ValueError, match=said) as refused:
        require_known([typed])
    assert "\n" not in str(refused.value)


def test_a_name_in_a_folder_of_somebody_s_own_is_left_to_hydra():
    require_known(["variant=mine", "hydra.searchpath=['file:///x/configs']"])
    require_known(["--config-dir=/x/configs", "preset=mine"])


def test_what_may_be_typed_passes():
    require_known(prepare([
        "variant=bc_sac", "preset=smoke,table", "run_dir='runs/${seed}'", "seed=1,2",
        "loss.bc_weight={init: 2}", "loss={gamma: 0.9}", "task.kwargs.g=9.0",
        "task.name='gymnasium:Pendulum-v1'",
        "task.randomise.factors.mass=[0.9,1.1]", "task.success=return>=-200",
        "hydra.verbose=true", "+experiment=mine", "~logging", "--multirun",
    ]))  # fmt: skip
