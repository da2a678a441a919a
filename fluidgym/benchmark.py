"""How fast the solver is: particle-steps a second on the dam break that PySPH, DualSPHysics and SPlisHSPlasH ship.

A column of water, 1 m wide and 2 m high (1 x 1 x 1 m in 3D), falls into a dry tank. Compilation is timed apart, the
clock runs once the column moves, and the median of several stretches counts. A speed means nothing without its error:
the front error of the same scheme on the validation suite's dam break stands beside it.
"""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import warp as wp

from fluidgym.scene import Box, Fluid, Scene
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.solver import Solver

STRETCHES = 5
SPEED_HEAD = (
    "dim  worlds x particles  ms a step  spread  M particle-steps/s"
    "  steps a simulated s  wall s a simulated s  set-up s"
)


@dataclass(frozen=True)
class Speed:
    """The speed of one solver.

    Attributes:
        dim: Number of dimensions.
        worlds: Number of worlds.
        particles: Particles of each world.
        device: Name of the Warp device.
        setup_s: Time to make the solver and run its first step, compilation included [s].
        ms_per_step: Median time of a step of all worlds [ms].
        spread: Slowest stretch over the fastest.
        particle_steps_per_s: Over all worlds [1/s].
        steps_per_simulated_s: [1/s].
        wall_s_per_simulated_s: Time of the machine for a second of all worlds.
    """

    dim: int
    worlds: int
    particles: int
    device: str
    setup_s: float
    ms_per_step: float
    spread: float
    particle_steps_per_s: float
    steps_per_simulated_s: float
    wall_s_per_simulated_s: float


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


def speed_line(speed: Speed) -> str:
    """One row under SPEED_HEAD."""
    return (
        f"{speed.dim}D   {f'{speed.worlds} x {speed.particles}':>18}  {speed.ms_per_step:9.3f}  {speed.spread:6.2f}"
        f"  {1e-6 * speed.particle_steps_per_s:18.2f}  {speed.steps_per_simulated_s:19.0f}"
        f"  {speed.wall_s_per_simulated_s:20.2f}  {speed.setup_s:8.1f}"
    )


def column_scene(dim: int, particles: int) -> Scene:
    """The falling column with about that many particles."""
    if dim == 2:
        spacing = 1.0 / max(1, round((particles / 2) ** 0.5))
        return Scene((0.0, 0.0), (4.0, 4.0), spacing, [Fluid(Box((0.0, 0.0), (1.0, 2.0)), pressure="hydrostatic")])
    spacing = 1.0 / max(1, round(particles ** (1 / 3)))
    fluid = Fluid(Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), pressure="hydrostatic")
    return Scene((0.0, 0.0, 0.0), (3.0, 1.0, 2.0), spacing, [fluid])


def measure_speed(
    dim: int,
    particles: int,
    worlds: int = 1,
    device: str | None = None,
    scheme: Scheme = DEFAULT_SCHEME,
    duration: float = 0.2,
    progress: Callable[[int], object] = lambda stretches: None,
) -> Speed:
    """Time the falling column.

    Args:
        dim: Number of dimensions.
        particles: About how many particles a world has.
        worlds: Number of worlds.
        device: Name of the Warp device; None takes a GPU where there is one.
        scheme: How it is simulated.
        duration: Simulated time that is timed, after as much that is not [s].
        progress: Called with 1 after each of STRETCHES + 1 stretches.
    """
    begin = time.perf_counter()
    solver = Solver(column_scene(dim, particles), scheme, worlds, device)
    n = max(1, round(duration / STRETCHES / solver.max_step))
    solver.step(n)
    wp.synchronize_device(solver.device)
    setup = time.perf_counter() - begin
    solver.advance(duration)
    wp.synchronize_device(solver.device)
    progress(1)
    stretches = []
    for _ in range(STRETCHES):
        begin = time.perf_counter()
        solver.step(n)
        wp.synchronize_device(solver.device)
        stretches.append((time.perf_counter() - begin) / n)
        progress(1)
    step = statistics.median(stretches)
    return Speed(
        dim=dim,
        worlds=worlds,
        particles=solver.capacity,
        device=str(solver.device),
        setup_s=setup,
        ms_per_step=1e3 * step,
        spread=max(stretches) / min(stretches),
        particle_steps_per_s=worlds * solver.capacity / step,
        steps_per_simulated_s=1.0 / solver.max_step,
        wall_s_per_simulated_s=step / solver.max_step,
    )
