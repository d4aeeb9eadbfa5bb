"""docs/howto/use-a-policy.md: its example as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from envs.door.definition import TASK
from pipeline.act.evaluation import reset_td

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "howto" / "use-a-policy.md"
SNIPPET = re.compile(r"<!-- snippet:policy -->\n```python\n(.*?)```", re.DOTALL)


def test_the_policy_of_the_page_acts(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(ROOT)
    (text,) = SNIPPET.findall(PAGE.read_text())
    names: dict[str, object] = {}
    exec(compile(text, str(PAGE), "exec"), names)
    action, recipe = names["action"], names["recipe"]
    assert action.shape == (1, 28)
    assert bool((action.abs() <= 1.0).all())
    env = recipe.find_task().make_env(recipe.env_options(seed=0))
    seen = env.reset(reset_td(TASK, env, 0, 0))["observation"]
    env.close()
    assert seen.shape == names["observation"].shape
    assert seen.dtype == torch.float32
