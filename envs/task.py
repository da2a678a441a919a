"""What a task is: a scene, what an action drives, what is seen, and what it is worth. Always for a batch of worlds."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from fluidgym.scene import Particles, Scene
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.solver import Solver


class Task(ABC):
    """One task, posed in all worlds of one solver.

    The runner calls, for a new episode: `start`, then `begin`; for a step: `apply_action`, then `measure`; and after
    either what it wants to know: `observe`, `reward`, `terminated`, `info`. Every array has the world first, and what
    is found for a world may not depend on the others.

    Attributes:
        scene: What is simulated, with the largest start there can be.
        scheme: How.
        control_interval: Time between actions [s].
        max_episode_steps: Actions in an episode; it is truncated after them.
        action_space: Of one world.
        observation_space: Of one world.
        reference_speed: Speed at the top of a drawing's colour bar [m/s].
        solver: The worlds, from `attach` on.
    """

    scene: Scene
    scheme: Scheme = DEFAULT_SCHEME
    control_interval: float
    max_episode_steps: int
    action_space: spaces.Box
    observation_space: spaces.Box
    reference_speed: float
    solver: Solver

    @classmethod
    def check_options(cls, options: Mapping[str, Any]) -> None:
        """Refuse options that the task does not have.

        Raises:
            ValueError: There is no such option.
        """
        known = list(inspect.signature(cls).parameters)
        for name in options:
            if name not in known:
                raise ValueError(f"{cls.__name__} has no option {name!r}; use {', '.join(known)}")

    def attach(self, solver: Solver) -> None:
        """Take the worlds that the task is posed in, and make what measures them."""
        self.solver = solver

    @abstractmethod
    def start(self, rng: np.random.Generator) -> Particles:
        """The fluid of one world at the start of an episode; all that differs between episodes comes from rng."""

    @abstractmethod
    def begin(self, worlds: np.ndarray) -> None:
        """Measure, and forget what was before in the worlds of the mask (world,): they are at a new start."""

    @abstractmethod
    def apply_action(self, actions: np.ndarray) -> None:
        """Set the solver's controls for the next interval from actions (world, action), each inside the space."""

    @abstractmethod
    def measure(self) -> None:
        """Look at the worlds as they are now."""

    @abstractmethod
    def observe(self) -> np.ndarray:
        """Observations, (world, ...): a new array."""

    @abstractmethod
    def reward(self) -> np.ndarray:
        """Rewards, (world,)."""

    @abstractmethod
    def terminated(self) -> np.ndarray:
        """Which worlds are at an end for a reason of their own, bool (world,)."""

    @abstractmethod
    def info(self) -> dict[str, np.ndarray]:
        """What else there is to know, arrays (world,)."""

    def annotate(self, world: int) -> dict[str, Any]:
        """What a drawing of a world shows beside the fluid: title, text, zone; see render.draw_frame."""
        return {}
