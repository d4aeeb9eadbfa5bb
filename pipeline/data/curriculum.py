"""Episodes begin at states of the demonstrations, from near their ends to their starts."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import tensordict
import torch
from pydantic.dataclasses import dataclass as settings
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.data.episodes import FinishedEpisode
from pipeline.settings import STRICT, Count

AHEAD: Final = (0.5, 0.25, 0.125, 0.0625, 0.0625)
"""Probabilities of beginning 0, 1, ... steps nearer to a demonstration's end than its frontier."""
SOLVED: Final = 1e-6
"""Weight of a demonstration whose frontier is its start, where that of others is the share of it
that lies before the frontier."""


@settings(frozen=True, kw_only=True, config=STRICT)
class CurriculumSettings:
    """Where training episodes begin (RFCL)."""

    reverse: bool = False  # at states of the demonstrations, further from their ends with success
    stride: Count = 8  # control steps by which a frontier moves towards its start
    successes: Count = 3  # episodes in a row, begun at the frontier, after which it moves


class ReverseCurriculum(TrainerHookBase):
    """A frontier in each demonstration, at which and a little behind which episodes begin.

    Source: arXiv:2405.03379, section 4.1, and its published code. A frontier starts at its
    demonstration's last state; after ``successes`` successful episodes in a row that began at it,
    it moves ``stride`` steps towards the first. Once all are there and have succeeded from there
    too, episodes begin as the task's own do.

    Args:
        states: Of each demonstration, what to reset with to begin at its observations [T + 1].
        stride: Control steps.
        successes: Episodes in a row.

    Raises:
        ValueError: If there are no demonstrations.
    """

    def __init__(self, states: Sequence[TensorDictBase], stride: int, successes: int) -> None:
        if not states:
            raise ValueError("curriculum.reverse=true needs demonstrations: set demos.source.")
        self.states = list(states)
        self.stride = stride
        self.lasts = torch.tensor([len(of_one) - 1 for of_one in self.states])
        self.frontiers = self.lasts.clone()
        self.solved = torch.zeros(len(self.states), dtype=torch.bool)
        self.recent: list[deque[bool]] = [deque(maxlen=successes) for _ in self.states]

    @property
    def done(self) -> bool:
        """Whether episodes begin as the task's own do."""
        return bool(self.solved.all())

    def begin(self, count: int) -> tuple[TensorDictBase, Tensor] | None:
        """Draws where ``count`` episodes begin, by torch's generator.

        Returns:
            What to reset with [count], and demonstration and step of each [count, 2]; None once
            the curriculum is done.
        """
        if self.done:
            return None
        weights = (self.frontiers / self.lasts.clamp(min=1)).clamp(min=SOLVED)
        demos = torch.multinomial(weights, count, replacement=True)
        ahead = torch.multinomial(torch.tensor(AHEAD), count, replacement=True)
        steps = torch.minimum(self.frontiers[demos] + ahead, self.lasts[demos])
        at = torch.stack([demos, steps], dim=-1)
        starts = [self.states[demo][step] for demo, step in at.tolist()]
        return tensordict.stack(starts), at

    def learn(self, at: tuple[int, int], success: bool) -> None:
        """Takes an episode that began at a demonstration's step; -1 for one of the task's own."""
        demo, step = at
        if demo < 0 or step != int(self.frontiers[demo]):
            return
        recent = self.recent[demo]
        recent.append(success)
        if sum(recent) < (recent.maxlen or 0):
            return
        recent.clear()
        self.solved[demo] = step == 0
        self.frontiers[demo] = max(step - self.stride, 0)

    def progress(self) -> dict[str, float]:
        """For the learning curve: the share of the demonstrations that lies behind a frontier."""
        behind = 1.0 - self.frontiers / self.lasts.clamp(min=1)
        return {"curriculum": float(behind.mean()), "curriculum_done": float(self.done)}

    def register(self, trainer: Trainer, name: str = "curriculum") -> None:
        """Registers for the checkpoint only; episodes come from ``EpisodeHook``."""
        trainer.register_module(name, self)

    def state_dict(self) -> dict[str, Any]:
        """Frontiers and the last episodes begun at each."""
        return {
            "frontiers": self.frontiers.clone(),
            "solved": self.solved.clone(),
            "recent": [list(recent) for recent in self.recent],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.frontiers, self.solved = state["frontiers"].clone(), state["solved"].clone()
        self.recent = [
            deque(kept, maxlen=recent.maxlen)
            for kept, recent in zip(state["recent"], self.recent, strict=True)
        ]


class CurriculumEpisodes:
    """Tells a curriculum how training episodes ended.

    Args:
        curriculum: What learns from it.
        key: Of the demonstration and step [T, 2] at which an episode began.
    """

    def __init__(self, curriculum: ReverseCurriculum, key: str) -> None:
        self.curriculum = curriculum
        self.key = key

    def __call__(self, episode: FinishedEpisode, frame: int) -> None:
        """Takes one finished training episode."""
        demo, step = episode.trajectory[self.key][0].tolist()
        self.curriculum.learn((demo, step), bool(episode.success))
