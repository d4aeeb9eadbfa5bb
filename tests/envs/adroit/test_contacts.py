"""Contacts of a hand: forces of a ball on fixed parts, worked out by hand; nothing else changes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from envs import EnvOptions, find_task
from envs.adroit.contacts import PARTS, ContactReader, Surface
from envs.adroit.simulator import HandSimulator
from envs.adroit.touch import FORCES, OPPOSITION, Contacts
from envs.door.contacts import SURFACES
from tests.envs.adroit.conftest import HANDS, held_actions

STEPS = 40
WEIGHT = 0.1 * 9.81
CONTACTS = Contacts(PARTS, "thumb", ("near", "far"), ("near",), 0.0, 0.0, {})
#: A ball of 0.1 kg above a palm, which looks along its own -y.
LYING = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="palm" euler="{turned} 0 0"><geom name="C_palm" type="box" size="1 0.1 1"/></body>
    <body name="ball" pos="0.2 0 0.2"><freejoint/>
      <geom name="ball" type="sphere" size="0.1" mass="0.1"/>
    </body>
  </worldbody>
</mujoco>
"""
#: A ball that is a little too large for the gap between thumb and finger; nothing weighs anything.
BETWEEN = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="palm" pos="0 0 9"/>
    <body name="thdistal" pos="-0.2 0 0"><geom name="t" type="box" size="0.101 1 1"/></body>
    <body name="{other}" pos="{at}"><geom name="f" type="box" size="0.101 1 1"/></body>
    <body name="ball"><freejoint/><geom name="ball" type="sphere" size="0.1" mass="0.1"/></body>
  </worldbody>
</mujoco>
"""


def read(model_text: str, target="near", steps: int = 1) -> tuple[np.ndarray, float]:
    model = mujoco.MjModel.from_xml_string(model_text)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, steps - 1)
    forces = np.full((len(PARTS), 2), 7.0, dtype=np.float32)
    reader = ContactReader(model, CONTACTS, (Surface("ball", target),))
    return forces, reader.step(data, forces, 1)


@pytest.mark.parametrize(("turned", "part"), [(-90, "palm"), (90, "back")])
def test_a_ball_weighs_on_the_side_that_is_up(turned, part):
    """Turned by -90 degrees about x, a palm's -y is up."""
    forces, opposition = read(LYING.format(turned=turned), steps=2000)
    expected = np.zeros_like(forces)
    expected[PARTS.index(part), 0] = WEIGHT
    np.testing.assert_allclose(forces, expected, atol=1e-3)
    assert opposition == 0.0


def test_forces_are_means_over_the_steps_of_the_simulation():
    model = mujoco.MjModel.from_xml_string(LYING.format(turned=-90))
    data, forces = mujoco.MjData(model), np.zeros((len(PARTS), 2), dtype=np.float32)
    mujoco.mj_step(model, data, 2000)
    reader = ContactReader(model, CONTACTS, (Surface("ball", "near"),))
    reader.step(data, forces, 4)
    assert forces.sum() == pytest.approx(WEIGHT, abs=1e-3)
    data.qpos[2] += 1.0
    reader.step(data, forces, 4)
    assert forces.sum() == 0.0


def test_what_is_touched_may_depend_on_where():
    """The lowest point of the ball, 0.1 m below its middle, in its own frame."""
    forces, _ = read(
        LYING.format(turned=-90), lambda at: "far" if at[2] < -0.09 else "near", steps=2000
    )
    assert forces[PARTS.index("palm")] == pytest.approx([0.0, WEIGHT], abs=1e-3)


def test_a_thumb_opposes_a_finger_on_the_other_side():
    forces, opposition = read(BETWEEN.format(other="ffdistal", at="0.2 0 0"))
    thumb, first = forces[PARTS.index("thumb"), 0], forces[PARTS.index("first"), 0]
    assert thumb == pytest.approx(first, rel=1e-3)
    assert thumb > 0.1
    assert opposition == pytest.approx(-1.0, abs=1e-6)


def test_it_does_so_whichever_geom_mujoco_puts_first():
    """A sphere comes before a capsule, and a box behind it: the thumb's normal points the other
    way than the finger's."""
    text = BETWEEN.format(other="ffdistal", at="0.2 0 0")
    text = text.replace('"t" type="box" size="0.101 1 1"', '"t" type="sphere" size="0.101"')
    text = text.replace('type="sphere" size="0.1" mass', 'type="capsule" size="0.1 0.01" mass')
    forces, opposition = read(text)
    assert forces[PARTS.index("thumb"), 0] > 0.1
    assert opposition == pytest.approx(-1.0, abs=1e-3)


def test_what_pushes_from_the_same_side_does_not_oppose():
    _, opposition = read(BETWEEN.format(other="ffdistal", at="-0.2 0 0"))
    assert opposition == pytest.approx(1.0, abs=1e-6)


def test_targets_that_are_not_held_are_no_grasp():
    forces, opposition = read(BETWEEN.format(other="ffdistal", at="0.2 0 0"), "far")
    assert forces[:, 1].sum() > 0.2
    assert opposition == 0.0


@pytest.mark.parametrize(
    ("geom", "point", "target"),
    [
        ("lever", None, "handle"),
        ("spindle", (0.0, -0.1, 0.0), "latch"),
        ("spindle", (0.0, 0.1, 0.0), "back"),
        ("panel", (0.0, -0.05, 0.1), "panel"),
        ("panel", (0.0, 0.05, 0.1), "back"),
        ("rim_latch", (-0.25, 0.0, 0.0), "edge"),
        ("rim_latch", (-0.205, -0.05, 0.0), "panel"),
        ("post_latch", None, "frame"),
    ],
)
def test_places_of_the_door(geom, point, target):
    surface = {s.geom: s.target for s in SURFACES}[geom]
    assert (surface if point is None else surface(np.array(point))) == target


@pytest.mark.parametrize("task", sorted(HANDS))
def test_recording_changes_no_bit(task):
    actions = torch.as_tensor(held_actions(task, 2, STEPS), dtype=torch.float32).clamp(-1, 1)

    def rolled(**options):
        env = find_task(task).make_env(EnvOptions(num_envs=2, seed=1, num_threads=2, **options))
        td, steps = env.reset(), []
        for action in actions.unbind(1):
            stepped, td = env.step_and_maybe_reset(td.set("action", action))
            steps.append(stepped["next"].clone())
        return env, torch.stack(steps, 1)

    _, plain = rolled()
    env, recorded = rolled(strategies=True)
    for key in plain.keys():  # noqa: SIM118 - a tensordict
        assert torch.equal(plain[key], recorded[key]), key
    contacts = find_task(task).strategies.contacts
    assert recorded[FORCES].shape[-1] == len(contacts.parts) * len(contacts.targets)
    assert (recorded[FORCES] >= 0).all()
    assert recorded[OPPOSITION].abs().max() <= 1.0 + 1e-6
    assert FORCES in env.observation_spec.keys()  # noqa: SIM118 - a spec is not a mapping
    # Whatever is recorded is of this episode.
    assert env.reset()[FORCES].abs().max() == 0.0


def test_a_resting_pen_lies_in_the_hand():
    """The pen drops into the hand, which pushes back with more than its weight."""
    weight = HANDS["pen"].scene().model.body("Object").mass.item() * 9.81
    with HandSimulator(HANDS["pen"], 1) as simulator:
        simulator.record_contacts()
        heaviest = 0.0
        for _ in range(20):
            simulator.step(np.zeros((1, 24)))
            heaviest = max(heaviest, float(simulator.forces.sum()))
    assert heaviest > weight


@pytest.mark.parametrize("task", sorted(HANDS))
def test_every_surface_is_a_geom_that_can_touch(task):
    model = HANDS[task].scene().model
    for surface in HANDS[task].surfaces:
        geom = model.geom(surface.geom)
        assert geom.contype.item() or geom.conaffinity.item(), surface.geom
