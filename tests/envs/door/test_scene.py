from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest

from envs.adroit import scene
from envs.door import hand
from tests.envs.door.conftest import ARM, FINGERS, WRIST


@pytest.fixture(scope="module")
def door():
    return hand.build_scene()


def test_servo_stiffness_by_actuator_name(door):
    expected = dict.fromkeys(WRIST, 10.0) | dict.fromkeys(FINGERS, 1.0)
    assert len(expected) == 24
    for name, stiffness in expected.items():
        actuator = door.model.actuator(f"A_{name}")
        np.testing.assert_array_equal(actuator.gainprm[:3], [stiffness, 0, 0], err_msg=name)
        np.testing.assert_array_equal(actuator.biasprm[:3], [0, -stiffness, 0], err_msg=name)


def test_arm_keeps_the_gains_of_the_file(door):
    for name in ARM:
        actuator = door.model.actuator(f"A_{name}")
        assert actuator.gainprm[0] == 500
        assert actuator.biasprm[1] == -200


def test_gains_do_not_rely_on_the_file(tmp_path, monkeypatch):
    """A file with other gains gives the same scene."""
    original = scene.model_path("adroit_door.xml")
    for part in original.parent.glob("*.xml"):
        text = part.read_text().replace('gainprm="10 0 0"', 'gainprm="33 0 0"')
        text = text.replace('biasprm="0 -1 0"', 'biasprm="0 -7 0"')
        text = text.replace("resources/", f"{original.parent}/resources/")
        (tmp_path / part.name).write_text(text)
    monkeypatch.setattr(hand, "model_path", lambda file: tmp_path / file)
    changed = hand.build_scene().model
    monkeypatch.undo()
    model = hand.build_scene().model
    np.testing.assert_array_equal(changed.actuator_gainprm, model.actuator_gainprm)
    np.testing.assert_array_equal(changed.actuator_biasprm, model.actuator_biasprm)


def test_actions_span_the_control_range(door):
    low, high = door.model.actuator_ctrlrange.T
    np.testing.assert_allclose(door.control_middle - door.control_half_range, low, atol=1e-15)
    np.testing.assert_allclose(door.control_middle + door.control_half_range, high, atol=1e-15)
    # A_ARRz reaches from -1 to 2 rad.
    assert (door.control_middle[3], door.control_half_range[3]) == (0.5, 1.5)


def test_time_step_gives_100_hz(door):
    assert door.model.opt.timestep * scene.SUBSTEPS == pytest.approx(0.01)


def test_the_model_package_is_not_imported(door):
    assert "gymnasium_robotics" not in sys.modules


def test_missing_package_names_the_remedy(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FileNotFoundError, match="pip install gymnasium-robotics"):
        scene.model_path("adroit_door.xml")


def test_missing_model_file_names_the_remedy(monkeypatch, tmp_path):
    spec = importlib.util.spec_from_file_location("fake", tmp_path / "__init__.py")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: spec)
    with pytest.raises(FileNotFoundError, match="--force-reinstall"):
        scene.model_path("adroit_door.xml")
