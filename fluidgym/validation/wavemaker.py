"""Wavemaker: a piston at the end of a tank of still water sends waves down it.

The resolution counts particles along the depth d = 0.5 m. The piston, the face x_min, moves as S/2 sin(omega t) with a
stroke S = 0.03 m from end to end, which it reaches within three periods; it is driven by its velocity, a few time steps
at a time. The tank is six wavelengths long and ends in a wall. The period is 1 s; 1.5 s and 2 s are cases of their own.
The waves are H = 0.051, 0.032 and 0.023 m high.

The surface is measured by gauges, sixteen a wavelength. A gauge divides the volume of the water around it by the
distance of the gauges, each particle's shared between the two beside it. Those of one wavelength, weighed by cos^2, are
then projected on exp(i (k x - omega t)) over the last two periods of a run. This takes the first harmonic, and of that
the waves that run away from the piston: those that come back from the far wall drop out, and so does the lattice of the
particles. A wave of dx/10 is found to 1 %. By the linear theory of this very tank, with the start of the piston, the
wavefronts and all reflections, the heights so measured are within 0.3 % of the reference.

Reference: linear theory of an endless tank (Biesel; Dean & Dalrymple 1991, chapter 6),

    H/S = 2 (cosh 2kd - 1) / (sinh 2kd + 2kd)        omega^2 = g k tanh kd

What it leaves out is of the order of (kH/2)^2, which is 1.1 % at 1 s.

Errors:
    height: H/S over that of the reference, less 1, one wavelength from the piston: with what is lost on the way.
        Only runs of ten periods or more have it.
    decay: the share of the height that is lost over the next three wavelengths. Only full runs have this and the next.
    wavelength: over that of the reference, less 1, over the same three. The height of the waves alone lengthens them by
        0.6 to 1.1 % at 1 s (Stokes), the less the more water flows back beneath them.
"""

import math
from functools import partial

import numpy as np

from fluidgym.scene import Box, Face, Fluid, Particles, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.smoothing import WENDLAND_C2
from fluidgym.validation.case import Case, Records

DEPTH = 0.5  # d [m]
STROKE = 0.03  # S [m]
GRAVITY = 9.81  # [m/s2]

LENGTH = 6.0  # of the tank, over the wavelength
RAMP = 3.0  # periods until the piston has its full stroke
NEAR, FAR = 1.0, 4.0  # where waves are measured, over the wavelength
SAMPLES = 20  # instants in a period
GAUGES = 16  # in a wavelength

# How long a run lasts, in periods: until the waves are steady four wavelengths down the tank, and what the far wall
# reflects has not yet come back from the piston. The longer the waves, the faster they go for their length.
PERIODS = {1.0: 14.0, 1.5: 12.5, 2.0: 11.0}
SETTLED = 10.0  # periods until they are steady one wavelength from the piston

# Nothing breaks and nothing strikes here, so the two terms that calm a violent flow are cut back to what keeps the
# pressure smooth: viscosity wears the waves down, and so does the diffusion, which at the surface lacks the neighbours
# above. A wide kernel is less troubled by the uneven spacing that waves leave behind; a wider one slows the waves. Loss
# of height over three wavelengths at d/25, with alpha, h/dx and delta: 18 % at 0.01, 1.5, 0.1, once the default;
# 12 % at 0, 1.5, 0.1 and at 0, 2, 0.05; 7 % at 0, 2.5, 0.1; 5 % at 0, 2.5, 0.02.
SCHEME = Scheme(kernel=WENDLAND_C2, smoothing_ratio=2.5, artificial_viscosity=0.0, density_diffusion=0.02, core=0.0)


def wave_number(period: float) -> float:
    """Wave number k [1/m] of waves of a period [s]: Newton's method on kd tanh kd = omega^2 d/g."""
    goal = (2.0 * math.pi / period) ** 2 * DEPTH / GRAVITY
    kd = max(goal, math.sqrt(goal))
    for _ in range(20):
        kd -= (kd * math.tanh(kd) - goal) / (math.tanh(kd) + kd / math.cosh(kd) ** 2)
    return kd / DEPTH


def height_over_stroke(period: float) -> float:
    """H/S of waves of a period [s]."""
    kd = wave_number(period) * DEPTH
    return 2.0 * (math.cosh(2.0 * kd) - 1.0) / (math.sinh(2.0 * kd) + 2.0 * kd)


def piston_velocity(time: float, period: float) -> float:
    """Velocity of the piston [m/s]: d/dt of S/2 a(t) sin(omega t), a growing smoothly from 0 to 1."""
    omega, share = 2.0 * math.pi / period, min(time / (RAMP * period), 1.0)
    grown = share - math.sin(2.0 * math.pi * share) / (2.0 * math.pi)
    growth = (1.0 - math.cos(2.0 * math.pi * share)) / (RAMP * period)
    return 0.5 * STROKE * (grown * omega * math.cos(omega * time) + growth * math.sin(omega * time))


def gauge_places(period: float) -> np.ndarray:
    """Where the gauges stand, from the piston's place at rest to the far wall [m], (n,)."""
    return 2.0 * math.pi / wave_number(period) / GAUGES * np.arange(round(LENGTH * GAUGES) + 1)


def elevation(particles: Particles, scene: Scene, gauges: np.ndarray) -> np.ndarray:
    """Height of the surface over its level at rest at evenly spaced gauges [m], (n,)."""
    between = gauges[1] - gauges[0]
    volume = scene.particle_mass / particles.density
    place = (particles.position[:, 0] - gauges[0]) / between + 1.0
    if not np.isfinite(place).all():  # a run that broke down
        return np.full(len(gauges), np.nan)
    place = np.clip(place, 0.0, len(gauges) + 1.0)  # one gauge more at each end takes what is beyond
    left = np.minimum(place.astype(int), len(gauges))
    share = place - left
    columns = np.bincount(left, volume * (1.0 - share), len(gauges) + 2)
    columns += np.bincount(left + 1, volume * share, len(gauges) + 2)
    return columns[1:-1] / between - DEPTH


def amplitude(times: np.ndarray, elevations: np.ndarray, period: float, place: float) -> complex:
    """Complex amplitude of the waves that run away from the piston [m], against exp(i (k x - omega t)).

    Args:
        times: Evenly spaced over whole periods [s], (n,).
        elevations: At all gauges [m], (n, gauge).
        period: [s].
        place: The middle of the wavelength over which it is measured, over the wavelength.
    """
    turns = np.arange(elevations.shape[1]) / GAUGES
    window = np.where(np.abs(turns - place) < 0.5, np.cos(math.pi * (turns - place)) ** 2, 0.0)
    harmonic = np.exp(2j * math.pi * times / period) @ elevations / len(times)
    blur = np.sinc(1.0 / GAUGES) ** 2  # what sharing particles between two gauges takes from a wave
    return 2.0 * complex(harmonic @ (window * np.exp(-2j * math.pi * turns))) / float(window.sum() * blur)


def scene(resolution: int, dim: int, period: float) -> Scene:
    """The tank, full to its depth, behind the piston room for its stroke."""
    spacing = DEPTH / resolution
    length = spacing * round(LENGTH * 2.0 * math.pi / wave_number(period) / spacing)
    return Scene(
        lower=(-spacing * math.ceil(STROKE / spacing), 0.0),  # whole spacings, for the lattice starts there
        upper=(length, 1.5 * DEPTH),
        particle_spacing=spacing,
        fluid=[Fluid(Box((0.0, 0.0), (length, DEPTH)), pressure="hydrostatic")],
        faces={"x_min": Face(moving=True, travel=(-STROKE, STROKE), start=0.0)},
        gravity=GRAVITY,
    )


def drive(solver: Solver, time: float, period: float) -> None:
    """Have the piston reach its velocity of a time."""
    solver.face_velocity[:, solver.face_index("x_min")] = piston_velocity(time, period)


def observe(solver: Solver, period: float) -> dict[str, np.ndarray]:
    """Elevation at the gauges [m]."""
    return {"elevation": elevation(solver.particles(), solver.scene, gauge_places(period))}


def errors(times: np.ndarray, records: Records, scene: Scene, period: float) -> dict[str, float]:
    """The errors that the head of this file defines."""
    periods = times[-1] / period * (1.0 + 1e-9)
    if periods < SETTLED:
        return {"height": math.nan}
    last = slice(-2 * SAMPLES, None)
    near, far = (amplitude(times[last], records["elevation"][last], period, place) for place in (NEAR, FAR))
    found = {"height": 2.0 * abs(near) / (height_over_stroke(period) * STROKE) - 1.0}
    if periods < PERIODS[period]:
        return found
    turned = float(np.angle(far / near)) / (2.0 * math.pi * (FAR - NEAR))  # lambda_ref/lambda - 1
    return found | {"decay": 1.0 - abs(far) / abs(near), "wavelength": 1.0 / (1.0 + turned) - 1.0}


def case_of(name: str, period: float, resolutions: tuple[int, ...]) -> Case:
    """The case of a period [s]."""
    samples = round(PERIODS[period] * SAMPLES)
    return Case(
        name=name,
        title=f"Piston wavemaker, period {period:g} s, height and decay of the waves",
        resolutions={2: resolutions},
        scene=partial(scene, period=period),
        times=period / SAMPLES * np.arange(1, samples + 1),
        end=PERIODS[period] * period,
        observe=partial(observe, period=period),
        errors=partial(errors, period=period),
        target={25: {"height": 0.03, "decay": 0.06}},
        goal={25: {"decay": 0.05}, 100: {"height": 0.03}},
        scheme=SCHEME,
        drive=partial(drive, period=period),
        headline="height",
    )


CASE = case_of("wavemaker", 1.0, (25, 50))
CASES = (CASE, case_of("wavemaker-1.5s", 1.5, (25,)), case_of("wavemaker-2s", 2.0, (25,)))
