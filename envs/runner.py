"""The runner: one task in N worlds. The only code that steps, whatever environment is around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded

from fluidgym.envs.screen import Look
from fluidgym.envs.task import Task
from fluidgym.solver import Solver


@dataclass(frozen=True)
class Outcome:
    """What is known of the worlds after a step or at a start.

    Attributes:
        observation: (world, ...), an array, or a tensor of PyTorch's.
        reward: (world,).
        terminated: bool (world,).
        truncated: bool (world,).
        info: Arrays (world,).
    """

    observation: Any
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    info: dict[str, np.ndarray]


class Runner:
    """A task and the solver of its worlds.

    Attributes:
        task: The task.
        solver: The worlds.
    """

    def __init__(
        self,
        task: Task,
        num_worlds: int,
        device: str | None,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        output: str = "numpy",
        look: Look = Look(),  # noqa: B008 - it is frozen
    ):
        """Make the worlds.

        Args:
            task: The task.
            num_worlds: Number of worlds.
            device: "cpu", "cuda", ...; None takes a GPU where there is one.
            max_episode_steps: Episodes are truncated after so many steps, or where the task ends if that is earlier.
            threads: Of a CPU, that share the worlds at most; None is as many as there are processors.
            output: What observations are: "numpy" or "torch".
            look: How frames look.
        """
        self.task, self._output, self._look = task, output, look
        self._limit = min(task.max_episode_steps, max_episode_steps or task.max_episode_steps)
        self.solver = Solver(task.scene, task.scheme, num_worlds, device, threads=threads)
        task.attach(self.solver)
        self._steps = np.zeros(num_worlds, int)
        self._seeds: list[int | None] = [None] * num_worlds
        self._episodes = [0] * num_worlds

    @property
    def num_worlds(self) -> int:
        """Number of worlds."""
        return self.solver.num_worlds

    def reset(self, worlds: np.ndarray, seeds: Sequence[int | None]) -> Outcome:
        """Begin an episode in some worlds; the others stay as they are.

        An episode is keyed by the seed of its world and by how many there were in the world since that seed.

        Args:
            worlds: Which, bool (world,).
            seeds: A new seed for each world (world,); None goes on with the one it has.
        """
        chosen = np.flatnonzero(worlds).tolist()
        keys = {}
        for world in chosen:
            seed = seeds[world]
            keys[world] = (self._seeds[world], self._episodes[world] + 1) if seed is None else (int(seed), 0)
        starts = [self.task.start(world, np.random.default_rng(keys[world])) for world in chosen]
        for world, (seed, episode) in keys.items():
            self._seeds[world], self._episodes[world] = seed, episode
        self.solver.set_start(chosen, starts)
        self.solver.reset(worlds)
        self.task.begin(worlds)
        self._steps[worlds] = 0
        return self._outcome()

    def needs_seed(self) -> bool:
        """Whether there are worlds that never had a seed."""
        return None in self._seeds

    def step(self, actions: np.ndarray) -> Outcome:
        """Go on by one control interval in all worlds.

        Args:
            actions: (world, action), as `check_actions` gave them.
        """
        self.task.apply_action(actions)
        self.solver.advance(self.task.control_interval)
        self.task.measure()
        self._steps += 1
        return self._outcome()

    def get_state(self, world: int) -> dict[str, np.ndarray]:
        """All that the future of a world depends on, as arrays by name."""
        seed = self._seeds[world]
        own = {"steps": self._steps[world], "episode": self._episodes[world], "seed": -1 if seed is None else seed}
        state = {f"runner.{name}": np.asarray(value, np.int64) for name, value in own.items()}
        state |= {f"task.{name}": np.asarray(value) for name, value in self.task.get_state(world).items()}
        return state | {f"solver.{name}": np.asarray(v) for name, v in self.solver.save_world(world).items()}

    def set_state(self, world: int, state: Mapping[str, np.ndarray]) -> None:
        """Put a world to what `get_state` gave, of any world of the same task.

        Raises:
            ValueError: Something is missing or has another shape; nothing has happened then.
        """
        now = self.get_state(world)
        for name, value in now.items():
            shape = np.shape(state[name]) if name in state else None
            if shape != value.shape:
                raise ValueError(
                    f"state {name!r} has shape {shape}, limit {value.shape}; give what get_state gave, of the same task"
                )
        parts: dict[str, dict[str, np.ndarray]] = {"runner": {}, "task": {}, "solver": {}}
        for name in now:
            part, _, rest = name.partition(".")
            parts[part][rest] = state[name]
        self.solver.restore_world(world, parts["solver"])
        self.task.set_state(world, parts["task"])
        own = {name: int(value) for name, value in parts["runner"].items()}
        self._steps[world], self._episodes[world] = own["steps"], own["episode"]
        self._seeds[world] = None if own["seed"] < 0 else own["seed"]

    def check_actions(self, actions: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Actions as float64 (world, action), clipped into the action space. Nothing else happens.

        Args:
            actions: What the user gave.
            name: What the user calls it.
            shape: The shape it is to have.

        Raises:
            ValueError: The shape is wrong or a number is not finite.
        """
        space = self.task.action_space
        try:
            values = np.asarray(actions, dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"{name} = {actions!r} is not numbers; give {shape} numbers of {self._range()}") from None
        if values.shape != shape:
            raise ValueError(
                f"{name} has shape {values.shape}, limit {shape}; give numbers of {self._range()} in that shape"
            )
        finite = np.isfinite(values)
        if not finite.all():
            place = tuple(np.argwhere(~finite)[0].tolist())
            raise ValueError(
                f"{name}[{', '.join(map(str, place))}] = {values[place]} is not finite, limit {self._range()};"
                " give a finite number"
            )
        return values.reshape(self.num_worlds, *space.shape).clip(space.low, space.high)

    def _range(self) -> str:
        """What an action may be, in words."""
        space = self.task.action_space
        return f"{space.low.min():g} to {space.high.max():g}"

    def frame(self, world: int) -> np.ndarray:
        """A picture of a world (height, width, 3), uint8."""
        from fluidgym.picture import picture  # a picture costs nothing where none is asked for

        look, task = self._look, self.task
        annotations = {"size": look.frame_size, "spheres": look.spheres, "camera": look.camera, **task.annotate(world)}
        if look.overlay and task.dim == 2:
            annotations["grid"] = task.shares(world)
        speeds = (0.0, task.reference_speed) if look.colour == "speed" else None
        return picture(self.solver, world, colour=look.colour, value_range=speeds, **annotations)

    def _outcome(self) -> Outcome:
        task = self.task
        return Outcome(
            task.observe(self._output), task.reward(), task.terminated(), self._steps >= self._limit, task.info()
        )


def opened(runner: Runner | None, call: str, begun: bool = False) -> Runner:
    """The runner of an environment, if the call can be made.

    Args:
        runner: None once the environment is closed.
        call: What the user calls.
        begun: Whether it needs a reset before.

    Raises:
        ClosedEnvironmentError: The environment is closed.
        ResetNeeded: There was no reset yet.
    """
    if runner is None:
        raise ClosedEnvironmentError(f"{call} was used after close; make a new environment")
    if begun and runner.needs_seed():
        raise ResetNeeded(f"{call} was called before reset; call reset() first")
    return runner


def check_seed(seed: Any) -> int | None:
    """A seed of one world, or None.

    Raises:
        ValueError: It is neither None nor a whole number of 0 or more.
    """
    if seed is None:
        return None
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed = {seed!r} must be a whole number of 0 or more; give one, or None to go on")
    return int(seed)
