"""Taylor-Green vortices in two dimensions: four vortices in a periodic box, which keep their places and fade away.

The resolution counts particles across the box, L = 1 m. The flow has the speed U = 1 m/s at the start,
Re = U L/nu = 100 and c_0 = 10 U. Every particle starts at most 0.2 dx along each axis from the lattice, with the
velocity and the pressure of the exact flow at the place where it is. At this Reynolds number the fluid's own viscosity
exceeds the artificial one, which therefore adds nothing.

Between the vortices the flow draws a lattice out along one diagonal and presses it together along the other, until its
rows give way to each other. From there on the error of an unshifted scheme is that of sums over particles in disorder:
the pressure force does not vanish where the pressure is uniform, and viscosity rubs out the eddies of a few spacings
that this makes. A finer resolution at the same h/dx wins little: at 50 and 100 across, the error `speed` is 3.0 and
1.7 % at h = 2.5 dx. With particle shifting, which is the default in a full box, it is 0.65 and 0.10 % at h = 2 dx, and
0.46 and 0.26 % at 1.5 dx.

The pressure has no constant part: it is below zero in the middle of each vortex. A constant that lifts it above zero
keeps particles farther apart, but pushes where the sums do not vanish; see `shifting` for how much of it pays.

Reference: the Navier-Stokes equations have the solution, with k = 2 pi/L and the decay b = exp(-2 nu k^2 t),

    u = U b (-cos kx sin ky, sin kx cos ky)        p = -rho/4 U^2 b^2 (cos 2kx + cos 2ky)

(Taylor 1923). Its largest speed is U b, its kinetic energy U^2 b^2/4 per mass; by t = 2 L/U, b is 0.206.

Errors, the largest over the instants t = 0.1, 0.2, ... 2 L/U. All are relative to the flow as it is at that instant, so
that a fifth of the speed at the end counts as much as all of it at the start.
    speed: mean over the particles of ||u| - |u_ref|| over the mean of |u_ref|, at the places where they are.
    decay: |u_max/(U b) - 1|, with the speed of the fastest particle.
    energy: |E/(U^2 b^2/4) - 1|, with the kinetic energy E per mass.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from fluidgym.diagnostics import kinetic_energy, largest_speed, mass
from fluidgym.scene import PERIODIC, Box, Fluid, Material, Scene, face_names
from fluidgym.solver import Solver
from fluidgym.validation.case import Case, Records

LENGTH = 1.0  # L [m]
SPEED = 1.0  # U [m/s]
DENSITY = 1000.0  # [kg/m3]
REYNOLDS = 100.0
VISCOSITY = SPEED * LENGTH / REYNOLDS  # [m2/s]
WAVE_NUMBER = 2.0 * math.pi / LENGTH  # k [1/m]
JITTER = 0.2  # over the spacing
TIMES = 0.1 * LENGTH / SPEED * np.arange(1, 21)  # [s]


def decay(time: float | np.ndarray) -> np.ndarray:
    """b, what is left of the velocity at a time [s]."""
    return np.exp(-2.0 * VISCOSITY * WAVE_NUMBER**2 * np.asarray(time, float))


def velocity(position: np.ndarray, time: float = 0.0) -> np.ndarray:
    """Velocity of the exact flow [m/s] at places [m], each (n, 2)."""
    x, y = WAVE_NUMBER * position.T
    return SPEED * decay(time) * np.stack([-np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)], axis=1)


def pressure(position: np.ndarray, time: float = 0.0) -> np.ndarray:
    """Pressure of the exact flow [Pa] (n,) at places [m], (n, 2); its mean over the box is zero."""
    x, y = WAVE_NUMBER * position.T
    return -0.25 * DENSITY * (SPEED * decay(time)) ** 2 * (np.cos(2.0 * x) + np.cos(2.0 * y))


Field = Callable[[np.ndarray], np.ndarray]


def periodic_box(resolution: int, dim: int, side: float, velocity: Field, pressure: Field) -> Scene:
    """A periodic box of a side [m], its fluid starting with the velocity [m/s] and pressure [Pa] of places [m]."""
    lower, upper = (0.0,) * dim, (side,) * dim
    still = Scene(
        lower=lower,
        upper=upper,
        particle_spacing=side / resolution,
        fluid=[Fluid(Box(lower, upper))],
        faces=dict.fromkeys(face_names(dim), PERIODIC),
        gravity=0.0,
        material=Material(density=DENSITY, viscosity=VISCOSITY),
        reference_speed=SPEED,
        jitter=JITTER,
    )
    # A scene asks for velocity and pressure on the lattice, before the jitter; here they are those after it.
    places = still.sample().position
    moving = Fluid(Box(lower, upper), velocity=lambda lattice: velocity(places), pressure=lambda _: pressure(places))
    return dataclasses.replace(still, fluid=[moving])


def scene(resolution: int, dim: int) -> Scene:
    """The periodic box, full of fluid that moves as the exact flow does."""
    return periodic_box(resolution, dim, LENGTH, velocity, pressure)


def speed_error(position: np.ndarray, moving: np.ndarray, time: float) -> float:
    """The mean of ||u| - |u_ref|| over that of |u_ref|, for places [m] and velocities [m/s], each (n, 2)."""
    exact = np.linalg.norm(velocity(position, time), axis=1)
    return float(np.abs(np.linalg.norm(moving, axis=1) - exact).mean() / exact.mean())


def observe(solver: Solver) -> dict[str, float]:
    """Error of the speed, largest speed [m/s], kinetic energy per mass [m2/s2]."""
    particles, scene = solver.particles(), solver.scene
    place, moving = particles.position.astype(float), particles.velocity.astype(float)
    return {
        "speed_error": speed_error(place, moving, float(solver.time[0])),
        "largest_speed": largest_speed(particles),
        "energy": kinetic_energy(particles, scene) / mass(particles, scene),
    }


def errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The errors that the head of this file defines."""
    left = SPEED * decay(times[1:])
    return {
        "speed": float(np.max(records["speed_error"][1:])),
        "decay": float(np.max(np.abs(records["largest_speed"][1:] / left - 1.0))),
        "energy": float(np.max(np.abs(records["energy"][1:] / (0.25 * left**2) - 1.0))),
    }


CASE = Case(
    name="taylor-green",
    title="Taylor-Green vortices in two dimensions, speed and decay",
    resolutions={2: (25, 50, 100)},
    scene=scene,
    times=TIMES,
    end=float(TIMES[-1]),
    observe=observe,
    errors=errors,
    target={50: {"speed": 0.01, "energy": 0.02}, 100: {"speed": 0.004}},
    goal={50: {"speed": 0.02}, 100: {"speed": 0.007}},
)
