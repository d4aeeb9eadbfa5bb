"""The door task as a batched TorchRL environment."""

from __future__ import annotations

import torch

from envs.adroit.torchrl_env import HandEnv
from envs.door.demos import DOOR_POSITION
from envs.door.simulator import DoorSimulator

DOOR_POSITION_KEY = DOOR_POSITION


class DoorEnv(HandEnv):
    """N doors as one `EnvBase`; see `HandEnv`, whose other arguments it takes.

    ``progress`` is the hinge angle (rad), ``success`` whether it is above 1.35 rad now, and
    ``terminated`` whether the hand has left the door (`envs.door.task.terminated`).

    Args:
        num_doors: N >= 1.
        num_threads: Threads of the simulator. Default: one per core, at most N.
        horizon: As in `HandEnv`, and so the following.
        success_steps: As there.
        sparse: As there.
        contacts: As there.
        seed: As there.
        device: As there.
    """

    simulator: DoorSimulator

    def __init__(
        self,
        num_doors: int = 1,
        *,
        horizon: int | None = None,
        success_steps: int | None = None,
        sparse: bool = False,
        contacts: bool = False,
        num_threads: int | None = None,
        seed: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(
            DoorSimulator(num_doors, num_threads),
            horizon=horizon,
            success_steps=success_steps,
            sparse=sparse,
            contacts=contacts,
            seed=seed,
            device=device,
        )

    @property
    def num_doors(self) -> int:
        """Number of doors N."""
        return self.num_copies

    @property
    def door_position(self) -> torch.Tensor:
        """Where the door frames stand now, shape [N, 3], float64, m."""
        return torch.as_tensor(self.simulator.door_position, device=self.device)
