"""Free fall: fluid that nothing touches keeps its shape, and flows alike wherever it is and however fast it goes.

The resolution counts particles along L = 1 m. There are no walls. Three runs of 0.6 s:

    fall: a block, a square or cube of side L, falls from rest under g = 9.81 m/s2, by 1.8 L.
    drift: the same block, without gravity, goes down the diagonal of its box at U = 3 m/s.
    shift: three drops, discs or balls of diameter L, without gravity, are drawn out along the first axis and shrink
        along the last: u = A (x, -z) at the start, seen from the centre, A = 0.75 1/s. The second is 2 L away from the
        first. The third is 2 L away on the other side and carried down at U besides. All stand alike on the lattice.

Reference: all of a block moves by g t^2/2, or by U t, and there is no pressure. The drops do alike, whatever that is.

Errors, the largest over all particles and the instants t = 0.1 to 0.6 s:
    distortion, drift_distortion: how far a particle is from its place in the block, over the spacing. The block is
        where its centre of mass is.
    path, drift_path: how far the centre of mass is from where it should be, over L.
    pressure, drift_pressure: |p| over rho g L, and over rho U^2.
    shift, carried: how far a particle of the second drop, and of the third, is from its like in the first, over the
        spacing, each seen from the centre of its drop.

Nothing but rounding should be left. Positions are kept in single precision: at 2 m from the origin a step rounds them
by up to 1.2e-7 m, always the same way where the velocity does not change. That can add up to 0.0011 dx in the 460 steps
of a block at L/20, and to four times as much at twice the resolution; and the drops' own flow can make it grow. So the
block that drifts has no acoustic damping, which would shorten the steps: at L/40 in two dimensions `drift_distortion`
is 0.0009 without it, and 0.0016 with.
"""

import dataclasses
import math
from functools import partial

import numpy as np

from fluidgym.scene import OPEN, Ball, Box, Fluid, Scene, face_names
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.validation.case import Case, Records

SIDE = 1.0  # L [m]
GRAVITY = 9.81  # [m/s2]
SPEED = 3.0  # U [m/s]
STRAIN_RATE = 0.75  # A [1/s]
PLACES = (0.0, 2.0, -2.0)  # of the drops along the first axis, over L
SPEEDS = (0.0, 0.0, 1.0)  # at which they are carried down, over U
GOALS = ("distortion", "path", "pressure", "drift_distortion", "drift_path", "drift_pressure", "shift", "carried")
TIMES = 0.1 * np.arange(1, 7)  # [s]


def block_scene(resolution: int, dim: int, gravity: float, speed: float) -> Scene:
    """The block in free space, with gravity [m/s2], and with a speed down the diagonal [m/s]."""
    along = speed / math.sqrt(dim)
    return Scene(
        lower=(*(-SIDE,) * (dim - 1), -3.0 * SIDE),
        upper=(*(3.0 * SIDE,) * (dim - 1), SIDE),
        particle_spacing=SIDE / resolution,
        fluid=[Fluid(Box((-0.5 * SIDE,) * dim, (0.5 * SIDE,) * dim), velocity=(*(along,) * (dim - 1), -along))],
        faces=dict.fromkeys(face_names(dim), OPEN),
        gravity=gravity,
        reference_speed=GRAVITY * float(TIMES[-1]),
    )


def drops_scene(resolution: int, dim: int) -> Scene:
    """The three drops in free space."""
    drops = []
    for place, speed in zip(PLACES, SPEEDS, strict=True):
        center = np.array([SIDE * place, *[0.0] * (dim - 1)])
        carried = np.array([*[0.0] * (dim - 1), -speed * SPEED])
        velocity = partial(_strain, center=center, carried=carried)
        drops.append(Fluid(Ball(tuple(center), 0.5 * SIDE), velocity=velocity))
    return Scene(
        lower=(-3.0 * SIDE,) * dim,
        upper=(3.0 * SIDE, *(SIDE,) * (dim - 1)),
        particle_spacing=SIDE / resolution,
        fluid=drops,
        faces=dict.fromkeys(face_names(dim), OPEN),
        gravity=0.0,
    )


def _strain(points: np.ndarray, center: np.ndarray, carried: np.ndarray) -> np.ndarray:
    turn = np.zeros(len(center))
    turn[0], turn[-1] = STRAIN_RATE, -STRAIN_RATE
    return carried + turn * (points - center)


def observe(solver: Solver) -> dict[str, np.ndarray]:
    """Place [m] and pressure [Pa] of each particle."""
    particles = solver.particles()
    return {"place": particles.position.astype(float), "pressure": particles.pressure.astype(float)}


def block_errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """Distortion, path and pressure of a block; it begins with the velocity of the scene's fluid."""
    t, g, u = times[:, None], scene.gravity_vector, np.asarray(scene.fluid[0].velocity, float)
    center = records["place"].mean(axis=1)
    within = records["place"] - center[:, None]
    path = u * t + 0.5 * g * t**2
    unit = scene.material.density * max(float(np.linalg.norm(g)) * SIDE, float(u @ u))
    return {
        "distortion": _farthest(within - within[0]) / scene.particle_spacing,
        "path": _farthest(center - center[0] - path) / SIDE,
        "pressure": float(np.max(np.abs(records["pressure"]))) / unit,
    }


def drift_errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The same of the block that drifts."""
    return {f"drift_{name}": error for name, error in block_errors(times, records, scene).items()}


def drops_errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """How differently the drops flow."""
    drops = np.split(records["place"], len(PLACES), axis=1)
    first, second, third = (drop - drop.mean(axis=1, keepdims=True) for drop in drops)
    return {
        "shift": _farthest(second - first) / scene.particle_spacing,
        "carried": _farthest(third - first) / scene.particle_spacing,
    }


def _farthest(offset: np.ndarray) -> float:
    """Longest of the vectors (..., dim)."""
    return float(np.max(np.linalg.norm(offset, axis=-1)))


FALL = Case(
    name="free-fall",
    title="Free fall and drift of a block, and drops that should flow alike",
    resolutions={2: (10, 20, 40), 3: (10, 20)},
    scene=partial(block_scene, gravity=GRAVITY, speed=0.0),
    times=TIMES,
    end=float(TIMES[-1]),
    observe=observe,
    errors=block_errors,
)
DRIFT = dataclasses.replace(
    FALL,
    scene=partial(block_scene, gravity=0.0, speed=SPEED),
    errors=drift_errors,
    scheme=Scheme(acoustic_damping=0.0),
)
SHIFT = dataclasses.replace(FALL, scene=drops_scene, errors=drops_errors)
CASE = dataclasses.replace(
    FALL,
    parts={"fall": FALL, "drift": DRIFT, "shift": SHIFT},
    target={
        10: {
            "distortion": 1e-4,
            "path": 1e-4,
            "pressure": 1e-6,
            "drift_distortion": 0.001,
            "drift_path": 1e-4,
            "drift_pressure": 1e-6,
            "shift": 0.004,
            "carried": 0.004,
        },
        80: {"drift_distortion": 0.02, "shift": 0.05, "carried": 0.05},  # what rounding adds up to
    },
    goal={10: dict.fromkeys(GOALS, 1e-4)},
)
