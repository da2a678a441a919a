"""Let waves run out of a flume: its end is a piston that is to swallow what the wavemaker sends."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from fluidgym.envs import rewards
from fluidgym.envs.actuators import Drive
from fluidgym.envs.fluid_task import GRAVITY, Level
from fluidgym.envs.task import Gate
from fluidgym.envs.wall_task import WALL, WallTask
from fluidgym.scene import Box, Face, Fluid, Particles, Scene
from fluidgym.solver import Solver

DEPTH = 0.4  # H, of the water [m]
LENGTH = 3.0  # of the flume at rest [m]
ROOM = 0.15  # that the piston has to either side [m]
STROKE = 0.1  # of the wavemaker at most, from end to end [m]
MAKER = "x_min"
WAVES = 3  # that the wavemaker sends


class WaveAbsorb(WallTask):
    """A wavemaker at the left sends three waves down a flume; a piston at the right moves so that none come back.

    Action (1,): velocity or acceleration of the piston as a share of the largest, positive to the right.

    Observation: the fluid on a coarse grid; the piston's position (-1 to 1 over its travel) and velocity (-1 to 1), the
    wavemaker's velocity (-1 to 1 over one and a half times the largest), and the time.

    Reward, from -0.1 to 1: calm - 0.1 effort. Calm is 1 where the water is at rest and 0 where its rms speed is 0.12 of
    sqrt(g H).

    The waves have a period of 1.1 to 1.6 s. By Biesel's theory a piston makes waves 2 (cosh 2kH - 1)/(sinh 2kH + 2kH)
    strokes high, and swallows such waves if it moves as it would to make them, backwards in time.
    """

    title = "WaveAbsorb"
    acts: ClassVar = ("piston",)
    boxes: ClassVar = {2: (LENGTH + ROOM, 0.7)}
    counted = ("the depth of the water", DEPTH)
    resolutions: ClassVar = {2: {"fast": 9, "balanced": 12, "accurate": 24}}
    gates: ClassVar = {2: Gate("wavemaker")}
    grids: ClassVar = {2: (6, 24)}
    duration = 8.0
    levels: ClassVar = {
        "easy": Level("fast", variation=0.3, resolution={2: 8}, interval=0.1),
        "medium": Level(variation=0.7),
        "hard": Level(variation=1.0, disturbance=0.003, viscosity=1e-4, resolution={2: 16}),
    }
    memory = ("_making",)
    gain = "calm"
    costs: ClassVar = {"effort": 0.1}
    numbers: ClassVar = [(-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)]

    def __init__(self, command: str = "velocity", max_speed: float = 0.5, max_acceleration: float = 5.0, **common: Any):
        """Pose the task.

        Args:
            command: "velocity" or "acceleration".
            max_speed: Of the piston [m/s].
            max_acceleration: Of the piston [m/s2].
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        super().__init__(**common)
        travel = (LENGTH - ROOM, LENGTH + ROOM)
        self.wall = Drive(travel, max_speed, max_acceleration, command, self.control_interval)
        self.reference_speed = math.sqrt(GRAVITY * DEPTH)
        self._top = math.pi * STROKE / 1.1  # of the wavemaker's speed
        self.scene = Scene(
            lower=(-STROKE, 0.0),
            upper=self.boxes[2],
            particle_spacing=self.spacing,
            fluid=[Fluid(Box((0.0, 0.0), (LENGTH, DEPTH)), pressure="hydrostatic")],
            faces={
                MAKER: Face(moving=True, travel=(-STROKE, STROKE), start=0.0),
                WALL: Face(moving=True, travel=travel, start=LENGTH),
            },
            gravity=GRAVITY,
            material=self.material(),
            reference_speed=self.reference_speed,
        )
        self._fluid = self.scene.sample()

    def attach(self, solver: Solver) -> None:
        """Take the worlds."""
        super().attach(solver)
        self._making = np.zeros((solver.num_worlds, self.max_episode_steps + 1))

    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """The water at rest, and what the wavemaker will do: a few waves of one period, the first and last lower."""
        period = 1.35 + 0.25 * self.variation * rng.uniform(-1.0, 1.0)
        stroke = STROKE * (0.8 + 0.2 * self.variation * rng.uniform(-1.0, 1.0))
        times = self.control_interval * np.arange(self.max_episode_steps + 1)
        waves = times / period
        swelling = np.minimum(2.0 * waves, 2.0 * (WAVES - waves)).clip(0.0, 1.0)
        place = 0.5 * stroke * swelling * np.sin(2.0 * math.pi * waves)
        self._making[world] = np.diff(place, append=0.0) / self.control_interval
        return self._fluid

    def push(self, velocity: np.ndarray) -> None:
        """Move the piston, and the wavemaker as it was drawn."""
        super().push(velocity)
        self.solver.face_velocity[:, self.solver.face_index(MAKER)] = self.making()

    def making(self) -> np.ndarray:
        """Velocity of the wavemaker in the interval to come [m/s], (world,)."""
        return self._making[np.arange(len(self._steps)), np.minimum(self._steps, self.max_episode_steps)]

    def state(self) -> list[np.ndarray]:
        """The piston's position and velocity, and what the wavemaker does."""
        place, speed = (self.position - LENGTH) / ROOM, self.velocity / self.wall.max_speed
        return [place, speed, self.making() / (1.5 * self._top)]

    def parts(self) -> dict[str, np.ndarray]:
        """Calm and effort."""
        unrest = rewards.unrest(self.fluid["kinetic"], 0.24 * self.reference_speed)
        return {"calm": 1.0 - unrest, "effort": self._effort.copy()}

    def scripted(self) -> np.ndarray:
        """Give way as open water would: sqrt(g/H) times how much higher the water is at the piston than on average."""
        rise = self.depths()[:, -5:-3].mean(axis=1) - DEPTH
        wanted = math.sqrt(GRAVITY / DEPTH) * rise - 0.5 * (self.position - LENGTH)
        return self.wall.towards(wanted, self.velocity)[:, None]
