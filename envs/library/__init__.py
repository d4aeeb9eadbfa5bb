"""Anybody's environment, of gymnasium or of the dm_control suite, as a task."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Final

from envs.demonstrations.schema import DemoSchema
from envs.library.copies import Buffers, Copies
from envs.library.files import FORM, offered, resolved
from envs.library.layers import time_limit
from envs.library.pictures import render_of
from envs.library.probe import SEARCHED, Probed, probe, truncates_after
from envs.library.resimulation import Resimulation
from envs.library.single import SingleEnv
from envs.library.starts import SEED, seeds
from envs.library.vector_env import VectorEnv
from envs.library.workers import Workers
from envs.options import EnvOptions, TaskOptions
from envs.task import Task

_logger = logging.getLogger(__name__)

MAX_COPIES: Final = 8
"""Copies that an evaluation makes at most; more would take their time one after the other."""
WORTH_A_PROCESS_S: Final = 1e-3
"""A step that costs more is taken in worker processes: asking one costs about a tenth of it."""
ENDLESS: Final = 10**9
"""Steps, where something else ends an episode."""
DEFAULTS: Final = MappingProxyType({"preset/default": MappingProxyType({"env.num_envs": 4})})
"""Each copy of a Python environment costs as much as the one before."""


_FOUND: Final[dict[str, Task]] = {}
"""By everything that makes a task what it is: making and trying a copy may take seconds."""


_OWN_LIMITS: Final[dict[str, int | None]] = {}
"""Of environments that truncate by themselves, by the same: the search may take seconds."""


def find(library: str, wanted: str, options: TaskOptions) -> Task:
    """The task ``library:wanted``. One copy is made, tried and closed.

    Raises:
        UnknownTaskError: the library cannot make it.
        ValueError: its spaces, or an option, are not supported.
        TaskFailedError: the environment raised.
    """
    return _of(SingleEnv(library, wanted, options))


def find_file(name: str, options: TaskOptions) -> Task:
    """The task that a file of the user's holds, or makes an environment for.

    Raises:
        ValueError: the file holds none, or an option does not suit it.
        TaskFailedError: the environment raised.
    """
    found = offered(name)
    if not isinstance(found, Task):
        # The working directory may be another when copies are made.
        return _of(SingleEnv("file", resolved(name), options, called=name))
    for key, value in options.given().items():
        raise ValueError(
            f"{key}={value} is for environments, and {name} ({FORM}) holds a Task, which is "
            "complete as it is: leave it out"
        )
    return found


def file_defaults(name: str) -> Mapping[str, Mapping[str, object]]:
    """:attr:`envs.task.Task.defaults` of a file's task; makes no environment."""
    found = offered(name)
    return found.defaults if isinstance(found, Task) else DEFAULTS


def _of(single: SingleEnv) -> Task:
    if repr(single) not in _FOUND:
        _FOUND[repr(single)] = _task(single)
    return _FOUND[repr(single)]


def _task(single: SingleEnv) -> Task:
    found = probe(single)
    make_env = Batched(single, found)
    if found.interface.success is None:
        _logger.warning(
            "task %s tells no success (no info['success'] or info['is_success'] in an episode of "
            "random actions): evaluations have returns only; task.success= can tell it",
            single.name,
        )  # fmt: skip
    # A replay ends with its recording, whatever limit a run sets.
    horizon = ENDLESS if found.limit is None else None
    one = partial(make_env, EnvOptions(seed=0, workers=0, horizon=horizon))
    resimulation = Resimulation(single.name, one, found.start)
    return Task(
        name=single.name,
        make_env=make_env,
        starts=seeds,
        demos=_schema(single.name, found),
        resimulate=resimulation,
        render=render_of(single.name, found, resimulation),
        max_copies=MAX_COPIES,
        defaults=DEFAULTS,
    )


@dataclass(frozen=True)
class Batched:
    """Makes N copies as one environment."""

    single: SingleEnv
    found: Probed

    def __call__(self, options: EnvOptions) -> VectorEnv:
        """The batched environment.

        Raises:
            ValueError: its episodes would never end, or an option cannot be met.
        """
        name, interface = self.single.name, self.found.interface
        self._require_end(options.horizon)
        if options.success_steps is not None and interface.success is None:
            raise ValueError(
                f"env.success_steps={options.success_steps} ends episodes that succeed, and task "
                f"{name} tells no success: say what it is (task.success=...) or leave it out "
                "(env.success_steps=null)"
            )
        make = partial(self.single, options.horizon, options.render_mode)
        workers = self._workers(options)
        copies: Copies | Workers
        if workers:
            copies = Workers(make, options.num_envs, interface.layout, workers)
        else:
            buffers = Buffers.make(options.num_envs, interface.layout)
            copies = Copies(make, buffers, interface.layout)
        return VectorEnv(
            copies,
            interface,
            seed=options.seed,
            success_steps=options.success_steps,
            device=options.device,
        )

    def _require_end(self, horizon: int | None) -> None:
        limit = self.found.limit
        if horizon is None and limit is None and _own_limit(self.single) is None:
            raise ValueError(
                f"task {self.single.name} has no time limit (none was seen in {SEARCHED} steps "
                "of random actions), so an episode may never end: set one (env.horizon=N, in steps)"
            )
        if horizon is None or limit is None or horizon <= limit:
            return
        env = self.single(horizon)
        extended = time_limit(env)
        env.close()
        if extended is not None and extended < horizon:
            raise ValueError(
                f"env.horizon={horizon}: a limit inside of task {self.single.name} ends its "
                f"episodes after {extended} steps and cannot be moved: set env.horizon={extended} "
                "or less"
            )

    def _workers(self, options: EnvOptions) -> int:
        if options.workers is not None:
            return min(options.workers, options.num_envs)
        cores = len(os.sched_getaffinity(0))
        if self.found.step_s < WORTH_A_PROCESS_S or options.num_envs == 1 or cores == 1:
            return 0
        return min(cores, options.num_envs)


def _own_limit(single: SingleEnv) -> int | None:
    if repr(single) not in _OWN_LIMITS:
        _OWN_LIMITS[repr(single)] = limit = truncates_after(single)
        if limit is not None:
            _logger.info("task %s: episodes end after %d steps by themselves", single.name, limit)
    return _OWN_LIMITS[repr(single)]


def _schema(name: str, found: Probed) -> DemoSchema:
    interface = found.interface
    flattener, actions = interface.layout.flattener, interface.actions
    leaves = flattener.leaves
    success, progress = interface.success, interface.progress
    return DemoSchema(
        describes=f"{name} ({flattener.size}-d observations, {actions.size}-d actions)",
        observation_size=flattener.size,
        action_size=actions.size,
        action_low=tuple(actions.low.tolist()),
        action_high=tuple(actions.high.tolist()),
        observation_keys=tuple(leaf.name for leaf in leaves),
        discrete=tuple(leaf for leaf in leaves if leaf.values),
        step_reward=interface.reward,
        start=(SEED, *(() if found.start is None else found.start.keys)),
        success=None if success is None else success.of_observations,
        progress=None if progress is None else progress.of_observations,
        horizon=found.limit,
    )
