"""Lid-driven cavity: fluid in a square box, stirred by the upper wall.

The resolution counts particles along the side L = 1 m. No wall slips. The upper one slides along x at U = 1 m/s from
the first instant on; Re = U L/nu is 100, and 1000 in the second case; c_0 = 10 U. There is no gravity. From rest it
takes about 12 L/U until the flow is steady at Re 100, and 35 L/U at Re 1000: runs go on for 20 and for 48 L/U, and the
last quarter of a run is averaged.

The velocity at a place is that of a polynomial of second degree, fitted to the particles around by least squares. Their
mean would be off by 0.7 % of U at Re 1000 and L/100, and by 8 % under the lid at Re 100 and L/25, where the uppermost
place is half a spacing from it.

In the eye of the vortex the pressure is low, and particles under tension part: without particle shifting, the default
in a full box, a hole of about five spacings opens at Re 1000 from a start off the lattice; `void` sees it. Shifted
particles leave none. More pressure than comes with shifting has its price: it pushes particles that lie unevenly to and
fro, and viscosity takes the energy. At h = 2 dx and alpha = 0.0005 the error `largest` is 2.4 and 0.82 % at Re 100, 25
and 50 across, and 9.6 and 2.7 % at Re 1000, 50 and 100 across; the last is 5.1 % without shifting, at alpha = 0.01.

Reference: in the middle of the box, the velocity u along x at heights y, and v along y at places x. Re 100: Ghia, Ghia
& Shin (1982), finite differences, 129 x 129. Re 1000: Botella & Peyret (1998), Chebyshev polynomials, 160 x 160. The
tests hold both against finite differences extrapolated to no spacing: the first are off by up to 0.005 U in u and by
0.009 U in v, the second by no more than 0.003 U.

Errors, over the places of the tables:
    largest: |u - u_ref| or |v - v_ref|, over U.
    rms: root mean square of the same.
    restless: how much the mean velocity at a place changes from the first half of what is averaged to the second,
        root mean square, over U.
    void: share of empty squares of 2 dx by 2 dx, which should hold four particles each.
"""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from fluidgym.scene import NO_SLIP_WALL, Box, Face, Fluid, Material, Particles, Scene, face_names
from fluidgym.solver import Solver
from fluidgym.validation.case import Case, Limits, Records, rms

LimitsAt = Mapping[int, Limits]

SIDE = 1.0  # L [m]
SPEED = 1.0  # U [m/s]
TIME_UNIT = SIDE / SPEED  # [s]
DENSITY = 1000.0  # [kg/m3]
DURATION = {100: 20.0, 1000: 48.0}  # of a run, over L/U, by Reynolds number
INTERVAL = 0.25  # between instants, over L/U
AVERAGED = 0.25  # which share of a run, at its end
REACH = 3.0  # of the fit, over the spacing

# By Reynolds number: heights y/L and u/U there, places x/L and v/U there.
HEIGHTS = {
    100: np.array([0.0547, 0.1016, 0.1719, 0.2813, 0.4531, 0.5, 0.6172, 0.7344, 0.8516, 0.9531, 0.9766]),
    1000: np.array([0.0547, 0.0703, 0.1016, 0.1719, 0.2813, 0.4531, 0.5, 0.6172, 0.7344, 0.8516, 0.9531, 0.9766]),
}
U = {
    100: np.array(
        [-0.03717, -0.06434, -0.10150, -0.15662, -0.21090, -0.20581, -0.13641, 0.00332, 0.23151, 0.68717, 0.84123]
    ),
    1000: np.array(
        [
            *(-0.18129, -0.22290, -0.30046, -0.38857, -0.28037, -0.10820),
            *(-0.06206, 0.05702, 0.18867, 0.33722, 0.47233, 0.66442),
        ]
    ),
}
_PLACES = np.array([0.0625, 0.0938, 0.1563, 0.2344, 0.5, 0.8047, 0.8594, 0.9063, 0.9453, 0.9688])
PLACES = {100: _PLACES, 1000: _PLACES}
V = {
    100: np.array([0.09233, 0.12317, 0.16077, 0.17527, 0.05454, -0.24533, -0.22445, -0.16914, -0.10313, -0.05906]),
    1000: np.array([0.28071, 0.33304, 0.37692, 0.32536, 0.02580, -0.32021, -0.42645, -0.52644, -0.41038, -0.22792]),
}


def scene(resolution: int, dim: int, reynolds: int) -> Scene:
    """The full box, at rest, its lid sliding."""
    size = (SIDE,) * dim
    return Scene(
        lower=(0.0,) * dim,
        upper=size,
        particle_spacing=SIDE / resolution,
        fluid=[Fluid(Box((0.0,) * dim, size))],
        faces=dict.fromkeys(face_names(dim), NO_SLIP_WALL) | {"y_max": Face(slip="no", sliding=(SPEED, 0.0))},
        gravity=0.0,
        material=Material(density=DENSITY, viscosity=SPEED * SIDE / reynolds),
        reference_speed=SPEED,
    )


def velocity_at(particles: Particles, points: np.ndarray, reach: float) -> np.ndarray:
    """Velocity at places [m/s], (n, 2): exact where it is a polynomial of second degree around a place.

    Args:
        particles: In two dimensions.
        points: Places [m], (n, 2).
        reach: How far away a particle counts [m]; its weight falls to zero there. A place with fewer than six has nan.
    """
    found = np.full((len(points), 2), np.nan)
    for index, place in enumerate(points):
        offset = (particles.position - place) / reach
        near = np.flatnonzero((offset**2).sum(axis=1) < 1.0)
        velocity = particles.velocity[near].astype(float)
        if len(near) < 6 or not np.isfinite(velocity).all():
            continue
        x, y = offset[near].T
        weight = 1.0 - np.hypot(x, y)
        terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        found[index] = np.linalg.lstsq(terms * weight[:, None], velocity * weight[:, None], rcond=None)[0][0]
    return found


def profile_places(reynolds: int) -> np.ndarray:
    """Where the tables have the velocity: those of u, then those of v [m], (n, 2)."""
    y, x = HEIGHTS[reynolds], PLACES[reynolds]
    return SIDE * np.concatenate(
        [np.stack([np.full_like(y, 0.5), y], axis=1), np.stack([x, np.full_like(x, 0.5)], axis=1)]
    )


def observe(solver: Solver, reynolds: int) -> dict[str, np.ndarray | float]:
    """The velocities of the tables, over U (n,), and the share of empty squares."""
    particles, spacing = solver.particles(), solver.scene.particle_spacing
    found = velocity_at(particles, profile_places(reynolds), REACH * spacing) / SPEED
    heights = len(HEIGHTS[reynolds])
    return {
        "profile": np.concatenate([found[:heights, 0], found[heights:, 1]]),
        "void": empty_squares(particles.position, spacing),
    }


def empty_squares(position: np.ndarray, spacing: float) -> float:
    """Share of the squares of two spacings [m] that hold none of the particles, (n, 2) [m]."""
    squares = round(0.5 * SIDE / spacing)
    which = np.clip(np.nan_to_num(position) / SIDE * squares, 0, squares - 1).astype(int)
    return float(np.mean(np.bincount(which @ [squares, 1], minlength=squares**2) == 0))


def errors(times: np.ndarray, records: Records, scene: Scene, reynolds: int) -> dict[str, float]:
    """The errors that the head of this file defines."""
    last = times > (1.0 - AVERAGED) * times[-1] * (1.0 + 1e-9)
    profiles = records["profile"][last]
    off = profiles.mean(axis=0) - np.concatenate([U[reynolds], V[reynolds]])
    half = len(profiles) // 2
    return {
        "largest": float(np.max(np.abs(off))),
        "rms": rms(off),
        "restless": rms(profiles[half:].mean(axis=0) - profiles[:half].mean(axis=0)) if half else math.nan,
        "void": float(np.mean(records["void"][last])),
    }


def case_of(name: str, reynolds: int, resolutions: tuple[int, ...], target: LimitsAt, goal: LimitsAt) -> Case:
    """The case of a Reynolds number."""
    instants = round(DURATION[reynolds] / INTERVAL)
    return Case(
        name=name,
        title=f"Lid-driven cavity at Re {reynolds}, velocity in the middle",
        resolutions={2: resolutions},
        scene=partial(scene, reynolds=reynolds),
        times=INTERVAL * TIME_UNIT * np.arange(1, instants + 1),
        end=DURATION[reynolds] * TIME_UNIT,
        observe=partial(observe, reynolds=reynolds),
        errors=partial(errors, reynolds=reynolds),
        target=target,
        goal=goal,
    )


CASE = case_of(
    "lid-cavity",
    100,
    (25, 50, 100),
    target={
        25: {"largest": 0.035, "rms": 0.012, "restless": 0.01, "void": 0.002},
        50: {"largest": 0.012, "rms": 0.006},
    },
    goal={50: {"largest": 0.02}},
)
CASE_1000 = case_of(
    "lid-cavity-1000",
    1000,
    (25, 50, 100),
    target={
        50: {"largest": 0.12, "rms": 0.06, "restless": 0.01, "void": 0.001},
        100: {"largest": 0.06, "rms": 0.026},
    },
    goal={100: {"largest": 0.04}},
)
CASES = (CASE, CASE_1000)
