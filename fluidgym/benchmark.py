"""What the benchmarks share, and what each feature adds to a step.

A tank of still water is timed in turn with the same tank that has one more feature.
"""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import warp as wp

from fluidgym.scene import (
    NO_SLIP_WALL,
    Ball,
    Body,
    Box,
    Face,
    Fluid,
    Inflow,
    Material,
    Outflow,
    Scene,
    face_names,
)
from fluidgym.scheme import DEFAULT_SCHEME, MUELLER, Scheme
from fluidgym.solver import Solver
from fluidgym.sph.state_equation import TAIT
from fluidgym.sph.wall_models import FrozenWalls, PenaltyWalls


def machine(device: str) -> dict[str, str]:
    """What a speed belongs to: processor or GPU, its driver, Warp, Python."""
    facts = {"device": wp.get_device(device).name, "warp": wp.__version__, "python": platform.python_version()}
    if wp.get_device(device).is_cuda:
        facts["driver"] = ".".join(map(str, wp.get_cuda_driver_version() or ()))
    else:
        facts["processor"] = _processor()
        facts["threads"] = "1"
    return facts


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def column_scene(dim: int, particles: int) -> Scene:
    """The falling column with about that many particles."""
    if dim == 2:
        spacing = 1.0 / max(1, round((particles / 2) ** 0.5))
        return Scene((0.0, 0.0), (4.0, 4.0), spacing, [Fluid(Box((0.0, 0.0), (1.0, 2.0)), pressure="hydrostatic")])
    spacing = 1.0 / max(1, round(particles ** (1 / 3)))
    fluid = Fluid(Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), pressure="hydrostatic")
    return Scene((0.0, 0.0, 0.0), (3.0, 1.0, 2.0), spacing, [fluid])


PAIRS = 7
STRETCH = 0.02  # [s]
COST_HEAD = (
    "dim  worlds x particles  feature                            ms a step  without  ratio  lowest  highest  set-up s"
)


@dataclass(frozen=True)
class Cost:
    """What a feature adds to a step.

    Attributes:
        feature: What is on.
        dim: Number of dimensions.
        worlds: Number of worlds.
        particles: Particles of each world at the end.
        device: Name of the Warp device.
        setup_s: Time to make the solver and run its first steps, compilation included [s].
        ms_per_step: Median time of a step of all worlds [ms].
        ms_per_step_without: The same without the feature, measured in turn [ms].
        ratio: Median, over pairs of stretches, of the time a particle with the feature over that without.
        lowest: Of these ratios.
        highest: Of these ratios.
    """

    feature: str
    dim: int
    worlds: int
    particles: int
    device: str
    setup_s: float
    ms_per_step: float
    ms_per_step_without: float
    ratio: float
    lowest: float
    highest: float

    def line(self) -> str:
        """One row under COST_HEAD."""
        return (
            f"{self.dim}D   {f'{self.worlds} x {self.particles}':>18}  {self.feature:<33}  {self.ms_per_step:9.3f}"
            f"  {self.ms_per_step_without:7.3f}  {self.ratio:5.2f}  {self.lowest:6.2f}  {self.highest:7.2f}"
            f"  {self.setup_s:8.1f}"
        )


def still_scene(dim: int, particles: int) -> Scene:
    """About that many particles of still water, 1 m each way, in a tank twice as high; all features named, and off."""
    spacing = 1.0 / max(1, round(particles ** (1 / dim)))
    return replace(
        _bare_scene(dim, spacing),
        faces=dict.fromkeys(face_names(dim), Face(kind="wall", slip="free", moving=False)),
        material=Material(viscosity=0.0, thermal_diffusivity=0.0),
        bodies={},
        inflows={},
        outflows={},
        central_force=0.0,
    )


def _bare_scene(dim: int, spacing: float) -> Scene:
    side = (1.0,) * (dim - 1)
    fluid = Fluid(Box((0.0,) * dim, (*side, 1.0)), pressure="hydrostatic")
    return Scene((0.0,) * dim, (*side, 2.0), spacing, [fluid], reference_speed=4.0)


def featured(base: Scene) -> dict[str, tuple[Scene, Scheme, bool]]:
    """A still scene with one feature on at a time: scene, scheme, whether forces are reported; by what is on."""
    dim, dx = base.dim, base.particle_spacing
    floor, far = face_names(dim)[2 * dim - 2], "x_max"
    ball = Body(Ball((0.5,) * dim, 0.2))
    # Between two rows of particles, and so thin that none is left out for it.
    row, across = dx * round(0.5 / dx), (1.0,) * (dim - 2)
    plate = Box((row - 0.2 * dx, *(0.0,) * (dim - 1)), (row + 0.2 * dx, *across, 1.5))
    down = (0.0,) * (dim - 1) + (-1.0,)
    nozzle = Inflow((*(0.5,) * (dim - 1), 1.9), down, width=4.0 * dx, speed=0.5)
    drain = Outflow(Box((0.0,) * dim, (2.0 * dx,) * dim))
    water, conductor = Material(viscosity=1e-6), Material(thermal_diffusivity=1e-6)
    stickiness = base.sound_speed * 2.0 * dx / 160.0  # what the preset mueller needs to hold still
    scenes = {
        "nothing, and nothing named": _bare_scene(dim, dx),
        "viscosity": replace(base, material=water),
        "viscosity and walls of no slip": replace(
            base, material=water, faces=dict.fromkeys(face_names(dim), NO_SLIP_WALL)
        ),
        "heat": replace(base, material=conductor),
        "heat and a warm floor": replace(base, material=conductor, faces={floor: Face(temperature=1.0)}),
        "a face that may move": replace(base, faces={far: Face(moving=True)}),
        "a gate, thin, that may move": replace(base, bodies={"gate": Body(plate, moving=True)}),
        "an obstacle, a ball": replace(base, bodies={"ball": ball}),
        "a nozzle and a drain": replace(
            base, inflows={"nozzle": nozzle}, outflows={"drain": drain}, reserve=round(0.1 / dx**dim)
        ),
        "a central force": replace(base, central_force=0.1),
    }
    found = {name: (scene, DEFAULT_SCHEME, False) for name, scene in scenes.items()}
    sticky = replace(base, material=Material(viscosity=stickiness))
    return found | {
        "forces reported": (base, DEFAULT_SCHEME, True),
        "Tait's equation": (base, Scheme(state_equation=TAIT), False),
        "another method: penalty walls": (base, Scheme(walls=PenaltyWalls()), False),
        "another method: frozen walls": (base, Scheme(walls=FrozenWalls()), False),
        "another method: preset mueller": (sticky, MUELLER, False),
    }


def measure_costs(dim: int, particles: int, worlds: int = 1, device: str | None = None) -> Iterator[Cost]:
    """Time still water with each feature, in turn with still water that has none.

    Args:
        dim: Number of dimensions.
        particles: About how many particles a world has.
        worlds: Number of worlds.
        device: Name of the Warp device; None takes a GPU where there is one.
    """
    base = Solver(still_scene(dim, particles), DEFAULT_SCHEME, worlds, device)
    n = max(1, round(STRETCH / base.max_step))
    _stretches(base, n, PAIRS)
    for name, (scene, scheme, forces) in featured(base.scene).items():
        begin = time.perf_counter()
        solver = Solver(scene, scheme, worlds, device, report_forces=forces)
        _stretches(solver, n, 1)
        setup = time.perf_counter() - begin
        _stretches(solver, n, PAIRS)
        pairs = [(_stretches(base, n, 1), _stretches(solver, n, 1)) for _ in range(PAIRS)]
        live = solver.account().live
        ratios = [with_it / live / (without / base.capacity) for without, with_it in pairs]
        yield Cost(
            feature=name,
            dim=dim,
            worlds=worlds,
            particles=live,
            device=str(solver.device),
            setup_s=setup,
            ms_per_step=1e3 * statistics.median(with_it for _, with_it in pairs),
            ms_per_step_without=1e3 * statistics.median(without for without, _ in pairs),
            ratio=statistics.median(ratios),
            lowest=min(ratios),
            highest=max(ratios),
        )


def _stretches(solver: Solver, n: int, count: int) -> float:
    """Go on by some stretches of n steps; return the time of a step [s]."""
    begin = time.perf_counter()
    for _ in range(count):
        solver.step(n)
    wp.synchronize_device(solver.device)
    return (time.perf_counter() - begin) / (n * count)
