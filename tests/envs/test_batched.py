"""The bookkeeping of batched environments, on copies that always succeed."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from envs.batched import BatchedEnv, Now


class Succeeds(BatchedEnv):
    """Two copies; an episode is over after three successes in a row."""

    def __init__(self) -> None:
        super().__init__(2, horizon=None, success_steps=3, called="toys", device="cpu")
        self._make_specs(1, 1, success=True, progress=False)
        self._set_seed(0)

    def _now(self) -> Now:
        no = np.zeros(2, dtype=bool)
        return Now({"observation": np.zeros((2, 1), np.float32), "success": ~no}, no, no)

    def _begin(self, copies: Any, given: Any) -> Now:
        return self._now()

    def _advance(self, copies: Any, action: Any) -> tuple[Now, Any]:
        return self._now(), np.ones(2)

    def _saved(self) -> dict[str, Any]:
        return {}

    def _restore(self, arrays: Any) -> None: ...


def test_successes_of_an_episode_do_not_count_for_the_next_nor_for_another_copy():
    env = Succeeds()
    td = env.reset()
    td["action"] = torch.zeros(2, 1)
    seen = [env.step(td.clone())["next", "done"].flatten().tolist() for _ in range(2)]
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False]])}, [2]))
    seen += [env.step(td.clone())["next", "done"].flatten().tolist() for _ in range(2)]
    assert seen == [[False, False], [False, False], [False, True], [False, True]]
