"""Demonstrated steps before and after the door has begun to open."""

from __future__ import annotations

import math

import pytest
import torch

from configs import compose_config
from envs.door.task import HINGE, OBSERVATION_SIZE
from pipeline.components import make_emphasis
from pipeline.emphasis import OpeningEmphasis


def at_angles(*angles: float) -> torch.Tensor:
    observation = torch.randn(len(angles), OBSERVATION_SIZE)
    observation[:, HINGE] = torch.tensor(angles)
    return observation


def test_the_factor_changes_where_the_door_begins_to_open():
    emphasis = OpeningEmphasis(closed=0.5, open=2.0, angle=0.02)
    factors = emphasis(at_angles(-0.01, 0.0, 0.019, 0.021, 1.5))
    assert factors.tolist() == [0.5, 0.5, 0.5, 2.0, 2.0]
    assert emphasis(torch.zeros(4, 3, OBSERVATION_SIZE)).shape == (4, 3)


@pytest.mark.parametrize("value", [-0.1, math.inf, math.nan])
@pytest.mark.parametrize("name", ["closed", "open"])
def test_a_bad_factor_is_named(name: str, value: float):
    with pytest.raises(ValueError, match=rf"loss\.bc_emphasis\.{name} must be .* got {value}"):
        OpeningEmphasis(**({"closed": 1.0, "open": 1.0, "angle": 0.1} | {name: value}))


def configured(*overrides: str) -> OpeningEmphasis | None:
    return make_emphasis(compose_config("variant=bc_sac", "preset=smoke", *overrides))


def test_what_is_configured_is_made():
    options = ["loss.bc_emphasis.closed=0.5", "loss.bc_emphasis.angle=0.1"]
    assert configured(*options) == OpeningEmphasis(closed=0.5, open=1.0, angle=0.1)


def test_alike_means_none():
    assert configured("loss.bc_emphasis.angle=0.1") is None


def test_a_task_without_a_door_is_refused():
    with pytest.raises(ValueError, match=r"open=2\.0\).*Pendulum-v1 does not have: set both to 1"):
        configured("loss.bc_emphasis.open=2", "env.name='gymnasium:Pendulum-v1'")
