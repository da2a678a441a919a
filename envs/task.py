"""What a task is: a scene, what an action drives, what is seen, and what it is worth. Always for a batch of worlds."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces

from fluidgym.checks import check_choice
from fluidgym.scene import Particles, Scene
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, Scheme
from fluidgym.solver import Solver

DEFAULT_FIDELITY = "balanced"


@dataclass(frozen=True)
class Gate:
    """The validation case that stands for the physics of a task.

    Attributes:
        case: Name of the case, a key of `fluidgym.validation.CASES`.
        scale: Resolution of the case over that of the task; 1 where both count along the same length.
    """

    case: str
    scale: float = 1.0


class Task(ABC):
    """One task, posed in all worlds of one solver.

    The runner calls, for a new episode: `start`, then `begin`; for a step: `apply_action`, then `measure`; and after
    either what it wants to know: `observe`, `reward`, `terminated`, `info`. Every array has the world first, and what
    is found for a world may not depend on the others.

    Attributes:
        resolutions: What a fidelity has as its resolution, unless another is given: {dim: {fidelity: resolution}}.
        gates: What the accuracy of the task is measured by, by dimension; its accuracy card has the errors.
        scene: What is simulated, with the largest start there can be.
        scheme: How.
        fidelity: Name of the trade-off that the scheme is of, a key of `FIDELITIES`; None for a scheme of one's own.
        dim: Number of dimensions.
        grid: Cells of the coarse grid that is seen, along (z,) y and x.
        resolution: Particles along the length that the task counts them along.
        control_interval: Time between actions [s].
        max_episode_steps: Actions in an episode; it is truncated after them.
        action_space: Of one world.
        observation_space: Of one world.
        reference_speed: Speed at the top of a drawing's colour bar [m/s].
        solver: The worlds, from `attach` on.
    """

    resolutions: ClassVar[Mapping[int, Mapping[str, int]]]
    gates: ClassVar[Mapping[int, Gate]] = {}
    scene: Scene
    scheme: Scheme = DEFAULT_SCHEME
    fidelity: str | None = DEFAULT_FIDELITY
    dim: int
    grid: tuple[int, ...]
    resolution: int
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

    def choose_fidelity(self, dim: int, fidelity: str | None, scheme: Scheme | None) -> int:
        """Set `fidelity` and `scheme` as asked for.

        Args:
            dim: 2 or 3.
            fidelity: A key of `FIDELITIES`; None is "balanced".
            scheme: In place of that of the fidelity.

        Returns:
            The resolution that goes with them.

        Raises:
            ValueError: There is no such fidelity, the scheme is none, or both are given.
        """
        if fidelity is not None:
            *others, last = map(repr, FIDELITIES)
            check_choice("fidelity", fidelity, tuple(FIDELITIES), f"{', '.join(others)} or {last}")
        if scheme is not None and not isinstance(scheme, Scheme):
            raise ValueError(f"scheme = {scheme!r} is not a Scheme; give fluidgym.Scheme(...), or leave it out")
        if scheme is not None and fidelity is not None:
            raise ValueError(f"fidelity = {fidelity!r} has a scheme, and another is given, limit one; leave one out")
        chosen = fidelity or DEFAULT_FIDELITY
        self.fidelity, self.scheme = (chosen, FIDELITIES[chosen]) if scheme is None else (None, scheme)
        return self.resolutions[dim][chosen]

    def attach(self, solver: Solver) -> None:
        """Take the worlds that the task is posed in, and make what measures them."""
        self.solver = solver

    @abstractmethod
    def start(self, world: int, rng: np.random.Generator) -> Particles:
        """The fluid of a world at the start of an episode; all that differs between episodes comes from rng."""

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
    def observe(self, output: str = "numpy") -> Any:
        """Observations, (world, ...): a new array, or with "torch" a new tensor on the solver's device."""

    @abstractmethod
    def parts(self) -> dict[str, np.ndarray]:
        """What the reward is made of, each in 0 to 1, (world,): the gain and the costs."""

    @abstractmethod
    def reward(self) -> np.ndarray:
        """Rewards, (world,)."""

    @abstractmethod
    def terminated(self) -> np.ndarray:
        """Which worlds are at an end for a reason of their own, bool (world,)."""

    @abstractmethod
    def info(self) -> dict[str, np.ndarray]:
        """What else there is to know, arrays (world,)."""

    @abstractmethod
    def scripted(self) -> np.ndarray:
        """Actions (world, action) of a simple controller that was made by hand, from what was measured last."""

    def null(self) -> np.ndarray:
        """Actions (world, action) that do nothing."""
        return np.zeros((self.solver.num_worlds, *self.action_space.shape))

    @abstractmethod
    def get_state(self, world: int) -> dict[str, np.ndarray]:
        """What a world's future depends on besides its solver, as arrays."""

    @abstractmethod
    def set_state(self, world: int, state: Mapping[str, np.ndarray]) -> None:
        """Put that back; the solver is as it is to be."""

    def annotate(self, world: int) -> dict[str, Any]:
        """What a drawing of a world shows beside the fluid: title, text, zone; see render.draw_frame."""
        return {}

    @abstractmethod
    def shares(self, world: int) -> np.ndarray:
        """Share of each cell of the coarse grid of a world that is fluid, from the lower corner (ny, nx)."""
