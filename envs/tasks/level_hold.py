"""Hold the level of a leaking tank with what flows in."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from fluidgym.envs import rewards
from fluidgym.envs.fluid_task import GRAVITY, FluidTask, Level
from fluidgym.envs.task import Gate
from fluidgym.scene import OPEN, Body, Box, Fluid, Inflow, Particles, Scene
from fluidgym.solver import Solver

LENGTH = 0.8  # of the tank [m]
FLOOR = 0.2  # height of its floor over the bottom of the world [m]
THICK = 0.1  # of that [m]
SLOT = 0.16  # width of the leak [m]
LEVEL = 0.35  # of the water over the floor, on average [m]
HIGHER = 0.12  # most that the level asked for differs from that [m]
NOZZLE_WIDTH = 0.2  # [m]
FASTEST = 2.5  # out of the nozzle [m/s]
START = 1.0  # out of the nozzle at the start [m/s]
CONTRACTION = 0.61  # of a jet out of a slot with sharp edges (Kirchhoff)


class LevelHold(FluidTask):
    """Water runs out of a tank through a slot in its floor; what flows in at the top is to hold the level asked for.

    Action (1,): the speed of the inflow, from none at -1 to the largest at 1. It follows at a limited rate.

    Observation: the fluid on a coarse grid; the speed of the inflow (0 to 1), level and level asked for (0 to 1 over
    0.7 m), and the time.

    Reward, from -0.25 to 1: hold - 0.2 splash - 0.05 effort. Hold is 1 at the level asked for and 0 where the level is
    a quarter of that off; splash the share of the water higher than 0.57 m over the floor; effort the change of the
    inflow.

    The level asked for changes once in an episode, at a time of its own. By Torricelli's law a level h drives water out
    at sqrt(2 g h), in a jet that is narrower than the slot; the scripted controller lets in just as much, and more or
    less by how far the level is off.
    """

    title = "LevelHold"
    acts: ClassVar = ("inflow",)
    boxes: ClassVar = {2: (LENGTH, 1.2)}
    counted = ("half a metre", 0.5)
    resolutions: ClassVar = {2: {"fast": 12, "balanced": 16, "accurate": 30}}
    gates: ClassVar = {2: Gate("still-tank")}
    grids: ClassVar = {2: (10, 8)}
    duration = 6.0
    levels: ClassVar = {
        "easy": Level("fast", variation=0.5, grids={2: (5, 4)}, interval=0.1),
        "medium": Level(variation=0.8),
        "hard": Level(variation=1.0, disturbance=0.05, viscosity=1e-3, resolution={2: 20}),
    }
    memory = ("speed", "_plan")
    gain = "hold"
    costs: ClassVar = {"splash": 0.2, "effort": 0.05}
    numbers: ClassVar = [(0.0, 1.0), (0.0, 1.0), (0.0, 1.0)]

    def __init__(self, **common: Any):
        """Pose the task.

        Args:
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        super().__init__(**common)
        self._follow = min(1.0, 4.0 * self.control_interval)  # share of its range that a command gets in an interval
        self.reference_speed = math.sqrt(2.0 * GRAVITY * 0.6)
        wide, high = self.boxes[2]
        slot = max(2, round(SLOT / self.spacing)) * self.spacing
        self.slot = slot
        pipe = 5.0 * self.spacing
        low, edge = FLOOR - THICK, 0.5 * (wide - slot)
        self.scene = Scene(
            lower=(0.0, 0.0),
            upper=(wide, high),
            particle_spacing=self.spacing,
            fluid=[Fluid(Box((0.0, FLOOR), (wide, FLOOR + LEVEL)), pressure="hydrostatic")],
            faces={"y_min": OPEN, "y_max": OPEN},
            bodies={
                "left": Body(Box((0.0, low), (edge, FLOOR))),
                "right": Body(Box((edge + slot, low), (wide, FLOOR))),
            },
            inflows={
                "nozzle": Inflow(
                    (0.5 * NOZZLE_WIDTH + self.spacing, high),
                    (0.0, -1.0),
                    max(2, round(NOZZLE_WIDTH / self.spacing)) * self.spacing,
                    speed=START,
                    max_speed=FASTEST,
                    length=pipe,
                )
            },
            gravity=GRAVITY,
            material=self.material(),
            reference_speed=1.2 * self.reference_speed,
            reserve=math.ceil(wide * (high - LEVEL) / self.spacing**2),  # to the brim
        )
        self._fluid = self.scene.sample()

    def zone(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The tank above its floor and below the nozzle."""
        return (0.0, FLOOR), (LENGTH, self.boxes[2][1] - 5.0 * self.spacing)

    def splash_height(self) -> float:
        """Well above the level."""
        return FLOOR + LEVEL + HIGHER + 0.1

    def attach(self, solver: Solver) -> None:
        """Take the worlds."""
        super().attach(solver)
        worlds = solver.num_worlds
        self.speed = np.full(worlds, START)
        self._plan = np.full((worlds, self.max_episode_steps + 1), LEVEL)

    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """The tank at its usual level; what is asked for is another, and yet another later."""
        before, after = LEVEL + HIGHER * self.variation * rng.uniform(-1.0, 1.0, 2)
        change = rng.uniform(0.35, 0.65) * self.max_episode_steps
        self._plan[world] = np.where(np.arange(self.max_episode_steps + 1) < change, before, after)
        return self._fluid

    def begin(self, worlds: np.ndarray) -> None:
        """Open the nozzle of some worlds as it is at the start."""
        self.speed[worlds] = START
        super().begin(worlds)

    def drive(self, actions: np.ndarray) -> None:
        """Open or shut the valve, as fast as it goes."""
        before, step = self.speed, self._follow * FASTEST
        self.speed = (0.5 * FASTEST * (1.0 + actions[:, 0])).clip(before - step, before + step)
        self.solver.inflow_speed[:, 0] = self.speed
        self._effort = rewards.effort((self.speed - before) / step, np.zeros_like(before))

    def level(self) -> np.ndarray:
        """Of the water over the floor of the tank [m], (world,)."""
        return self.fluid["in_zone"] * self.fluid["live"] * (self.spacing * self.spacing / LENGTH)

    def wanted(self) -> np.ndarray:
        """The level asked for [m], (world,)."""
        return self._plan[np.arange(len(self._steps)), np.minimum(self._steps, self.max_episode_steps)]

    def state(self) -> list[np.ndarray]:
        """Inflow, level, and level asked for."""
        return [self.speed / FASTEST, self.level() / 0.7, self.wanted() / 0.7]

    def parts(self) -> dict[str, np.ndarray]:
        """Hold, splash and effort."""
        off = np.abs(self.level() - self.wanted()) / (0.25 * self.wanted())
        return {
            "hold": (1.0 - off).clip(0.0, 1.0),
            "splash": rewards.splash(self.fluid["above"]),
            "effort": self._effort.copy(),
        }

    def info(self) -> dict[str, np.ndarray]:
        """What every task tells, the inflow [m/s], the level and that asked for [m]."""
        return super().info() | {"inflow": self.speed.copy(), "level": self.level(), "wanted": self.wanted()}

    def scripted(self) -> np.ndarray:
        """Let in what Torricelli lets out, and more where the level is too low."""
        level, wanted = self.level(), self.wanted()
        out = CONTRACTION * self.slot * np.sqrt(2.0 * GRAVITY * level)
        fill = 2.0 * LENGTH * (wanted - level)  # within half a second
        speed = (out + fill) / self.scene.inflows["nozzle"].width
        return (2.0 * speed / FASTEST - 1.0).clip(-1.0, 1.0)[:, None]

    def null(self) -> np.ndarray:
        """Leave the inflow as it is at the start."""
        return np.full((self.solver.num_worlds, 1), 2.0 * START / FASTEST - 1.0)
