"""Calm the water in a shaken tank with an inner wall."""

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

DEPTH = 0.4  # H, of the water [m]
LENGTH = 1.0  # of the tank at rest [m]
ROOM = 0.15  # that the wall has to either side [m]
FREQUENCY = math.sqrt(GRAVITY * math.pi / LENGTH * math.tanh(math.pi * DEPTH / LENGTH)) / (2.0 * math.pi)  # [Hz]


class SloshDamp(WallTask):
    """A tank of water is shaken near its first sloshing frequency; its right wall moves to keep the water calm.

    Action (1,): velocity or acceleration of the wall as a share of the largest, positive to the right.

    Observation: the fluid on a coarse grid; the wall's position (-1 to 1 over its travel) and velocity (-1 to 1), the
    acceleration of the ground (-1 to 1 over the largest), and the time.

    Reward, from -0.1 to 1: calm - 0.1 effort. Calm is 1 where the water is at rest and 0 where its rms speed is 0.3 of
    sqrt(g H).

    The ground swings for the whole episode within `variation` of 15 % of 0.815 Hz (omega^2 = g k tanh(k H),
    k = pi/L). A wall that gives way to the waves as open water would takes their energy, which is what the scripted
    controller does.
    """

    title = "SloshDamp"
    acts: ClassVar = ("wall",)
    boxes: ClassVar = {2: (LENGTH + ROOM, 0.9)}
    counted = ("the depth of the water", DEPTH)
    resolutions: ClassVar = {2: {"fast": 10, "balanced": 14, "accurate": 28}}
    gates: ClassVar = {2: Gate("standing-wave")}
    grids: ClassVar = {2: (8, 12)}
    duration = 6.0
    levels: ClassVar = {
        "easy": Level("fast", variation=0.3, disturbance=0.06, resolution={2: 8}, interval=0.1),
        "medium": Level(variation=0.7, disturbance=0.08),
        "hard": Level(variation=1.0, disturbance=0.1, viscosity=1e-3, resolution={2: 20}),
    }
    gain = "calm"
    costs: ClassVar = {"effort": 0.1}
    numbers: ClassVar = [(-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0)]

    def __init__(self, command: str = "velocity", max_speed: float = 0.6, max_acceleration: float = 6.0, **common: Any):
        """Pose the task.

        Args:
            command: "velocity" or "acceleration".
            max_speed: Of the wall [m/s].
            max_acceleration: Of the wall [m/s2].
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        super().__init__(**common)
        travel = (LENGTH - ROOM, LENGTH + ROOM)
        self.wall = Drive(travel, max_speed, max_acceleration, command, self.control_interval)
        self.reference_speed = math.sqrt(GRAVITY * DEPTH)
        self.scene = Scene(
            lower=(0.0, 0.0),
            upper=self.boxes[2],
            particle_spacing=self.spacing,
            fluid=[Fluid(Box((0.0, 0.0), (LENGTH, DEPTH)), pressure="hydrostatic")],
            faces={WALL: Face(moving=True, travel=travel, start=LENGTH)},
            gravity=GRAVITY,
            material=self.material(),
            reference_speed=1.5 * self.reference_speed,
        )
        self._fluid = self.scene.sample()

    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """The water at rest."""
        return self._fluid

    def shaking(self, rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
        """Of one frequency near that of the first mode, swelling within half a second."""
        frequency = FREQUENCY * (1.0 + 0.15 * self.variation * rng.uniform(-1.0, 1.0))
        strength = 1.0 - 0.4 * self.variation * rng.uniform(0.0, 1.0)
        phase = 2.0 * math.pi * rng.uniform()
        return strength * (2.0 * times).clip(0.0, 1.0) * np.sin(2.0 * math.pi * frequency * times + phase)

    def state(self) -> list[np.ndarray]:
        """The wall's position and velocity, and the ground's acceleration."""
        largest = max(self.disturbance * GRAVITY, 1e-9)
        return [(self.position - LENGTH) / ROOM, self.velocity / self.wall.max_speed, self.ground() / largest]

    def parts(self) -> dict[str, np.ndarray]:
        """Calm and effort."""
        unrest = rewards.unrest(self.fluid["kinetic"], 0.6 * self.reference_speed)
        return {"calm": 1.0 - unrest, "effort": self._effort.copy()}

    def scripted(self) -> np.ndarray:
        """Give way as open water would: sqrt(g/H) times how much higher the water is at the wall than on average."""
        depths = self.depths()
        rise = depths[:, -5:-3].mean(axis=1) - DEPTH * LENGTH / self.position
        wanted = math.sqrt(GRAVITY / DEPTH) * rise - 0.8 * (self.position - LENGTH)
        return self.wall.towards(wanted, self.velocity)[:, None]
