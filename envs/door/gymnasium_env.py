"""The door task as a gymnasium environment, for tools that speak gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from envs.adroit.render import HandRenderer
from envs.adroit.simulator import HandSimulator
from envs.door import task
from envs.door.hand import DOOR, DOOR_POSITION


class AdroitDoorEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One door; `gymnasium.make("AdroitDoor-v0")` after `import envs`.

    Observation: float32 [38], see `envs.door.task`. Action: float32 [28] in [-1, 1].
    `terminated` when the hand has left the door (> 1 m); `truncated` after 200 steps, by the
    `TimeLimit` wrapper that `gymnasium.make` adds. `info` holds ``success`` (hinge > 1.35 rad now),
    ``hinge_angle`` (rad) and ``door_position`` (m, [3]).

    Args:
        render_mode: None or ``rgb_array``.
        width: Picture width, pixels.
        height: Picture height, pixels.
        camera_name: Camera of the scene, see `envs.adroit.render`.

    Raises:
        ValueError: If the render mode is unknown.
    """

    # Declared like this by gymnasium: an instance variable with a default in the class.
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012

    def __init__(
        self,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera_name: str = "fixed",
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be None or 'rgb_array', got {render_mode!r}")
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Box(
            -np.inf, np.inf, (task.OBSERVATION_SIZE,), np.float32
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (task.ACTION_SIZE,), np.float32)
        self._picture = (width, height, camera_name)
        self._simulator = HandSimulator(DOOR)
        # Made on the first picture: a training run without pictures needs no OpenGL.
        self._renderer: HandRenderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Seeds the door positions of this and the following episodes.
            options: ``door_position`` [3], m, places the door; otherwise it is drawn.

        Returns:
            Observation [38] and info.

        Raises:
            ValueError: If an option is unknown or the position is not three finite numbers.
        """
        super().reset(seed=seed)
        options = dict(options or {})
        position = options.pop(DOOR_POSITION, None)
        if options:
            raise ValueError(f"unknown reset options {sorted(options)}; known: ['{DOOR_POSITION}']")
        if position is None:
            position = DOOR.draw(self.np_random)[DOOR_POSITION]
        where = {DOOR_POSITION: np.asarray(position, dtype=np.float64)[None]}
        observation = self._simulator.start(where)[0]
        return observation, self._info(observation)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Advance by 0.01 s. `action`: shape [28], clipped to [-1, 1].

        Raises:
            ValueError: If the action has another shape or is not finite.
            PhysicsDivergedError: If the simulation produced NaN or huge numbers.
        """
        observation = self._simulator.step(np.asarray(action)[None])[0]
        reward = float(task.reward(observation))
        terminated = bool(task.terminated(observation))
        return observation, reward, terminated, False, self._info(observation)

    def render(self) -> NDArray[np.uint8] | None:
        """Picture of the door, uint8 [height, width, 3]; None without a render mode.

        Raises:
            RenderingUnavailableError: If there is no OpenGL to render with.
        """
        if self.render_mode is None:
            return None
        if self._renderer is None:
            self._renderer = HandRenderer(self._simulator, *self._picture)
        return self._renderer.render()

    def close(self) -> None:
        """Free the renderer and the simulator."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self._simulator.close()

    def _info(self, observation: NDArray[np.float32]) -> dict[str, Any]:
        return {
            "success": bool(task.success(observation)),
            "hinge_angle": float(task.hinge_angle(observation)),
            DOOR_POSITION: self._simulator.placement[DOOR_POSITION][0],
        }
