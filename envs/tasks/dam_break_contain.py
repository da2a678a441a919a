"""Keep a collapsing column of water in the left part of a tank with its moving right wall."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np

from fluidgym.envs import rewards
from fluidgym.envs.actuators import Drive
from fluidgym.envs.fluid_task import GRAVITY, Level, check_range
from fluidgym.envs.task import Gate
from fluidgym.envs.wall_task import WALL, WallTask
from fluidgym.scene import Body, Box, Face, Fluid, Particles, Scene

# The tank is that of the dam break everybody measures: a column twice as wide as high in a tank 5.366 heights long.
HEIGHT = 0.6  # H, of the column [m]
WIDTH = 2.0 * HEIGHT  # of the column along x [m]
LENGTH = 5.366 * HEIGHT  # of the tank [m]
BOX = {2: (LENGTH, 2.5 * HEIGHT), 3: (LENGTH, HEIGHT, 2.5 * HEIGHT)}  # [m]
TRAVEL = (2.6 * HEIGHT, LENGTH)  # of the wall [m]
ZONE_WIDTH = 3.0 * HEIGHT  # [m]
ZONE_HEIGHT = 0.8 * HEIGHT  # [m]
SPLASH_HEIGHT = 1.2 * HEIGHT  # [m]
VARIATION = 0.2  # most that a column's width and height differ, as a share
GATE_OPEN = 0.5 * HEIGHT  # how high a gate is over the floor at the start [m]
GATE_THICK = 0.05  # [m]
CLOSING = 4.0  # speed of the wall for each metre that is left, over the largest, of the scripted controller [1/m]
COLUMNS_KEPT = 48  # sampled columns that a task keeps: all there are at the default resolution and variation


class DamBreakContain(WallTask):
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
    or narrower and higher or lower by up to `variation` of a fifth, its particles shifted by up to `jitter` of their
    spacing.

    The resolution counts particles over the height H of the column, and so do the dam breaks of the validation suite
    that stand for the task. They have its column, 2 H wide and in 3D H/2 deep, in a tank of its length; in 3D theirs is
    no deeper than the column.
    """

    resolutions: ClassVar = {
        2: {"fast": 12, "balanced": 16, "accurate": 32},
        3: {"fast": 8, "balanced": 10, "accurate": 16},
    }
    gates: ClassVar = {2: Gate("dam-break"), 3: Gate("dam-break-3d")}

    title = "DamBreakContain"
    acts: ClassVar = ("wall",)
    boxes: ClassVar = BOX
    counted = ("the column's height", HEIGHT)
    grids: ClassVar = {2: (10, 20), 3: (6, 3, 12)}
    levels: ClassVar = {
        "easy": Level("fast", variation=0.25, resolution={2: 10}, grids={2: (5, 10)}, interval=0.1),
        "medium": Level(),
        "hard": Level(variation=1.0, disturbance=0.05, viscosity=1e-3, resolution={2: 24, 3: 12}),
    }
    gain = "containment"
    costs: ClassVar = {"effort": 0.05, "splash": 0.2, "spread": 0.1}
    numbers: ClassVar = [(0.0, 1.0), (-1.0, 1.0)]

    def __init__(
        self,
        command: str = "velocity",
        max_wall_speed: float = 1.5,
        max_wall_acceleration: float = 8.0,
        depth: float | None = None,
        **common: Any,
    ):
        """Pose the task.

        Args:
            command: "velocity" or "acceleration".
            max_wall_speed: [m/s].
            max_wall_acceleration: [m/s2].
            depth: Only in 3D: the share of the tank's depth that the column takes; 1 makes the 2D flow of a slice, None
                is 0.5.
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        super().__init__(**common)
        if depth is not None and self.dim == 2:
            raise ValueError(f"depth = {depth!r} is for 3D only; leave it out in 2D")
        self.depth = check_range("depth", 0.5 if depth is None else depth, 0.1, 1.0, "0.5")
        self.wall = self.driven(max_wall_speed, max_wall_acceleration, command)
        self._column = lru_cache(COLUMNS_KEPT)(partial(_column, self.dim, self.spacing))
        self.reference_speed = 2.0 * math.sqrt(GRAVITY * HEIGHT)
        self.scene = self.whole_scene(self._columns(1.0 + VARIATION * self.variation))

    def driven(self, speed: float, acceleration: float, command: str) -> Drive:
        """What an action drives: the right wall."""
        names = "max_wall_speed", "max_wall_acceleration"
        return Drive(TRAVEL, speed, acceleration, command, self.control_interval, names)

    def whole_scene(self, column: tuple[int, ...]) -> Scene:
        """The tank with a column of so many particles along each axis, and what is driven."""
        faces = {WALL: Face(moving=True, travel=TRAVEL)}
        return _scene(self.dim, self.spacing, column, faces=faces, material=self.material())

    def zone(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower left part of the tank."""
        return (0.0,) * self.dim, (ZONE_WIDTH, *BOX[self.dim][1:-1], ZONE_HEIGHT)

    def splash_height(self) -> float:
        """A fifth above the top of the column at rest."""
        return SPLASH_HEIGHT

    # -- a start -------------------------------------------------------------------------------------------------

    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """A column of a size of its own."""
        width, height = 1.0 + VARIATION * self.variation * rng.uniform(-1.0, 1.0, 2)
        return self._column(self._columns(width, height))

    def _columns(self, width: float, height: float | None = None) -> tuple[int, ...]:
        """Particles along each axis of a column that is so many times as wide and as high as the nominal one."""
        wide = max(1, round(width * WIDTH / self.spacing))
        high = round((width if height is None else height) * HEIGHT / self.spacing)
        if self.dim == 2:
            return wide, high
        return wide, max(1, round(self.depth * BOX[3][1] / self.spacing)), high

    def state(self) -> list[np.ndarray]:
        """The wall."""
        low, high = self.wall.travel
        return [(self.position - low) / (high - low), self.velocity / self.wall.max_speed]

    def parts(self) -> dict[str, np.ndarray]:
        """Containment, effort, splash and spread."""
        fluid, width = self.fluid, self.scene.upper[0] - self.scene.lower[0]
        return {
            "containment": rewards.containment(fluid["in_zone"]),
            "effort": self._effort.copy(),
            "splash": rewards.splash(fluid["above"]),
            "spread": rewards.spread(fluid["spread"], width),
        }

    def scripted(self) -> np.ndarray:
        """Close in and hold."""
        return self.wall.towards(CLOSING * self.wall.max_speed * (ZONE_WIDTH - self.position), self.velocity)[:, None]


class DamBreakGate(DamBreakContain):
    """A column of water collapses; a gate over the edge of the target zone comes down to keep it there.

    Action (1,): velocity or acceleration of the gate as a share of the largest, positive upwards.

    Observation: as in DamBreakContain, with the height of the gate (0 to 1 over its travel) and its velocity.

    Reward: as in DamBreakContain. What has passed before the gate is down stays out, unless the gate is lifted when it
    comes back from the far wall.
    """

    title = "DamBreakGate"
    acts: ClassVar = ("gate",)

    def __init__(
        self,
        command: str = "velocity",
        max_gate_speed: float = 2.0,
        max_gate_acceleration: float = 20.0,
        depth: float | None = None,
        **common: Any,
    ):
        """Pose the task.

        Args:
            command: "velocity" or "acceleration".
            max_gate_speed: [m/s].
            max_gate_acceleration: [m/s2].
            depth: As in DamBreakContain.
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        super().__init__(command, max_gate_speed, max_gate_acceleration, depth, **common)

    def driven(self, speed: float, acceleration: float, command: str) -> Drive:
        """What an action drives: the gate."""
        names = "max_gate_speed", "max_gate_acceleration"
        return Drive((0.0, GATE_OPEN), speed, acceleration, command, self.control_interval, names)

    def whole_scene(self, column: tuple[int, ...]) -> Scene:
        """The tank with the gate above the floor."""
        dim, size = self.dim, BOX[self.dim]
        low = (ZONE_WIDTH, *[0.0] * (dim - 2), GATE_OPEN)
        high = (ZONE_WIDTH + GATE_THICK, *size[1:-1], GATE_OPEN + size[-1])
        travel = (*[0.0] * (dim - 1), -GATE_OPEN), (0.0,) * dim
        gate = Body(Box(low, high), moving=True, travel=travel)
        return _scene(dim, self.spacing, column, bodies={"gate": gate}, material=self.material())

    def push(self, velocity: np.ndarray) -> None:
        """Give the gates their velocities."""
        self.solver.body_velocity[:, 0, -1] = velocity

    def look(self) -> tuple[np.ndarray, np.ndarray]:
        """Height of the gates' lower edges over the floor [m] and their velocities [m/s]."""
        bodies, middle = self.solver.state.bodies, 0.5 * BOX[self.dim][-1]
        height = bodies.position.numpy()[:, 0, -1].astype(float) - middle
        return height, bodies.velocity.numpy()[:, 0, -1].astype(float)

    def info(self) -> dict[str, np.ndarray]:
        """What every task tells, and the gate [m, m/s]."""
        told = super().info()
        return told | {"gate_height": told.pop("wall_position"), "gate_velocity": told.pop("wall_velocity")}

    def scripted(self) -> np.ndarray:
        """Shut the gate at once, and lift it a little while what has passed comes back."""
        back = self.fluid["velocity"][:, 0] < -0.05
        late = self.time() > 1.0
        wanted = np.where(back & late & (self.fluid["in_zone"] < 0.95), 0.2 * GATE_OPEN, 0.0)
        return self.wall.towards((wanted - self.position) / self.wall.interval, self.velocity)[:, None]


def close_in(info: Mapping[str, Any], target: float = ZONE_WIDTH, gain: float = CLOSING) -> np.ndarray:
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


def _scene(dim: int, spacing: float, particles: tuple[int, ...], **more: Any) -> Scene:
    """The box with a column of so many particles along each axis, and whatever else."""
    corner = tuple(count * spacing for count in particles)
    return Scene(
        lower=(0.0,) * dim,
        upper=BOX[dim],
        particle_spacing=spacing,
        fluid=[Fluid(Box((0.0,) * dim, corner), pressure="released")],
        gravity=GRAVITY,
        **more,
    )
