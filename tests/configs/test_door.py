"""What the door's runs are composed of is what its published results were made with.

``door.json`` holds every key of every variant and preset: all of them for one, and for the others
what differs from it. It changes only with a change of the door's results.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.configs.test_compose import flat

KEPT: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_name("door.json").read_text())
WHOLE = "paper/sac"


@pytest.mark.parametrize("name", list(KEPT))
def test_the_door_is_composed_as_it_was(name: str):
    preset, variant = name.split("/")
    found = json.loads(json.dumps(flat(variant, preset, "task.name=door")))
    kept = KEPT[WHOLE] | KEPT[name]
    # Keys that came later are not the business of this test.
    assert {key: found.get(key, "nothing of this name") for key in kept} == kept
