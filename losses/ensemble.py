"""Several critics behind the one call that :class:`losses.BCSACLoss` makes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class CriticEnsemble(nn.Module):
    """Independent critics of one shape of input, evaluated one after the other.

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
        """E."""
        return len(self.critics)

    def forward(self, observation: Tensor, action: Tensor, members: Tensor | None = None) -> Tensor:
        """Return the values ``[E, B, 1]`` of ``observation [B, O]`` and ``action [B, A]``.

        Of ``members [M]`` only, where some are named: ``[M, B, 1]``.
        """
        chosen = range(len(self.critics)) if members is None else members.tolist()
        return torch.stack([self.critics[index](observation, action) for index in chosen])
