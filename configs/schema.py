"""What Hydra may compose: the keys of a recipe, and where a run is kept."""

from __future__ import annotations

from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from pipeline.recipe import Recipe


def register_schema() -> None:
    """Makes the keys known to Hydra under the name that ``train.yaml`` builds on.

    Every room of the pipeline declares its own settings; nothing is repeated here. Hydra refuses
    keys that are not there, and :meth:`~pipeline.recipe.Recipe.of` checks the values.
    """
    places: dict[str, Any] = {"run_dir": "???", "resume": None}
    node = OmegaConf.create(Recipe().plain() | {"variant": "???", "preset": "???"} | places)
    ConfigStore.instance().store(name="schema", node=node)
