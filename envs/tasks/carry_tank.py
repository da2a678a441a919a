"""Carry an open tank of water from A to B: spill nothing, arrive calm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from fluidgym.envs import rewards
from fluidgym.envs.actuators import Drive
from fluidgym.envs.fluid_task import GRAVITY, FluidTask, Level
from fluidgym.envs.task import Gate
from fluidgym.scene import OPEN, Box, Fluid, Particles, Scene
from fluidgym.solver import Solver

DEPTH = 0.4  # H, of the water [m]
LENGTH = 1.0  # of the tank [m]
ROOM = 10.0  # to go, either way [m]
DISTANCE = 2.0  # from A to B, on average [m]
FARTHER = 0.8  # most that it differs from that [m]
PERIOD = 2.0 * math.pi / math.sqrt(GRAVITY * math.pi / LENGTH * math.tanh(math.pi * DEPTH / LENGTH))


class CarryTank(FluidTask):
    """An open tank, two thirds full of water, stands at A; it is to go to B and stand there with its water at rest.

    Action (1,), in 3D (2,) along x and y: acceleration or velocity of the tank as a share of the largest. The tank
    feels its acceleration as a body force, so the world is seen from the tank.

    Observation: the fluid on a coarse grid; for each horizontal axis the way that is left (-1 to 1 over 3 m) and the
    tank's velocity (-1 to 1); the share of the water that is lost, and the time.

    Reward, from -2.05 to 1: arrival - 1 spill - 1 unrest - 0.05 effort. Arrival is 1 at B and 0 at A or as far beyond
    B; spill ten times the share of the water that is over the rim and gone; unrest how fast the water moves in the
    tank, 1 at half of sqrt(g H); effort that of the drive.

    Sloshing that is set off takes 1.23 s to swing once (omega^2 = g k tanh(k H), k = pi/L). An acceleration that lasts
    just as long leaves the water calm, which is what the scripted controller makes use of.
    """

    title = "CarryTank"
    acts: ClassVar = ("tank along x", "tank along y")
    boxes: ClassVar = {2: (LENGTH, 0.6), 3: (LENGTH, 0.4, 0.6)}
    counted = ("the depth of the water", DEPTH)
    resolutions: ClassVar = {
        2: {"fast": 10, "balanced": 14, "accurate": 28},
        3: {"fast": 8, "balanced": 10, "accurate": 16},
    }
    gates: ClassVar = {2: Gate("standing-wave"), 3: Gate("still-tank")}
    grids: ClassVar = {2: (6, 10), 3: (6, 4, 10)}
    duration = 5.0
    levels: ClassVar = {
        "easy": Level("fast", variation=0.2, resolution={2: 8, 3: 8}, grids={2: (4, 8)}, interval=0.1),
        "medium": Level(variation=0.6),
        "hard": Level(variation=1.0, disturbance=0.03, viscosity=1e-3, resolution={2: 20, 3: 12}),
    }
    memory = ("place", "velocity", "target")
    gain = "arrival"
    costs: ClassVar = {"spill": 1.0, "unrest": 1.0, "effort": 0.05}

    def __init__(
        self, command: str = "acceleration", max_speed: float = 1.5, max_acceleration: float = 4.0, **common: Any
    ):
        """Pose the task.

        Args:
            command: "acceleration" or "velocity"; where a velocity may change by a small part of its range between
                commands, what explores jerks, and learns slowly.
            max_speed: Of the tank along each axis [m/s].
            max_acceleration: Of the tank along each axis [m/s2].
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        axes = 2 if common.get("dim") == 3 else 1
        self.actions = axes
        self.numbers = [(-1.0, 1.0)] * (2 * axes) + [(0.0, 1.0)]
        super().__init__(**common)
        self.cart = Drive((-ROOM, ROOM), max_speed, max_acceleration, command, self.control_interval)
        self.reference_speed = math.sqrt(GRAVITY * DEPTH)
        size = self.boxes[self.dim]
        self.scene = Scene(
            lower=(0.0,) * self.dim,
            upper=size,
            particle_spacing=self.spacing,
            fluid=[Fluid(Box((0.0,) * self.dim, (*size[:-1], DEPTH)), pressure="hydrostatic")],
            faces={"xyz"[self.dim - 1] + "_max": OPEN},
            gravity=GRAVITY,
            material=self.material(),
            reference_speed=2.0 * self.reference_speed,
        )
        self._fluid = self.scene.sample()

    def attach(self, solver: Solver) -> None:
        """Take the worlds, and put the tanks to A."""
        super().attach(solver)
        shape = (solver.num_worlds, self.dim - 1)
        self.place, self.velocity, self.target = np.zeros(shape), np.zeros(shape), np.full(shape, DISTANCE)

    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """The water at rest; B is somewhere else each time."""
        way = DISTANCE + self.variation * FARTHER * rng.uniform(-1.0, 1.0)
        angle = rng.uniform(-0.25, 0.25) * math.pi if self.dim == 3 else 0.0
        self.target[world] = [way * math.cos(angle), way * math.sin(angle)][: self.dim - 1]
        return self._fluid

    def begin(self, worlds: np.ndarray) -> None:
        """Put some tanks to A, at rest."""
        self.place[worlds], self.velocity[worlds] = 0.0, 0.0
        super().begin(worlds)

    def drive(self, actions: np.ndarray) -> None:
        """Move the tank as far as its limits let it; the water feels the opposite of its acceleration."""
        cart, before = self.cart, self.velocity
        after = cart.next_velocity(actions, self.place, before)
        self.place = self.place + 0.5 * (before + after) * cart.interval
        self.velocity = after
        self.solver.gravity[:, :-1] = -(after - before) / cart.interval
        self._effort = cart.effort(after, before).max(axis=1)

    def state(self) -> list[np.ndarray]:
        """What is left to go, the velocity, and what is lost."""
        left, velocity = (self.target - self.place) / 3.0, self.velocity / self.cart.max_speed
        return [*left.T, *velocity.T, self.lost()]

    def parts(self) -> dict[str, np.ndarray]:
        """Arrival, spill, unrest and effort."""
        left = (self.target - self.place) * (self.target - self.place)
        way = self.target * self.target
        return {
            "arrival": (1.0 - np.sqrt(left.sum(axis=1) / way.sum(axis=1))).clip(0.0, 1.0),
            "spill": rewards.spill(self.lost()),
            "unrest": rewards.unrest(self.fluid["kinetic"], self.reference_speed),
            "effort": self._effort.copy(),
        }

    def info(self) -> dict[str, np.ndarray]:
        """What every task tells, and how far it is to B [m], the tank's speed [m/s], and the share that is lost."""
        left = self.target - self.place
        return super().info() | {
            "distance": np.sqrt((left * left).sum(axis=1)),
            "speed": np.sqrt((self.velocity * self.velocity).sum(axis=1)),
            "lost": self.lost(),
        }

    def scripted(self) -> np.ndarray:
        """Speed up for one period of the sloshing, go on, and slow down for one: the water swings once and is calm."""
        way = np.sqrt((self.target * self.target).sum(axis=1))[:, None]
        top = np.minimum(0.8 * self.cart.max_speed, way / PERIOD)
        time = (self.time() + self.cart.interval)[:, None]
        slowing = way / top  # when to begin slowing down
        speed = top * np.minimum((time / PERIOD).clip(0.0, 1.0), (1.0 - (time - slowing) / PERIOD).clip(0.0, 1.0))
        wanted = speed * self.target / way
        at_end = time >= slowing + PERIOD
        wanted = np.where(at_end, (self.target - self.place).clip(-0.1, 0.1), wanted)
        return self.cart.towards(wanted, self.velocity)

    def annotate(self, world: int) -> dict[str, Any]:
        """How well it goes, and how far it is."""
        shown: Mapping[str, Any] = super().annotate(world)
        left = self.target[world] - self.place[world]
        return {**shown, "text": f"{math.hypot(*left):.2f} m to go, {shown['text']}"}
