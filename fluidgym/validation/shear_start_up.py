"""Start of a shear flow: fluid at rest between two parallel walls, set in motion by a force or by one of the walls.

The resolution counts particles across the width L = 1 m, along the last axis; the other axes are periodic and, so that
whole particles fit, about L long in two dimensions and L/3 in three. There is no slip at the walls. Poiseuille flow is
driven by a body force along x, Couette flow by the upper wall, which slides along x from the first instant on; they are
two runs. The largest speed of either is U = 1 m/s, Re = U L/nu = 10 and c_0 = 10 U: by the end, rows of particles have
slid past their neighbours by up to sixteen spacings. At this Reynolds number the fluid's own viscosity exceeds the
artificial one, which therefore adds nothing.

On a lattice the sum over the neighbours that stands for the second moment of the kernel's slope says how strongly
viscosity acts: right to within 0.1 % at the default h, but 0.26 % too weakly at 1.5 dx in two dimensions, and 2.1 % at
1.3 dx in three. No resolution wins that share back.

Reference: with y = distance from the wall at rest over L and T = nu t/L^2, the series of the diffusion equation

    u/U = 4 y (1 - y) - sum over odd n of 32/(n pi)^3 sin(n pi y) exp(-n^2 pi^2 T)    Poiseuille, U = g L^2/(8 nu)
    u/U = y + sum over n of 2/(n pi) (-1)^n sin(n pi y) exp(-n^2 pi^2 T)              Couette

Errors:
    poiseuille, couette: largest |u - u_ref|/U over all particles at T = 0.02, 0.05, 0.1, 0.2 and 0.5.
"""

import dataclasses
import math

import numpy as np

from fluidgym.scene import NO_SLIP_WALL, PERIODIC, Box, Face, Fluid, Material, Scene, face_names
from fluidgym.solver import Solver
from fluidgym.validation.case import Case, Records, largest_error

WIDTH = 1.0  # L [m]
SPEED = 1.0  # U [m/s]
REYNOLDS = 10.0
VISCOSITY = SPEED * WIDTH / REYNOLDS  # [m2/s]
LENGTH = {2: 1.0, 3: 1.0 / 3.0}  # of the channel, over L
TIME_UNIT = WIDTH**2 / VISCOSITY  # [s]
TIMES = np.array([0.02, 0.05, 0.1, 0.2, 0.5])  # T
TERMS = 60  # of the series: the first one left out is below 1e-30 at the first instant


def poiseuille(y: np.ndarray, time: float) -> np.ndarray:
    """u/U of the flow that a body force drives, at y/L (n,) and T > 0."""
    n = math.pi * np.arange(1, TERMS, 2)[:, None]
    return 4.0 * y * (1.0 - y) - (32.0 / n**3 * np.sin(n * y) * np.exp(-(n**2) * time)).sum(axis=0)


def couette(y: np.ndarray, time: float) -> np.ndarray:
    """u/U of the flow that the upper wall drives, at y/L (n,) and T > 0."""
    order = np.arange(1, TERMS)[:, None]
    n = math.pi * order
    return y + (2.0 / n * (-1.0) ** order * np.sin(n * y) * np.exp(-(n**2) * time)).sum(axis=0)


def channel(resolution: int, dim: int, force: float, upper: Face) -> Scene:
    """The channel: a body force along x [m/s2], and the upper wall."""
    spacing = WIDTH / resolution
    along = (spacing * round(LENGTH[dim] * resolution),) * (dim - 1)
    size = (*along, WIDTH)
    *sides, low, high = face_names(dim)
    return Scene(
        lower=(0.0,) * dim,
        upper=size,
        particle_spacing=spacing,
        fluid=[Fluid(Box((0.0,) * dim, size))],
        faces=dict.fromkeys(sides, PERIODIC) | {low: NO_SLIP_WALL, high: upper},
        gravity=(force, *(0.0,) * (dim - 1)),
        material=Material(viscosity=VISCOSITY),
        reference_speed=SPEED,
    )


def poiseuille_scene(resolution: int, dim: int) -> Scene:
    """A force along the channel, walls at rest."""
    return channel(resolution, dim, 8.0 * VISCOSITY * SPEED / WIDTH**2, NO_SLIP_WALL)


def couette_scene(resolution: int, dim: int) -> Scene:
    """No force, the upper wall sliding."""
    return channel(resolution, dim, 0.0, Face(slip="no", sliding=(SPEED, *(0.0,) * (dim - 1))))


def observe(solver: Solver) -> dict[str, np.ndarray]:
    """Place y/L across the channel and speed u/U along it of each particle."""
    particles = solver.particles()
    return {
        "place": particles.position[:, -1].astype(float) / WIDTH,
        "speed": particles.velocity[:, 0].astype(float) / SPEED,
    }


def poiseuille_errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The error of the flow that a force drives."""
    return {"poiseuille": largest_error(poiseuille, times / TIME_UNIT, records["place"], records["speed"])}


def couette_errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The error of the flow that a wall drives."""
    return {"couette": largest_error(couette, times / TIME_UNIT, records["place"], records["speed"])}


POISEUILLE = Case(
    name="shear-start-up",
    title="Poiseuille and Couette flow starting between two walls",
    resolutions={2: (15, 30, 60), 3: (15, 30)},
    scene=poiseuille_scene,
    times=TIME_UNIT * TIMES,
    end=TIME_UNIT * float(TIMES[-1]),
    observe=observe,
    errors=poiseuille_errors,
)
COUETTE = dataclasses.replace(POISEUILLE, scene=couette_scene, errors=couette_errors)
CASE = dataclasses.replace(
    POISEUILLE,
    parts={"poiseuille": POISEUILLE, "couette": COUETTE},
    target={30: {"poiseuille": 0.005, "couette": 0.0025}, 60: {"poiseuille": 0.0015, "couette": 5e-4}},
    goal={30: {"poiseuille": 0.005, "couette": 0.005}},
)
