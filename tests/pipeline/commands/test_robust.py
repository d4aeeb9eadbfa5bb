"""``make robust``: ladders of a task, and one that is climbed with a real policy."""

from __future__ import annotations

from pathlib import Path

import pytest

from envs import find_task
from pipeline.commands import robust
from pipeline.commands.robust import plans, robustness
from tests.pipeline.toys import built, tiny_config
from tests.toys.reach import TASK as REACH


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, demos: Path) -> Path:
    run = built(tiny_config("sac", tmp_path_factory.mktemp("runs"), demos))
    run.train()
    return run.run_dir


def test_noise_and_delays_are_of_every_task_and_the_rest_of_those_that_say_so():
    generic = ["observation_noise", "action_noise", "delay"]
    assert [plan.kind for plan in plans(REACH)] == generic
    door = [plan.kind for plan in plans(find_task("door"))]
    assert door[:3] == generic
    assert set(door[3:]) == {
        *("contact_friction", "finger_gain", "mass", "door_x", "door_y", "door_z"),
        *("hinge_friction", "hinge_damping", "latch_friction"),
    }
    assert door.count("mass") == 2  # more and less
    assert {"board_z", "nail_friction"} <= {plan.kind for plan in plans(find_task("hammer"))}
    assert {"ball_x", "target_z"} <= {plan.kind for plan in plans(find_task("relocate"))}
    asked = [plan for plan in plans(find_task("pen")) if plan.kind == "asked_x"]
    assert [plan.what for plan in asked] == ["asked_x above its box", "asked_x below its box"]
    assert [rung.setting for rung in asked[1].rungs] == ["-0.1 rad", "-0.2 rad", "-0.4 rad"]
    for task in ("hammer", "pen", "relocate"):
        assert "finger_damping" in {plan.kind for plan in plans(find_task(task))}


def test_a_policy_climbs_its_ladders(trained: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(robust, "BEYOND", (0.02,))
    lines: list[str] = []
    found = robustness(trained, episodes=2, kinds=["door_z"], report=lines.append)
    assert [ladder.what for ladder in found.ladders] == [
        "door_z above its box",
        "door_z below its box",
    ]
    (above,), (below,) = (ladder.settings for ladder in found.ladders)
    # A policy of forty frames opens nothing; Wilson's interval of 0 of 2 ends at 0.658.
    assert (above.setting, above.success) == ("+0.02 m", 0.0)
    assert above.ci95 == pytest.approx((0.0, 0.6576), abs=1e-3)
    assert above.return_mean != found.undisturbed.return_mean
    assert below.success is None
    assert "penetrates the table" in str(below.refused)
    assert found.made_from["task"] == "door"
    assert lines[0].startswith("undisturbed: 0.0 [0.0, 65.8]")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"kinds": ["wind"]}, "wind is no disturbance of this task; it has observation_noise"),
        ({"bar": 0.0}, r"BAR=0\.0"),
        ({"bar": 1.5}, r"BAR=1\.5"),
    ],
)
def test_what_cannot_be_asked_for(trained: Path, options: dict, told: str):
    with pytest.raises(ValueError, match=told):
        robustness(trained, **options)
