"""Who is filmed: the policy of a run, or demonstrations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, Self

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from envs import Task
from envs.demonstrations import DemoOptions, Episode, load_demonstrations
from envs.pictures import RGB, Picture, Render
from pipeline.act.evaluation import Acting, reset_td
from pipeline.files.run_files import CONFIG
from pipeline.film.takes import Moment, Studio
from pipeline.playing import make_evaluator
from pipeline.policy import load_policy
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe

DEMOS: Final = "demos"
"""After ``WITH=``: the run's own demonstrations."""


@dataclass(frozen=True)
class LoadedRun:
    """A run directory, its recipe and its task."""

    path: Path
    recipe: Recipe
    task: Task

    @classmethod
    def of(cls, path: Path, overrides: Sequence[str] = ()) -> Self:
        """Reads it.

        Raises:
            RunDirectoryError: It is none.
        """
        recipe = load_recipe(path, overrides)
        return cls(path, recipe, recipe.find_task())

    @property
    def name(self) -> str:
        """Of the folder, with the one above where it is a seed's: ``best/seed0``."""
        parts = self.path.resolve().parts
        return "/".join(parts[-2:] if parts[-1].startswith("seed") else parts[-1:])


class Performer(Protocol):
    """Plays episodes in front of a camera."""

    def play(self, number: int) -> tuple[str, Iterator[Moment]]:
        """What episode ``number`` of the task's list is called, and the episode."""
        ...


Opens = Callable[[Picture, int], AbstractContextManager[Performer]]
"""Makes environment and camera, of so many control steps between two pictures."""


def performer(given: str | Path, run: LoadedRun, overrides: Sequence[str] = ()) -> Opens:
    """Who stands beside ``run``.

    Args:
        given: a run directory; ``demos``, the run's own; or another source of demonstrations
            (``bundled``, a path, ``minari:ID``).
        run: beside which.
        overrides: of the task, for another run.

    Raises:
        ValueError: the other run is of another task.
    """
    if str(given) == DEMOS:
        return DemonstrationPerformer.opener(run, run.recipe.demos.source)
    if not (Path(given) / CONFIG).is_file():
        return DemonstrationPerformer.opener(run, str(given))
    of_task = [text for text in overrides if text.lstrip("+").startswith("task.")]
    other = LoadedRun.of(Path(given), of_task)
    if other.task.name != run.task.name:
        raise ValueError(
            f"WITH={given} is of task {other.task.name} and {run.path} of {run.task.name}: they "
            "cannot stand beside each other"
        )
    return PolicyPerformer.opener(other)


@dataclass(frozen=True)
class PolicyPerformer:
    """A policy, as it is evaluated, in episodes of its task's list."""

    run: LoadedRun
    studio: Studio
    acting: Acting

    @classmethod
    def opener(cls, run: LoadedRun) -> Opens:
        """Opens the camera first: what it lacks is told before a policy is read."""

        @contextmanager
        def opened(picture: Picture, every: int) -> Iterator[Performer]:
            with studio(run, run.recipe.env.horizon, picture, every) as ready:
                policy, _ = load_policy(run.recipe, run.task, run.path)
                evaluator = make_evaluator(run.recipe, run.task, episodes=1)
                with evaluator.acting(policy) as acting:
                    yield cls(run, ready, acting)

        return opened

    def play(self, number: int) -> tuple[str, Iterator[Moment]]:
        """Episode ``number``, as ``make eval`` plays it."""
        env, recipe = self.studio.env, self.run.recipe
        begun = env.reset(reset_td(self.run.task, env, recipe.evaluation.seed, number))
        title = f"{self.run.name}, episode {number}"
        return title, self.studio.play(begun, self.acting(number, 1))


@dataclass(frozen=True)
class DemonstrationPerformer:
    """Demonstrations, their actions played again from where they begin."""

    run: LoadedRun
    studio: Studio
    source: str
    episodes: tuple[Episode, ...]

    @classmethod
    def opener(cls, run: LoadedRun, source: str) -> Opens:
        """Loads them as ``make demos-check`` does."""

        @contextmanager
        def opened(picture: Picture, every: int) -> Iterator[Performer]:
            render: Render = run.task.require("render", "make video")
            if render.begin is None:
                raise ValueError(
                    f"WITH={source}: task {run.task.name} cannot begin recorded episodes; leave it "
                    "out, or give its `render` a `begin` (see envs/pictures.py)"
                )
            options = DemoOptions(resimulate=run.task.resimulate is not None)
            loaded = load_demonstrations(source, run.task, options)
            longest = max(episode.length for episode in loaded.episodes)
            with studio(run, longest, picture, every) as ready, torch.no_grad():
                yield cls(run, ready, loaded.source, loaded.episodes)

        return opened

    def play(self, number: int) -> tuple[str, Iterator[Moment]]:
        """The demonstration that begins nearest to episode ``number`` of the list."""
        render = self.run.task.render
        assert render is not None
        assert render.begin is not None
        chosen = nearest(number, self.episodes, self._start(number))
        episode = self.episodes[chosen]
        begun = render.begin(self.studio.env, episode)
        actions = iter(torch.as_tensor(episode.played_actions).clamp(-1.0, 1.0))

        def act(td: TensorDictBase) -> TensorDictBase:
            return td.set("action", next(actions)[None].to(td.device))

        title = f"{self.source}, demonstration {chosen}"
        return title, self.studio.play(begun, act, episode.length)

    def _start(self, number: int) -> dict[str, NDArray[Any]]:
        """Where the episode of the list begins; a seed says nothing of where."""
        if self.run.task.starts is None:
            return {}
        listed = self.run.task.starts(self.run.recipe.evaluation.seed, number, 1)
        return {
            str(key): value[0].cpu().numpy().reshape(-1)
            for key, value in listed.items()
            if value.is_floating_point()
        }


def nearest(number: int, episodes: Sequence[Episode], start: dict[str, NDArray[Any]]) -> int:
    """Index of the episode that begins nearest to ``start``.

    Distances are in standard deviations of the episodes' starts. Where nothing tells where both
    begin it is the episode of that number, counted round.

    Args:
        number: of the episode beside which it stands.
        episodes: to choose from.
        start: vectors by name.
    """
    told = [key for key in start if all(key in episode.start for episode in episodes)]
    if not told:
        return number % len(episodes)
    wanted = np.concatenate([start[key] for key in told])
    found = np.stack([np.concatenate([e.start[key] for key in told]) for e in episodes])
    spread = found.std(axis=0)
    away = (found - wanted) / np.where(spread > 0, spread, 1.0)
    return int(np.argmin((away**2).sum(axis=1)))


@contextmanager
def studio(run: LoadedRun, horizon: int | None, picture: Picture, every: int) -> Iterator[Studio]:
    """One copy of the run's task, and a camera.

    Raises:
        MissingCapabilityError: If the task cannot be filmed.
        RenderingUnavailableError: If there is nothing to render with.
    """
    render: Render = run.task.require("render", "make video")
    told = run.task.strategies is not None
    options = run.recipe.env_options(horizon=horizon, workers=0, render_mode=RGB, strategies=told)
    env = run.task.make_env(options)
    try:
        with render.open(env, picture) as renderer:
            yield Studio(run.task, env, renderer, every)
    finally:
        env.close()
