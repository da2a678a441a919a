"""One world as a gymnasium.Env."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from fluidgym.envs import make_task
from fluidgym.envs.runner import Runner, check_seed, opened
from fluidgym.envs.screen import RENDER_MODES, Look, Screen
from fluidgym.envs.task import Task
from fluidgym.solver import Solver

_ONE = np.ones(1, bool)


class FluidEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A task in one world.

    An episode is truncated where the task ends, or earlier by the TimeLimit that gymnasium.make adds when it is given
    max_episode_steps. An action outside the action space is clipped into it.
    """

    # Each instance has a copy of its own.
    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 20}  # noqa: RUF012

    def __init__(
        self,
        task: str = "DamBreakContain",
        *,
        render_mode: str | None = None,
        colour: str = "speed",
        overlay: bool = False,
        frame_size: tuple[int, int] = (640, 400),
        spheres: bool = False,
        camera: tuple[float, float] | None = None,
        device: str | None = None,
        threads: int | None = None,
        **options: Any,
    ):
        """Make the world.

        Args:
            task: Name of the task.
            render_mode: "rgb_array", "human", or None.
            colour: What frames are coloured by: "speed", "pressure" or "density".
            overlay: Whether the observed grid is laid over frames, in 2D.
            frame_size: Width and height of a frame [pixels].
            spheres: Whether frames show each particle by itself, not the body of water that they make.
            camera: In 3D, how far around the box from the front to the right, and how far up, the eye is [degrees].
            device: "cpu", "cuda", ...; None takes a GPU where there is one.
            threads: How many threads of a CPU share the worlds, at most; None is as many as there are processors.
            options: What the task takes; see its class.

        Raises:
            ValueError: An argument is out of its limits.
        """
        posed = make_task(task, **options)
        look = Look(colour, overlay, frame_size, spheres, camera)
        self._screen = Screen(render_mode, posed.control_interval)
        self.render_mode = render_mode
        self.metadata = self._screen.metadata(self.metadata)
        self.observation_space, self.action_space = posed.observation_space, posed.action_space
        self._action_shape = posed.action_space.shape
        self._runner: Runner | None = Runner(posed, 1, device, threads=threads, look=look)

    @property
    def task(self) -> Task:
        """The task."""
        return opened(self._runner, "task").task

    @property
    def solver(self) -> Solver:
        """The simulated world."""
        return opened(self._runner, "solver").solver

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Key of this and the following episodes; None goes on with the one before.
            options: Not used.

        Raises:
            ValueError: The seed is not a whole number of 0 or more.
            ClosedEnvironmentError: The environment is closed.
        """
        runner, seed = opened(self._runner, "reset"), check_seed(seed)
        super().reset(seed=seed)
        if seed is None and runner.needs_seed():
            seed = int(self.np_random.integers(2**31))
        outcome = runner.reset(_ONE, [seed])
        self._show()
        return outcome.observation[0], _first(outcome.info)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Go on by one control interval.

        Raises:
            ValueError: The action has the wrong shape or is not finite; the world is as it was.
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        runner = opened(self._runner, "step", begun=True)
        outcome = runner.step(runner.check_actions(action, "action", self._action_shape))
        self._show()
        reward, terminated, truncated = outcome.reward[0], outcome.terminated[0], outcome.truncated[0]
        return outcome.observation[0], float(reward), bool(terminated), bool(truncated), _first(outcome.info)

    def get_state(self) -> dict[str, np.ndarray]:
        """All that the future of the world depends on, as arrays by name: for planning, and to go on from later.

        Raises:
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        return opened(self._runner, "get_state", begun=True).get_state(0)

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Go on from what `get_state` gave, of this or another environment of the same task, bit for bit.

        Raises:
            ValueError: It is of another task; nothing has happened then.
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        opened(self._runner, "set_state", begun=True).set_state(0, state)

    def render(self) -> np.ndarray | None:
        """A picture (height, width, 3) uint8, or None where the window shows it already.

        Raises:
            ResetNeeded: There was no reset yet.
            ClosedEnvironmentError: The environment is closed.
        """
        runner = opened(self._runner, "render", begun=True)
        return runner.frame(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window, if there is one, and free the world's memory."""
        self._screen.close()
        self._runner = None

    def _show(self) -> None:
        if self.render_mode == "human":
            self._screen.show([opened(self._runner, "render").frame(0)])


def _first(info: dict[str, np.ndarray]) -> dict[str, Any]:
    return {name: values.tolist()[0] for name, values in info.items()}
