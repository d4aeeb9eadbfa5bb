"""Whole episodes come out of the stream however it is cut into batches."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDictBase

from pipeline.data.episodes import EpisodeAssembler, FinishedEpisode
from tests.pipeline.toys import trajectory


@st.composite
def streams(draw: st.DrawFn) -> tuple[TensorDictBase, list[list[float]], list[int]]:
    """A stream [N, T] of whole and broken-off episodes, the whole ones, and where it is cut."""
    copies, steps = draw(st.integers(1, 3)), draw(st.integers(1, 12))
    pieces, whole = [], []
    for copy in range(copies):
        ends = sorted(draw(st.sets(st.integers(0, steps - 1))))
        stops = draw(st.lists(st.booleans(), min_size=len(ends), max_size=len(ends)))
        pieces.append(
            trajectory(
                [float(100 * copy + t) for t in range(steps)],
                terminated=[e for e, stop in zip(ends, stops, strict=True) if stop],
                truncated=[e for e, stop in zip(ends, stops, strict=True) if not stop],
                tag=100.0 * copy,
            )
        )
        starts = [0, *(end + 1 for end in ends)]
        whole += [
            [float(100 * copy + t) for t in range(start, end + 1)]
            for start, end in zip(starts, ends, strict=False)
        ]
    cuts = sorted(draw(st.sets(st.integers(1, steps), max_size=4)) | {steps})
    return torch.stack(pieces), whole, cuts


def assemble(assembler: EpisodeAssembler, stream: TensorDictBase, cuts: list[int]) -> list:
    starts = [0, *cuts]
    return [
        episode
        for start, stop in zip(starts, cuts, strict=False)
        for episode in assembler(stream[:, start:stop])
    ]


def seen(episodes: list[FinishedEpisode]) -> list[list[float]]:
    return sorted(episode.trajectory["observation"].squeeze(-1).tolist() for episode in episodes)


@settings(max_examples=60)
@given(streams())
def test_cutting_the_stream_elsewhere_changes_no_episode(stream):
    steps, whole, cuts = stream
    episodes = assemble(EpisodeAssembler(), steps, cuts)
    assert seen(episodes) == sorted(whole)
    assert all(
        episode.episode_return == pytest.approx(episode.trajectory["next", "reward"].sum().item())
        and episode.length == len(episode.trajectory["observation"])
        and episode.trajectory["next", "done"].sum() == 1
        for episode in episodes
    )


@settings(max_examples=30)
@given(streams(), st.data())
def test_an_assembler_goes_on_from_its_state(stream, data: st.DataObject):
    steps, whole, cuts = stream
    at = data.draw(st.integers(0, len(cuts) - 1))
    before = EpisodeAssembler()
    episodes = assemble(before, steps, cuts[:at])
    after = EpisodeAssembler()
    after.load_state_dict(before.state_dict())
    rest = [cut - ([0, *cuts][at]) for cut in cuts[at:]]
    episodes += assemble(after, steps[:, [0, *cuts][at] :], rest)
    assert seen(episodes) == sorted(whole)


def test_what_is_restored_goes_to_the_device_of_the_batches():
    before, after = EpisodeAssembler(), EpisodeAssembler("meta")
    before(trajectory([0.0, 1.0]).unsqueeze(0))
    after.load_state_dict(before.state_dict())
    (pieces,) = after._open.values()
    assert all(piece["action"].device.type == "meta" for piece in pieces)


def test_return_and_largest_angle():
    steps = trajectory([1.0, -2.0, 4.5], truncated=[2])
    steps["next", "progress"] = torch.tensor([[0.1], [1.4], [0.7]])
    (episode,) = EpisodeAssembler()(steps.unsqueeze(0))
    assert episode.episode_return == 3.5
    assert episode.max_progress == pytest.approx(1.4)
    assert episode.length == 3


def test_a_task_without_a_hinge_has_no_angle():
    episode = FinishedEpisode.from_trajectory(trajectory([1.0], truncated=[0]))
    assert math.isnan(episode.max_progress)
