"""The configuration of a run from Python, as the command line composes it."""

from __future__ import annotations

from typing import cast

from hydra import compose, initialize_config_module
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf, open_dict

from configs.schema import Config, register_schema


def compose_config(*overrides: str) -> Config:
    """Composes and resolves what ``python -m pipeline.train`` with these arguments would run.

    Args:
        overrides: As on the command line: ``variant=sid_bc``, ``preset=smoke``, ``seed=3``.

    Raises:
        HydraException: If a key or choice is unknown or a value has the wrong type.
    """
    register_schema()
    with initialize_config_module("configs", version_base="1.3"):
        config = compose("train", list(overrides), return_hydra_config=True)
    # Names of the choices made are looked up in Hydra's own part, as under hydra.main.
    HydraConfig.instance().set_config(config)
    with open_dict(config):
        del config["hydra"]
    OmegaConf.resolve(config)
    return cast(Config, config)
