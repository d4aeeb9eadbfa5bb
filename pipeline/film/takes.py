"""An episode as it is played in front of a camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from envs import Task
from envs.pictures import Render, Renderer
from envs.task import PROGRESS, SUCCESS
from pipeline.finite import require_finite_step


@dataclass(frozen=True)
class Moment:
    """A picture and what is known of the episode then.

    Attributes:
        picture: uint8 [height, width, 3].
        step: control steps so far.
        seconds: of the task's own time so far.
        reward: of the last step; 0 before the first.
        return_: undiscounted, so far.
        progress: in the task's unit; None where it tells none.
        success: whether the task is accomplished now; None likewise.
        stage: the last of the task's stages that the episode has ever reached; empty before.
        notes: further lines, of `Task.strategies` and of `Render.notes`.
    """

    picture: NDArray[Any]
    step: int
    seconds: float
    reward: float
    return_: float
    progress: float | None
    success: bool | None
    stage: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Studio:
    """One copy of a task's environment and the camera in front of it.

    Attributes:
        task: which.
        env: one copy.
        renderer: of it.
        every: control steps between two pictures.
    """

    task: Task
    env: EnvBase
    renderer: Renderer
    every: int

    def play(
        self,
        begun: TensorDictBase,
        act: Callable[[TensorDictBase], TensorDictBase],
        steps: int | None = None,
    ) -> Iterator[Moment]:
        """An episode: its start, every so many steps, and its end.

        Args:
            begun: what the reset gave.
            act: writes the action.
            steps: after which it ends, if not before.

        Raises:
            NonFiniteError: A number is not finite.
        """
        td, step, reward, return_, passed = begun, 0, 0.0, 0.0, 0
        active = torch.ones(1, 1, dtype=torch.bool, device=td.device)
        ended = steps == 0
        yield self._moment(td, step, reward, return_, passed)
        while not ended:
            td = self.env.step(act(td))
            require_finite_step(td, active)
            after = td["next"]
            step += 1
            reward = float(after["reward"])
            return_ += reward
            passed = max(passed, self._passed(after))
            ended = bool(after["done"].any()) or step == steps
            td = self.env.step_mdp(td)
            if step % self.every == 0 or ended:
                yield self._moment(td, step, reward, return_, passed)

    def _passed(self, after: TensorDictBase) -> int:
        """How many stages have been passed, by the last one that holds now."""
        held = [i for i, stage in enumerate(self.task.stages, 1) if bool(stage.reached(after))]
        return max(held, default=0)

    def _moment(
        self, td: TensorDictBase, step: int, reward: float, return_: float, passed: int
    ) -> Moment:
        render = self.task.render
        assert render is not None
        progress, success = td.get(PROGRESS, None), td.get(SUCCESS, None)
        return Moment(
            picture=self.renderer.render(0),
            step=step,
            seconds=step / render.steps_per_second,
            reward=reward,
            return_=return_,
            progress=None if progress is None else float(progress),
            success=None if success is None else bool(success),
            stage=self.task.stages[passed - 1].label if passed else "",
            notes=(
                *self._now(td),
                *(() if render.notes is None else render.notes(td)),
            ),
        )

    def _now(self, td: TensorDictBase) -> Iterator[str]:
        """What the task tells its strategies from; nothing where the environment writes none."""
        strategies = self.task.strategies
        if strategies is not None and all(column in td for column in strategies.columns):
            yield strategies.now(td)


def stride(render: Render, pictures_per_second: float) -> int:
    """Control steps between two pictures, so that a film runs in real time.

    Args:
        render: of the task.
        pictures_per_second: at most.
    """
    return max(1, round(render.steps_per_second / pictures_per_second))
