"""What must not break: twelve flows that numbers like to break on, and how far each is from doing so.

A stress has a mark for each value that it finds. Each is run short, which takes seconds, or long, as the marks were
meant. What a sound world is: every number finite, every particle there once and inside the walls.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from fluidgym.diagnostics import (
    LARGEST_COMPRESSION,
    LARGEST_VOID,
    elastic_energy,
    front,
    kinetic_energy,
    potential_energy,
    rms_speed,
)
from fluidgym.envs import TASKS
from fluidgym.scene import OPEN, Body, Box, Face, Fluid, Inflow, Material, Particles, Scene, face_names
from fluidgym.scheme import Scheme
from fluidgym.soak import Report, amiss, soak
from fluidgym.solver import Solver
from fluidgym.validation import dam_break, taylor_green
from fluidgym.validation.report import markdown_table, told

G, RHO = 9.81, 1000.0


@dataclass(frozen=True)
class Finding:
    """A value, and the mark it is held against.

    Attributes:
        name: What it is.
        value: What was found.
        limit: The largest that passes, or the least.
        least: Whether it is the least.
    """

    name: str
    value: float
    limit: float
    least: bool = False

    @property
    def passed(self) -> bool:
        """Whether the value keeps the mark; a value that is not a number does not."""
        return bool(self.value >= self.limit if self.least else self.value <= self.limit)

    def __str__(self) -> str:
        sign = ">=" if self.least else "<="
        return f"{self.name} {self.value:.3g} ({sign} {self.limit:.3g}{'' if self.passed else ', MISSED'})"


Run = Callable[[bool, str | None], list[Finding]]


@dataclass(frozen=True)
class Stress:
    """One of the twelve.

    Attributes:
        number: Its place in the list.
        title: One line for people.
        run: Long or short -> what was found; device as the solver takes it.
    """

    number: int
    title: str
    run: Run


STRESSES: list[Stress] = []

# Why a mark is known to be missed, and what was tried, by number.
MISSES = {
    2: "The diffusion of density lets the surface of still water rise by a twentieth of a spacing, and then no more;"
    " without it no energy is gained.",
}


def _numbered(number: int) -> Callable[[Run], Run]:
    """Makes a function one of the twelve, its title the first line of what is said of it."""

    def add(run: Run) -> Run:
        title = (run.__doc__ or "").splitlines()[0].rstrip(".")
        STRESSES.append(Stress(number, title, run))
        return run

    return add


class Sound:
    """Looks at worlds again and again, and remembers the worst: what is not finite, beyond a wall, missing or twice."""

    def __init__(self) -> None:
        self.broken = self.missing = 0
        self.beyond = 0.0

    def look(self, solver: Solver, world: int = 0) -> Particles:
        """The particles of a world, looked at."""
        water = solver.particles(world)
        numbers = (water.position, water.velocity, water.density, water.pressure)
        self.broken += int(sum((~np.isfinite(array)).sum() for array in numbers))
        missing, beyond = amiss(solver, [world])
        self.missing, self.beyond = self.missing + missing, max(self.beyond, beyond)
        return water

    def findings(self) -> list[Finding]:
        """That nothing was amiss."""
        return [
            Finding("numbers not finite", self.broken, 0),
            Finding("particles missing or twice", self.missing, 0),
            Finding("beyond a wall, spacings", self.beyond, 0.0),
        ]


def tank(spacing: float = 0.05, **changes) -> Scene:
    """A column 1 m high in a closed tank of four times its width."""
    column = Fluid(Box((0.0, 0.0), (1.0, 1.0)), pressure="hydrostatic")
    return Scene((0.0, 0.0), (4.0, 2.0), spacing, [column], **changes)


def still(**changes) -> Scene:
    """Water half a metre deep at rest."""
    water = Fluid(Box((0.0, 0.0), (0.5, 0.5)), pressure="hydrostatic")
    return Scene((0.0, 0.0), (0.5, 0.8), 0.05, [water], **changes)


def density_error(water: Particles) -> float:
    """The largest |rho / rho_0 - 1|."""
    return float(np.abs(water.density.astype(float) / RHO - 1.0).max(initial=0.0))


def nearest(position: np.ndarray) -> np.ndarray:
    """From each place to the nearest other [m], (n,)."""
    apart = np.linalg.norm(position[:, None].astype(float) - position[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return apart.min(axis=1)


@_numbered(1)
def dam_breaks(long: bool, device: str | None) -> list[Finding]:
    """Dam breaks of many jittered starts."""
    seeds = 128 if long else 8
    solver = Solver(tank(), num_worlds=seeds, device=device)
    solver.set_start(range(seeds), [tank(jitter=0.25, seed=seed).sample() for seed in range(seeds)])
    solver.reset()
    sound, worst = Sound(), 0.0
    for k in range(1, 11):
        solver.advance(0.5 / np.sqrt(G))
        waters = [sound.look(solver, world) for world in range(seeds)]
        if k <= 3:  # the front is not at the far wall yet
            worst = max(worst, *map(density_error, waters))
    return [Finding("density error before the impact", worst, 0.03), *sound.findings()]


@_numbered(2)
def still_water(long: bool, device: str | None) -> list[Finding]:
    """Still water for a long time."""
    solver, parts = Solver(still(), device=device), 10
    start, sound, speeds, energies = solver.particles(), Sound(), [], []

    def energy(water: Particles) -> float:
        scene = solver.scene
        return kinetic_energy(water, scene) + potential_energy(water, scene) + elastic_energy(water, scene)

    for _ in range(parts):
        solver.step(10_000 if long else 300)
        water = sound.look(solver)
        speeds.append(rms_speed(water) / np.sqrt(G * 0.5))
        energies.append(energy(water))
    at_start = energy(start)
    half = parts // 2
    return [
        Finding("u_rms over sqrt(gH)", max(speeds), 1e-3),
        Finding("u_rms, second half over first", float(np.mean(speeds[half:]) / np.mean(speeds[:half])), 1.0),
        Finding("energy gained, of that at the start", max(energies) / at_start - 1.0, 1e-3),
        *sound.findings(),
    ]


@_numbered(3)
def square_patch(long: bool, device: str | None) -> list[Finding]:
    """Rotating square patch, particles shifted."""
    omega, side, n = 1.0, 1.0, 64 if long else 32

    def pressure(points: np.ndarray) -> np.ndarray:
        """Laplace p = 2 rho omega^2, zero at the edges: a double sine series (Colagrossi 2005)."""
        x, total = points + 0.5 * side, np.zeros(len(points))
        for k in range(1, 60, 2):
            for m in range(1, 60, 2):
                share = (
                    -32.0 * RHO * omega**2 / (k * m * np.pi**2) / ((k * np.pi / side) ** 2 + (m * np.pi / side) ** 2)
                )
                total += share * np.sin(k * np.pi * x[:, 0] / side) * np.sin(m * np.pi * x[:, 1] / side)
        return total

    patch = Fluid(
        Box((-0.5 * side,) * 2, (0.5 * side,) * 2),
        velocity=lambda points: omega * np.stack([points[:, 1], -points[:, 0]], axis=1),
        pressure=pressure,
    )
    scene = Scene(
        (-2.0, -2.0),
        (2.0, 2.0),
        side / n,
        [patch],
        dict.fromkeys(face_names(2), OPEN),
        gravity=0.0,
        reference_speed=1.0,
    )
    solver, sound = Solver(scene, Scheme(surface_shifting=4.0), device=device), Sound()
    unit, pressures, least, void = RHO * (omega * side) ** 2, [], np.inf, 0.0
    for k in range(20):
        water = sound.look(solver)
        if k == 0:
            center = np.linalg.norm(water.position, axis=1) < 0.05 * side
            pressures.append(float(water.pressure[center].mean()) / unit)
        apart = nearest(water.position) / scene.particle_spacing
        least, void = min(least, float(apart.min())), max(void, float(np.median(apart)))
        solver.advance(0.1 / omega)
    return [
        Finding("centre pressure + .1473 at t = 0", abs(pressures[0] + 0.1473), 0.005),
        Finding("least distance, spacings", least, 0.4, least=True),
        Finding("median distance, spacings", void, 1.2),
        *sound.findings(),
    ]


@_numbered(4)
def jets(long: bool, device: str | None) -> list[Finding]:
    """Head-on jets of three times the speed expected."""
    streams = [
        Fluid(Box((-1.0, -0.25), (0.0, 0.25)), velocity=(3.0, 0.0)),
        Fluid(Box((0.0, -0.25), (1.0, 0.25)), velocity=(-3.0, 0.0)),
    ]
    spacing = 0.0125 if long else 0.05
    faces = dict.fromkeys(face_names(2), OPEN)
    solver = Solver(
        Scene((-3.0, -3.0), (3.0, 3.0), spacing, streams, faces, gravity=0.0, reference_speed=1.0), device=device
    )
    scale, drift, sound = np.abs(solver.particles().velocity.astype(float)).sum(), 0.0, Sound()
    for _ in range(5):
        solver.advance(0.08)
        water = sound.look(solver)
        drift = max(drift, float(np.abs(water.velocity.astype(float).sum(axis=0)).max() / scale))
    return [
        Finding("momentum drift", drift, 1e-4),
        Finding("speed across, m/s", float(np.abs(water.velocity[:, 1]).max()), 1.0, least=True),
        *sound.findings(),
    ]


@_numbered(5)
def piston(long: bool, device: str | None) -> list[Finding]:
    """A piston of .3 c_0, reversed; a gate that shuts."""
    scene = Scene(
        (0.0, 0.0),
        (1.0, 2.0),
        0.05,
        [Fluid(Box((0.0, 0.0), (1.0, 0.5)), pressure="hydrostatic")],
        faces={"x_min": Face(moving=True, travel=(0.0, 0.4))},
    )
    solver, sound = Solver(scene, device=device), Sound()
    for _ in range(24 if long else 6):
        for sign in (1.0, -1.0):  # reversed within five steps
            for k in range(5):
                solver.face_velocity[0, 0] = sign * 0.3 * scene.sound_speed * min(1.0, k / 3)
                solver.step()
                sound.look(solver)
        solver.face_velocity[0, 0] = 0.0
        for _ in range(5):  # the water comes back to the piston
            solver.advance(0.1)
            sound.look(solver)
    shut, through = _shut_gate(device, sound)
    return [
        Finding("gap left, spacings", shut, 0.02),
        Finding("particles through the gate", through, 0),
        *sound.findings(),
    ]


def _shut_gate(device: str | None, sound: Sound) -> tuple[float, int]:
    """A gate falls into running water until there is no gap: what is left of it [spacings], and how many pass then."""
    scene = Scene(
        (0.0, 0.0),
        (2.0, 1.2),
        0.05,
        [Fluid(Box((0.0, 0.0), (0.8, 0.8)), pressure="hydrostatic")],
        bodies={"gate": Body(Box((1.0, 0.6), (1.02, 1.8)), moving=True, travel=((0.0, -0.6), (0.0, 0.0)))},
    )
    solver = Solver(scene, device=device)
    solver.advance(0.25)
    solver.body_velocity[0, 0, 1] = -3.0
    solver.advance(0.4)
    beyond = int((sound.look(solver).position[:, 0] > 1.01).sum())
    for _ in range(10):
        solver.advance(0.1)
        water = sound.look(solver)
    gap = float(solver.body_position("gate")[0, 1]) - 0.6
    return abs(gap) / scene.particle_spacing, abs(int((water.position[:, 0] > 1.01).sum()) - beyond)


@_numbered(6)
def disorder(long: bool, device: str | None) -> list[Finding]:
    """A random start; Taylor-Green vortices, Re 1000, from a lattice."""
    solver, sound, speeds = Solver(still(jitter=0.5, seed=3), device=device), Sound(), []
    for _ in range(40):
        solver.advance(0.1)
        speeds.append(rms_speed(sound.look(solver)) / np.sqrt(G * 0.5))
    eddies = taylor_green.scene(50 if long else 25, 2)
    moving = Fluid(eddies.fluid[0].shape, velocity=taylor_green.velocity, pressure=taylor_green.pressure)
    eddies = replace(eddies, fluid=[moving], jitter=0.0, material=Material(viscosity=1e-3))
    solver, energies = Solver(eddies, device=device), []
    for _ in range(20 if long else 10):
        solver.advance(0.1)
        energies.append(0.5 * float((sound.look(solver).velocity.astype(float) ** 2).sum(axis=1).mean()))
    left = 0.25 * np.exp(-4.0 * 1e-3 * taylor_green.WAVE_NUMBER**2 * 0.1 * np.arange(1, len(energies) + 1))
    rise = float(np.diff([0.25, *energies]).max()) / 0.25
    return [
        Finding("random start: u_rms at the end over its largest", speeds[-1] / max(speeds), 0.5),
        Finding("eddies, Re 1000: energy gained in a tenth", rise, 1e-3),
        Finding("eddies: energy over the exact, off by", float(np.abs(energies / left - 1.0).max()), 0.1),
        *sound.findings(),
    ]


@_numbered(7)
def falling_block(long: bool, device: str | None) -> list[Finding]:
    """A block in free fall."""
    block = Fluid(Box((0.25, 0.25), (0.75, 0.75)))
    scene = Scene((0.0, -8.0), (1.0, 1.0), 0.0125 if long else 0.05, [block], dict.fromkeys(face_names(2), OPEN))
    solver, sound = Solver(scene, device=device), Sound()
    before = solver.particles().position.astype(float)
    worst = 0.0
    for _ in range(10):
        solver.advance(0.1)
        water = sound.look(solver)
        worst = max(worst, float(np.abs(water.pressure).max()) / (RHO * G * 0.5))
    fall = water.position.astype(float).mean(axis=0) - before.mean(axis=0)
    return [
        Finding("pressure over rho g H", worst, 0.01),
        Finding("fall, off by, m", float(np.abs(fall - (0.0, -0.5 * G)).max()), 1e-3),
        *sound.findings(),
    ]


@_numbered(8)
def inflow(long: bool, device: str | None) -> list[Finding]:
    """Inflow on and off."""
    nozzle = Inflow((0.2, 1.0), (1.0, 0.0), 0.2, speed=2.0, max_speed=3.0)
    scene = Scene(
        (0.0, 0.0), (1.5, 1.5), 0.025, [], dict.fromkeys(face_names(2), OPEN), reference_speed=5.0,
        inflows={"jet": nozzle}, reserve=3000,
    )  # fmt: skip
    solver, sound, wrong, refused = Solver(scene, device=device), Sound(), 0, 0
    for n in range(1000 if long else 100):
        solver.inflow_speed[:, 0] = 2.0 * (n % 2)
        solver.advance(0.01)
        account = solver.account()
        wrong += account.live != account.started + account.emitted - account.retired
        wrong += account.live != len(solver.particles())
        refused += account.refused
    sound.look(solver)
    return [
        Finding("books that do not balance", wrong, 0),
        Finding("particles refused", refused, 0),
        Finding("particles emitted", account.emitted, 1, least=True),
        *sound.findings(),
    ]


@_numbered(9)
def little(long: bool, device: str | None) -> list[Finding]:
    """An empty world, one particle, a film, a trap of half a spacing."""
    dx, sound, findings = 0.05, Sound(), []
    empty = Solver(Scene((0.0, 0.0), (1.0, 1.0), dx, [], reference_speed=1.0), device=device)
    empty.advance(0.1)
    one = Solver(Scene((0.0, 0.0), (1.0, 1.0), dx, [Fluid(Box((0.0, 0.5), (dx, 0.5 + dx)), (2.0, 0.0))]), device=device)
    start, energy = 0.5 * 2.0**2 + G * (0.5 + 0.5 * dx), 0.0
    film = Solver(Scene((0.0, 0.0), (1.0, 1.0), dx, [Fluid(Box((0.0, 0.0), (1.0, dx)))]), device=device)
    for _ in range(100 if long else 20):
        one.advance(0.1)
        alone = sound.look(one)
        energy = max(energy, 0.5 * float((alone.velocity.astype(float) ** 2).sum()) + G * float(alone.position[0, 1]))
        film.advance(0.1)
        thin = sound.look(film)
    findings.append(Finding("particles in an empty world", len(sound.look(empty)), 0))
    findings.append(Finding("energy of one particle over that at its start", energy / start, 1.02))
    findings.append(Finding("height of a film, spacings", float(thin.position[:, 1].max()) / dx, 1.0))
    trap = Scene(
        (0.0, 0.0), (1.0, 2.0), dx, [Fluid(Box((0.0, 0.0), (1.0, 0.2)), pressure="hydrostatic")],
        faces={"x_min": Face(moving=True, travel=(0.0, 1.0 - 0.5 * dx)), "y_max": OPEN},
    )  # fmt: skip
    solver = Solver(trap, device=device)
    solver.face_velocity[0, 0] = 1.0
    for _ in range(80 if long else 40):
        solver.advance(0.05)
        water = sound.look(solver)
    findings.append(Finding("particles left in the trap", len(water), 1, least=True))
    return [*findings, *sound.findings()]


def dam_break_front() -> float:
    """Front of a dam break at H/10 and t* = 2, over H, in this process's precision."""
    scene = dam_break.scene(10, 2)
    solver = Solver(scene, device="cpu")
    solver.advance(2.0 * dam_break.TIME_UNIT)
    return front(solver.particles(), scene) / dam_break.HEIGHT


@_numbered(10)
def precision(long: bool, device: str | None) -> list[Finding]:
    """Single against double precision."""
    code = "from fluidgym.stress import dam_break_front; print(dam_break_front())"
    fronts = []
    for name in ("single", "double"):
        environment = os.environ | {"FLUIDGYM_PRECISION": name}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        fronts.append(float(done.stdout.splitlines()[-1]))
    off = abs(fronts[0] - fronts[1]) / (fronts[1] - 2.0)
    return [Finding("front of single from double precision, of its way", off, 2e-3)]


@_numbered(11)
def long_steps(long: bool, device: str | None) -> list[Finding]:
    """Steps of 1.5 times the usual, and longer ones."""
    scene, fronts, sound = tank(), [], Sound()
    for factor in (1.0, 1.5):
        solver = Solver(scene, device=device)
        dt = factor * solver.max_step
        solver.step(round(1.5 / np.sqrt(G) / dt), dt)
        fronts.append(front(sound.look(solver), scene))
    refused = 0
    for factor in (1.51, 3.0, 100.0):
        try:
            solver.step(1, factor * solver.max_step)
        except ValueError:
            refused += 1
    return [
        Finding("front with steps of 1.5 times the usual, off by, of its way", abs(fronts[1] / fronts[0] - 1.0), 0.01),
        Finding("longer steps refused, of 3", refused, 3, least=True),
        *sound.findings(),
    ]


@_numbered(12)
def worst_actions(long: bool, device: str | None) -> list[Finding]:
    """The worst actions in every task."""
    reports = [
        soak(task, {"difficulty": "easy"}, worlds=16, steps=100_000 if long else 800, device=device) for task in TASKS
    ]
    steps = sum(report.steps for report in reports)
    return [
        Finding("environment steps", steps, 1, least=True),
        Finding("divergences per million steps", 1e6 * sum(report.diverged for report in reports) / steps, 0.0),
        Finding("beyond a wall, spacings", max(report.penetration for report in reports), 0.0),
        Finding("particles missing or twice", sum(report.mass_error for report in reports), 0),
    ]


def choose(numbers: Sequence[int], hours: float | None) -> list[Stress]:
    """The stresses of these numbers; of none, all.

    Raises:
        ValueError: There is no such number, or the hours are not above zero.
    """
    if hours is not None and not 0.0 < hours <= 10_000.0:
        raise ValueError(f"--hours {hours:g} is outside 0 to 10000; give how long the tasks are to be driven")
    for number in numbers:
        if not 1 <= number <= len(STRESSES):
            raise ValueError(f"stress {number} is outside 1 to {len(STRESSES)}; name one of them")
    return [stress for stress in STRESSES if stress.number in (numbers or range(1, len(STRESSES) + 1))]


@dataclass
class Found:
    """What a run of stresses has found.

    Attributes:
        rows: Stresses, what each found, and how long it took [s].
        soaked: Reports by environment.
    """

    rows: list[tuple[Stress, list[Finding], float]] = field(default_factory=list)
    soaked: dict[str, Report] = field(default_factory=dict)

    def add(self, stress: Stress, long: bool, device: str | None) -> str:
        """Run a stress, and tell of it in lines."""
        begin = time.monotonic()
        findings = stress.run(long, device)
        self.rows.append((stress, findings, time.monotonic() - begin))
        return "\n    ".join([f"{stress.number}  {stress.title}", *map(str, findings)])

    @property
    def passed(self) -> bool:
        """Whether every mark was kept and nothing diverged."""
        held = all(finding.passed for _, findings, _ in self.rows for finding in findings)
        return held and all(report.sound for report in self.soaked.values())

    def as_json(self) -> list[dict[str, Any]]:
        """All of it, for a file."""
        stresses = [
            {
                "number": stress.number,
                "title": stress.title,
                "seconds": seconds,
                "findings": [{**asdict(finding), "passed": finding.passed} for finding in findings],
            }
            for stress, findings, seconds in self.rows
        ]
        soaked = [{"id": name, **asdict(r), "per_million": r.per_million} for name, r in self.soaked.items()]
        return stresses + soaked


def markdown(found: Found, machine: Mapping[str, Any], command: str) -> str:
    """A page of what was found."""
    text = [f"# What it stands\n\nMade by `{command}`.\n\n{told(machine)}.\n"]
    if found.rows:
        rows = [
            (
                f"{stress.number}",
                stress.title,
                "; ".join(map(str, findings)),
                "held" if all(finding.passed for finding in findings) else "**missed**",
                f"{seconds:.0f} s",
            )
            for stress, findings, seconds in found.rows
        ]
        text += markdown_table(("", "stress", "found (mark)", "", "time"), rows)
        missed = [stress.number for stress, findings, _ in found.rows if not all(one.passed for one in findings)]
        if known := [number for number in missed if number in MISSES]:
            text += ["", *(f"- {number}: {MISSES[number]}" for number in known)]
    if found.soaked:
        head = (
            "environment",
            "minutes",
            "steps",
            "diverged, per million",
            "largest compression, but for those",
            "largest void",
            "largest speed over that of sound",
            "put right at walls in a step, at most",
            "beyond a wall, spacings",
            "missing or twice",
        )
        rows = [
            (
                f"`{env_id.rpartition('/')[2]}`",
                f"{report.seconds / 60.0:.1f}",
                f"{report.steps}",
                f"{report.diverged}, {report.per_million:.0f}",
                f"{report.compression:.2f}",
                f"{report.void:.2f}",
                f"{report.speed:.2f}",
                f"{report.clamped}",
                f"{report.penetration:.2g}",
                f"{report.mass_error}",
            )
            for env_id, report in found.soaked.items()
        ]
        text += [
            "\n## Soaks\n\nTasks driven by the worst actions, all particles looked at in every tenth step. Compression"
            " is rho/rho_0 - 1, and void, where fluid has torn, 1 - rho/rho_0; a world counts as diverged past"
            f" {LARGEST_COMPRESSION:g} of the one or {LARGEST_VOID:g} of the other:\n"
        ]
        text += markdown_table(head, rows)
    return "\n".join(text) + "\n"
