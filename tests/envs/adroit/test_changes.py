"""A copy with a model of its own is MuJoCo with that model; its neighbours are as before."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from envs import find_task
from envs.adroit.scene import SUBSTEPS
from envs.adroit.simulator import HandSimulator
from tests.envs.adroit.conftest import HANDS, OTHERS, held_actions, starts_of

STEPS = 60


def play(simulator: HandSimulator, task: str, actions: np.ndarray) -> np.ndarray:
    starts = starts_of(task, len(actions))
    placement = {name: starts[name] for name in simulator.placement}
    simulator.start(placement)
    for action in actions.swapaxes(0, 1):
        simulator.step(action)
    return simulator.qpos


def changed(task: str, name: str, factor: float):
    """What the task's own setting writes into a model."""

    def write(model: mujoco.MjModel) -> None:
        find_task(task).disturb.apply.multiply[name](model, factor)

    return write


def by_mujoco(task: str, actions: np.ndarray, copy: int, change) -> np.ndarray:
    """Joint positions after playing one copy's actions in MuJoCo alone."""
    scene, starts = HANDS[task].scene(), starts_of(task, len(actions))
    change(scene.model)
    for name, numbers in scene.placed.items():
        numbers.of(scene.model)[:] = starts[name][copy]
    data = mujoco.MjData(scene.model)
    if not scene.current:
        mujoco.mj_forward(scene.model, data)
    for action in actions[copy]:
        data.ctrl[:] = scene.control_middle + scene.control_half_range * action.clip(-1, 1)
        mujoco.mj_step(scene.model, data, SUBSTEPS)
    return data.qpos


@pytest.mark.parametrize("task", sorted(HANDS))
def test_a_changed_copy_is_mujoco_with_that_model_and_its_neighbour_is_as_before(task):
    actions = held_actions(task, 3, STEPS)
    with HandSimulator(HANDS[task], 3, 2) as simulator:
        plain = play(simulator, task, actions)
        simulator.change_model(1, changed(task, "finger_gain", 0.5))
        mixed = play(simulator, task, actions)
        np.testing.assert_array_equal(mixed[[0, 2]], plain[[0, 2]])
        expected = by_mujoco(task, actions, 1, changed(task, "finger_gain", 0.5))
        np.testing.assert_allclose(mixed[1], expected, atol=1e-12)
        assert np.abs(mixed[1] - plain[1]).max() > 1e-3
        simulator.change_model(1, None)
        np.testing.assert_array_equal(play(simulator, task, actions), plain)


@pytest.mark.parametrize("task", sorted(HANDS))
def test_every_factor_writes_what_it_is_called_after(task):
    written = {
        "contact_friction": {"geom_friction"},
        "finger_gain": {"actuator_gainprm", "actuator_biasprm"},
        "hinge_friction": {"dof_frictionloss"},
        "latch_friction": {"dof_frictionloss"},
        "nail_friction": {"dof_frictionloss"},
        "hinge_damping": {"dof_damping"},
        "finger_damping": {"dof_damping"},
    }
    for name in find_task(task).disturb.factors:
        with HandSimulator(HANDS[task], 1) as simulator:
            simulator.change_model(0, changed(task, name, 2.0))
            found = set(simulator._states.changed)
            if name == "mass":
                assert found >= {"body_mass", "body_inertia", "body_subtreemass", "dof_M0"}
                total = HANDS[task].scene().model.body_mass
                heavier = simulator._states.changed["body_mass"][0]
                moved = heavier != total
                np.testing.assert_allclose(heavier[moved], 2 * total[moved])
                assert moved.sum() == (2 if task == "door" else 1)
            else:
                assert found == written[name]


@pytest.mark.parametrize("task", OTHERS)
def test_damped_fingers_are_the_fingers_and_follow_more_slowly(task):
    model = HANDS[task].scene().model
    was = model.dof_damping.copy()
    changed(task, "finger_damping", 4.0)(model)
    names = {model.joint(model.dof_jntid[i]).name for i in np.flatnonzero(model.dof_damping != was)}
    assert len(names) == 22
    assert {name[:2] for name in names} == {"FF", "MF", "RF", "LF", "TH"}
    actions = np.zeros((2, 5, HANDS[task].action_size))  # to the middle of each joint's range
    with HandSimulator(HANDS[task], 2) as simulator:
        simulator.change_model(1, changed(task, "finger_damping", 4.0))
        bent = play(simulator, task, actions)
    first = model.joint("MFJ1").qposadr[0]
    assert 0.05 < bent[1, first] < bent[0, first] - 0.05


def test_no_copy_of_this_number():
    with HandSimulator(HANDS["door"], 2) as simulator, pytest.raises(IndexError, match="2"):
        simulator.change_model(2, None)


def test_a_picture_is_of_the_changed_model():
    with HandSimulator(HANDS["door"], 2) as simulator:
        simulator.change_model(1, changed("door", "mass", 3.0))
        simulator.data(1)
        heavy = simulator.scene.model.body("door").mass.item()
        simulator.data(0)
        assert heavy == pytest.approx(3 * simulator.scene.model.body("door").mass.item())
