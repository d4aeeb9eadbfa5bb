"""Loss functions: the SAC family with demonstrations.

``functional`` holds the arithmetic as pure functions, ``schedules`` the weights over time, and
:class:`BCSACLoss` fetches keys, chooses rows and reduces. Nothing here imports from the rest of
the project.
"""

from __future__ import annotations

from losses.bc_sac import BCSACLoss
from losses.distributions import SquashedNormal
from losses.ensemble import CriticEnsemble
from losses.schedules import (
    SCHEDULES,
    ConstantWeight,
    CosineWeight,
    ExponentialWeight,
    LinearWeight,
    PiecewiseWeight,
    Schedule,
    make_schedule,
)
from losses.terms import ActorTerms, CriticTerms

__all__ = [
    "SCHEDULES",
    "ActorTerms",
    "BCSACLoss",
    "ConstantWeight",
    "CosineWeight",
    "CriticEnsemble",
    "CriticTerms",
    "ExponentialWeight",
    "LinearWeight",
    "PiecewiseWeight",
    "Schedule",
    "SquashedNormal",
    "make_schedule",
]
