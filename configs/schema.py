"""What Hydra may compose: the keys of a recipe, and where a run is kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from pipeline.recipe import Recipe

OF_PRESETS: Final[Mapping[str, float]] = {"dbc_decay": 0.999}
"""What presets say to the variants that read it (``${dbc_decay}``), with its value where a preset
says nothing. It is no part of a recipe, and no command line can set it: a variant that does not
read it would ignore it silently."""
READ_AS: Final[Mapping[str, str]] = {"dbc_decay": "loss.bc_weight.decay"}
"""The key of a recipe that it becomes."""


def register_schema() -> None:
    """Makes the keys known to Hydra under the name that ``train.yaml`` builds on.

    Every room of the pipeline declares its own settings; nothing is repeated here. Hydra refuses
    keys that are not there, and :meth:`~pipeline.recipe.Recipe.of` checks the values.
    """
    places = {"run_dir": "???", "resume": None, "variant": "???", "preset": "???"}
    node = OmegaConf.create({**Recipe().plain(), **places, **OF_PRESETS})
    ConfigStore.instance().store(name="schema", node=node)
