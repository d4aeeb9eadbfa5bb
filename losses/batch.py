"""A flat batch of transitions as the terms see it, and which of its rows are for reinforcement."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from losses.policy import Rows


@dataclass
class BatchKeys:
    """Where a flat batch of B transitions has its entries; ``LossModule.set_keys`` renames them.

    =================== =========== =============================== ================================
    name                shape       meaning                         read by
    =================== =========== =============================== ================================
    observation         [B, O]      state                           all terms of critics and actor
    action              [B, A]      the executed one, in [-1, 1]    SoftTD, Imitation, SelfImitation
    (next, observation) [B, O]      state after n steps             SoftTD
    (next, reward)      [B, 1]      discounted sum of n rewards     SoftTD
    (next, terminated)  [B, 1] bool the environment's own end       SoftTD
    steps_to_next_obs   [B, 1] int  optional: steps n, else 1       SoftTD
    is_demo             [B, 1] bool optional: is a demonstration    Imitation, Objective
    imitated_action     [B, A]      optional: if not ``action``     Imitation, SelfImitation
    to_end              [B]         optional: ``Batch.to_end``      SelfImitation
    =================== =========== =============================== ================================

    A time limit is no end of the environment's own. :class:`~losses.Objective` reads ``is_demo``
    to leave the demonstrations out of the terms that reinforce, unless ``rl_on_demos`` is set.
    """

    observation: NestedKey = "observation"
    action: NestedKey = "action"
    reward: NestedKey = "reward"
    terminated: NestedKey = "terminated"
    is_demo: NestedKey = "is_demo"
    imitated_action: NestedKey = "imitated_action"
    steps_to_next_obs: NestedKey = "steps_to_next_obs"
    to_end: NestedKey = "to_end"


OPTIONAL = ("steps_to_next_obs", "is_demo", "imitated_action", "to_end")
"""The entries, by their names in :class:`BatchKeys`, that a batch may be without."""


def location(name: NestedKey, keys: BatchKeys) -> NestedKey:
    """Return where a batch has the entry ``name`` of the table in :class:`BatchKeys`.

    A name that is not in the table stays as it is: an entry that a term of one's own reads.
    """
    if isinstance(name, tuple):
        *parents, last = name
        return (*parents, getattr(keys, last, last))
    return getattr(keys, name, name)


class Batch:
    """B transitions, whose entries are read by their meaning and never written to.

    Args:
        data: ``[B]``, the transitions; a term may read further entries from it directly.
        keys: Where the entries are.
    """

    def __init__(self, data: TensorDictBase, keys: BatchKeys) -> None:
        self.data = data
        self.keys = keys

    def __getitem__(self, rows: Rows) -> Batch:
        """Return some of the rows; a slice copies nothing."""
        return Batch(self.data[rows], self.keys)

    @cached_property
    def observation(self) -> Tensor:
        """``[B, O]``."""
        return self.data[self.keys.observation]

    @cached_property
    def action(self) -> Tensor:
        """``[B, A]``, the executed actions, which led to ``next`` and which the critics value."""
        return self.data[self.keys.action]

    @cached_property
    def demonstrated_action(self) -> Tensor:
        """``[B, A]``, the actions to imitate: ``imitated_action`` if given, or ``action``."""
        shown = self.data.get(self.keys.imitated_action, None)
        return self.action if shown is None else shown

    @property
    def next_observation(self) -> Tensor:
        """``[B, O]``."""
        return self.data["next", self.keys.observation]

    @property
    def reward(self) -> Tensor:
        """``[B, 1]``, the reward; with n steps to ``next``, the discounted sum of n rewards."""
        return self.data["next", self.keys.reward]

    @property
    def terminated(self) -> Tensor:
        """``[B, 1]`` bool, whether the environment's own end was reached; a time limit is none."""
        return self.data["next", self.keys.terminated]

    @property
    def steps(self) -> Tensor | None:
        """``[B, 1]``, environment steps n to ``next``; ``None`` means one each."""
        return self.data.get(self.keys.steps_to_next_obs, None)

    @cached_property
    def to_end(self) -> TensorDictBase | None:
        """``[B]``, what is left of each row's episode; ``None`` if the batch does not say.

        Its entries are ``reward [B, 1]``, the discounted sum of all remaining rewards; ``steps
        [B, 1]``, the number of these rewards, 0 where the end of the episode is unknown;
        ``observation [B, O]`` and ``terminated [B, 1]``, those of the episode's last state.
        """
        return self.data.get(self.keys.to_end, None)

    @cached_property
    def is_demo(self) -> Tensor | None:
        """``[B]`` bool, which rows are demonstrations; ``None`` if the batch has no marks."""
        mask = self.data.get(self.keys.is_demo, None)
        return None if mask is None else mask.squeeze(-1)


def reinforcement_rows(batch: Batch, main_rows: int | None = None) -> Rows | None:
    """Return the R rows that are not demonstrations, or ``None`` if the batch has no marks.

    If the demonstrations come last, as in the pipeline's batches, the rows are a slice, so that
    taking them is a view and copies nothing. Otherwise they are indices ``[R]``.

    Args:
        batch: ``[B]``.
        main_rows: R, where it is known that so many rows come before the demonstrations. ``None``
            counts them, for which the host of an accelerator has to wait once.

    Raises:
        ValueError: if all rows are demonstrations.
    """
    is_demo = batch.is_demo
    if is_demo is None:
        return None
    if main_rows is not None:
        return slice(main_rows)
    others = is_demo.logical_not()
    count, first_demo = torch.stack([others.sum(), is_demo.int().argmax()]).tolist()
    if count == 0:
        raise ValueError(
            "all rows of the batch are demonstrations, which leaves none for reinforcement: "
            "mix in other transitions, set rl_on_demos=True, or call bc_loss alone"
        )
    if count in (first_demo, len(others)):
        return slice(count)
    return others.nonzero().squeeze(-1)
