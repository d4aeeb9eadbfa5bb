"""Several critics as one module, as :class:`losses.Objective` calls them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class CriticEnsemble(nn.Module):
    """Independent critics with the same inputs, evaluated one after the other.

    Args:
        critics: modules ``(observation [B, O], action [B, A]) -> [B, 1]``; kept, not copied.

    Raises:
        ValueError: if ``critics`` is empty.
    """

    def __init__(self, critics: Sequence[nn.Module]) -> None:
        super().__init__()
        if not critics:
            raise ValueError("a critic ensemble needs at least one critic")
        self.critics = nn.ModuleList(critics)

    @property
    def num_critics(self) -> int:
        """Number of critics E."""
        return len(self.critics)

    def forward(self, observation: Tensor, action: Tensor, members: Tensor | None = None) -> Tensor:
        """Return the critics' values ``[E, B, 1]``.

        Args:
            observation: ``[B, O]``.
            action: ``[B, A]``.
            members: ``[M]``, indices of the critics to run, whose values are ``[M, B, 1]``;
                ``None`` runs all.
        """
        chosen = range(len(self.critics)) if members is None else members.tolist()
        return torch.stack([self.critics[index](observation, action) for index in chosen])
