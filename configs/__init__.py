"""Hydra configuration: presets, one YAML per variant, and how they become a recipe.

``train.yaml`` composes ``preset`` (how big, how long, which stabilisers) and then ``variant``
(which terms, which buffers: the paper's rows).  A key that no room of the pipeline declares is an
error.
"""

from configs.composition import compose, prepare, recipe_of
from configs.known_keys import require_known

__all__ = ["compose", "prepare", "recipe_of", "require_known"]
