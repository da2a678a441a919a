"""How fast: the solver by stages, many worlds, environments, start-up, and PySPH beside it; errors beside times.

The scene is the dam break that PySPH, DualSPHysics and SPlisHSPlasH ship: a column of water, 1 m wide and 2 m high
(1 x 1 x 1 m in 3D), falls into a dry tank. Compilation is timed apart, the clock runs once the column moves, and the
median of several stretches counts. A pair is a neighbour within the support, or an image of one, that a particle meets
in a step, whatever the number of sweeps.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import warp as wp

from fluidgym.benchmark import column_scene
from fluidgym.cuda_report import CudaKernel, compiled
from fluidgym.envs.fluid_vector_env import FluidVectorEnv
from fluidgym.picture import picture, shot_of
from fluidgym.render.mesh import Mesh, mesh_surface
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, Scheme
from fluidgym.solver import Solver
from fluidgym.sph.neighbour_count import make_counter
from fluidgym.sph.smoothing import WENDLAND_C2
from fluidgym.stepping import GROUP_PARTICLES, processors

STRETCHES = 5
STRETCH_S = 0.6  # about how long one takes [s]
SETTLED = 0.2  # simulated time before the clock runs [s]

SIZES = (2000, 10000, 50000, 200000)
BATCHES = (1, 16, 256, 1024)  # worlds
BATCH_SIZE = 1000  # particles of each
ENV_BATCHES = (1, 8, 64)
ENV_SECONDS = 2.0
FRAMES = (2000, 10000, 50000)  # particles of worlds that are drawn


@dataclass(frozen=True)
class Speed:
    """The speed of one solver.

    Attributes:
        dim: Number of dimensions.
        worlds: Number of worlds.
        particles: Particles of each world.
        threads: That share the worlds, at most.
        device: Name of the Warp device.
        setup_s: Time to make the solver and run its first step, compilation included [s].
        ms_per_step: Median time of a step of all worlds [ms].
        spread: Slowest stretch over the fastest.
        particle_steps_per_s: Over all worlds [1/s].
        neighbours: Mean number of them, images included.
        pairs_per_s: Over all worlds [1/s].
        ns_per_pair: [ns].
        shares: Of a step, by stage, launched one by one in a single thread.
        launches: Kernels of a step.
        bytes_per_particle: On the device.
        steps_per_simulated_s: [1/s].
        wall_s_per_simulated_s: Time of the machine for a second of all worlds.
    """

    dim: int
    worlds: int
    particles: int
    threads: int
    device: str
    setup_s: float
    ms_per_step: float
    spread: float
    particle_steps_per_s: float
    neighbours: float
    pairs_per_s: float
    ns_per_pair: float
    shares: dict[str, float]
    launches: int
    bytes_per_particle: float
    steps_per_simulated_s: float
    wall_s_per_simulated_s: float

    HEAD = (
        "dim  worlds x particles  threads  ms a step  spread  M particle-steps/s  M pairs/s  ns a pair  sort  density"
        "  force  launches  bytes a particle  steps a simulated s  wall s a simulated s  set-up s"
    )

    def line(self) -> str:
        """One row under HEAD."""
        shares = [f"{self.shares.get(name, 0.0):.0%}" for name in ("sort", "density", "force")]
        return (
            f"{self.dim}D   {f'{self.worlds} x {self.particles}':>18}  {self.threads:7}  {self.ms_per_step:9.3f}"
            f"  {self.spread:6.2f}  {1e-6 * self.particle_steps_per_s:18.2f}  {1e-6 * self.pairs_per_s:9.1f}"
            f"  {self.ns_per_pair:9.2f}  {shares[0]:>4}  {shares[1]:>7}  {shares[2]:>5}  {self.launches:8}"
            f"  {self.bytes_per_particle:16.0f}  {self.steps_per_simulated_s:19.0f}"
            f"  {self.wall_s_per_simulated_s:20.2f}  {self.setup_s:8.1f}"
        )


def measure_speed(
    dim: int,
    particles: int,
    worlds: int = 1,
    device: str | None = None,
    scheme: Scheme = DEFAULT_SCHEME,
    threads: int | None = 1,
    stretch_s: float = STRETCH_S,
    progress: Callable[[int], object] = lambda stretches: None,
) -> Speed:
    """Time the falling column.

    Args:
        dim: Number of dimensions.
        particles: About how many particles a world has.
        worlds: Number of worlds.
        device: Name of the Warp device; None takes a GPU where there is one.
        scheme: How it is simulated.
        threads: Of a CPU; None is as many as there are processors.
        stretch_s: About how long each of the stretches is [s].
        progress: Called with 1 after each of STRETCHES + 1 stretches.
    """
    begin = time.perf_counter()
    solver = Solver(column_scene(dim, particles), scheme, worlds, device, threads=threads)
    solver.step()
    wp.synchronize_device(solver.device)
    setup = time.perf_counter() - begin
    step = _seconds(solver, 2) / 2
    # A batch that is slow need not fall as long: how its particles lie hardly counts.
    settle = min(solver.steps_for(SETTLED), max(10, round(10 * stretch_s / step)))
    solver.step(settle)
    n = max(2, round(stretch_s / step))
    _seconds(solver, max(2, n // 4))
    progress(1)
    stretches = []
    for _ in range(STRETCHES):
        stretches.append(_seconds(solver, n) / n)
        progress(1)
    step = statistics.median(stretches)
    neighbours = count_neighbours(solver)
    total = worlds * solver.capacity
    shares, launches = _stages(solver)
    return Speed(
        dim=dim,
        worlds=worlds,
        particles=solver.capacity,
        threads=solver.threads,
        device=str(solver.device),
        setup_s=setup,
        ms_per_step=1e3 * step,
        spread=max(stretches) / min(stretches),
        particle_steps_per_s=total / step,
        neighbours=neighbours,
        pairs_per_s=total * neighbours / step,
        ns_per_pair=1e9 * step / (total * neighbours),
        shares=shares,
        launches=launches,
        bytes_per_particle=solver.memory / total,
        steps_per_simulated_s=1.0 / solver.max_step,
        wall_s_per_simulated_s=step / solver.max_step,
    )


def _seconds(solver: Solver, n: int) -> float:
    """Time of n steps [s]."""
    begin = time.perf_counter()
    solver.step(n)
    wp.synchronize_device(solver.device)
    return time.perf_counter() - begin


def _stages(solver: Solver, turns: int = 10) -> tuple[dict[str, float], int]:
    """What share of a step each stage takes, replayed one by one, and how many kernels a step launches."""
    saved = solver.save()
    group = solver._worlds()
    if solver.device.is_cpu:  # as they are when worlds go ahead in groups
        group = group.part(0, max(1, min(solver.num_worlds, GROUP_PARTICLES // solver.capacity)))
    launched, launch = 0, wp.launch

    def count(*arguments: Any, **options: Any) -> Any:
        nonlocal launched
        launched += 1
        return launch(*arguments, **options)

    graphs = {}
    with mock.patch.object(wp, "launch", count):
        for name, work in group.stages().items():
            with wp.ScopedCapture(device=solver.device) as capture:
                work()
            graphs[name] = capture.graph
    spent = dict.fromkeys(graphs, 0.0)
    for turn in range(turns + 1):
        for name, graph in graphs.items():
            begin = time.perf_counter()
            wp.capture_launch(graph)
            wp.synchronize_device(solver.device)
            spent[name] += (time.perf_counter() - begin) * (turn > 0)  # the first warms up
    solver.restore(saved)
    total = sum(spent.values())
    return {name: seconds / total for name, seconds in spent.items()}, launched


def count_neighbours(solver: Solver) -> float:
    """Mean number of neighbours within the support of a particle, images included; the solver is as it was."""
    saved = solver.save()
    group = solver._worlds().part(0, 1)
    plan, state = group.plan, group.state
    group.stages()["sort"]()
    found = wp.zeros(solver.capacity, dtype=float, device=solver.device)
    wp.launch(
        make_counter(plan.structure),
        dim=solver.capacity,
        inputs=[
            *(solver.capacity, group.constants, plan.grid, group.bounds, state.faces, state.bodies),
            *(plan.frozen, plan.frozen_grid, state.middle, state.identity),
        ],
        outputs=[found, state.sums, state.spans],
        device=solver.device,
    )
    solver.restore(saved)
    return float(found.numpy().sum() / max(solver.account().live, 1))


# -- environments ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class EnvSpeed:
    """The speed of one environment.

    Attributes:
        id: Of the environment.
        worlds: Number of worlds.
        particles: Particles of each world.
        threads: That share the worlds, at most.
        device: Name of the Warp device.
        fidelity: Of the simulation.
        env_steps_per_s: Over all worlds [1/s].
        substeps: Solver's steps in one of the environment.
        overhead: What an environment's step takes beside its solver's, over the latter.
    """

    id: str
    worlds: int
    particles: int
    threads: int
    device: str
    fidelity: str
    env_steps_per_s: float
    substeps: int
    overhead: float

    HEAD = "environment                      fidelity  worlds x particles  threads  env steps/s  substeps  overhead"

    def line(self) -> str:
        """One row under HEAD."""
        return (
            f"{self.id:<31}  {self.fidelity:<8}  {f'{self.worlds} x {self.particles}':>18}  {self.threads:7}"
            f"  {self.env_steps_per_s:11.1f}  {self.substeps:8}  {self.overhead:8.1%}"
        )


def measure_environment(
    name: str,
    options: Mapping[str, Any],
    worlds: int,
    device: str | None,
    threads: int | None = None,
    seconds: float = ENV_SECONDS,
) -> EnvSpeed:
    """Time an environment that is driven by random actions.

    Args:
        name: Its id.
        options: Of the environment, the task among them.
        worlds: Number of worlds.
        device: Name of the Warp device; None takes a GPU where there is one.
        threads: Of a CPU; None is as many as there are processors.
        seconds: About how long it is timed [s].
    """
    env = FluidVectorEnv(worlds, device=device, threads=threads, **options)
    env.reset(seed=0)
    env.action_space.seed(0)
    solver = env.solver
    spent, advance = 0.0, solver.advance

    def timed(duration: float) -> None:
        nonlocal spent
        begin = time.perf_counter()
        advance(duration)
        wp.synchronize_device(solver.device)
        spent += time.perf_counter() - begin

    solver.advance = timed  # pyright: ignore[reportAttributeAccessIssue]
    for _ in range(2):
        env.step(env.action_space.sample())
    spent, steps, begin = 0.0, 0, time.perf_counter()
    while time.perf_counter() - begin < seconds or steps < 2:
        env.step(env.action_space.sample())
        steps += 1
    total = time.perf_counter() - begin
    particles, count = solver.capacity, solver.steps_for(env.task.control_interval)
    name_of = {scheme: label for label, scheme in FIDELITIES.items()}
    speed = EnvSpeed(
        id=name,
        worlds=worlds,
        particles=particles,
        threads=solver.threads,
        device=str(solver.device),
        fidelity=name_of.get(solver.scheme, "own"),
        env_steps_per_s=worlds * steps / total,
        substeps=count,
        overhead=total / spent - 1.0,
    )
    env.close()
    return speed


# -- start-up and memory -----------------------------------------------------------------------------------------------

_START = """
import time
begin = time.perf_counter()
import gymnasium, fluidgym
env = gymnasium.make({name!r}, device={device!r})
env.reset(seed=0)
env.step(env.action_space.sample())
print(time.perf_counter() - begin)
"""

_MEMORY = """
import resource, sys
from pathlib import Path
from fluidgym.benchmark import column_scene
from fluidgym.solver import Solver
solver = Solver(column_scene({dim}, {particles}), device="cpu")
solver.step(2)
# Linux counts the memory of the process that started this one into ru_maxrss.
status = Path("/proc/self/status")
peaks = [line.split() for line in status.read_text().splitlines()] if status.exists() else []
kilobytes = next((int(words[1]) for words in peaks if words[0] == "VmHWM:"), None)
unit = 1 if sys.platform == "darwin" else 1024
resident = kilobytes * 1024 if kilobytes else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
print(solver.capacity, solver.memory, resident)
"""


@dataclass(frozen=True)
class StartUp:
    """How long until the first step of an environment, in a new process.

    Attributes:
        id: Of the environment.
        cold_s: With an empty kernel cache [s].
        warm_s: With what the first left there [s].
    """

    id: str
    cold_s: float
    warm_s: float

    def line(self) -> str:
        """One sentence."""
        return f"{self.id}: import, make, reset and first step take {self.cold_s:.1f} s cold, {self.warm_s:.2f} s warm"


def _run(code: str, cache: str | None = None) -> list[str]:
    """What a Python program prints, word by word."""
    environment = {**os.environ, **({"WARP_CACHE_PATH": cache} if cache else {})}
    said = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return said.stdout.split()


def measure_start(name: str, device: str) -> StartUp:
    """Time the start of an environment, with an empty cache and with a full one."""
    code = _START.format(name=name, device=device)
    with tempfile.TemporaryDirectory(prefix="fluidgym-cache-") as cache:
        cold, warm = (float(_run(code, cache)[-1]) for _ in range(2))
    return StartUp(name, cold, warm)


@dataclass(frozen=True)
class Memory:
    """What a solver takes on a CPU, in a new process.

    Attributes:
        dim: Number of dimensions.
        particles: Particles.
        bytes_per_particle: In its arrays.
        resident_mb: The whole process at its largest [MB].
    """

    dim: int
    particles: int
    bytes_per_particle: float
    resident_mb: float

    def line(self) -> str:
        """One sentence."""
        return (
            f"{self.dim}D, {self.particles} particles: {self.bytes_per_particle:.0f} bytes a particle,"
            f" {self.resident_mb:.0f} MB resident"
        )


def measure_memory(dim: int, particles: int) -> Memory:
    """Memory of the falling column."""
    capacity, taken, resident = map(int, _run(_MEMORY.format(dim=dim, particles=particles))[-3:])
    return Memory(dim, capacity, taken / capacity, resident * 1e-6)


# -- frames ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FrameTime:
    """How long a picture of 640 x 400 pixels takes, and the surface as triangles.

    Attributes:
        dim: Number of dimensions.
        particles: Particles.
        surface_s: With the body of water drawn [s].
        spheres_s: With each particle drawn [s].
        mesh_s: To find the triangles of the surface [s]; of a world of two dimensions those of a slab.
        triangles: How many they are.
    """

    dim: int
    particles: int
    surface_s: float
    spheres_s: float
    mesh_s: float
    triangles: int

    HEAD = "dim  particles  surface [ms]  spheres [ms]  mesh [ms]  triangles"

    def line(self) -> str:
        """One row under HEAD."""
        times = f"{1e3 * self.surface_s:12.0f}  {1e3 * self.spheres_s:12.0f}  {1e3 * self.mesh_s:9.0f}"
        return f"{self.dim}D   {self.particles:9}  {times}  {self.triangles:9}"


def measure_frame(dim: int, size: int, device: str) -> FrameTime:
    """Time pictures of the falling column; the fastest of three counts."""
    solver = Solver(column_scene(dim, size), device=device)
    solver.advance(SETTLED)

    def fastest(draw: Callable[[], Any]) -> float:
        draw()
        times = []
        for _ in range(3):
            begin = time.perf_counter()
            draw()
            times.append(time.perf_counter() - begin)
        return min(times)

    meshes: list[Mesh] = []
    return FrameTime(
        dim,
        solver.capacity,
        fastest(lambda: picture(solver)),
        fastest(lambda: picture(solver, spheres=True)),
        fastest(lambda: meshes.append(mesh_surface(shot_of(solver, layers=4)))),
        len(meshes[-1].triangles),
    )


# -- beside others -----------------------------------------------------------------------------------------------------

# M particle-steps/s of DualSPHysics 5.4 at about 10000 particles, one core, Wendland C2: by dimensions, after its
# support over the spacing. Measured on a machine of this kind, not in the same run.
DUALSPHYSICS = {2: (2.83, 0.81), 3: (2.6, 0.20)}
PYSPH_RATIO = 1.3  # h/dx of its dam break
PEER_SECONDS = 0.02  # of simulated time


@dataclass(frozen=True)
class Fall:
    """How long a second of the falling column takes, and how far the same scheme is off on the validation cases.

    Attributes:
        dim: Number of dimensions.
        particles: Particles.
        fidelity: Of the simulation.
        steps_per_simulated_s: [1/s].
        wall_s_per_simulated_s: One thread.
        front_error: Of the dam break in two dimensions at H/40; a share.
    """

    dim: int
    particles: int
    fidelity: str
    steps_per_simulated_s: float
    wall_s_per_simulated_s: float
    front_error: float

    HEAD = "dim  particles  fidelity  steps a simulated s  wall s a simulated s  front error, 2D, H/40"

    def line(self) -> str:
        """One row under HEAD."""
        return (
            f"{self.dim}D   {self.particles:9}  {self.fidelity:<8}  {self.steps_per_simulated_s:19.0f}"
            f"  {self.wall_s_per_simulated_s:20.2f}  {self.front_error:22.2%}"
        )


@dataclass(frozen=True)
class Rate:
    """Particle-steps a second at one support, ours and a peer's.

    Attributes:
        dim: Number of dimensions.
        particles: Particles.
        kernel: Our smoothing kernel.
        support: Over the spacing.
        particle_steps_per_s: Ours, walls included, one thread [1/s].
        front_error: Ours, of the dam break in two dimensions at H/40; a share.
        peer: Its name.
        peer_support: Over the spacing.
        peer_particle_steps_per_s: Its rate on the same particles [1/s].
        peer_front_error: Likewise; nan where it was not run.
    """

    dim: int
    particles: int
    kernel: str
    support: float
    particle_steps_per_s: float
    front_error: float
    peer: str
    peer_support: float
    peer_particle_steps_per_s: float
    peer_front_error: float

    HEAD = (
        "dim  particles  kernel       support  M particle-steps/s  front error  against       support"
        "  M particle-steps/s  front error  times as fast"
    )

    def line(self) -> str:
        """One row under HEAD."""
        error, theirs = ("-" if np.isnan(one) else f"{one:.2%}" for one in (self.front_error, self.peer_front_error))
        ratio = self.particle_steps_per_s / self.peer_particle_steps_per_s
        return (
            f"{self.dim}D   {self.particles:9}  {self.kernel:<11}  {self.support:7.2f}"
            f"  {1e-6 * self.particle_steps_per_s:18.2f}  {error:>11}  {self.peer:<12}  {self.peer_support:7.2f}"
            f"  {1e-6 * self.peer_particle_steps_per_s:18.3f}  {theirs:>11}  {ratio:13.1f}"
        )


@lru_cache
def front_error(scheme: Scheme, device: str) -> float:
    """Front error of the validation suite's dam break at H/40."""
    from fluidgym.validation import CASES, run

    return run(CASES["dam-break"], 40, 2, device, scheme=scheme).errors["front"]


def measure_fall(dim: int, fidelity: str, device: str) -> Fall:
    """Time the falling column of about ten thousand particles."""
    scheme = FIDELITIES[fidelity]
    speed = measure_speed(dim, 10000, 1, device, scheme)
    error = front_error(scheme, device)
    return Fall(dim, speed.particles, fidelity, speed.steps_per_simulated_s, speed.wall_s_per_simulated_s, error)


def like_a_peer(support: float) -> Scheme:
    """The default scheme with the smoothing kernel and the support of others: Wendland C2 without a core."""
    return Scheme(kernel=WENDLAND_C2, smoothing_ratio=0.5 * support, core=0.0)


def measure_rate(dim: int, support: float | None, device: str, peer: str | None, interpreter: str | None) -> Rate:
    """Our rate at a support, and that of PySPH, which is run on the same particles, or DualSPHysics' on record.

    Args:
        dim: Number of dimensions.
        support: Over the spacing; None is the default scheme as it is.
        device: Name of the Warp device.
        peer: Name of a peer that is run, or None.
        interpreter: That has it.
    """
    from fluidgym.peers import find_peer, pace, run
    from fluidgym.validation import CASES

    scheme = DEFAULT_SCHEME if support is None else like_a_peer(support)
    speed = measure_speed(dim, 10000, 1, device, scheme)
    scene = column_scene(dim, 10000)
    support = scheme.support(1.0, dim)
    name, theirs, error = "DualSPHysics", DUALSPHYSICS[dim][1] * 1e6, float("nan")
    if peer:
        name, ratio = peer, 0.5 * support  # its kernel is Wendland's, too, and ends at 2 h
        steps, wall = pace(find_peer(peer), scene, PEER_SECONDS, ratio, interpreter)
        theirs = steps * speed.particles / wall
        if dim == 2 and abs(ratio - PYSPH_RATIO) < 1e-9:
            error = run(find_peer(peer), CASES["dam-break"], 40, interpreter=interpreter).errors["front"]
    return Rate(
        dim=dim,
        particles=speed.particles,
        kernel=scheme.kernel_in(dim).name,
        support=support,
        particle_steps_per_s=speed.particle_steps_per_s,
        front_error=front_error(scheme, device) if dim == 2 else float("nan"),
        peer=name,
        peer_support=support,
        peer_particle_steps_per_s=theirs,
        peer_front_error=error,
    )


# -- all of it ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Section:
    """A table: its title, its head, and what measures each row."""

    title: str
    head: str
    rows: list[Callable[[], Any]]


def sections(
    device: str,
    environments: Mapping[str, Mapping[str, Any]],
    dims: Iterable[int] = (2, 3),
    sizes: Iterable[int] | None = None,
    batches: Iterable[int] | None = None,
    threads: Iterable[int] | None = None,
    peer: str | None = None,
    interpreter: str | None = None,
) -> list[Section]:
    """What `benchmark --speed` measures; where sizes, worlds or threads are named, the solver at those and no more.

    Args:
        device: Name of the Warp device.
        environments: Options of each that is timed, by id.
        dims: Numbers of dimensions.
        sizes: About how many particles a world has.
        batches: Numbers of worlds.
        threads: Numbers of threads.
        peer: A peer that is installed, or None.
        interpreter: That has it.
    """
    cuda = wp.get_device(device).is_cuda
    every = (1,) if cuda else tuple(sorted({1, processors()}))
    dims = tuple(dims)

    def solver(dim: int, size: int, worlds: int, count: int) -> Callable[[], Speed]:
        def measure() -> Speed:
            try:
                return measure_speed(dim, size, worlds, device, threads=count)
            except ValueError as error:  # too few particles for the scene
                raise ValueError(f"{dim}D, {worlds} x {size}: {error}") from None

        return measure

    if sizes or batches or threads:
        found = [
            solver(dim, size, worlds, count)
            for dim in dims
            for worlds in batches or (1,)
            for size in sizes or SIZES
            for count in threads or (1,)
        ]
        return [Section("The solver", Speed.HEAD, found)]
    alone = [solver(dim, size, 1, 1) for dim in dims for size in SIZES]
    many = [solver(dim, BATCH_SIZE, worlds, count) for dim in dims for worlds in BATCHES for count in every]
    tables = [
        Section("One world, one thread", Speed.HEAD, alone),
        Section("Many worlds", Speed.HEAD, many),
        Section(
            "The dam break of PySPH, DualSPHysics and SPlisHSPlasH, one thread",
            Fall.HEAD,
            [partial(measure_fall, dim, fidelity, device) for dim in dims for fidelity in ("balanced", "fast")],
        ),
    ]
    if not cuda:
        pairs: list[tuple[int, float | None, str | None]] = [(dim, DUALSPHYSICS[dim][0], None) for dim in dims]
        if peer:
            pairs += [(dim, support, peer) for dim in dims for support in (2.0 * PYSPH_RATIO, None)]
        rows = [partial(measure_rate, dim, support, device, name, interpreter) for dim, support, name in pairs]
        tables.append(Section("At the same support, one thread, walls included", Rate.HEAD, rows))
    names = [name for name, options in environments.items() if options.get("dim") in (None, *dims)]
    timed = [
        partial(measure_environment, name, {**environments[name], "fidelity": fidelity}, worlds, device, count)
        for name in names
        for fidelity in ("balanced", "fast")
        for worlds in ENV_BATCHES
        for count in (every if worlds > 1 else (1,))
    ]
    tables.append(Section("Environments, random actions, numpy", EnvSpeed.HEAD, timed))
    tables.append(
        Section(
            "Frames", FrameTime.HEAD, [partial(measure_frame, dim, size, device) for dim in dims for size in FRAMES]
        )
    )
    starts: list[Callable[[], Any]] = [partial(measure_start, name, device) for name in names]
    if not cuda:
        starts += [partial(measure_memory, dim, 50000) for dim in dims]
    tables.append(Section("Start-up and memory, in new processes", "", starts))
    if not cuda:
        kernels = [partial(next, iterator) for dim in dims for iterator in [compiled_kernels(dim)] for _ in range(4)]
        tables.append(Section("The kernels on a GPU, compiled for sm_90 and not run", CudaKernel.HEAD, kernels))
    return tables


def compiled_kernels(dim: int) -> Iterator[CudaKernel]:
    """The kernels of a step of the falling column as a GPU would have them: drift, gather and the two sweeps."""
    yield from compiled(Solver(column_scene(dim, 500), device="cpu"))


def draw(rows: list[Any], about: str, path: Path) -> None:
    """Draw what a particle-step costs against particles, worlds and threads."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    speeds = [row for row in rows if isinstance(row, Speed)]
    axes: list[tuple[str, Callable[[Speed], int], Callable[[Speed], bool]]] = [
        ("particles", lambda row: row.particles, lambda row: row.worlds == 1 and row.threads == 1),
        ("worlds", lambda row: row.worlds, lambda row: row.particles < 2 * BATCH_SIZE),
    ]
    figure, panels = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
    for panel, (label, of, counts) in zip(panels, axes, strict=True):
        curves: dict[tuple[int, int], list[tuple[int, float]]] = {}
        for row in filter(counts, speeds):
            cost = 1e6 * row.ms_per_step / (row.worlds * row.particles)
            curves.setdefault((row.dim, row.threads), []).append((of(row), cost))
        for (dim, threads), points in sorted(curves.items()):
            plural = "thread" if threads == 1 else "threads"
            panel.plot(*zip(*sorted(points), strict=True), "o-", label=f"{dim}D, {threads} {plural}")
        panel.set(xscale="log", xlabel=label)
        panel.grid(alpha=0.3)
        panel.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=2, frameon=False)
    panels[0].set_ylim(bottom=0.0)  # of both
    panels[0].set_ylabel("ns a particle-step")
    figure.suptitle(about, fontsize=8, y=1.08)
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)
