"""What the tasks have in common: how they are posed, disturbed, seen and paid. A task adds a scene and its parts."""

from __future__ import annotations

import inspect
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import warp as wp
from gymnasium import spaces

from fluidgym.checks import check_choice, check_type
from fluidgym.diagnostics import LARGEST_COMPRESSION, LARGEST_VOID
from fluidgym.envs import observations, rewards
from fluidgym.envs.task import Task
from fluidgym.scene import Material, Particles
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.measure import Measure

GRAVITY = 9.81  # [m/s2]

# Past this a world has blown up, as past LARGEST_COMPRESSION and LARGEST_VOID: the worst actions come to half of it.
LARGEST_SPEED = 1.0  # over that of sound

# What every task remembers of each world.
_MEMORY = ("_steps", "_shaking", "_viscosities", "_effort")


@dataclass(frozen=True)
class Level:
    """What a difficulty stands for; an option that is given by itself comes before it.

    Attributes:
        fidelity: Key of `FIDELITIES`.
        variation: How much the starts differ, over the most a task allows.
        disturbance: Largest sideways acceleration of the ground over gravity.
        viscosity: Largest kinematic viscosity of the fluid [m2/s]; every episode draws its own from 0 to this.
        resolution: By dimension, where it is not that of the fidelity.
        grids: Cells of the coarse grid by dimension, where they are not the task's.
        interval: Time between actions [s], where it is not the task's.
    """

    fidelity: str = "balanced"
    variation: float = 0.5
    disturbance: float = 0.0
    viscosity: float = 0.0
    resolution: Mapping[int, int] = field(default_factory=dict)
    grids: dict[int, tuple[int, ...]] = field(default_factory=dict)
    interval: float | None = None


class FluidTask(Task):
    """A box of fluid with something that an action drives.

    An observation is the fluid on a coarse grid and a few numbers, the last of them the time (0 to 1 over the episode).
    A reward is a gain in 0 to 1 less weighted costs in 0 to 1. A world that has diverged (numbers that are not finite
    or not credible) gets the lowest reward and is terminated.

    Attributes:
        title: As a drawing has it.
        boxes: Size of the box by dimension [m].
        counted: What the resolution counts particles over, in words, and how long that is [m].
        grids: Cells of the coarse grid by dimension, (ny, nx) or (nz, ny, nx).
        interval: Time between actions [s].
        duration: Of an episode [s].
        levels: The difficulties.
        gain: Which of the parts is the gain; the others are costs.
        costs: Their weights.
        numbers: Lowest and highest of each number beside the grid, the time aside.
        memory: Names of what is kept of each world from step to step, arrays (world, ...).
        acts: What the numbers of an action are, in words.
        actions: How many there are.
        dim: Number of dimensions.
        difficulty: Key of `levels`.
        weights: Of the costs.
        fluid: What `Measure` found of the fluid.
    """

    title: ClassVar[str]
    boxes: ClassVar[Mapping[int, tuple[float, ...]]]
    counted: ClassVar[tuple[str, float]]
    grids: ClassVar[dict[int, tuple[int, ...]]]
    interval: ClassVar[float] = 0.05
    duration: ClassVar[float] = 4.0
    levels: ClassVar[Mapping[str, Level]]
    gain: ClassVar[str]
    costs: ClassVar[Mapping[str, float]]
    numbers: Sequence[tuple[float, float]]
    memory: ClassVar[Sequence[str]] = ()
    acts: ClassVar[Sequence[str]]
    actions: int = 1
    fluid: dict[str, np.ndarray]

    def __init__(
        self,
        dim: int = 2,
        difficulty: str = "medium",
        resolution: int | None = None,
        obs: str = "flat",
        grid: Sequence[int] | None = None,
        solid: bool = False,
        stack: int = 1,
        control_interval: float | None = None,
        episode: float | None = None,
        variation: float | None = None,
        disturbance: float | None = None,
        viscosity: float | None = None,
        jitter: float = 0.05,
        weights: Mapping[str, float] | None = None,
        scheme: Scheme | None = None,
        fidelity: str | None = None,
    ):
        """Pose the task.

        Args:
            dim: Number of dimensions.
            difficulty: "easy", "medium" or "hard": fidelity, resolution, grid, control interval, and how far starts,
                disturbance and viscosity range, unless they are given.
            resolution: Particles over the length that the task counts them along; None is that of the
                fidelity or, if neither that nor a scheme is given, of the difficulty.
            obs: "flat" is one vector, "grid" (channel, ny, nx) or (channel, nz, ny, nx), "image", in 2D, uint8 (row,
                column, channel), at least 40 pixels each way.
            grid: Cells of the coarse grid, (ny, nx) or (nz, ny, nx).
            solid: Whether the share of each cell that is solid is observed, too.
            stack: Frames of an observation, the latest last.
            control_interval: Time between actions [s].
            episode: How long an episode is [s]; rounded up to whole control intervals.
            variation: How much the starts differ, 0 to 1.
            disturbance: Largest sideways acceleration of the ground over gravity, 0 to 0.5. Each episode has its own
                strength, frequency and phase.
            viscosity: Largest kinematic viscosity [m2/s]; each episode draws its own from 0 to this.
            jitter: Largest shift of each start position, as a share of the particle spacing.
            weights: Of the costs in the reward; those not named keep their default.
            scheme: How the fluid is simulated; None is as the fidelity has it.
            fidelity: "fast", "balanced" or "accurate", a trade-off between run time and error: the scheme, and the
                resolution unless that is given. Not together with a scheme.

        Raises:
            ValueError: An argument is out of its limits.
        """
        if not isinstance(dim, int) or dim not in tuple(self.boxes):
            raise ValueError(f"dim = {dim!r} is unknown; use {' or '.join(map(str, self.boxes))}")
        check_choice("difficulty", difficulty, tuple(self.levels), ", ".join(map(repr, self.levels)))
        level = self.levels[difficulty]
        asked = fidelity if fidelity is not None or scheme is not None else level.fidelity
        usual = self.choose_fidelity(dim, asked, scheme)
        if fidelity is None and scheme is None:
            usual = level.resolution.get(dim, usual)
        self.dim, self.difficulty, self.obs = dim, difficulty, obs
        self.resolution = self._whole("resolution", resolution, usual)
        self.control_interval = _number(
            "control_interval", control_interval, level.interval or self.interval, 0.005, 0.5, "s"
        )
        self.episode = _number("episode", episode, self.duration, 0.005, 3600.0, "s")
        self.variation = _number("variation", variation, level.variation, 0.0, 1.0)
        self.disturbance = _number("disturbance", disturbance, level.disturbance, 0.0, 0.5)
        self.viscosity = _number("viscosity", viscosity, level.viscosity, 0.0, 0.1, "m2/s")
        self.jitter = _number("jitter", jitter, 0.05, 0.0, 0.25)
        observations.check_kind(obs)
        self.grid = observations.check_grid((self.grids | level.grids)[dim] if grid is None else grid, dim)
        self.weights = _all_weights(self.costs, weights)
        self.max_episode_steps = max(1, math.ceil(self.episode / self.control_interval - 1e-9))
        self.spacing = self.counted[1] / self.resolution
        self.action_space = spaces.Box(-1.0, 1.0, (self.actions,), np.float32)
        check_type("solid", solid, bool, "a bool", "True or False")
        self.view = observations.View(obs, self.grid, [*self.numbers, (0.0, 1.0)], solid, stack)
        self.observation_space = self.view.space

    @classmethod
    def check_options(cls, options: Mapping[str, Any]) -> None:
        """Refuse options that neither the task nor all of them have.

        Raises:
            ValueError: There is no such option.
        """
        own, common = (list(inspect.signature(of).parameters) for of in (cls, FluidTask))
        known = [name for name in own if name != "common"] + [name for name in common if name not in own]
        for name in options:
            if name not in known:
                raise ValueError(f"{cls.__name__} has no option {name!r}; use {', '.join(known)}")

    def action_names(self) -> list[str]:
        """What each number of an action is, in words."""
        return list(self.acts[: self.actions])

    # -- what a task adds ------------------------------------------------------------------------------------------

    @abstractmethod
    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """The fluid of a world at the start of an episode, on its lattice; what else is drawn is kept by world."""

    @abstractmethod
    def state(self) -> list[np.ndarray]:
        """The numbers beside the grid, the time aside, each (world,)."""

    def zone(self) -> tuple[Sequence[float], Sequence[float]]:
        """Corners of the zone that is measured and drawn [m], each (dim,)."""
        return self.scene.lower, self.scene.upper

    def splash_height(self) -> float:
        """What counts as above [m]."""
        return self.scene.upper[-1]

    # -- a start -----------------------------------------------------------------------------------------------------

    def attach(self, solver: Solver) -> None:
        """Take the worlds, and lay out the coarse grid and the marks."""
        super().attach(solver)
        scene, worlds = self.scene, solver.num_worlds
        self._deposit = observations.deposit(solver, self.grid, self.reference_speed)
        self._measure = Measure(
            scene.lower,
            scene.upper,
            self.zone(),
            self.splash_height(),
            scene.particle_spacing,
            worlds,
            solver.capacity,
            solver.device,
        )
        self._frames: list[Any] = []
        self._begun, self._stepped = np.zeros(worlds, bool), False
        self._no_reason = np.full(worlds, "", object)  # as Gymnasium has words in the info of a vector
        self._closed = not scene.outflows and all(face.kind != "open" for face in scene.faces.values())
        self._steps, self._effort = np.zeros(worlds, int), np.zeros(worlds)
        self._shaking = np.zeros((worlds, self.max_episode_steps))
        self._viscosities = np.full(worlds, self.scene.material.viscosity)
        self._clamped_before = np.zeros(worlds, int)

    def start(self, world: int, rng: np.random.Generator) -> Particles:
        """The fluid of a world at the start of an episode, its particles a little out of place."""
        fluid = self.sample(world, rng)
        if self.jitter > 0.0:
            shift = self.jitter * self.spacing * rng.uniform(-1.0, 1.0, fluid.position.shape)
            faces = self.scene.face_start_positions().reshape(-1, 2)
            position = np.clip(fluid.position + self._free(fluid) * shift, faces[:, 0], faces[:, 1])
            fluid = replace(fluid, position=position)
        if self.disturbance > 0.0:
            times = self.control_interval * np.arange(self.max_episode_steps)
            self._shaking[world] = self.disturbance * GRAVITY * self.shaking(rng, times)
        if self.viscosity > 0.0:
            self._viscosities[world] = self.viscosity * rng.uniform(0.05, 1.0)
        return fluid

    def _free(self, fluid: Particles) -> np.ndarray:
        """1 for particles that may be out of place, 0 for those in pipes, (n, 1)."""
        free = np.ones((len(fluid), 1))
        for inflow in self.scene.inflows.values():
            length = inflow.pipe_length(self.spacing) + self.spacing
            free[np.linalg.norm(fluid.position - inflow.center, axis=1) <= length + 0.5 * inflow.width] = 0.0
        return free

    def shaking(self, rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
        """How the ground is shaken in an episode: sideways acceleration over the largest at times [s] (step,)."""
        strength, frequency, phase = rng.uniform(0.5, 1.0), rng.uniform(0.2, 1.5), rng.uniform(0.0, 2.0 * math.pi)
        return strength * np.sin(2.0 * math.pi * frequency * times + phase)

    def material(self) -> Material:
        """Water, or, if viscosity is drawn, something thicker."""
        return Material(viscosity=self.viscosity)

    def begin(self, worlds: np.ndarray) -> None:
        """Forget the last episode of some worlds."""
        if self.viscosity > 0.0:
            self.solver.set_parameters(viscosity=self._viscosities)
        self._steps[worlds], self._effort[worlds] = 0, 0.0
        self._begun |= worlds
        self.measure()
        self._clamped[:] = 0  # a start is not a step

    # -- a step ------------------------------------------------------------------------------------------------------

    def apply_action(self, actions: np.ndarray) -> None:
        """Drive what there is to drive, and shake the ground."""
        self.solver.gravity[:, 0] = 0.0
        self.drive(actions)
        if self.disturbance > 0.0:
            self.solver.gravity[:, 0] -= self.ground()
        self._steps += 1
        self._stepped = True

    def ground(self) -> np.ndarray:
        """Acceleration of the ground in the interval to come [m/s2], (world,)."""
        return self._shaking[np.arange(len(self._steps)), np.minimum(self._steps, self.max_episode_steps - 1)]

    @abstractmethod
    def drive(self, actions: np.ndarray) -> None:
        """Set the solver's controls and the effort for the next interval from actions (world, action) in the space."""

    def measure(self) -> None:
        """Look at the fluid."""
        now = self.solver.state.now
        self.fluid = self._measure.run(now.position, now.velocity, now.density_error, now.identity)
        clamped = self.solver.state.clamped.numpy().astype(int)
        self._clamped, self._clamped_before = clamped - self._clamped_before, clamped
        self._judge()
        self._on_device: Any = None
        self._on_host: Any = None

    def deposited(self) -> wp.array:
        """The fluid on the coarse grid, on the device, (world, 1 + dim, cell)."""
        if self._on_device is None:
            now = self.solver.state.now
            self._on_device = self._deposit.run_on_device(now.position, now.velocity, now.identity)
        return self._on_device

    def coarse(self) -> np.ndarray:
        """The fluid on the coarse grid, (world, 1 + dim, ny, nx) or (world, 1 + dim, nz, ny, nx)."""
        if self._on_host is None:
            self._on_host = self.deposited().numpy().reshape(self._deposit.shape).copy()
        return self._on_host

    def shares(self, world: int) -> np.ndarray:
        """Share of each cell that is fluid, from the lower corner (ny, nx) or (nz, ny, nx)."""
        return self.coarse()[world, 0]

    def depths(self) -> np.ndarray:
        """Depth of the fluid in each column of the coarse grid, averaged over y in 3D [m], (world, nx)."""
        height = self.scene.upper[-1] - self.scene.lower[-1]
        fraction = self.coarse()[:, 0].astype(float)
        return height * fraction.reshape(len(fraction), -1, self.grid[-1]).mean(axis=1)

    def gone(self) -> np.ndarray:
        """Particles that have left the world, (world,)."""
        emitted = self.solver.state.ledger.emitted.numpy().astype(int) if self.scene.inflows else 0
        return self.solver.started + emitted - self.fluid["live"]

    def lost(self) -> np.ndarray:
        """Share of the fluid that has left the world, (world,)."""
        return self.gone() / np.maximum(self.solver.started, 1)

    def observe(self, output: str = "numpy") -> Any:
        """The coarse grid, the task's numbers and the time.

        Args:
            output: "numpy", or "torch" for a tensor on the solver's device, where the grid stays.
        """
        limits = np.asarray(self.numbers, float).reshape(-1, 2)
        state = [values.clip(low, high) for values, (low, high) in zip(self.state(), limits, strict=True)]
        time = (self.time() / self.episode).clip(0.0, 1.0)
        numbers: Any = np.stack([*state, time], axis=1).astype(np.float32)
        solid: list[Any] = [observations.solid_fraction(self.solver, self.grid)] * self.view.solid
        if output == "torch":
            import torch

            grid: Any = wp.to_torch(self.deposited()).reshape(self._deposit.shape)
            numbers, *solid = (torch.as_tensor(part, device=grid.device) for part in (numbers, *solid))
        else:
            grid = self.coarse()
        frame = self.view.frame([grid, *solid], numbers)
        return frame if self.view.stack == 1 else self._stacked(frame)

    def _stacked(self, frame: Any) -> Any:
        """The latest frames of each world; where an episode has begun, its first one again and again."""
        if self._stepped or not self._frames:
            self._frames = [*self._frames, frame][-self.view.stack :]
        self._frames = [frame] * (self.view.stack - len(self._frames)) + self._frames
        of = observations.library(frame)
        on: Any = ~self._begun.reshape(-1, *[1] * (frame.ndim - 1))
        if of is not np:
            on = of.as_tensor(on, device=frame.device)
        self._frames = [of.where(on, kept, frame) for kept in self._frames]
        self._begun[:], self._stepped = False, False
        return observations.joined(self._frames, self.view.axis)

    def reward(self) -> np.ndarray:
        """The gain less the costs."""
        parts = self.parts()
        reward = rewards.total(parts.pop(self.gain), parts, self.weights)
        return np.where(self.diverged(), rewards.lowest(self.weights), reward)

    def diverged(self) -> np.ndarray:
        """Worlds whose numbers are not finite or not credible, bool (world,)."""
        return self._diverged

    def reasons(self) -> np.ndarray:
        """Why worlds have diverged: "not finite", "density", "speed", "mass", or "" where they have not, (world,)."""
        if not self._diverged.any():
            return self._no_reason.copy()
        return np.select(list(self._signs.values()), list(self._signs), "").astype(object)

    def _judge(self) -> None:
        """Find the worlds that have diverged."""
        fluid = self.fluid
        self._signs = {
            "not finite": fluid["broken"] > 0,
            "density": (fluid["compression"] > LARGEST_COMPRESSION) | (fluid["void"] > LARGEST_VOID),
            "speed": fluid["speed"] > LARGEST_SPEED * self.scene.sound_speed,
        }
        if self._closed:
            self._signs["mass"] = self.gone() != 0
        self._diverged = np.logical_or.reduce(list(self._signs.values()))

    def terminated(self) -> np.ndarray:
        """Worlds that have diverged."""
        return self.diverged()

    def get_state(self, world: int) -> dict[str, np.ndarray]:
        """What a world's future depends on besides its solver: what the task remembers, and the frames at hand."""
        state = {name: getattr(self, name)[world].copy() for name in (*_MEMORY, *self.memory)}
        return state | {f"frame_{n}": observations.on_host(frame[world]) for n, frame in enumerate(self._frames)}

    def set_state(self, world: int, state: Mapping[str, np.ndarray]) -> None:
        """Put that back; the solver is as it is to be."""
        for name in (*_MEMORY, *self.memory):
            getattr(self, name)[world] = state[name]
        for n, frame in enumerate(self._frames):
            kept = state[f"frame_{n}"]
            frame[world] = kept if observations.library(frame) is np else observations.library(frame).as_tensor(kept)
        self._begun[world] = False
        self.measure()

    def info(self) -> dict[str, np.ndarray]:
        """The parts of the reward, time [s], mass [kg], divergence and why, penetrations put right, the task's own."""
        return self.parts() | {
            "time": self.time(),
            "mass": self.fluid["live"] * self.scene.particle_mass,
            "diverged": self.diverged(),
            "reason": self.reasons(),
            "clamped": self._clamped.copy(),
        }

    def annotate(self, world: int) -> dict[str, Any]:
        """The zone, if it is not the whole box, the time, and how well it goes."""
        zone = tuple(map(tuple, self.zone()))
        return {
            "title": f"{self.title}{self.dim}D",
            "text": ", ".join(f"{name} {values[world]:.2f}" for name, values in self.parts().items()),
            "time": float(self.time()[world]),
            "zone": None if zone == (self.scene.lower, self.scene.upper) else zone,
        }

    def time(self) -> np.ndarray:
        """Time in the episode [s], (world,)."""
        return self._steps * self.control_interval

    def _whole(self, name: str, given: int | None, usual: int) -> int:
        """A resolution, checked."""
        value = usual if given is None else given
        check_range(name, value, 8, 512, f"{usual}", f"particles over {self.counted[0]}")
        if value != int(value):
            raise ValueError(f"{name} = {value} must be a whole number; use {round(value)}")
        return int(value)


def _number(name: str, given: float | None, usual: float, low: float, high: float, unit: str = "") -> float:
    """An option, checked; None is what is usual."""
    return check_range(name, usual if given is None else given, low, high, f"{usual:g}", unit)


def _all_weights(usual: Mapping[str, float], given: Mapping[str, float] | None) -> dict[str, float]:
    """The weights of the costs, those not given at their default."""
    weights = dict(usual)
    if given is not None and not isinstance(given, Mapping):
        raise ValueError(f"weights = {given!r} is not a mapping; give one, such as {dict(usual)}")
    for name, value in (given or {}).items():
        if name not in weights:
            raise ValueError(f"weights has no {name!r}; use {', '.join(weights)}")
        weights[name] = check_range(f"weights[{name!r}]", value, 0.0, 10.0, f"{weights[name]:g}")
    return weights


def check_range(name: str, value: float, low: float, high: float, advice: str, unit: str = "") -> float:
    """A number, refused outside its range."""
    if not (isinstance(value, int | float | np.number) and low <= value <= high):
        raise ValueError(f"{name} = {value!r} {unit}".rstrip() + f" is outside {low:g} to {high:g}; use {advice}")
    return float(value)
