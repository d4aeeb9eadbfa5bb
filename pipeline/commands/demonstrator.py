"""Who acts while demonstrations are recorded: a run's policy, or a controller of the user's."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase

from envs import Task
from envs.library.functions import load_function
from envs.task import SUCCESS, has_column
from envs.user_files import split_file, told_at
from pipeline.data.episodes import FinishedEpisode
from pipeline.growth import admission_rule
from pipeline.overrides import recipe_of
from pipeline.policy import load_policy
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe

POLICY: Final = "POLICY"
ROUNDING: Final = 1e-6
"""By which an action may be beyond 1."""


@dataclass(frozen=True)
class Demonstrator:
    """Who acts, where, and which of its episodes are good.

    Attributes:
        name: of the demonstrations' source.
        made_by: the command.
        recipe: of the environment's options.
        task: what is done.
        policy: a new one for each batch of episodes that begin together.
        admits: whether an episode is good.
        admission: that, for people.
        card: what is known of the policy.
    """

    name: str
    made_by: str
    recipe: Recipe
    task: Task
    policy: Callable[[], TensorDictModuleBase]
    admits: Callable[[FinishedEpisode], bool]
    admission: str
    card: dict[str, Any]

    @classmethod
    def of_run(cls, run_dir: Path, overrides: Sequence[str] = ()) -> Self:
        """The mean action of a run's policy; ``growth.admission`` says which episodes are good.

        Raises:
            RunDirectoryError, FileNotFoundError, ValueError: As ``load_recipe``, ``load_policy``.
        """
        recipe = load_recipe(run_dir, overrides)
        task = recipe.find_task()
        policy, origin = load_policy(recipe, task, run_dir)
        card = {
            "variant": recipe.variant,
            "preset": recipe.preset,
            "seed": recipe.seed,
            "checkpoint": origin.name,
            "trained_on": Path(recipe.demos.source).name,
            "multiplied": recipe.demos.multiply.enabled,
        }
        return cls(
            run_dir.name, f"make record RUN={run_dir.name}", recipe, task, lambda: policy,
            admission_rule(recipe).admits, "growth.admission", card,
        )  # fmt: skip

    @classmethod
    def of_controller(cls, where: str, overrides: Sequence[str] = ()) -> Self:
        """A controller of the user's; good are episodes that succeed, or all if none can be told.

        Args:
            where: ``path.py:function`` (:func:`controller`).
            overrides: ``key=value`` of the task and its environment.

        Raises:
            SettingsError: If an override is not possible.
            ValueError: If there is no such function or task.
        """
        recipe = recipe_of(overrides)
        load_function(POLICY, where)  # before the task, which may take seconds to make
        task = recipe.find_task()
        env = task.make_env(recipe.env_options(workers=0))
        actions, tells = env.action_spec.shape[-1], has_column(env, SUCCESS)
        env.close(raise_if_closed=False)
        file = Path(where.rpartition(":")[0]).name
        return cls(
            file,
            f"make record TASK={recipe.task.name} POLICY={where}",
            recipe,
            task,
            controller(where, actions),
            lambda episode: bool(episode.success) or not tells,
            "success" if tells else "every complete episode: the task tells no success",
            {"controller": where},
        )


def controller(where: str, actions: int) -> Callable[[], TensorDictModuleBase]:
    """Makes policies of the function, or class, that ``path.py:function`` names.

    ``function(observation [N, O]) -> action [N, A]`` has flat float32 observations of N copies, as
    policies see them, and gives actions in [-1, 1]. It is given numpy arrays, or tensors if its
    argument is annotated as ``torch.Tensor``, and may return either. A class is made anew, without
    arguments, for every N episodes that begin together; its objects are called as a function is,
    and may remember.

    Args:
        where: path and name.
        actions: A.

    Raises:
        ValueError: If there is none.
    """
    found = load_function(POLICY, where)

    def make() -> TensorDictModuleBase:
        act: Any = found() if inspect.isclass(found) else found
        takes_tensors = _takes_tensors(act)

        def action(observation: torch.Tensor) -> torch.Tensor:
            given = observation.cpu()
            try:
                told = act(given if takes_tensors else given.numpy())
                acted = torch.as_tensor(np.asarray(told), dtype=torch.float32)
            # Whatever a user's function raises is told in one line.
            except Exception as error:
                split = split_file(where)
                assert split is not None
                at = told_at(error, Path(split[0]).resolve())
                raise ValueError(f"{POLICY}={where} raised: {at}") from error
            return _checked(where, acted, (len(observation), actions)).to(observation.device)

        return TensorDictModule(action, ["observation"], ["action"])

    return make


def _takes_tensors(act: Callable[..., Any]) -> bool:
    function = act if inspect.isroutine(act) else type(act).__call__
    try:
        hints = [h for key, h in typing.get_type_hints(function).items() if key != "return"]
    except (NameError, TypeError):  # of something that is not imported at run time
        return False
    return hints[:1] == [torch.Tensor]


def _checked(where: str, action: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
    if action.shape != shape:
        raise ValueError(
            f"{POLICY}={where} gave actions of shape {list(action.shape)}; expected {list(shape)}, "
            "a row for each observation"
        )
    largest = float(action.abs().max())
    if not largest <= 1.0 + ROUNDING:
        raise ValueError(
            f"{POLICY}={where} gave an action entry of magnitude {largest:.4g}; expected [-1, 1]: "
            "the task's own units are scaled to that; clip it"
        )
    return action.clamp(-1.0, 1.0)
