"""Spread a lump of water evenly over the floor of a box by tilting it."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from fluidgym.checks import check_number
from fluidgym.envs import rewards
from fluidgym.envs.actuators import Drive
from fluidgym.envs.fluid_task import GRAVITY, FluidTask, Level, check_range
from fluidgym.envs.task import Gate
from fluidgym.scene import Box, Fluid, Particles, Scene
from fluidgym.solver import Solver

HEIGHT = 0.5  # H, of the lump [m]
WIDTH = 0.5  # of the lump [m]
LENGTH = 2.0  # of the box [m]


class SpreadEven(FluidTask):
    """A lump of water falls apart in a box; tilting that is to spread the water evenly over the floor, soon.

    Action (1,): how fast the slope of the floor changes or, with command="acceleration", how fast that does, as a share
    of the largest. Positive raises the left end, so that the water runs to the right. The box turns slowly enough for
    the slope to be a turn of gravity and no more.

    Observation: the fluid on a coarse grid; the slope and its rate of change (-1 to 1), and the time.

    Reward, from -0.15 to 1: evenness - 0.1 splash - 0.05 effort. Evenness is 1 where the water is equally deep
    everywhere and 0 where all of it is in one column of the grid; splash the share of the water above 0.3 m.

    Left alone the water runs from wall to wall until friction stops it.
    """

    title = "SpreadEven"
    acts: ClassVar = ("tilt",)
    boxes: ClassVar = {2: (LENGTH, 0.9)}
    counted = ("the height of the lump", HEIGHT)
    resolutions: ClassVar = {2: {"fast": 14, "balanced": 18, "accurate": 36}}
    gates: ClassVar = {2: Gate("dam-break")}
    grids: ClassVar = {2: (6, 20)}
    levels: ClassVar = {
        "easy": Level("fast", variation=0.3, resolution={2: 12}, grids={2: (3, 10)}, interval=0.1),
        "medium": Level(variation=0.7),
        "hard": Level(variation=1.0, disturbance=0.02, viscosity=1e-3, resolution={2: 24}),
    }
    memory = ("slope", "rate")
    gain = "evenness"
    costs: ClassVar = {"splash": 0.1, "effort": 0.05}
    numbers: ClassVar = [(-1.0, 1.0), (-1.0, 1.0)]

    def __init__(self, command: str = "velocity", max_slope: float = 0.2, max_rate: float = 0.8, **common: Any):
        """Pose the task.

        Args:
            command: "velocity" drives the rate of change of the slope, "acceleration" how fast that changes.
            max_slope: Largest slope of the floor, as a tangent.
            max_rate: Largest rate of change of the slope [1/s].
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        super().__init__(**common)
        check_range("max_slope", max_slope, 0.01, 1.0, "0.1 to 0.3")
        check_number("max_rate", max_rate, "1/s", above=0.0)
        self.tilt = Drive((-max_slope, max_slope), max_rate, 8.0 * max_rate, command, self.control_interval)
        self.reference_speed = math.sqrt(2.0 * GRAVITY * HEIGHT)
        self._width = round(WIDTH / self.spacing) * self.spacing
        self.scene = self._scene(0.0)

    def _scene(self, left: float) -> Scene:
        """The box with the lump so far from the left wall."""
        return Scene(
            lower=(0.0, 0.0),
            upper=self.boxes[2],
            particle_spacing=self.spacing,
            fluid=[Fluid(Box((left, 0.0), (left + self._width, HEIGHT)))],
            gravity=GRAVITY,
            material=self.material(),
            reference_speed=self.reference_speed,
        )

    def attach(self, solver: Solver) -> None:
        """Take the worlds, and level the boxes."""
        super().attach(solver)
        self.slope, self.rate = np.zeros(solver.num_worlds), np.zeros(solver.num_worlds)

    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """The lump, somewhere near the left wall or, with much variation, anywhere."""
        places = round((LENGTH - self._width) / self.spacing)
        left = round(self.variation * rng.uniform(0.0, 1.0) * places) * self.spacing
        return self._scene(left).sample()

    def begin(self, worlds: np.ndarray) -> None:
        """Level some boxes."""
        self.slope[worlds], self.rate[worlds] = 0.0, 0.0
        super().begin(worlds)

    def drive(self, actions: np.ndarray) -> None:
        """Tilt the box: gravity turns."""
        tilt, before = self.tilt, self.rate
        self.rate = tilt.next_velocity(actions[:, 0], self.slope, before)
        self.slope = self.slope + 0.5 * (before + self.rate) * tilt.interval
        down = GRAVITY / np.sqrt(1.0 + self.slope * self.slope)
        self.solver.gravity[:, 0], self.solver.gravity[:, 1] = down * self.slope, -down
        self._effort = tilt.effort(self.rate, before)

    def state(self) -> list[np.ndarray]:
        """The slope and its rate."""
        return [self.slope / self.tilt.travel[1], self.rate / self.tilt.max_speed]

    def parts(self) -> dict[str, np.ndarray]:
        """Evenness, splash and effort."""
        return {
            "evenness": rewards.evenness(self.depths()),
            "splash": rewards.splash(self.fluid["above"]),
            "effort": self._effort.copy(),
        }

    def splash_height(self) -> float:
        """A good part of the lump's own."""
        return 0.6 * HEIGHT

    def info(self) -> dict[str, np.ndarray]:
        """What every task tells, and the slope."""
        return super().info() | {"slope": self.slope.copy()}

    def scripted(self) -> np.ndarray:
        """Tilt against where the water is and where it runs to, so that it comes to rest in the middle."""
        off = self.fluid["middle"][:, 0] - 0.5 * LENGTH
        wanted = (-0.15 * off - 0.25 * self.fluid["velocity"][:, 0]).clip(-0.18, 0.18)
        return self.tilt.towards((wanted - self.slope) / (2.0 * self.tilt.interval), self.rate)[:, None]
