"""Keep a collapsing column of water in the left part of a tank with its moving right wall."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces

from fluidgym.envs import observations, rewards
from fluidgym.envs.actuators import DrivenWall
from fluidgym.envs.task import Gate, Task
from fluidgym.scene import Box, Face, Fluid, Particles, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.measure import Measure

# The tank is that of the dam break everybody measures: a column twice as wide as high in a tank 5.366 heights long.
WALL = "x_max"
HEIGHT = 0.6  # H, of the column [m]
WIDTH = 2.0 * HEIGHT  # of the column along x [m]
LENGTH = 5.366 * HEIGHT  # of the tank [m]
BOX = {2: (LENGTH, 2.5 * HEIGHT), 3: (LENGTH, HEIGHT, 2.5 * HEIGHT)}  # [m]
TRAVEL = (2.6 * HEIGHT, LENGTH)  # of the wall [m]
ZONE_WIDTH = 3.0 * HEIGHT  # [m]
ZONE_HEIGHT = 0.8 * HEIGHT  # [m]
SPLASH_HEIGHT = 1.2 * HEIGHT  # [m]
GRID = {2: (10, 20), 3: (6, 3, 12)}
WEIGHTS = {"effort": 0.05, "splash": 0.2, "spread": 0.1}
GRAVITY = 9.81  # [m/s2]
COLUMNS_KEPT = 48  # sampled columns that a task keeps: all there are at the default resolution and variation

# Past this a world has blown up, though its numbers may still be finite: impacts reach 0.1 to 0.2.
LARGEST_DENSITY_ERROR = 0.5


class DamBreakContain(Task):
    """A column of water collapses; the right wall moves to keep it in a target zone at the left.

    Action (1,): velocity or acceleration of the wall as a share of the largest, positive to the right. The wall is
    limited in speed and acceleration and brakes before the ends of its travel.

    Observation: fluid fraction 0 to 2 and momentum -1 to 1 (over full cells at 2 sqrt(g H)) on a coarse grid over the
    box; beside it the wall's position (0 to 1 over its travel), its velocity (-1 to 1) and the time (0 to 1 over the
    episode).

    Reward, from -0.35 to 1 with the default weights: containment - 0.05 effort - 0.2 splash - 0.1 spread, where
    containment is the share of the fluid in the zone x < 1.8 m, height < 0.48 m; splash the share above 0.72 m; spread
    its width; effort that of the wall. A world that has diverged gets the lowest reward and is terminated.

    An episode is truncated after `episode` seconds, whatever the control interval. Each has a column of its own, wider
    or narrower and higher or lower by up to `variation`, its particles shifted by up to `jitter` of their spacing.

    The resolution counts particles over the height H of the column, and so do the dam breaks of the validation suite
    that stand for the task. They have its column, 2 H wide and in 3D H/2 deep, in a tank of its length; in 3D theirs is
    no deeper than the column.
    """

    resolutions: ClassVar = {
        2: {"fast": 12, "balanced": 16, "accurate": 32},
        3: {"fast": 8, "balanced": 10, "accurate": 16},
    }
    gates: ClassVar = {2: Gate("dam-break"), 3: Gate("dam-break-3d")}

    def __init__(
        self,
        dim: int = 2,
        resolution: int | None = None,
        command: str = "velocity",
        obs: str = "flat",
        grid: Sequence[int] | None = None,
        control_interval: float = 0.05,
        episode: float = 4.0,
        max_wall_speed: float = 1.5,
        max_wall_acceleration: float = 8.0,
        variation: float = 0.1,
        jitter: float = 0.05,
        depth: float | None = None,
        weights: Mapping[str, float] | None = None,
        scheme: Scheme | None = None,
        fidelity: str | None = None,
    ):
        """Pose the task.

        Args:
            dim: 2 or 3.
            resolution: Particles over the height of the column; None is that of the fidelity: 12, 16 or 32 in 2D, 8, 10
                or 16 in 3D.
            command: "velocity" or "acceleration".
            obs: "flat" is one vector, "grid" (channel, ny, nx) or (channel, nz, ny, nx).
            grid: Cells of the coarse grid, (ny, nx) or (nz, ny, nx); None is (10, 20) or (6, 3, 12).
            control_interval: Time between actions [s].
            episode: How long an episode is [s]; rounded up to whole control intervals.
            max_wall_speed: [m/s].
            max_wall_acceleration: [m/s2].
            variation: Largest change of the column's width and height from episode to episode, as a share.
            jitter: Largest shift of each start position, as a share of the particle spacing.
            depth: Only in 3D: the share of the tank's depth that the column takes; 1 makes the 2D flow of a slice, None
                is 0.5.
            weights: Of effort, splash and spread in the reward; those not named keep their default.
            scheme: How the fluid is simulated; None is as the fidelity has it.
            fidelity: "fast", "balanced" or "accurate", a trade-off between run time and error: the scheme, and the
                resolution unless that is given; None is "balanced". Not together with a scheme.

        Raises:
            ValueError: An argument is out of its limits.
        """
        if dim not in tuple(BOX):
            raise ValueError(f"dim = {dim!r} is unknown; use 2 or 3")
        usual = self.choose_fidelity(dim, fidelity, scheme)
        resolution = usual if resolution is None else resolution
        _check_range("resolution", resolution, 8, 512, f"{usual}", "particles over the column's height")
        if resolution != int(resolution):
            raise ValueError(f"resolution = {resolution} must be a whole number; use {round(resolution)}")
        _check_range("control_interval", control_interval, 0.005, 0.5, "0.05", "s")
        _check_range("episode", episode, 0.005, 3600.0, "4", "s")
        _check_range("variation", variation, 0.0, 0.2, "0.1")
        _check_range("jitter", jitter, 0.0, 0.25, "0.05")
        if depth is not None and dim == 2:
            raise ValueError(f"depth = {depth!r} is for 3D only; leave it out in 2D")
        depth = 0.5 if depth is None else depth
        _check_range("depth", depth, 0.1, 1.0, "0.5")
        observations.check_kind(obs)
        self.dim, self.resolution, self.obs = dim, int(resolution), obs
        self.control_interval, self.episode = control_interval, episode
        self.max_episode_steps = max(1, math.ceil(episode / control_interval - 1e-9))
        self.wall = DrivenWall(TRAVEL, max_wall_speed, max_wall_acceleration, command, control_interval)
        self.grid = observations.check_grid(GRID[dim] if grid is None else grid, dim)
        self.weights = _all_weights(weights)
        self.variation, self.jitter, self.depth = variation, jitter, depth
        self.spacing = HEIGHT / resolution
        self._column = lru_cache(COLUMNS_KEPT)(partial(_column, dim, self.spacing))
        self.reference_speed = 2.0 * math.sqrt(GRAVITY * HEIGHT)
        self.zone = ((0.0,) * dim, (ZONE_WIDTH, *BOX[dim][1:-1], ZONE_HEIGHT))
        self.scene = _scene(dim, self.spacing, self._columns(1.0 + variation))
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = observations.space(obs, self.grid, [(0.0, 1.0), (-1.0, 1.0), (0.0, 1.0)])

    # -- a start -------------------------------------------------------------------------------------------------

    def start(self, rng: np.random.Generator) -> Particles:
        """A column of a size of its own, on the lattice, with its particles a little out of place."""
        width, height = 1.0 + self.variation * rng.uniform(-1.0, 1.0, 2)
        column = self._column(self._columns(width, height))
        shift = self.jitter * self.spacing * rng.uniform(-1.0, 1.0, column.position.shape)
        return replace(column, position=column.position + shift)

    def _columns(self, width: float, height: float | None = None) -> tuple[int, ...]:
        """Particles along each axis of a column that is so many times as wide and as high as the nominal one."""
        wide = max(1, round(width * WIDTH / self.spacing))
        high = round((width if height is None else height) * HEIGHT / self.spacing)
        if self.dim == 2:
            return wide, high
        return wide, max(1, round(self.depth * BOX[3][1] / self.spacing)), high

    def attach(self, solver: Solver) -> None:
        """Take the worlds, and lay out the coarse grid and the marks."""
        super().attach(solver)
        scene, worlds = self.scene, solver.num_worlds
        self._deposit = observations.deposit(solver, self.grid, self.reference_speed)
        self._measure = Measure(
            scene.lower,
            scene.upper,
            self.zone,
            SPLASH_HEIGHT,
            scene.particle_spacing,
            worlds,
            solver.capacity,
            solver.device,
        )
        self._face = solver.face_index(WALL)
        self._steps = np.zeros(worlds, int)
        self._effort = np.zeros(worlds)
        self._mass = np.zeros(worlds, int)
        self._clamped_before = np.zeros(worlds, int)

    def begin(self, worlds: np.ndarray) -> None:
        """Forget the last episode of some worlds."""
        self.measure()
        self._clamped[:] = 0  # a start is not a step
        self._steps[worlds] = 0
        self._effort[worlds] = 0.0
        self._mass[worlds] = self._fluid["live"][worlds]

    # -- a step --------------------------------------------------------------------------------------------------

    def apply_action(self, actions: np.ndarray) -> None:
        """Move the wall as far as its limits let it."""
        wall, before = self.wall, self._velocity
        velocity = wall.next_velocity(actions[:, 0], self._position, before)
        self.solver.face_velocity[:, self._face] = velocity
        speed = velocity / wall.max_speed
        acceleration = (velocity - before) / (wall.max_acceleration * wall.interval)
        self._effort = rewards.effort(speed, acceleration)
        self._steps += 1

    def measure(self) -> None:
        """Look at the fluid and at the wall."""
        now, faces = self.solver.state.now, self.solver.state.faces
        self._fluid = self._measure.run(now.position, now.velocity, now.density_error, now.identity)
        self._position = faces.position.numpy()[:, self._face].astype(float)
        self._velocity = faces.velocity.numpy()[:, self._face].astype(float)
        clamped = self.solver.state.clamped.numpy().astype(int)
        self._clamped, self._clamped_before = clamped - self._clamped_before, clamped

    def observe(self) -> np.ndarray:
        """The coarse grid, the wall and the time."""
        now, (low, high) = self.solver.state.now, TRAVEL
        grid = self._deposit.run(now.position, now.velocity, now.identity)
        position = ((self._position - low) / (high - low)).clip(0.0, 1.0)
        velocity = (self._velocity / self.wall.max_speed).clip(-1.0, 1.0)
        time = (self._time() / self.episode).clip(0.0, 1.0)
        return observations.assemble(self.obs, grid, np.stack([position, velocity, time], axis=1))

    def reward(self) -> np.ndarray:
        """Containment less effort, splash and spread."""
        parts = self._parts()
        reward = rewards.total(parts.pop("containment"), parts, self.weights)
        return np.where(self.terminated(), rewards.lowest(self.weights), reward)

    def terminated(self) -> np.ndarray:
        """Worlds that have diverged: numbers that are not finite or not credible, or fluid that is gone."""
        fluid = self._fluid
        lost = fluid["live"] < self._mass
        return (fluid["broken"] > 0) | lost | (fluid["density_error"] > LARGEST_DENSITY_ERROR)

    def info(self) -> dict[str, np.ndarray]:
        """The parts of the reward, time [s], wall [m, m/s], mass [kg], divergence, penetrations put right."""
        return self._parts() | {
            "time": self._time(),
            "wall_position": self._position.copy(),
            "wall_velocity": self._velocity.copy(),
            "mass": self._fluid["live"] * self.scene.particle_mass,
            "diverged": self.terminated(),
            "clamped": self._clamped.copy(),
        }

    def annotate(self, world: int) -> dict[str, Any]:
        """The zone, the time, and how well it goes."""
        parts = {name: values[world] for name, values in self._parts().items()}
        return {
            "title": f"DamBreakContain{self.dim}D",
            "text": ", ".join(f"{name} {value:.2f}" for name, value in parts.items()),
            "time": float(self._time()[world]),
            "zone": self.zone,
        }

    def _time(self) -> np.ndarray:
        return self._steps * self.control_interval

    def _parts(self) -> dict[str, np.ndarray]:
        fluid, width = self._fluid, self.scene.upper[0] - self.scene.lower[0]
        return {
            "containment": rewards.containment(fluid["in_zone"]),
            "effort": self._effort.copy(),
            "splash": rewards.splash(fluid["above"]),
            "spread": rewards.spread(fluid["spread"], width),
        }


def close_in(info: Mapping[str, Any], target: float = ZONE_WIDTH, gain: float = 4.0) -> np.ndarray:
    """A simple controller for command="velocity": push the wall to the edge of the zone and hold it there.

    Args:
        info: What reset and step return, of one world or of many.
        target: Where to hold the wall [m].
        gain: Wall speed for each metre that is left, over the largest speed [1/m].

    Returns:
        Action (1,) of one world or (world, 1) of many.
    """
    left = target - np.asarray(info["wall_position"], float)
    return np.clip(gain * left, -1.0, 1.0)[..., None].astype(np.float32)


def _column(dim: int, spacing: float, particles: tuple[int, ...]) -> Particles:
    """A column at rest on the lattice, its dam just gone."""
    return _scene(dim, spacing, particles).sample()


def _scene(dim: int, spacing: float, particles: tuple[int, ...]) -> Scene:
    """The box with a column of so many particles along each axis."""
    corner = tuple(count * spacing for count in particles)
    return Scene(
        lower=(0.0,) * dim,
        upper=BOX[dim],
        particle_spacing=spacing,
        fluid=[Fluid(Box((0.0,) * dim, corner), pressure="released")],
        faces={WALL: Face(moving=True, travel=TRAVEL)},
        gravity=GRAVITY,
    )


def _all_weights(given: Mapping[str, float] | None) -> dict[str, float]:
    """The weights of the costs, those not given at their default."""
    weights = dict(WEIGHTS)
    if given is not None and not isinstance(given, Mapping):
        raise ValueError(f"weights = {given!r} is not a mapping; give one, such as {WEIGHTS}")
    for name, value in (given or {}).items():
        if name not in weights:
            raise ValueError(f"weights has no {name!r}; use {', '.join(weights)}")
        _check_range(f"weights[{name!r}]", value, 0.0, 10.0, f"{weights[name]:g}")
        weights[name] = float(value)
    return weights


def _check_range(name: str, value: float, low: float, high: float, advice: str, unit: str = "") -> None:
    """Refuse a number outside its range."""
    if not (isinstance(value, int | float | np.number) and low <= value <= high):
        raise ValueError(f"{name} = {value!r} {unit}".rstrip() + f" is outside {low:g} to {high:g}; use {advice}")
