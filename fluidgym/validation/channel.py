"""Channel: fluid flows in at one end and out at the other, with the profile of laminar flow.

The resolution counts particles across the channel, H = 1 m. The mean speed is U = 1 m/s, the Reynolds number UH/nu is
20, and c_0 is ten times the speed of the middle line. From the end of the nozzle's pipe to the outflow it is 2 H; walls
do not slip. Two starts:

`channel`: full, with the exact profile and its pressure. Runs end after 8 H/U, and in full after 20 H/U.

`channel-start`: at rest up to the outflow, which is empty: a particle crosses an outflow at the speed it came in with,
and one at rest in there would never leave. The nozzle runs at full speed at once. Runs end after 12 H/U.

The outflow holds the pressure 0, as the nozzle takes that of the fluid ahead and one of the two has to set the level.

Reference: u = 6 U y (H - y) / H^2, dp/dx = -12 nu rho U / H^2. A nozzle hands out particles at rest density, so it is
the mass flux that is exactly rho U H; on the way down to no pressure the fluid of c_0 = 15 m/s grows by 0.5 %, and so
does its speed: 0.3 % of it in the middle, where it is measured.

The smoothing length is h = 1.5 dx, below the default. Under a wide kernel the row of particles beside a wall is drawn
towards it, and its particles come together in pairs: with Wendland C2, `profile` and `worst` are 0.45 and 4.3 % at H/20
and h = 2 dx, and 0.27 and 1.4 % at 1.5 dx; here, with C4, they are 0.36 and 1.2 %.

Errors, those of the last 4 H/U of a run and of the middle H of the channel unless said otherwise:
    profile: root mean square over particles and instants of u - u_ref, over the speed of the middle line.
    worst: largest of the same.
    flux: mean mass flux, the sum of m u over the length that it is taken of, over rho U H, less 1.
    outflow: mass of the particles that have left, over rho U H and the time, less 1. One particle more or less of
        every row is 1.2 % at H/20.
    gradient: mean slope of the pressure over the reference's, less 1.
    ledger: largest discrepancy at any instant of the run [particles]: between the particles there are and those that
        started, came and left; between their number and that of their distinct identities; between the identities
        handed out and those that started and came.
"""

import dataclasses

import numpy as np

from fluidgym.scene import NO_SLIP_WALL, OPEN, Box, Fluid, Inflow, Material, Outflow, Scene
from fluidgym.scheme import Scheme
from fluidgym.solver import Solver
from fluidgym.validation.case import Case, Records, rms

HEIGHT = 1.0  # H [m]
SPEED = 1.0  # U [m/s]
REYNOLDS = 20.0
DENSITY = 1000.0  # [kg/m3]
LENGTH = 2.0  # of the free channel, over H
MEASURED = 1.0  # length of the part that is measured, in its middle, over H
OUTFLOW = 6  # length of the outflow, over the spacing
TIME_UNIT = HEIGHT / SPEED  # [s]
WINDOW = 4.0 * TIME_UNIT  # [s]
PEAK = 1.5 * SPEED  # [m/s]
VISCOSITY = SPEED * HEIGHT / REYNOLDS  # [m2/s]
GRADIENT = -12.0 * VISCOSITY * DENSITY * SPEED / HEIGHT**2  # [Pa/m]


def profile(y: np.ndarray) -> np.ndarray:
    """Speed along the channel at heights [m] (n,) -> [m/s] (n,)."""
    return 6.0 * SPEED * y * (HEIGHT - y) / HEIGHT**2


def _free_part(scene: Scene) -> tuple[float, float]:
    """Where the free channel begins and ends [m]."""
    return scene.inflows["inlet"].pipe_length(scene.particle_spacing), float(scene.outflows["outlet"].region.lower[0])


def _scene(resolution: int, running: bool) -> Scene:
    spacing = HEIGHT / resolution
    inlet = Inflow((0.0, 0.5 * HEIGHT), (1.0, 0.0), HEIGHT, speed=SPEED, profile="parabolic")
    first = inlet.pipe_length(spacing)
    last = first + LENGTH * HEIGHT
    upper = (last + OUTFLOW * spacing, HEIGHT)
    at_rest = Fluid(Box((first, 0.0), (last, HEIGHT)))
    exact = Fluid(
        Box((first, 0.0), upper),
        velocity=lambda points: np.stack([profile(points[:, 1]), np.zeros(len(points))], axis=1),
        pressure=lambda points: np.maximum(GRADIENT * (points[:, 0] - last), 0.0),
    )
    return Scene(
        lower=(0.0, 0.0),
        upper=upper,
        particle_spacing=spacing,
        fluid=[exact if running else at_rest],
        faces={"x_max": OPEN, "y_min": NO_SLIP_WALL, "y_max": NO_SLIP_WALL},
        gravity=0.0,
        material=Material(density=DENSITY, viscosity=VISCOSITY),
        reference_speed=PEAK,
        inflows={"inlet": inlet},
        outflows={"outlet": Outflow(Box((last, 0.0), upper), "+x", pressure=0.0)},
    )


def running_scene(resolution: int, dim: int) -> Scene:
    """The channel as it should be for ever."""
    return _scene(resolution, running=True)


def starting_scene(resolution: int, dim: int) -> Scene:
    """The channel at rest."""
    return _scene(resolution, running=False)


def observe(solver: Solver) -> dict[str, float]:
    """What the errors are made of: three of them at this instant, the mass gone [kg/m], and the state of the books."""
    particles, scene, account = solver.particles(), solver.scene, solver.account()
    first, last = _free_part(scene)
    x = particles.position[:, 0]
    middle = np.abs(x - 0.5 * (first + last)) < 0.5 * MEASURED * HEIGHT
    u = particles.velocity[middle, 0].astype(float)
    off = (u - profile(particles.position[middle, 1].astype(float))) / PEAK
    slope = np.polyfit(x[middle].astype(float), particles.pressure[middle], 1)[0]
    came = account.started + account.emitted
    books = (
        came - account.retired - len(particles),
        len(particles) - len(np.unique(particles.identity)),
        came - 1 - int(particles.identity.max()),
    )
    return {
        "profile": rms(off),
        "worst": float(np.abs(off).max()),
        "flux": scene.particle_mass * float(u.sum()) / (MEASURED * HEIGHT) / (DENSITY * SPEED * HEIGHT) - 1.0,
        "gradient": float(slope) / GRADIENT - 1.0,
        "gone": account.retired * scene.particle_mass,
        "ledger": float(max(map(abs, books))),
    }


def errors(times: np.ndarray, records: Records, scene: Scene) -> dict[str, float]:
    """The errors that the head of this file defines."""
    begin = int(np.argmin(np.abs(times - max(0.0, times[-1] - WINDOW))))
    late = slice(begin + 1, None)
    due = DENSITY * SPEED * HEIGHT * (times[-1] - times[begin])
    return {
        "profile": rms(records["profile"][late]),
        "worst": float(records["worst"][late].max()),
        "flux": float(records["flux"][late].mean()),
        "outflow": float((records["gone"][-1] - records["gone"][begin]) / due) - 1.0,
        "gradient": float(records["gradient"][late].mean()),
        "ledger": float(records["ledger"].max()),
    }


CASE = Case(
    name="channel",
    title="Channel from inflow to outflow, profile, flux and ledger",
    resolutions={2: (20, 40, 80)},
    scene=running_scene,
    times=0.1 * TIME_UNIT * np.arange(1, 201),
    end=8.0 * TIME_UNIT,
    observe=observe,
    errors=errors,
    target={
        20: {"profile": 0.005, "worst": 0.03, "flux": 0.001, "gradient": 0.015, "ledger": 0.0},
        40: {"profile": 0.003, "worst": 0.02, "outflow": 0.005},
    },
    goal={
        20: {"profile": 0.01, "worst": 0.01, "flux": 0.005, "gradient": 0.05, "ledger": 0.0},
        40: {"outflow": 0.005},
    },
    scheme=Scheme(smoothing_ratio=1.5),
)

START = dataclasses.replace(
    CASE,
    name="channel-start",
    title="Channel from inflow to outflow, from rest",
    scene=starting_scene,
    end=12.0 * TIME_UNIT,
    target={20: {"profile": 0.006, "flux": 0.002, "ledger": 0.0}},
)

CASES = (CASE, START)
