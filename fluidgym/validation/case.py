"""What a validation case is, and how one is run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp

from fluidgym.scene import Scene
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.solver import Solver

Limits = Mapping[str, float]
Records = dict[str, np.ndarray]

# Steps handed to the solver at once: long enough that handing over costs nothing, short enough for a live progress bar.
STEPS_AT_ONCE = 16

# The same where a case drives the controls, which change linearly over each such piece: short, so as to follow a sine.
STEPS_DRIVEN = 4

# Shift of start positions, over the spacing, of runs that are to differ by chance alone: no flow feels as little.
SHAKE = 0.01


@dataclass(frozen=True)
class Case:
    """A flow whose answer is known, how far a run is from that answer, and how far it may be.

    Attributes:
        name: On the command line.
        title: One line for people.
        resolutions: Resolutions to run by default for each dimension the case exists in; what a resolution counts is
            the case's to say.
        scene: (resolution, dim) -> Scene.
        times: Instants at which the flow is observed [s], rising.
        end: When a run ends unless asked for all of `times` [s].
        observe: Solver -> what to keep of an instant, by name; 0 is before the first step.
        errors: (times [s] (n,), records (n, ...) by name, scene) -> errors by name.
        target: Limits that a run must keep, {resolution: {error: limit}}, each from that resolution on.
        goal: Limits to strive for, likewise.
        scheme: How it is simulated.
        drive: (solver, time [s]) -> None, called before every few steps: sets the controls to what they are to be at
            the end of those steps, that is, at that time.
        parts: Cases by name that are run one after another in place of this one, which only adds the target and the
            goal for the errors of all of them; their instants are the same.
        headline: Name of the error that stands for the case beside its run time; "" is the first that has a goal.
    """

    name: str
    title: str
    resolutions: Mapping[int, tuple[int, ...]]
    scene: Callable[[int, int], Scene]
    times: np.ndarray
    end: float
    observe: Callable[[Solver], dict[str, Any]]
    errors: Callable[[np.ndarray, Records, Scene], dict[str, float]]
    target: Mapping[int, Limits] = field(default_factory=dict)
    goal: Mapping[int, Limits] = field(default_factory=dict)
    scheme: Scheme = DEFAULT_SCHEME
    drive: Callable[[Solver, float], None] | None = None
    parts: Mapping[str, Case] = field(default_factory=dict)
    headline: str = ""


@dataclass(frozen=True)
class Result:
    """A case that was run.

    Attributes:
        case: Name of the case.
        resolution: As the case counts it.
        dim: Number of dimensions.
        particles: Number of particles at the start.
        steps: Number of time steps.
        wall_s: Time of the steps alone [s].
        setup_s: Time to make the solver, compile its kernels and run the first of them [s].
        device: Name of the Warp device.
        errors: By name; nan is a run that broke down. The mean, where there are several runs.
        target: Limits the run must keep, by name of the error; some errors have none.
        goal: Limits to strive for.
        times: Instants of the records [s], (n,).
        records: What was observed, by name, (n, ...); of the first run.
        seeds: Number of runs.
        spread: Standard deviation of each error over the runs; empty for one.
    """

    case: str
    resolution: int
    dim: int
    particles: int
    steps: int
    wall_s: float
    setup_s: float
    device: str
    errors: dict[str, float]
    target: dict[str, float]
    goal: dict[str, float]
    times: np.ndarray = field(repr=False)
    records: Records = field(repr=False)
    seeds: int = 1
    spread: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool | None:
        """Whether every error with a target keeps it; None where there is no target at this resolution."""
        verdicts = [self.keeps(name, self.target) for name in self.target]
        return all(verdicts) if verdicts else None

    def keeps(self, error: str, limits: Limits) -> bool | None:
        """Whether an error keeps the limit of its name; None where there is none."""
        if error not in limits:
            return None
        return abs(self.errors.get(error, math.nan)) <= limits[error]


def run(
    case: Case,
    resolution: int,
    dim: int = 2,
    device: str | None = None,
    end: float | None = None,
    scheme: Scheme | None = None,
    progress: Callable[[float], object] = lambda duration: None,
    seeds: int | None = None,
) -> Result:
    """Run a case.

    Where water breaks and strikes, errors differ by chance from run to run; their mean and spread over several do not.

    Args:
        case: The case.
        resolution: As the case counts it.
        dim: 2 or 3.
        device: Warp device; None takes a GPU where there is one.
        end: Latest instant to observe [s]; None is the case's own end. Errors are those of the instants up to it.
        scheme: In place of the case's own.
        progress: Called with every further piece of simulated time [s], over the number of runs.
        seeds: Number of runs, each from a start of its own (`shaken`): back comes their mean errors and spread,
            the median of their times, and what else the first has. None is one run from the start of the case.

    Raises:
        ValueError: The case does not exist in this dimension, or no instant is early enough.
    """
    if dim not in case.resolutions:
        raise ValueError(f"{case.name} has no {dim}D variant; use dim = {' or '.join(map(str, case.resolutions))}")
    if seeds or case.parts:
        share = 1.0 / (seeds or len(case.parts))

        def run_one(one: Case) -> Result:
            return run(one, resolution, dim, device, end, scheme, lambda duration: progress(share * duration))

        if seeds:
            return _mean([run_one(shaken(case, seed)) for seed in range(seeds)])
        return _joined(case, {name: run_one(part) for name, part in case.parts.items()})
    end = case.end if end is None else end
    times = case.times[case.times <= end * (1 + 1e-9)]
    if not len(times):
        raise ValueError(f"run end = {end:g} s is before the first instant of {case.name}; use {case.times[0]:g} s")
    started = time.perf_counter()
    scene = case.scene(resolution, dim)
    solver = Solver(scene, scheme or case.scheme, device=device)
    for n in (STEPS_DRIVEN if case.drive else STEPS_AT_ONCE, 1):  # these two are captured once, and used from here on
        solver.step(n)
    solver.reset()
    wp.synchronize_device(solver.device)
    setup_s = time.perf_counter() - started

    observed = [case.observe(solver)]
    steps, wall_s = 0, 0.0
    for last, now in zip([0.0, *times], times, strict=False):
        taken, seconds = _go_on(solver, now - last, progress, case.drive)
        steps, wall_s = steps + taken, wall_s + seconds
        observed.append(case.observe(solver))
    times = np.concatenate([[0.0], times])
    records = {name: np.array([instant[name] for instant in observed]) for name in observed[0]}
    return Result(
        case=case.name,
        resolution=resolution,
        dim=dim,
        particles=len(scene.sample()),
        steps=steps,
        wall_s=wall_s,
        setup_s=setup_s,
        device=str(solver.device),
        errors=case.errors(times, records, scene),
        target=limits_at(resolution, case.target),
        goal=limits_at(resolution, case.goal),
        times=times,
        records=records,
    )


def shaken(case: Case, seed: int) -> Case:
    """A case whose start is off its own by a hundredth of the spacing, at random; more where it is so already."""

    def scene(resolution: int, dim: int) -> Scene:
        still = case.scene(resolution, dim)
        return replace(still, jitter=max(still.jitter, SHAKE), seed=seed)

    return replace(case, scene=scene, parts={name: shaken(part, seed) for name, part in case.parts.items()})


def _mean(results: Sequence[Result]) -> Result:
    """The results of several runs of a case as one."""
    errors = {name: np.array([result.errors[name] for result in results]) for name in results[0].errors}
    return replace(
        results[0],
        wall_s=float(np.median([result.wall_s for result in results])),
        setup_s=sum(result.setup_s for result in results),
        errors={name: float(values.mean()) for name, values in errors.items()},
        seeds=len(results),
        spread={name: float(values.std(ddof=1)) for name, values in errors.items()} if len(results) > 1 else {},
    )


def _joined(case: Case, parts: Mapping[str, Result]) -> Result:
    """The results of a case's parts as one: errors together, steps and times added up, particles of the largest."""
    results = list(parts.values())
    return replace(
        results[0],
        case=case.name,
        particles=max(result.particles for result in results),
        steps=sum(result.steps for result in results),
        wall_s=sum(result.wall_s for result in results),
        setup_s=sum(result.setup_s for result in results),
        errors={name: error for result in results for name, error in result.errors.items()},
        target=limits_at(results[0].resolution, case.target),
        goal=limits_at(results[0].resolution, case.goal),
        records={f"{part}_{name}": kept for part, result in parts.items() for name, kept in result.records.items()},
    )


def _go_on(
    solver: Solver,
    duration: float,
    progress: Callable[[float], object],
    drive: Callable[[Solver, float], None] | None,
) -> tuple[int, float]:
    """Advance by a duration [s] in equal steps; return their number and how long they took [s]."""
    steps = solver.steps_for(duration)
    dt = duration / steps
    seconds = 0.0
    at_once = STEPS_DRIVEN if drive else STEPS_AT_ONCE
    full, rest = divmod(steps, at_once)
    for n in [at_once] * full + [1] * rest:
        started = time.perf_counter()
        if drive:
            drive(solver, float(solver.time[0]) + n * dt)
        solver.step(n, dt)
        wp.synchronize_device(solver.device)
        seconds += time.perf_counter() - started
        progress(n * dt)
    return steps, seconds


def limits_at(resolution: int, limits: Mapping[int, Limits]) -> dict[str, float]:
    """The limits that hold at a resolution, by name of the error: those set at it or at a coarser one."""
    merged: dict[str, float] = {}
    for since in sorted(limits):
        if since <= resolution:
            merged.update(limits[since])
    return merged


def observed_order(coarse: Result, fine: Result) -> dict[str, float]:
    """Order of convergence between two runs of a case, by name of the error; nan where an error is 0 or not finite."""
    refinement = math.log(fine.resolution / coarse.resolution)
    orders = {}
    for name in fine.errors.keys() & coarse.errors.keys():
        ratio = abs(coarse.errors[name]) / abs(fine.errors[name]) if fine.errors[name] else math.nan
        orders[name] = math.log(ratio) / refinement if ratio > 0.0 and math.isfinite(ratio) else math.nan
    return {name: orders[name] for name in fine.errors if name in orders}


def runge_kutta(rate: Callable[[np.ndarray], np.ndarray], state: np.ndarray, duration: float, steps: int) -> np.ndarray:
    """A state after a duration, its rate of change known: the classical method, in equal steps."""
    dt = duration / steps
    for _ in range(steps):
        k1 = rate(state)
        k2 = rate(state + 0.5 * dt * k1)
        k3 = rate(state + 0.5 * dt * k2)
        k4 = rate(state + dt * k3)
        state = state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return state


def largest_error(
    reference: Callable[[np.ndarray, float], np.ndarray],
    times: np.ndarray,
    places: Sequence[np.ndarray] | np.ndarray,
    values: Sequence[np.ndarray] | np.ndarray,
) -> float:
    """Largest difference from a reference (place, time) -> value over all places and instants but the first."""
    instants = zip(times[1:], places[1:], values[1:], strict=True)
    return float(np.max([np.abs(found - reference(place, time)).max() for time, place, found in instants]))


def rms(values: Sequence[float] | np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
