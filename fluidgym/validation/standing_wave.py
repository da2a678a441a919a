"""Standing wave: water in a tank swings up and down between its walls.

The resolution counts particles along the depth H = 1 m. The tank is half a wavelength wide, so that the first mode of
the tank, high at one wall while it is low at the other, is the wave; as the walls let the water slip, a tank of a whole
wavelength has the same flow twice. All runs have c_0 = 10 sqrt(gH).

They start as the wave passes through level water: a box of particles with the velocity of linear theory,

    phi = B cosh(kz) / cosh(kH) cos(kx)        B = a g / omega_0        omega_0^2 = g k tanh(kH)

and the pressure of the incompressible flow with this velocity and a level surface,

    p/rho = g (H - z) + (k B / 2 cosh(kH))^2 (cosh(2kH) - cosh(2kz) + (1 - cosh(2kz)/cosh(2kH)) cos(2kx))

Its Laplacian is -grad u : grad u, and it is 0 at the surface and has no slope at walls and floor but that of gravity.
So the lattice makes no steps in the surface, as it would in a raised one, and there is hardly a sound: only the
uppermost rows settle, whose kernel is cut off by the surface, with pressures of the order of rho g dx. In deep water a
standing wave of second order has just this level surface and this potential as well.

Observed are the first harmonics of the surface, (2/L) int eta cos(nkx) dx with L the width. That is 2/L times the sum
over the particles of V cos(nkx), which is smooth in all their places: neither a single particle nor the compression of
the water under it counts. A sine that decays is fitted to the first harmonic, over the whole run.

standing-wave. Without viscosity; wavelength 2 m, a = 0.1 m, ka = 0.31; five periods, and in full ten.

Reference: the period of Tadjbakhsh & Keller (1960), to second order in ka: T_0 = 2 pi/omega_0 = 1.13392 s over

    1 + (ka)^2 (9 s^-8 - 12 s^-4 - 3 - 2 s^4) / 64        s = tanh(kH)^(1/2)

which is 1.24 % more than T_0. Potential flow, solved numerically from the same start, has 1.26 %. As the wave decays,
its period shortens; (ka)^2 is therefore the mean over the run, by way of the energy.

Errors:
    period: over that of the reference, less 1.
    linear: over T_0, less 1; that of the reference has 0.0124.
    loss: the share of its energy that the wave loses in a period T_0: the exponential decay fitted to the energy over
        that of still water. That is the kinetic energy and, from the harmonics, rho g/2 int eta^2 dx. (The heights of
        the particles would not do: if the water sinks by 0.01 % of its depth, which no one would notice, that takes 2 %
        of the energy of this wave. Nor is the energy of compression counted; it hardly changes.)

standing-wave-viscous. Wavelength 1 m, a = 0.02 m, ka = 0.13; Re = H sqrt(gH)/nu = 250, 500 and 2500, three runs; four
periods. Walls and floor let the water slip.

Reference: the motion of a wave of small height from this start (Prosperetti 1976), whose Laplace transform is

    a_1(s) = a omega_0 / ((s + 2 nu k^2)^2 + omega_0^2 - 4 nu^2 k^3 (k^2 + s/nu)^(1/2))

with Lamb's relation for the decaying wave (Hydrodynamics, section 349) below the line. It starts as the irrotational
flow does, with omega_0 = 7.85096 1/s and the rate of decay 2 nu k^2, that is, with amplitude factors per period of
0.4531, 0.6731 and 0.9239. Then vorticity spreads down from the surface, and the wave decays more slowly: by Lamb's
relation alone at 0.82, 0.87 and 0.94 of this rate. The reference is fitted as the run is, at the same instants.

Errors, for each Reynolds number:
    damping: rate of decay over that of the reference, less 1.
    omega: angular frequency over that of the reference and of the finite amplitude, less 1.
"""

import cmath
import dataclasses
import math
from functools import partial

import numpy as np

from fluidgym.diagnostics import kinetic_energy
from fluidgym.scene import Box, Fluid, Material, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.sph.viscosity import VISCOSITY_MONAGHAN
from fluidgym.validation.case import Case, Records

DEPTH = 1.0  # H [m]
GRAVITY = 9.81  # [m/s2]
DENSITY = 1000.0  # [kg/m3]
SPEED = math.sqrt(GRAVITY * DEPTH)  # [m/s]

WAVELENGTH, AMPLITUDE = 2.0, 0.1  # [m]
PERIODS, ALL_PERIODS = 5, 10

VISCOUS_WAVELENGTH, VISCOUS_AMPLITUDE = 1.0, 0.02  # [m]
VISCOUS_PERIODS = 4
REYNOLDS = (250, 500, 2500)

SAMPLES = 40  # instants in a period
HARMONICS = 4  # that are observed; from the third on they have 0.1 % of the energy

# Nothing breaks and nothing strikes here, so little needs to be calmed: viscosity wears the wave down, and so does the
# diffusion. Under this kernel a strained lattice keeps its density (see the oscillating drop). With Wendland C2 at
# h = 1.5 dx, a strain e lets the lattice grow by 0.013 e^2 at the same density, on the mean over its directions;
# that lifts the water above, as if gravity were stronger by 1.3 % for the wave, and would make omega 0.7 % too high at
# any resolution. Error of the period and loss over five periods at H/25 and H/50, with kernel, h/dx, alpha and delta:
#     C2, 1.5, 0.01, 0.1 without acoustic damping   -0.3 %, 11.8 %    -0.5 %, 7.4 %
#     C2, 2, 0.0005, 0.1                             0.6 %, 2.8 %     0.05 %, 1.4 %
#     C2, 2, 0, 0.02                                 0.6 %, 2.0 %     0.05 %, 1.1 %
#     C4, 2.2, 0.0003, 0.1 and a core (the default)  0.8 %, 2.8 %      0.2 %, 1.0 %
#     C4, 2.4, 0.0002, 0.1                           1.1 %, 2.5 %      0.3 %, 0.8 %
#     C4, 2.4, 0, 0.02 (here)                        1.1 %, 1.4 %      0.3 %, 0.4 %
# The acoustic damping makes no difference. Later on, when the lattice has dissolved, the wave loses more: over ten
# periods 2.3 % and 0.8 %, and 1.5 % at H/50 with the default.
SCHEME = Scheme(smoothing_ratio=2.4, artificial_viscosity=0.0, density_diffusion=0.02, core=0.0)

# The Laplacian of the velocity, which is the default, damps the wave at half the rate: where the surface is free, it
# takes nu int |grad u|^2 from the energy in place of 2 nu int |D|^2, with D the symmetric part of grad u, as if half
# of the stress were missing there (Colagrossi, Antuono, Souto-Iglesias & Le Touze 2011). Monaghan's form takes the
# whole. The wave is half as long as that without viscosity, so a wide kernel slows it more: hence h = 2.1 dx. Damping
# at Re 500 and 2500, and omega, are 1.7, 19 and 0.4 % off at H/50; with C2 at 2 dx, alpha = 0.0005 and
# delta = 0.1, 2.7, 24 and 0.2 %.
VISCOUS_SCHEME = Scheme(
    smoothing_ratio=2.1,
    artificial_viscosity=0.0,
    density_diffusion=0.05,
    viscosity=VISCOSITY_MONAGHAN,
)


def wave_number(scene: Scene) -> float:
    """Wave number k of the first mode of a tank [1/m]."""
    return math.pi / scene.upper[0]


def linear_omega(k: float) -> float:
    """Angular frequency omega_0 of waves of no height [1/s]."""
    return math.sqrt(GRAVITY * k * math.tanh(k * DEPTH))


def frequency_ratio(k: float, amplitude_squared: float) -> float:
    """Angular frequency of a standing wave over that of linear theory, from the square of its amplitude [m2].

    Tadjbakhsh & Keller (1960), to second order.
    """
    s4 = math.tanh(k * DEPTH) ** 2
    return 1.0 + k**2 * amplitude_squared * (9.0 / s4**2 - 12.0 / s4 - 3.0 - 2.0 * s4) / 64.0


def lamb_root(k: float, viscosity: float) -> complex:
    """Growth n [1/s] of a viscous wave a ~ exp(n t) that turns one way; that of the other is its conjugate."""
    rate, friction = viscosity * k**2, 2.0 * viscosity * k**2
    n = complex(-friction, linear_omega(k))
    for _ in range(50):
        root = cmath.sqrt(1.0 + n / rate)
        n -= ((n + friction) ** 2 + linear_omega(k) ** 2 - friction**2 * root) / _slope(n, rate)
    return n


def _slope(n: complex, rate: float) -> complex:
    """Derivative of Lamb's relation with respect to n [1/s], rate = nu k^2."""
    return 2.0 * (n + 2.0 * rate) - 2.0 * rate / cmath.sqrt(1.0 + n / rate)


def viscous_wave(times: np.ndarray, k: float, viscosity: float, start_speed: float) -> np.ndarray:
    """First harmonic of the surface [m] at instants [s] (n,), from its rate at the start [m/s].

    The inverse Laplace transform: the residues at Lamb's two roots, and an integral along the cut of the square root,
    s = -nu k^2 (1 + y^2), which is of vorticity that fades.
    """
    n, rate = lamb_root(k, viscosity), viscosity * k**2
    wave = 2.0 * (np.exp(n * times) / _slope(n, rate)).real
    # The integrand is even and smooth, for which the trapezoidal rule is all but exact.
    y, step = np.linspace(0.0, 60.0 * math.sqrt(linear_omega(k) / rate), 6001, retstep=True)
    gone = (rate * (1.0 - y**2)) ** 2 + linear_omega(k) ** 2
    share = 8.0 * rate**3 * y**2 / (gone**2 + 16.0 * rate**4 * y**2)
    fading = np.exp(-rate * np.outer(times, 1.0 + y**2)) @ share * step / math.pi
    return start_speed * (wave - fading)


def oscillation(times: np.ndarray, values: np.ndarray, omega: float) -> tuple[float, float]:
    """Angular frequency and rate of decay [1/s] of the sine that decays and fits best: the Gauss-Newton method.

    Args:
        times: [s], (n,), over at least a period; less gives nan.
        values: (n,); nan among them, as of a run that broke down, gives nan.
        omega: A first guess [1/s]; it must not be off by more than a quarter turn at the end.
    """
    guess, rate = omega, 0.0
    if not np.isfinite(values).all() or (times[-1] - times[0]) * guess < 2.0 * math.pi * (1.0 - 1e-6):
        return math.nan, math.nan
    for _ in range(30):
        fade = np.exp(-rate * times)
        cosine, sine = fade * np.cos(omega * times), fade * np.sin(omega * times)
        (p, q), *_ = np.linalg.lstsq(np.stack([cosine, sine], axis=1), values, rcond=None)
        wave, turned = p * cosine + q * sine, q * cosine - p * sine
        slopes = np.stack([cosine, sine, times * turned, -times * wave], axis=1)
        step = np.linalg.lstsq(slopes, values - wave, rcond=None)[0]
        omega = float(np.clip(omega + step[2], 0.5 * guess, 2.0 * guess))  # whatever it is given, it does not run away
        rate = float(np.clip(rate + step[3], -guess, guess))
    return omega, rate


def scene(resolution: int, dim: int, wavelength: float, amplitude: float, viscosity: float) -> Scene:
    """The tank, the water level and on its way; the width is rounded to whole particles, the wave with it."""
    spacing = DEPTH / resolution
    width = spacing * round(0.5 * wavelength / spacing)
    k = math.pi / width
    speed = k * amplitude * GRAVITY / linear_omega(k) / math.cosh(k * DEPTH)

    def velocity(points: np.ndarray) -> np.ndarray:
        x, z = k * points.T
        return speed * np.stack([-np.cosh(z) * np.sin(x), np.sinh(z) * np.cos(x)], axis=1)

    def pressure(points: np.ndarray) -> np.ndarray:
        x, z = 2.0 * k * points.T
        top = math.cosh(2.0 * k * DEPTH)
        dynamic = 0.25 * speed**2 * (top - np.cosh(z) + (1.0 - np.cosh(z) / top) * np.cos(x))
        return DENSITY * (GRAVITY * (DEPTH - points[:, 1]) + dynamic)

    return Scene(
        lower=(0.0, 0.0),
        upper=(width, 1.5 * DEPTH),
        particle_spacing=spacing,
        fluid=[Fluid(Box((0.0, 0.0), (width, DEPTH)), velocity, pressure)],
        gravity=GRAVITY,
        material=Material(density=DENSITY, viscosity=viscosity),
        reference_speed=SPEED,
    )


def observe(solver: Solver) -> dict[str, np.ndarray | float]:
    """First harmonics of the surface [m], (harmonic,), and the kinetic energy [J/m]."""
    particles, scene = solver.particles(), solver.scene
    turns = wave_number(scene) * np.arange(1, HARMONICS + 1)[:, None] * particles.position[:, 0].astype(float)
    return {
        "elevation": 2.0 / scene.upper[0] * scene.particle_spacing**2 * np.cos(turns).sum(axis=1),
        "kinetic": kinetic_energy(particles, scene),
    }


def errors(times: np.ndarray, records: Records, scene: Scene, amplitude: float) -> dict[str, float]:
    """The errors of the wave without viscosity that the head of this file defines."""
    k = wave_number(scene)
    linear = linear_omega(k)
    omega, _ = oscillation(times, records["elevation"][:, 0], linear)
    surface = 0.25 * DENSITY * GRAVITY * scene.upper[0] * (records["elevation"] ** 2).sum(axis=1)
    energy = records["kinetic"] + surface
    growth = math.nan
    if math.isfinite(omega):
        growth = float(np.polyfit(times, np.log(energy), 1)[0])
    mean_square = amplitude**2 * float(np.mean(energy)) / float(energy[0])
    return {
        "period": linear * frequency_ratio(k, mean_square) / omega - 1.0,
        "linear": linear / omega - 1.0,
        "loss": 1.0 - math.exp(2.0 * math.pi / linear * growth),
    }


def viscous_errors(
    times: np.ndarray, records: Records, scene: Scene, amplitude: float, reynolds: int
) -> dict[str, float]:
    """The errors of a viscous wave that the head of this file defines."""
    k = wave_number(scene)
    linear = linear_omega(k)
    exact = viscous_wave(times, k, scene.material.viscosity, amplitude * linear)
    exact_omega, exact_rate = oscillation(times, exact, linear)
    omega, rate = oscillation(times, records["elevation"][:, 0], linear)
    lost = 2.0 * exact_rate * float(times[-1])
    mean_square = amplitude**2 * -math.expm1(-lost) / lost
    return {
        f"damping_{reynolds}": rate / exact_rate - 1.0,
        f"omega_{reynolds}": omega / (exact_omega * frequency_ratio(k, mean_square)) - 1.0,
    }


def viscous_part(reynolds: int) -> Case:
    """The viscous wave of a Reynolds number."""
    period = 2.0 * math.pi / linear_omega(2.0 * math.pi / VISCOUS_WAVELENGTH)
    return Case(
        name="standing-wave-viscous",
        title="Standing wave in a viscous fluid, damping and frequency",
        resolutions={2: (25, 50, 100)},
        scene=partial(
            scene,
            wavelength=VISCOUS_WAVELENGTH,
            amplitude=VISCOUS_AMPLITUDE,
            viscosity=DEPTH * SPEED / reynolds,
        ),
        times=period / SAMPLES * np.arange(1, VISCOUS_PERIODS * SAMPLES + 1),
        end=VISCOUS_PERIODS * period,
        observe=observe,
        errors=partial(viscous_errors, amplitude=VISCOUS_AMPLITUDE, reynolds=reynolds),
        scheme=VISCOUS_SCHEME,
    )


PERIOD = 2.0 * math.pi / linear_omega(2.0 * math.pi / WAVELENGTH)  # [s]
CASE = Case(
    name="standing-wave",
    title="Standing wave, period and loss of energy",
    resolutions={2: (25, 50, 100)},
    scene=partial(scene, wavelength=WAVELENGTH, amplitude=AMPLITUDE, viscosity=0.0),
    times=PERIOD / SAMPLES * np.arange(1, ALL_PERIODS * SAMPLES + 1),
    end=PERIODS * PERIOD,
    observe=observe,
    errors=partial(errors, amplitude=AMPLITUDE),
    target={25: {"period": 0.013, "loss": 0.025}, 50: {"period": 0.004, "loss": 0.009}},
    goal={50: {"period": 0.005, "loss": 0.01}},
    scheme=SCHEME,
    headline="loss",
)
VISCOUS = dataclasses.replace(
    viscous_part(REYNOLDS[0]),
    parts={str(reynolds): viscous_part(reynolds) for reynolds in REYNOLDS},
    target={
        50: {f"omega_{reynolds}": 0.005 for reynolds in REYNOLDS}
        | {"damping_250": 0.015, "damping_500": 0.03, "damping_2500": 0.22}
    },
    goal={50: {f"omega_{reynolds}": 0.005 for reynolds in REYNOLDS} | {"damping_500": 0.05}},
    headline="damping_500",
)
CASES = (CASE, VISCOUS)
