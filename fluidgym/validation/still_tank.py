"""Still tank: a column at rest in a closed box should stay at rest.

The resolution counts particles along the depth H = 0.9 m. In two dimensions the tank is 1 m wide, in three its floor is
a square of H/2; both are rounded to whole particles, because a column that does not fill its tank would rightly spread
and sink. The particles start off their lattice by up to 2 % of the spacing: a perfect lattice is an equilibrium that
gives way, and without a push rounding would decide when, so that the same scheme could seem to grow still or to grow
restless. Its rows lie closer at the bottom, as the pressure asks (`Scene.sample`); a column that does not would turn
over. Runs end after 20 sqrt(H/g), and in full after 100 sqrt(H/g).

Reference: p = rho g (H - y).

Errors, those of the last quarter of a run unless said otherwise:
    pressure: root mean square over particles and instants of p - p_ref, over rho g H.
    early_speed: root mean square speed over sqrt(gH), of the last quarter of the first 20 sqrt(H/g) or of a shorter
        run. The lattice gives way in this time, and the water is not still yet.
    speed: likewise, of the last quarter of a full run; others do not have it.
    growth: root mean square speed, over that of the second quarter of the run: at most 1 where motion does not grow.
    depth: mean of twice the height of the centre of mass, over its value at the start, less 1.
"""

import math

import numpy as np

from fluidgym.diagnostics import center_of_mass, rms_speed
from fluidgym.scene import Box, Fluid, Scene
from fluidgym.solver import Solver
from fluidgym.validation.case import Case, Records, rms

DEPTH = 0.9  # [m]
WIDTH = {2: 1.0, 3: 0.45}  # [m]
GRAVITY = 9.81  # [m/s2]
JITTER = 0.02  # over the spacing
TIME_UNIT = math.sqrt(DEPTH / GRAVITY)  # [s]
EARLY, LATE = 20.0, 100.0  # when a run ends, and a full one, over sqrt(H/g)


def scene(resolution: int, dim: int) -> Scene:
    """The full tank, with half as much air over the water."""
    spacing = DEPTH / resolution
    floor = (spacing * round(WIDTH[dim] / spacing),) * (dim - 1)
    return Scene(
        lower=(0.0,) * dim,
        upper=(*floor, 1.5 * DEPTH),
        particle_spacing=spacing,
        fluid=[Fluid(Box((0.0,) * dim, (*floor, DEPTH)), pressure="hydrostatic")],
        gravity=GRAVITY,
        jitter=JITTER,
    )


def observe(solver: Solver) -> dict[str, float]:
    """Pressure error over rho g H, speed over sqrt(gH), centre of mass over H/2."""
    particles = solver.particles()
    pressure_unit = solver.scene.material.density * GRAVITY * DEPTH
    expected = pressure_unit * (1.0 - particles.position[:, -1] / DEPTH)
    return {
        "pressure": rms(particles.pressure - expected) / pressure_unit,
        "speed": rms_speed(particles) / math.sqrt(GRAVITY * DEPTH),
        "depth": float(center_of_mass(particles)[-1]) / (0.5 * DEPTH),
    }


def errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The errors that the head of this file defines."""
    end = times[-1]
    early = min(end, EARLY * TIME_UNIT * (1.0 + 1e-6))
    second = (times > 0.25 * end) & (times <= 0.5 * end)
    last = times > 0.75 * end
    speed = rms(records["speed"][last])
    return {
        "pressure": rms(records["pressure"][last]),
        "early_speed": rms(records["speed"][(times > 0.75 * early) & (times <= early)]),
        **({"speed": speed} if end > LATE * TIME_UNIT * (1.0 - 1e-6) else {}),
        "growth": speed / rms(records["speed"][second]),
        "depth": float(np.mean(records["depth"][last]) / records["depth"][0] - 1.0),
    }


CASE = Case(
    name="still-tank",
    title="Still tank, pressure and unwanted motion",
    resolutions={2: (20, 40, 80), 3: (10, 20)},
    scene=scene,
    times=TIME_UNIT * 0.25 * np.arange(1, round(4.0 * LATE) + 1),
    end=EARLY * TIME_UNIT,
    observe=observe,
    errors=errors,
    target={20: {"pressure": 0.01, "early_speed": 0.004, "growth": 1.0, "depth": 0.004}, 40: {"depth": 0.0025}},
    goal={20: {"pressure": 0.01, "speed": 1e-3, "growth": 1.0, "depth": 0.005}},
)
