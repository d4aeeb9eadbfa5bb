"""What a task is to the rest of the project: an environment, and whatever else it can offer.

A task is one room: a folder or a file that defines one :class:`Task`. Training, evaluation and
reports ask it for capabilities and never for its name. Only ``name`` and ``make_env`` are
required; with them SAC trains. What a capability is missing for says so through
:meth:`Task.require`.

Columns. Beside TorchRL's own keys an environment may write, with every observation,

* ``success`` [N, 1] bool: whether the task is accomplished *now*;
* ``progress`` [N, 1] float: how far it is, in a unit of the task's own (the door: its angle in
  rad),

and demonstrations carry the same two. Success rates, early ends of training episodes, admission to
the demonstrations and backtracking read ``success``; rewards for progress, the emphasis of
demonstrated steps and bounds on episodes read ``progress``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Protocol

from numpy.typing import NDArray

from envs.disturbing import Disturb
from envs.motion import Motion
from envs.options import EnvOptions
from envs.pictures import Render
from envs.reference import Reference
from envs.strategies import Strategies

if TYPE_CHECKING:  # tables and messages ask about tasks without tensors
    from tensordict import TensorDict, TensorDictBase
    from torch import Tensor
    from torchrl.envs import EnvBase

    # At run time they import this module.
    from envs.demonstrations.episode import Episode
    from envs.demonstrations.schema import DemoSchema
    from envs.demonstrations.variation import Variation

SUCCESS: Final = "success"
PROGRESS: Final = "progress"


@dataclass(frozen=True)
class Stage:
    """A landmark of an episode; tasks list theirs in the order in which they are passed.

    Attributes:
        label: short, for tables and plots: ``reached``, ``> 1.35 rad``.
        reached: maps what an environment writes after a step (``observation`` [..., O],
            ``success``, ``progress``) to bool [...].
    """

    label: str
    reached: Callable[[TensorDictBase], Tensor]


class Starts(Protocol):
    """The fixed, numbered list of episodes that evaluations use."""

    def __call__(self, seed: int, first: int, count: int) -> TensorDict:
        """What to reset ``count`` copies with for the episodes ``first``, ``first + 1``, ...

        Args:
            seed: of the list.
            first: number of the first episode, from 0.
            count: how many; the result has batch size [count].
        """
        ...


class Resimulate(Protocol):
    """Replays recorded episodes from their starts: the states and rewards a policy will see."""

    def __call__(
        self, episodes: Sequence[Episode], *, num_threads: int | None = None
    ) -> list[Episode]:
        """The episodes as this task plays their actions, in the same order.

        Raises:
            DemonstrationError: an episode cannot be replayed.
        """
        ...


class States(Protocol):
    """Says how to begin an episode anywhere in demonstrations."""

    def __call__(
        self, episodes: Sequence[Episode], *, num_threads: int | None = None
    ) -> list[TensorDict]:
        """What to reset a copy with to begin at each observation of each episode, [T + 1].

        Raises:
            DemonstrationError: an episode does not lead where its observations say.
        """
        ...


class Summary(Protocol):
    """Figures of a task's own that an evaluation reports besides those of every task."""

    def __call__(
        self,
        progress: NDArray[Any] | None,
        returns: NDArray[Any],
        lengths: NDArray[Any],
        stages: Mapping[str, NDArray[Any]],
    ) -> Mapping[str, Any]:
        """Figures by name.

        Args:
            progress: [E, T] after each step, NaN behind an episode's end.
            returns: undiscounted, [E].
            lengths: control steps, [E].
            stages: whether each episode ever reached each stage, bool [E] by label.
        """
        ...


class TaskFailedError(RuntimeError):
    """An environment raised while it was used; one line names the task, the copy and the step."""


class MissingCapabilityError(ValueError):
    """Something asks for what a task does not offer; the message names the key and the remedy."""


@dataclass(frozen=True)
class Task:
    """One task and what it can do.

    Attributes:
        name: as it is written after ``TASK=``.
        make_env: a batched environment [N] with a flat float32 ``observation`` [N, O], an
            ``action`` [N, A] in [-1, 1], ``reward`` [N, 1], ``terminated`` apart from
            ``truncated`` (time limits truncate), and the columns of this module that the task has.
        stages: landmarks of an episode in their order.
        starts: the numbered list of evaluation episodes. Without it, an evaluation's episodes
            depend on how many are stepped together.
        demos: what demonstrations of this task look like; without it there are none.
        resimulate: replays recorded episodes.
        states: begins episodes anywhere in demonstrations.
        vary: draws and plays variations of demonstrations, to multiply them.
        render: films.
        summary: figures of its own in ``evaluation.json``.
        motion: where its moving parts stand, for comparisons with people.
        strategies: tells how an episode was done.
        disturb: what of its model and its starts can be disturbed, for tests and training.
        progress_unit: of ``progress``, for messages and plots.
        reference: published rows.
        rewards: that ``make_env`` can be asked for, its own first; none where it has only that.
            ``sparse`` is success - 1 at every step.
        max_copies: of the environment that one evaluation steps together at most; None for any
            number. Copies of a Python environment are slow to make and take memory each.
        defaults: values of configuration keys that suit this task, by the file that they follow
            (``preset/default``, ``variant/best``). The command line overrides them.
    """

    name: str
    make_env: Callable[[EnvOptions], EnvBase]
    stages: tuple[Stage, ...] = ()
    starts: Starts | None = None
    demos: DemoSchema | None = None
    resimulate: Resimulate | None = None
    states: States | None = None
    vary: Variation | None = None
    render: Render | None = None
    summary: Summary | None = None
    motion: Motion | None = None
    strategies: Strategies | None = None
    disturb: Disturb | None = None
    progress_unit: str = ""
    reference: Reference | None = None
    rewards: tuple[str, ...] = ()
    max_copies: int | None = None
    defaults: Mapping[str, Mapping[str, object]] = field(
        default_factory=lambda: MappingProxyType({})
    )

    def require(self, capability: str, key: str) -> Any:
        """The capability, an attribute of this class.

        Args:
            capability: attribute name.
            key: of the configuration (with its value), or the command, that asks for it.

        Raises:
            MissingCapabilityError: the task does not offer it.
        """
        found = getattr(self, capability)
        if found is None:
            raise MissingCapabilityError(
                f"{key} needs a task that {NEEDS[capability]}, and task {self.name} does not: "
                f"leave it out, or give the task its `{capability}` (see envs/task.py)"
            )
        return found

    def copies(self, wanted: int) -> int:
        """How many copies to step together where ``wanted`` were asked for."""
        return wanted if self.max_copies is None else min(wanted, self.max_copies)


NEEDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "starts": "numbers its evaluation episodes",
        "demos": "says what its demonstrations look like",
        "resimulate": "can replay recorded episodes",
        "states": "can begin an episode anywhere in a demonstration",
        "vary": "can vary its demonstrations",
        "render": "can be filmed",
        "summary": "has figures of its own",
        "reference": "has published rows",
        "motion": "says where its moving parts stand",
        "strategies": "tells how its episodes were done",
        "disturb": "says what of it can be disturbed",
    }
)
"""What each capability lets a task do, for messages."""


def has_column(env: EnvBase, column: str) -> bool:
    """Whether ``env`` writes ``success`` or ``progress`` with every observation."""
    return column in env.observation_spec.keys()  # noqa: SIM118 - a spec is not a mapping
