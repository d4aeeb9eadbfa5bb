"""Hydra configuration: one typed schema, three presets, one YAML per paper variant.

``schema.py`` declares every key with its unit and source; ``train.yaml`` composes
``preset`` (how big, how long, which stabilisers) and then ``variant`` (which terms, which
buffers: the paper's rows).  A key that the schema does not know is an error.
"""

from configs.composition import compose_config
from configs.schema import Config, register_schema

__all__ = ["Config", "compose_config", "register_schema"]
