"""Heat: temperature spreads through a fluid at rest, between two walls that hold theirs.

The resolution counts particles from wall to wall, L = 1 m, along the last axis. The fluid has the thermal diffusivity
alpha, no weight and no motion, and its particles stay the lattice they start as. In two dimensions the other two walls
insulate and are about L/4 apart; in three the layer is thin and periodic. Two runs: an arch of warmth between walls
held at 0, and a cold fluid whose upper wall is raised to 1 as the run starts.

Reference: with z = distance from the lower wall over L and tau = alpha t/L^2, for the arch

    T = sin(pi z) exp(-pi^2 tau)

and for the step the series of a wall that starts to slide (`shear_start_up.couette`).

Errors:
    arch, step: largest |T - T_ref| over all particles at tau = 0.02, 0.05, 0.1, 0.2 and 0.5, over the largest
        temperature of the run, which is 1.
"""

import dataclasses
from typing import Any

import numpy as np

from fluidgym.scene import AXES, PERIODIC, Box, Face, Fluid, Material, Scene
from fluidgym.solver import Solver
from fluidgym.validation import shear_start_up
from fluidgym.validation.case import Case, Records, largest_error

GAP = 1.0  # L [m]
DIFFUSIVITY = 0.01  # [m2/s]
TIME_UNIT = GAP**2 / DIFFUSIVITY  # [s]
TIMES = np.array([0.02, 0.05, 0.1, 0.2, 0.5])  # tau
SPEED = DIFFUSIVITY / GAP  # [m/s]; nothing moves, and sound of ten times this leaves the time step to heat
THIN = {2: 5, 3: 4}  # particles across a periodic layer: its least width is the reach of the kernel


def arch(z: np.ndarray, time: float) -> np.ndarray:
    """Temperature that an arch of warmth has left, at z (n,) and tau."""
    return np.sin(np.pi * z) * np.exp(-(np.pi**2) * time)


def step(z: np.ndarray, time: float) -> np.ndarray:
    """Temperature after the upper wall has been raised, at z (n,) and tau > 0."""
    return shear_start_up.couette(z, time)


def layer(resolution: int, dim: int, upper: float, temperature: Any) -> Scene:
    """The fluid between its walls, the lower at 0 and the upper at a temperature."""
    spacing = GAP / resolution
    across = max(THIN[dim], resolution // 4) if dim == 2 else THIN[dim]
    size = (*(across * spacing,) * (dim - 1), GAP)
    axis = AXES[dim - 1]
    sides = dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), PERIODIC) if dim == 3 else {}
    return Scene(
        lower=(0.0,) * dim,
        upper=size,
        particle_spacing=spacing,
        fluid=[Fluid(Box((0.0,) * dim, size), temperature=temperature)],
        faces=sides | {f"{axis}_min": Face(temperature=0.0), f"{axis}_max": Face(temperature=upper)},
        gravity=0.0,
        material=Material(thermal_diffusivity=DIFFUSIVITY),
        reference_speed=SPEED,
    )


def arch_scene(resolution: int, dim: int) -> Scene:
    """A warm fluid between cold walls."""
    return layer(resolution, dim, 0.0, lambda points: arch(points[:, -1] / GAP, 0.0))


def step_scene(resolution: int, dim: int) -> Scene:
    """A cold fluid and a warm wall."""
    return layer(resolution, dim, 1.0, 0.0)


def observe(solver: Solver) -> dict[str, np.ndarray]:
    """Place z between the walls and temperature of each particle."""
    particles = solver.particles()
    assert particles.temperature is not None
    return {"place": particles.position[:, -1].astype(float) / GAP, "temperature": particles.temperature.astype(float)}


def arch_errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The error of the arch."""
    return {"arch": largest_error(arch, times / TIME_UNIT, records["place"], records["temperature"])}


def step_errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The error of the step."""
    return {"step": largest_error(step, times / TIME_UNIT, records["place"], records["temperature"])}


ARCH = Case(
    name="heat",
    title="Heat between two walls, from an arch and from a step",
    resolutions={2: (20, 40, 80), 3: (10, 20, 40)},
    scene=arch_scene,
    times=TIME_UNIT * TIMES,
    end=TIME_UNIT * float(TIMES[-1]),
    observe=observe,
    errors=arch_errors,
)
STEP = dataclasses.replace(ARCH, scene=step_scene, errors=step_errors)
CASE = dataclasses.replace(
    ARCH,
    parts={"arch": ARCH, "step": STEP},
    target={20: {"arch": 0.001, "step": 0.004}, 40: {"arch": 2e-4, "step": 9e-4}, 80: {"step": 3e-4}},
    goal={40: {"arch": 0.002, "step": 0.002}},
)
