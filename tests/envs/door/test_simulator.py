from __future__ import annotations

import numpy as np
import pytest

from envs.adroit.simulator import HandSimulator, PhysicsDivergedError
from envs.door import task
from envs.door.hand import DOOR, DOOR_POSITION
from tests.envs.door.conftest import door_position

POSITION = np.array([-0.25, 0.3, 0.3])
PLACED = {DOOR_POSITION: POSITION[None]}


def doors(count: int, seed: int = 0):
    return np.array([door_position(seed, door, 0) for door in range(count)])


def held_actions(rng, steps: int, count: int, hold: int = 10):
    """Actions that go beyond [-1, 1] and are held, so that hands reach the door."""
    return rng.uniform(-1.3, 1.3, (steps // hold + 1, count, 28)).repeat(hold, axis=0)[:steps]


def play(simulator: HandSimulator, actions):
    return np.stack([simulator.step(action) for action in actions])


def test_equals_dm_control_physics_exactly(reference_door, rng):
    count = 3
    positions, actions = doors(count), held_actions(rng, 60, count)
    with HandSimulator(DOOR, count, num_threads=2) as simulator:
        first = simulator.start({DOOR_POSITION: positions})
        observations = play(simulator, actions)
        qpos, qvel = simulator.qpos, simulator.qvel
    contacts = 0
    for door in range(count):
        np.testing.assert_array_equal(
            first[door], reference_door.reset(positions[door]).astype(np.float32)
        )
        for step in range(len(actions)):
            expected = reference_door.step(actions[step, door])
            np.testing.assert_array_equal(observations[step, door], expected.astype(np.float32))
            contacts += reference_door.physics.data.ncon
        # In float64, not only after rounding.
        np.testing.assert_array_equal(qpos[door], reference_door.physics.data.qpos)
        np.testing.assert_array_equal(qvel[door], reference_door.physics.data.qvel)
    assert contacts > 0


def test_starts_in_motion_as_dm_control_does(reference_door, one_door, rng):
    qpos, qvel = rng.uniform(-0.3, 0.3, 30), rng.uniform(-1, 1, 30)
    first = one_door.start(PLACED, qpos=qpos[None], qvel=qvel[None])[0]
    expected = reference_door.reset(POSITION, qpos, qvel)
    np.testing.assert_array_equal(first, expected.astype(np.float32))
    for action in held_actions(rng, 20, 1):
        expected = reference_door.step(action[0])
        np.testing.assert_array_equal(one_door.step(action)[0], expected.astype(np.float32))


def test_observation_layout(one_door):
    """Every entry where `task` says it is: identifiable joint angles."""
    qpos = np.arange(30)[None] / 100
    observation = one_door.start(PLACED, qpos=qpos)[0]
    np.testing.assert_allclose(observation[task.HAND_QPOS], np.arange(1, 28) / 100, rtol=1e-6)
    assert observation[task.HINGE] == np.float32(0.28)
    assert observation[task.LATCH] == np.float32(0.29)
    np.testing.assert_allclose(
        observation[task.PALM] - observation[task.HANDLE],
        observation[task.PALM_TO_HANDLE],
        atol=1e-7,
    )


def test_moving_the_door_moves_the_handle_and_not_the_palm(one_door):
    before = one_door.start(PLACED)[0]
    after = one_door.start({DOOR_POSITION: POSITION[None] + [[0.02, -0.03, 0.04]]})[0]
    moved = after[task.HANDLE] - before[task.HANDLE]
    np.testing.assert_allclose(moved, [0.02, -0.03, 0.04], atol=1e-6)
    np.testing.assert_array_equal(after[task.PALM], before[task.PALM])


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_trajectories_do_not_depend_on_threads_or_neighbours(threads, rng):
    positions, actions = doors(5), held_actions(rng, 25, 5)
    with HandSimulator(DOOR, 5, num_threads=threads) as simulator:
        simulator.start({DOOR_POSITION: positions})
        together = play(simulator, actions)
    with HandSimulator(DOOR, 1) as alone:
        for door in range(5):
            alone.start({DOOR_POSITION: positions[[door]]})
            np.testing.assert_array_equal(play(alone, actions[:, [door]])[:, 0], together[:, door])


def test_unmasked_doors_stand_still(rng):
    action, mask = rng.uniform(-1, 1, (4, 28)), np.array([True, False, True, False])
    with HandSimulator(DOOR, 4) as simulator:
        before = simulator.start({DOOR_POSITION: doors(4)})
        state = simulator.get_state()["physics"]
        after = simulator.step(action, mask=mask)
        moved = (simulator.get_state()["physics"] != state).any(axis=1)
    np.testing.assert_array_equal(moved, mask)
    np.testing.assert_array_equal((after != before).any(axis=1), mask)


def test_reset_of_some_doors_leaves_the_others(rng):
    with HandSimulator(DOOR, 4) as simulator:
        fresh = simulator.start({DOOR_POSITION: doors(4)})
        play(simulator, held_actions(rng, 5, 4))
        running, positions = simulator.observation(), simulator.placement[DOOR_POSITION]
        returned = simulator.start({DOOR_POSITION: doors(4)[[3, 1]]}, indices=[3, 1])
        observation = simulator.observation()
    np.testing.assert_array_equal(returned, fresh[[3, 1]])
    np.testing.assert_array_equal(observation[[1, 3]], fresh[[1, 3]])
    np.testing.assert_array_equal(observation[[0, 2]], running[[0, 2]])
    np.testing.assert_array_equal(positions, simulator.placement[DOOR_POSITION])


def test_reset_forgets_everything(one_door, rng):
    actions = held_actions(rng, 20, 1)
    one_door.start(PLACED)
    first = play(one_door, actions)
    one_door.start({DOOR_POSITION: POSITION[None] + 0.01})
    play(one_door, -actions)
    one_door.start(PLACED)
    np.testing.assert_array_equal(play(one_door, actions), first)


def test_observations_share_no_memory(one_door):
    kept = one_door.start(PLACED)
    copy = kept.copy()
    later = one_door.step(np.ones((1, 28)))
    np.testing.assert_array_equal(kept, copy)
    assert not np.shares_memory(later, one_door.observation())


def test_actions_are_clipped(one_door):
    one_door.start(PLACED)
    wild = one_door.step(np.full((1, 28), 5.0))
    one_door.start(PLACED)
    np.testing.assert_array_equal(wild, one_door.step(np.ones((1, 28))))


def test_state_continues_bit_for_bit(rng):
    before, after = held_actions(rng, 40, 2), held_actions(rng, 40, 2)
    with HandSimulator(DOOR, 2) as simulator, HandSimulator(DOOR, 2, num_threads=1) as other:
        simulator.start({DOOR_POSITION: doors(2)})
        play(simulator, before)
        state, at_state = simulator.get_state(), simulator.observation()
        expected = play(simulator, after)
        other.start({DOOR_POSITION: doors(2, seed=5)})
        play(other, after)
        other.set_state(state)
        np.testing.assert_array_equal(other.observation(), at_state)
        np.testing.assert_array_equal(play(other, after), expected)
        np.testing.assert_array_equal(
            other.get_state()["physics"], simulator.get_state()["physics"]
        )


def test_divergence_names_the_door_and_is_not_hidden():
    qvel = np.zeros((3, 30))
    qvel[1, 0] = 1e9
    with HandSimulator(DOOR, 3) as simulator:
        simulator.start({DOOR_POSITION: doors(3)}, qvel=qvel)
        with pytest.raises(PhysicsDivergedError, match=r"doors \[1\].*reset them") as caught:
            simulator.step(np.zeros((3, 28)))
        assert caught.value.indices == (1,)
        # MuJoCo's own answer, putting the door back to its start pose unasked, is switched off.
        broken = ~(np.abs(simulator.qpos) < 1e6).all(axis=1)
        np.testing.assert_array_equal(broken, [False, True, False])
        # The door is usable again after a reset.
        simulator.start({DOOR_POSITION: doors(3)[[1]]}, indices=[1])
        assert np.isfinite(simulator.step(np.zeros((3, 28)))).all()


def test_a_diverged_door_leaves_no_trace_in_its_neighbours(rng):
    """All doors pass through the same MuJoCo data, one after the other."""
    qvel, actions = np.zeros((3, 30)), held_actions(rng, 20, 3)
    with HandSimulator(DOOR, 3, num_threads=1) as simulator:
        simulator.start({DOOR_POSITION: doors(3)})
        expected = play(simulator, actions)
        qvel[1, 0] = 1e9
        simulator.start({DOOR_POSITION: doors(3)}, qvel=qvel)
        for step, action in enumerate(actions):
            with pytest.raises(PhysicsDivergedError, match=r"doors \[1\]"):
                simulator.step(action)
            observation = simulator.observation()
            np.testing.assert_array_equal(observation[[0, 2]], expected[step, [0, 2]])


@pytest.mark.parametrize("number", ["qpos", "qvel"])
@pytest.mark.parametrize("index", [0, 29])
def test_a_start_beyond_what_mujoco_handles_is_refused(one_door, number, index):
    start = np.zeros((1, 30))
    start[0, index] = 1e11
    with pytest.raises(PhysicsDivergedError, match=r"doors \[0\]"):
        one_door.start(PLACED, **{number: start})


def test_data_is_an_up_to_date_copy(rng):
    with HandSimulator(DOOR, 2) as simulator:
        simulator.start({DOOR_POSITION: doors(2)})
        play(simulator, held_actions(rng, 20, 2))
        observation = simulator.observation()
        for door in range(2):
            data = simulator.data(door)
            np.testing.assert_array_equal(data.qpos, simulator.qpos[door])
            np.testing.assert_array_equal(
                np.float32(data.site("S_handle").xpos), observation[door, task.HANDLE]
            )
            # As it is drawn, not only where its sites are.
            stands = simulator.placement[DOOR_POSITION][door]
            np.testing.assert_array_equal(data.body("frame").xpos, stands)
            data.qpos[:] = 7.0
        np.testing.assert_array_equal(simulator.observation(), observation)
        assert (simulator.qpos != 7.0).all()


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda s: s.step(np.zeros(28)), ValueError, r"action must have shape \(1, 28\)"),
        (lambda s: s.step(np.full((1, 28), np.nan)), ValueError, "action holds NaN"),
        (lambda s: s.step(np.zeros((1, 28)), mask=np.ones(2, bool)), ValueError, "mask must"),
        (lambda s: s.step(np.zeros((1, 28)), mask=np.ones(1)), ValueError, "mask must be bool"),
        (lambda s: s.start({DOOR_POSITION: POSITION}), ValueError, r"door_position .* \(1, 3\)"),
        (lambda s: s.start(PLACED, indices=[1]), IndexError, r"\[1\] are not all in \[0, 1\)"),
        (lambda s: s.start(PLACED, indices=[-1]), IndexError, "not all in"),
        (lambda s: s.start(PLACED, qpos=np.zeros((1, 3))), ValueError, "qpos must have shape"),
        (lambda s: s.set_state({"physics": np.zeros((1, 3))}), ValueError, "state"),
        (lambda s: HandSimulator(DOOR, 0), ValueError, "num_copies"),
        (lambda s: HandSimulator(DOOR, 1, num_threads=0), ValueError, "num_threads"),
    ],
)
def test_bad_input(one_door, call, error, message):
    with pytest.raises(error, match=message):
        call(one_door)


def test_start_positions_lie_in_the_box_and_differ():
    positions = np.array([door_position(0, door, k) for door in range(40) for k in range(5)])
    assert (positions >= task.DOOR_POSITION_LOW).all()
    assert (positions <= task.DOOR_POSITION_HIGH).all()
    # The box is filled: its corners are approached in every direction.
    width = np.subtract(task.DOOR_POSITION_HIGH, task.DOOR_POSITION_LOW)
    assert (np.ptp(positions, axis=0) > 0.9 * width).all()
    assert len(np.unique(positions, axis=0)) == 200


def test_start_positions_refuse_negative_numbers():
    with pytest.raises(ValueError, match=">= 0"):
        door_position(0, -1, 0)
