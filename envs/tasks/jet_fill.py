"""Fill a bucket with a jet of water: hit it, spill nothing, stop in time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from fluidgym.envs import rewards
from fluidgym.envs.fluid_task import GRAVITY, FluidTask, Level
from fluidgym.envs.task import Gate
from fluidgym.scene import OPEN, Body, Box, Inflow, Particles, Scene
from fluidgym.solver import Solver

JET = 0.1  # width of the jet [m]
NOZZLE = (0.1, 1.3)  # back of the pipe, on average [m]
LIFT = 0.2  # most that its height differs from that [m]
BUCKET = (0.9, 0.2)  # lower left corner of what it holds [m]
INSIDE = (0.8, 0.7)  # width and depth of that [m]
THICK = 0.1  # its walls and floor [m]
FULL = 0.5  # share of that which is to be filled
FASTEST = 5.0  # jet [m/s]
STEEPEST = 0.6  # slope of the jet at the nozzle, up or down
SHUT = -0.6  # command up to which the valve is shut: what dribbles falls beside the bucket, and who explores dribbles


class JetFill(FluidTask):
    """A nozzle at the left throws a jet into the air; it is to fill a bucket at the right and then to stop.

    Action (2,): the speed of the jet, off up to -0.6 and the largest at 1; and its slope at the nozzle, as a share of
    the steepest, positive upwards. Speed and slope follow at a limited rate.

    Observation: the fluid on a coarse grid; speed (0 to 1) and slope (-1 to 1) of the jet, the height of the nozzle
    (-1 to 1), how full the bucket is (0 to 1), and the time.

    Reward, from -2.05 to 1: fill - 2 spill - 0.05 effort. Fill is how much is in the bucket over half of what it
    holds; spill what has fallen past it since the last action, over what the fastest jet brings in that time; effort
    the change of speed and slope.

    The jet takes the path of a bullet: with slope s and speed u along x it is s x - g x^2/(2 u^2) higher at x. What
    misses the bucket falls out of the world through the floor.
    """

    title = "JetFill"
    acts: ClassVar = ("speed", "slope")
    boxes: ClassVar = {2: (2.4, 1.8)}
    counted = ("half a metre", 0.5)
    resolutions: ClassVar = {2: {"fast": 10, "balanced": 15, "accurate": 30}}
    gates: ClassVar = {2: Gate("free-fall")}
    grids: ClassVar = {2: (9, 12)}
    duration = 4.0
    levels: ClassVar = {
        "easy": Level("fast", variation=0.3, grids={2: (6, 8)}, interval=0.1),
        "medium": Level(variation=0.7),
        "hard": Level(variation=1.0, disturbance=0.1, viscosity=1e-3, resolution={2: 20}),
    }
    memory = ("speed", "slope", "height", "_gone")
    gain = "fill"
    costs: ClassVar = {"spill": 2.0, "effort": 0.05}
    actions = 2
    numbers: ClassVar = [(0.0, 1.0), (-1.0, 1.0), (-1.0, 1.0), (0.0, 1.0)]

    def __init__(self, **common: Any):
        """Pose the task.

        Args:
            common: As every task has them; see `FluidTask`.

        Raises:
            ValueError: An argument is out of its limits.
        """
        super().__init__(**common)
        self._follow = min(1.0, 5.0 * self.control_interval)  # share of its range that a command gets in an interval
        self.reference_speed = FASTEST
        (x, y), (wide, deep) = BUCKET, INSIDE
        size = self.boxes[2]
        self.scene = Scene(
            lower=(0.0, 0.0),
            upper=size,
            particle_spacing=self.spacing,
            fluid=[],
            faces={"x_min": OPEN, "x_max": OPEN, "y_min": OPEN, "y_max": OPEN},
            bodies={
                "floor": Body(Box((x - THICK, y - THICK), (x + wide + THICK, y))),
                "left": Body(Box((x - THICK, y), (x, y + deep))),
                "right": Body(Box((x + wide, y), (x + wide + THICK, y + deep))),
            },
            inflows={
                "nozzle": Inflow(
                    NOZZLE,
                    (1.0, 0.0),
                    max(2, round(JET / self.spacing)) * self.spacing,
                    max_speed=FASTEST,
                    length=5.0 * self.spacing,
                )
            },
            gravity=GRAVITY,
            material=self.material(),
            reference_speed=1.2 * FASTEST,
            reserve=math.ceil((0.45 * wide * deep * 4.0 + JET * 4.0) / self.spacing**2),
        )
        self._fluid = self.scene.sample()
        self.whole = FULL * wide * deep / self.spacing**2  # particles that fill it
        self._most = JET * FASTEST * self.control_interval / self.spacing**2  # particles of the fastest jet

    def zone(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Inside the bucket."""
        (x, y), (wide, deep) = BUCKET, INSIDE
        return (x, y), (x + wide, y + deep)

    def attach(self, solver: Solver) -> None:
        """Take the worlds, and shut the nozzles."""
        super().attach(solver)
        worlds = solver.num_worlds
        self.speed, self.slope = np.zeros(worlds), np.zeros(worlds)
        self.height = np.full(worlds, NOZZLE[1])
        self._gone = np.zeros(worlds, int)

    def sample(self, world: int, rng: np.random.Generator) -> Particles:
        """An empty bucket; the nozzle, whose pipe is full, is higher or lower each time."""
        lift = LIFT * self.variation * rng.uniform(-1.0, 1.0)
        self.height[world] = NOZZLE[1] + lift
        return replace(self._fluid, position=self._fluid.position + np.array([0.0, lift]))

    def begin(self, worlds: np.ndarray) -> None:
        """Shut the nozzle of some worlds."""
        self.speed[worlds], self.slope[worlds], self._gone[worlds] = 0.0, 0.0, 0
        self._aim()
        super().begin(worlds)

    def drive(self, actions: np.ndarray) -> None:
        """Open or shut the valve and turn the nozzle, as fast as they go."""
        self._gone = self.gone()
        speed, slope = self.speed, self.slope
        step = self._follow * FASTEST, self._follow * STEEPEST
        opened = (actions[:, 0] - SHUT) / (1.0 - SHUT)
        self.speed = (FASTEST * opened.clip(0.0)).clip(speed - step[0], speed + step[0])
        self.slope = (STEEPEST * actions[:, 1]).clip(slope - step[1], slope + step[1])
        self._effort = rewards.effort((self.speed - speed) / step[0], (self.slope - slope) / step[1])
        self._aim()

    def _aim(self) -> None:
        solver = self.solver
        solver.inflow_center[:, 0, 1] = self.height
        solver.inflow_speed[:, 0] = self.speed
        solver.inflow_direction[:, 0, 1] = self.slope

    def filled(self) -> np.ndarray:
        """What is in the bucket over what is wanted, (world,)."""
        return self.fluid["in_zone"] * self.fluid["live"] / self.whole

    def state(self) -> list[np.ndarray]:
        """Speed, slope and height of the nozzle, and how full the bucket is."""
        return [self.speed / FASTEST, self.slope / STEEPEST, (self.height - NOZZLE[1]) / LIFT, self.filled()]

    def parts(self) -> dict[str, np.ndarray]:
        """Fill, spill and effort."""
        return {
            "fill": self.filled().clip(0.0, 1.0),
            "spill": ((self.gone() - self._gone) / self._most).clip(0.0, 1.0),
            "effort": self._effort.copy(),
        }

    def info(self) -> dict[str, np.ndarray]:
        """What every task tells, and the jet: its speed [m/s] and slope, and the height of the nozzle [m]."""
        own = {"jet_speed": self.speed, "jet_slope": self.slope, "nozzle_height": self.height}
        return super().info() | {name: values.copy() for name, values in own.items()}

    def scripted(self) -> np.ndarray:
        """Throw upwards, so that the jet falls steeply into the bucket, and stop when what flies will fill it."""
        slope = 0.7 * STEEPEST
        pipe = 5.0 * self.spacing / math.sqrt(1.0 + slope * slope)
        away = BUCKET[0] + 0.4 * INSIDE[0] - NOZZLE[0] - pipe
        fall = self.height + pipe * slope - BUCKET[1] - INSIDE[1]
        speed = away * np.sqrt(0.5 * GRAVITY * (1.0 + slope * slope) / (slope * away + fall))
        aimed = self.slope > 0.9 * slope
        in_air = (1.0 - self.fluid["in_zone"]) * self.fluid["live"] / self.whole
        wanted = np.where(aimed & (self.filled() + in_air < 1.1), SHUT + (1.0 - SHUT) * speed / FASTEST, -1.0)
        return np.stack([wanted, np.full_like(wanted, slope / STEEPEST)], axis=1)

    def null(self) -> np.ndarray:
        """Leave the jet off."""
        return np.tile([-1.0, 0.0], (self.solver.num_worlds, 1))
