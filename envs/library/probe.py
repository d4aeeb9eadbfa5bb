"""What an environment turns out to be, from making one copy and taking a few steps."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from envs.flatten import Flattener, UnsupportedSpaceError
from envs.library import calls
from envs.library.actions import ActionScale, UnsupportedActionsError
from envs.library.copies import Layout
from envs.library.layers import layers, time_limit
from envs.library.own_state import OwnStateError, offers_state
from envs.library.signals import (
    FOUND,
    info_keys,
    progress_signal,
    reward_function,
    success_signal,
)
from envs.library.single import Env, SingleEnv, quiet
from envs.library.starts import StartState, start_state
from envs.library.state import continues_exactly
from envs.library.vector_env import Interface
from envs.one_line import kind_and_text
from envs.options import TaskOptions
from envs.task import TaskFailedError

_logger = logging.getLogger(__name__)
STEPS: Final = 4
PICTURES_PER_SECOND: Final = 30.0
"""Of environments that do not say how many."""
SEARCHED: Final = 2000
"""Steps at most of random actions in which a key of ``info``, or a time limit, is looked for."""

SILENT: Final = ("gymnasium.", "shimmy.")
"""Modules of environments and wrappers that are known to tell no success."""


@dataclass(frozen=True)
class Probed:
    """An environment as it was found.

    Attributes:
        interface: how it is read and driven.
        limit: steps until it truncates an episode, as far as it says so; None if it does not.
        step_s: what a step costs.
        start: how an episode is put where a recorded one began; None if it cannot be.
        shows: what it can be asked to show, ``rgb_array`` or ``human`` among them.
        pictures_per_second: that it names for films, a step each.
    """

    interface: Interface
    limit: int | None
    step_s: float
    start: StartState | None
    shows: tuple[str, ...] = ()
    pictures_per_second: float = PICTURES_PER_SECOND


def probe(single: SingleEnv) -> Probed:
    """Makes one copy, takes a few steps of random actions, and closes it.

    Raises:
        UnknownTaskError: it cannot be made.
        ValueError: its spaces, or what the options ask of it, are not supported.
        TaskFailedError: it raised, or does not keep to gymnasium's API.
    """
    options = single.options
    reward = reward_function(options)
    env = single()
    with _closed(single.name, env), quiet(single.name):
        flattener, actions = _spaces(single.name, env)
        told, step_s = _told(single.name, env)
        asked = info_keys(options)
        if _may_tell_more(single, env, told):
            told |= _told_in_an_episode(single, env, told)
        for key, wanted in asked.items():
            _require_told(single.name, key, wanted, told)
        signals = success_signal(options.success, told), progress_signal(options.progress)
        info = tuple(sorted({s.info for s in signals if s is not None and s.info is not None}))
        layout = Layout(single.name, flattener, info, actions.shape, actions.dtype)
        interface = Interface(layout, actions, *signals, reward, _resumes(single.name, env))
        return Probed(
            interface,
            time_limit(env),
            step_s,
            start_state(env),
            shows=tuple(map(str, env.metadata.get("render_modes") or ())),
            pictures_per_second=float(env.metadata.get("render_fps") or PICTURES_PER_SECOND),
        )


def truncates_after(single: SingleEnv) -> int | None:
    """Steps after which an environment without a limit that can be seen truncates its episodes.

    Random actions are taken until two episodes are truncated, or `SEARCHED` steps are over. None
    unless the truncated ones are of one length, and none was longer: an environment that truncates
    only on leaving some bounds may go on for ever without.

    Raises:
        TaskFailedError: it raised.
    """
    name, env = single.name, single()
    lengths: list[int] = []
    elapsed, longest = 0, 0
    with _closed(name, env), quiet(name):
        env.action_space.seed(0)
        _tried(name, lambda: calls.reset(env, seed=0))
        for _ in range(SEARCHED):
            _, _, terminated, truncated, _ = _random_step(name, env)
            elapsed += 1
            longest = max(longest, elapsed)
            if truncated:
                lengths.append(elapsed)
                if len(lengths) == 2:
                    break
            if terminated or truncated:
                _tried(name, lambda: calls.reset(env))
                elapsed = 0
    return longest if lengths and set(lengths) == {longest} else None


@contextlib.contextmanager
def _closed(name: str, env: Env) -> Iterator[None]:
    """Closes ``env`` in the end; of several errors the first counts."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(Exception):
            env.close()
        raise
    _tried(name, env.close, "in close()")


def _spaces(name: str, env: Env) -> tuple[Flattener, ActionScale]:
    try:
        return Flattener.of(env.observation_space), ActionScale.of(env.action_space)
    except (UnsupportedSpaceError, UnsupportedActionsError) as error:
        raise type(error)(f"task {name}: {error}") from error


def _told(name: str, env: Env) -> tuple[frozenset[str], float]:
    """Keys of ``info`` in the first steps, and the seconds of the fastest of them."""
    env.action_space.seed(0)
    told = set(_tried(name, lambda: calls.reset(env, seed=0))[1])
    seconds = []
    for _ in range(STEPS):
        step = partial(calls.step, env, env.action_space.sample())
        began = time.perf_counter()
        _, _, terminated, truncated, info = _tried(name, step)
        seconds.append(time.perf_counter() - began)
        told |= set(info)
        if terminated or truncated:
            _tried(name, lambda: calls.reset(env))
    return frozenset(told), min(seconds)


def _may_tell_more(single: SingleEnv, env: Env, told: frozenset[str]) -> bool:
    """Whether a whole episode may tell a key that is wanted and that its first steps do not."""
    if not _asked(single.options, told):
        return True
    # gymnasium's and the suite's own tell no success, and some take seconds for an episode.
    modules = [type(layer).__module__ for layer in layers(env)]
    silent = all(module.startswith(SILENT) for module in modules)
    return not silent and not _success(single.options, told)


def _told_in_an_episode(single: SingleEnv, env: Env, told: frozenset[str]) -> frozenset[str]:
    """Keys of ``info`` in one episode of random actions, until what is wanted is among them."""
    name, options, seen = single.name, single.options, told
    _tried(name, lambda: calls.reset(env, seed=0))
    for _ in range(SEARCHED):
        _, _, terminated, truncated, info = _random_step(name, env)
        seen |= set(info)
        if terminated or truncated or (_asked(options, seen) and _success(options, seen)):
            break
    return seen


def _asked(options: TaskOptions, told: frozenset[str]) -> bool:
    """Whether every key that the options name is told."""
    return told.issuperset(info_keys(options).values())


def _success(options: TaskOptions, told: frozenset[str]) -> bool:
    """Whether what success is needs no looking for any more."""
    return options.success is not None or not told.isdisjoint(FOUND)


def _require_told(name: str, key: str, wanted: str, told: frozenset[str]) -> None:
    if wanted in told:
        return
    if wanted in FOUND:
        # Often told in the step that succeeds alone, which random actions may never reach.
        _logger.warning(
            "%s=info:%s: task %s told no %r in an episode of random actions; it counts as false "
            "until it is told", key, wanted, name, wanted,
        )  # fmt: skip
        return
    found = ", ".join(sorted(map(str, told))) or "nothing"
    raise ValueError(
        f"{key}=info:{wanted}: task {name} never told {wanted!r} in a whole episode; its info "
        f"holds {found} (success is found by itself under {' or '.join(FOUND)})"
    )


def _random_step(name: str, env: Env) -> calls.Stepped:
    stepped: calls.Stepped = _tried(name, partial(calls.step, env, env.action_space.sample()))
    return stepped


def _resumes(name: str, env: Env) -> bool:
    def tried() -> tuple[bool, str]:
        try:
            return continues_exactly(env), "an episode does not go on from them as it did"
        except OwnStateError as error:
            return False, str(error)

    exact, why = _tried(name, tried)
    if offers_state(env) and not exact:
        _logger.warning(
            "task %s offers get_state() and set_state(state), but %s: a resumed run begins its "
            "episodes anew", name, why,
        )  # fmt: skip
    return bool(exact)


def _tried(name: str, use: Callable[[], Any], when: str = "when tried") -> Any:
    try:
        return use()
    except calls.OtherApiError as error:
        raise TaskFailedError(f"task {name}: {error}") from error
    # Whatever somebody's environment raises is told in one line.
    except Exception as error:
        raise TaskFailedError(
            f"task {name}: the environment raised {when}: {kind_and_text(error)}"
        ) from error
