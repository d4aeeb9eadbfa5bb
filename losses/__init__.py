"""Loss functions: the SAC family with demonstrations.

``functional`` holds the arithmetic as pure functions, ``schedules`` the weights over time. A term
(``critic``, ``actor``, ``temperature``, ``imitation``, ``self_imitation``) reads what it needs from
a batch, chooses the rows that count and takes their mean. :class:`Objective` is a loss module made
of a list of terms, :class:`BCSACLoss` the one with the terms of BC-SAC. Nothing here imports from
the rest of the project.
"""

from __future__ import annotations

from losses.actor import SoftValue
from losses.bc_sac import BCSACLoss
from losses.critic import SoftTD
from losses.distributions import SquashedNormal
from losses.ensemble import CriticEnsemble
from losses.imitation import Emphasis, Imitation, QFilter
from losses.objective import Objective
from losses.passes import ActorPass, CriticPass
from losses.proposal import Proposal
from losses.rules import GradientRatio
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
from losses.self_imitation import SelfImitation
from losses.settings import SettingError
from losses.temperature import Temperature
from losses.terms import ActorTerm, ActorTerms, CriticTerm, CriticTerms, TermValue

__all__ = [
    "SCHEDULES",
    "ActorPass",
    "ActorTerm",
    "ActorTerms",
    "BCSACLoss",
    "ConstantWeight",
    "CosineWeight",
    "CriticEnsemble",
    "CriticPass",
    "CriticTerm",
    "CriticTerms",
    "Emphasis",
    "ExponentialWeight",
    "GradientRatio",
    "Imitation",
    "LinearWeight",
    "Objective",
    "PiecewiseWeight",
    "Proposal",
    "QFilter",
    "Schedule",
    "SelfImitation",
    "SettingError",
    "SoftTD",
    "SoftValue",
    "SquashedNormal",
    "Temperature",
    "TermValue",
    "make_schedule",
]
