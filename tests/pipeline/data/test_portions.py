"""Rows of portions are the rows of the trajectories that the portions cut."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from pipeline.data.portions import PortionRows
from pipeline.data.rows import ROW_KEYS, TransitionRows
from tests.pipeline.toys import built, tiny_config, trajectory

GAMMA = 0.5  # exact in float32, like the rewards


def by_hand(steps: TensorDict, n_step: int) -> list[tuple]:
    """The rows of a trajectory [T] that are known by its end: one loop over the definition."""
    rewards = steps["next", "reward"].flatten().tolist()
    done, terminated = (steps["next", k].flatten().tolist() for k in ("done", "terminated"))
    rows = []
    for t in range(len(rewards)):
        total, ahead = 0.0, 0
        while ahead < n_step and t + ahead < len(rewards):
            total += GAMMA**ahead * rewards[t + ahead]
            ahead += 1
            if done[t + ahead - 1]:
                break
        last = t + ahead - 1
        if ahead == n_step or done[last]:
            start, end = steps["observation"][t].item(), steps["next", "observation"][last].item()
            rows.append((start, end, total, ahead, terminated[last]))
    return rows


def entries(rows: TensorDict) -> list[tuple]:
    keys = ("observation", ("next", "observation"), ("next", "reward"), "steps_to_next_obs")
    columns = [rows[key].flatten().tolist() for key in (*keys, ("next", "terminated"))]
    return list(zip(*columns, strict=True))


@st.composite
def collected(draw: st.DrawFn) -> TensorDict:
    """[N, T] of whole-number rewards, with ends anywhere; observations tell all steps apart."""
    length = draw(st.integers(1, 14))
    copies = []
    for copy in range(draw(st.integers(1, 3))):
        rewards = draw(st.lists(st.integers(-8, 8), min_size=length, max_size=length))
        at = st.sets(st.integers(0, length - 1), max_size=4)
        terminated = draw(at)
        truncated = draw(at) - terminated
        ends = {"terminated": sorted(terminated), "truncated": sorted(truncated)}
        copies.append(trajectory([float(r) for r in rewards], tag=100.0 * copy, **ends))
    return torch.stack(copies)


@settings(max_examples=200)
@given(data=st.data(), whole=collected(), n_step=st.integers(1, 6), save=st.booleans())
def test_any_portions_give_the_rows_of_the_whole(
    data: st.DataObject, whole: TensorDict, n_step: int, save: bool
):
    """Each row once, in the order of time; also where what waits goes through a checkpoint."""
    length = whole.shape[1]
    cuts = sorted(data.draw(st.sets(st.integers(1, length), max_size=length)))
    to_rows = TransitionRows(GAMMA, n_step)
    portions = PortionRows(to_rows)
    found = []
    for start, end in zip([0, *cuts], [*cuts, length], strict=True):
        if start == end:
            continue
        found += entries(portions(whole[:, start:end]))
        if save:
            saved, portions = portions.state_dict(), PortionRows(to_rows)
            portions.load_state_dict(saved)
    for copy in range(whole.shape[0]):
        own = [row for row in found if 100 * copy <= row[0] < 100 * copy + 50]
        assert own == by_hand(whole[copy], n_step)


def test_three_step_rows_of_portions_of_one_step():
    """Rewards 1 2 4 | 8 16 32 64 at discount 1/2, an episode ends after the third."""
    steps = trajectory([1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0], truncated=[2]).unsqueeze(0)
    portions = PortionRows(TransitionRows(GAMMA, n_step=3))
    found = [entries(portions(steps[:, t : t + 1])) for t in range(7)]
    # 1 + 2/2 + 4/4; 2 + 4/2; 4, all known with the third; 8 + 16/2 + 32/4; 16 + 32/2 + 64/4.
    ended = [(0, 3, 3, 3, False), (1, 3, 4, 2, False), (2, 3, 4, 1, False)]
    assert found == [[], [], ended, [], [], [(3, 6, 24, 3, False)], [(4, 7, 48, 3, False)]]


def test_one_step_rows_are_those_of_the_portion():
    steps = torch.stack([trajectory([1.0, 2.0], tag=t, truncated=[0]) for t in (0.0, 10.0)])
    to_rows = TransitionRows(
        0.9, bonus=lambda after: torch.ones_like(after["reward"]), reward_scale=0.3
    )
    found, expected = PortionRows(to_rows)(steps), to_rows(steps)
    assert set(found.keys(True, True)) == set(ROW_KEYS)
    assert (found == expected).all()
    assert PortionRows(to_rows).state_dict() == {}


@pytest.mark.parametrize("n_step", [2, 5])
def test_what_waits_does_not_change_with_the_batch_it_came_from(n_step: int):
    """A collector writes its next batch over the last one."""
    steps = trajectory([1.0, 2.0, 4.0, 8.0, 16.0, 32.0]).unsqueeze(0)
    portions = PortionRows(TransitionRows(GAMMA, n_step))
    first = steps[:, :3].clone()
    found = entries(portions(first))
    first.zero_()
    found += entries(portions(steps[:, 3:]))
    assert found == by_hand(steps[0], n_step)


FRAME_BY_FRAME = (
    "env.num_envs=1",
    "env.horizon=50",
    "collector.frames_per_batch=1",
    "collector.total_frames=30",
    "optim.updates_per_frame=1",
    "sampler.batch_size=4",
    "evaluation.interval=0",
    "loss.n_step=5",
)


def test_a_run_that_collects_frame_by_frame_stores_rows_of_all_their_steps(
    tmp_path: Path, demos: Path
):
    """As the preset `paper` does; of 30 frames in one episode, the last four still wait."""
    config = tiny_config("sac", tmp_path, demos, *FRAME_BY_FRAME, "collector.random_frames=10")
    run = built(config)
    run.train()
    rows = run.trainer._modules["main_buffer"][:]
    assert rows["steps_to_next_obs"].flatten().tolist() == [5] * 26


def test_an_update_before_the_first_row_is_named(tmp_path: Path, demos: Path):
    config = tiny_config("sac", tmp_path, demos, *FRAME_BY_FRAME, "collector.random_frames=4")
    with pytest.raises(ValueError, match=r"loss\.n_step \(5\).*after 4: set collector\.random_fr"):
        built(config)


def test_a_buffer_that_cannot_hold_what_comes_at_once_is_named(tmp_path: Path, demos: Path):
    """Portions of 20 frames of two copies, and four rows that wait in each."""
    options = ("loss.n_step=5", "sampler.capacity=27")
    with pytest.raises(ValueError, match=r"sampler\.capacity \(27\) .* 28: collector\.frames_per"):
        built(tiny_config("sac", tmp_path, demos, *options))


def test_chunks_are_those_of_the_uncut_trajectory():
    """Portions of one step: what waits for its chunk comes with the last action of it."""
    steps = trajectory([1.0, 2.0, 4.0, 8.0, 16.0], terminated=[2])[None]
    steps["action"] = torch.arange(5.0)[None, :, None]
    to_rows = TransitionRows(GAMMA, n_step=2, chunk=2)
    portions = PortionRows(to_rows)
    found = torch.cat([portions(steps[:, t : t + 1]) for t in range(5)])
    assert (found == to_rows(steps)).all()
    assert found["action"].tolist() == [[0, 1], [1, 2], [3, 4]]
