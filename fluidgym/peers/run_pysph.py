"""Runs a handed-over scene in PySPH: PYTHON run_pysph.py SCENE.npz FLOW.npz, or --version.

A program by itself, for whatever interpreter has PySPH; it imports nothing of FluidGym. What is in the two files is
told in fluidgym/peers/__init__.py.

All particles, their positions, velocities, masses and densities are those handed over. Walls are four layers of
PySPH's own solid particles, which carry the lattice of the fluid on through each wall (a lid that gravity pulls away
from has none). Everything else is as in the examples that PySPH ships:

    walls       WCSPHScheme of its dam_break_2d: Wendland quintic, h = 1.3 dx, alpha = 0.1, gamma = 7, Hughes and
                Graham's correction, h that follows the density, predictor and corrector, adaptive steps of CFL 0.3
    free        WCSPHScheme of its elliptical_drop: Gaussian, h = 1.3 dx, alpha = 0.1, gamma = 7, evaluated before and
                after the prediction, adaptive steps of CFL 0.3
    periodic    TVFScheme of its taylor_green: quintic spline, h = dx, background pressure rho c^2, steps of
                0.25 h / (c + U) or 0.125 h^2 / nu
    edac        EDACScheme of its dam_break_2d and taylor_green: quintic spline, h = 1.3 dx (periodic: h = dx and the
                transport velocity), pressure of walls not below zero, steps of 0.125 h / c (0.25 h / (c + U))
    thin        as walls and free, with alpha = 0.01, which is what the dam break's published reference has

A fluid with a viscosity of its own has that instead of alpha. One thread, and PySPH's linked lists as they come: kept
neighbours (`cache`) and spatial order (`reorder_freq`) made a dam break 2 to 5 % slower, and walls half as high 4 %
faster. Its delta-SPH was no more accurate there (9.2 % against 8.5 % at H/20 with alpha = 0.01) and took 2.5 times as
long. The dam_break_2d that PySPH ships leaves h and m at the values of another spacing when it is given --dx; here they
are those of the spacing. PySPH computes in double precision. The time is that of Solver.solve, without the copies of
the particles at the instants.
"""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

LAYERS = 4  # of wall particles, unless the kernel reaches further
BROKEN = 3  # exit status of a run that breaks down


def main() -> int:
    """Run the scene; an exit status."""
    if sys.argv[1:] == ["--version"]:
        import pysph  # pyright: ignore[reportMissingImports]

        print(pysph.__version__)
        return 0
    source, target = map(Path, sys.argv[1:])
    begin = time.perf_counter()
    with np.load(source) as handed:
        arrays = {name: handed[name] for name in handed.files}
    facts = json.loads(str(arrays.pop("facts")))
    solver, fluid = make_solver(facts, arrays)
    setup = time.perf_counter() - begin
    log = Log(fluid, arrays["times"], facts, solver.dt)
    solver.add_post_step_callback(log)
    begin = time.perf_counter()
    try:
        solver.solve(show_progress=False)
    except FloatingPointError as error:
        print(error, file=sys.stderr)
        return BROKEN
    wall = time.perf_counter() - begin - log.spent
    found = {name: np.array([kept[name] for kept in log.kept]) for name in log.kept[0]}
    said = {"wall_s": wall, "setup_s": setup, "steps": solver.count, "gamma": facts["gamma"]}
    if facts["gamma"] == 0.0:  # the pressure is a variable of its own
        found["density"] = facts["density"] * (1.0 + found["pressure"] / (facts["density"] * facts["sound_speed"] ** 2))
        said["gamma"] = 1.0
    kept: dict[str, Any] = {"facts": json.dumps(said), **found}
    np.savez(target, **kept)
    return 0


class Log:
    """Keeps the particles of the instants asked for, says how far the run is, and stops one that has broken down."""

    def __init__(self, fluid: Any, times: np.ndarray, facts: dict[str, Any], step: float):
        self.fluid, self.times, self.dim, self.sound_speed = fluid, times, facts["dim"], facts["sound_speed"]
        self.most = 20.0 * times[-1] / step
        self.spent = 0.0
        self.steps, self.told = 0, 0.0
        self.kept = [self.copy()]

    def __call__(self, solver: Any) -> None:
        """After a step; the solver's clock is still at its beginning."""
        begin = time.perf_counter()
        now = solver.t + solver.dt
        instant = self.times[min(len(self.kept), len(self.times)) - 1]
        if len(self.kept) <= len(self.times) and now > instant - 1e-9 * self.times[-1]:
            self.kept.append(self.copy())
        self.steps += 1
        fastest = max(np.abs(getattr(self.fluid, axis)).max() for axis in "uvw"[: self.dim])
        if not fastest < 3.0 * self.sound_speed:
            raise FloatingPointError(f"broke down after {now:.3g} s: a particle is {fastest:.3g} m/s fast")
        if self.steps > self.most:
            raise FloatingPointError(f"broke down after {now:.3g} s: steps became {solver.dt:.2g} s short")
        if now - self.told > 0.01 * self.times[-1] or now >= self.times[-1]:
            print("time", now, flush=True)
            self.told = now
        self.spent += time.perf_counter() - begin

    def copy(self) -> dict[str, np.ndarray]:
        """The particles now, in the order in which they were handed over."""
        order = np.argsort(self.fluid.gid[: self.fluid.get_number_of_particles(True)])
        axes, motion = "xyz"[: self.dim], "uvw"[: self.dim]
        real = len(order)
        return {
            "position": np.stack([getattr(self.fluid, axis)[:real][order] for axis in axes], axis=1),
            "velocity": np.stack([getattr(self.fluid, axis)[:real][order] for axis in motion], axis=1),
            "density": self.fluid.rho[:real][order].copy(),
            "pressure": self.fluid.p[:real][order].copy(),
        }


def make_solver(facts: dict[str, Any], arrays: dict[str, np.ndarray]) -> tuple[Any, Any]:
    """PySPH's solver, compiled, and its fluid."""
    from compyle.config import get_config  # pyright: ignore[reportMissingImports]
    from pysph.base.nnps import DomainManager, LinkedListNNPS  # pyright: ignore[reportMissingImports]
    from pysph.base.utils import get_particle_array  # pyright: ignore[reportMissingImports]

    get_config().use_openmp = False
    dim, dx, rho, c = facts["dim"], facts["spacing"], facts["density"], facts["sound_speed"]
    kinds = facts["faces"]
    walls = wall_particles(facts)
    scheme, ratio = make_scheme(facts, solids=["walls"] if len(walls) else [])
    gamma = facts["gamma"] or 1.0
    density = rho * np.maximum(1.0 + gamma * arrays["pressure"] / (rho * c * c), 0.0) ** (1.0 / gamma)
    fluid = get_particle_array(
        name="fluid",
        m=rho * dx**dim,
        h=ratio * dx,
        rho=density,
        p=arrays["pressure"],
        **dict(zip("xyz", arrays["position"].T, strict=False)),
        **dict(zip("uvw", arrays["velocity"].T, strict=False)),
    )
    particles = [fluid]
    if len(walls):
        places = dict(zip("xyz", walls.T, strict=False))
        particles.append(get_particle_array(name="walls", m=rho * dx**dim, h=ratio * dx, rho=rho, **places))
    scheme.setup_properties(particles)
    if "gid" not in fluid.properties:
        fluid.add_property("gid", type="unsigned int")
    fluid.gid[:] = np.arange(len(fluid.gid))
    for each in particles:
        if "V" in each.properties:
            each.V[:] = 1.0 / dx**dim
    domain, limits = None, {}
    for axis in range(dim):
        if kinds[2 * axis] == "periodic":
            name = "xyz"[axis]
            limits |= {f"{name}min": facts["lower"][axis], f"{name}max": facts["upper"][axis]}
            limits |= {f"periodic_in_{name}": True}
    if limits:
        domain = DomainManager(**limits)
    solver = scheme.get_solver()
    solver.set_disable_output(True)
    solver.set_final_time(float(arrays["times"][-1]))
    solver.set_output_at_times(arrays["times"])  # it steps onto them
    solver.set_parallel_manager(None)
    nnps = LinkedListNNPS(
        dim=dim, particles=particles, radius_scale=solver.kernel.radius_scale, domain=domain, fixed_h=solver.fixed_h
    )
    solver.setup(particles, scheme.get_equations(), nnps, solver.kernel, solver.fixed_h)
    return solver, fluid


def make_scheme(facts: dict[str, Any], solids: list[str]) -> tuple[Any, float]:
    """A scheme of PySPH, its solver configured, and h/dx; the exponent of its state equation goes into the facts."""
    from pysph.base.kernels import Gaussian, QuinticSpline, WendlandQuintic  # pyright: ignore[reportMissingImports]
    from pysph.sph.integrator import EPECIntegrator, PECIntegrator  # pyright: ignore[reportMissingImports]
    from pysph.sph.scheme import TVFScheme, WCSPHScheme  # pyright: ignore[reportMissingImports]
    from pysph.sph.wc.edac import EDACScheme  # pyright: ignore[reportMissingImports]

    dim, dx, rho, c, nu = (facts[name] for name in ("dim", "spacing", "density", "sound_speed", "viscosity"))
    courant, method = facts["courant"], facts["method"]
    everywhere = set(facts["faces"]) == {"periodic"}
    ratio = 1.0 if everywhere else facts["ratio"] or 1.3
    h = ratio * dx
    names: dict[str, Any] = {"fluids": ["fluid"], "solids": solids, "dim": dim, "rho0": rho, "c0": c}
    names |= dict(zip(("gx", "gy", "gz"), facts["gravity"], strict=False))
    smooth = courant * min(0.25 * h / (c + facts["reference_speed"]), 0.125 * h * h / nu if nu else math.inf)
    if method == "edac":
        facts["gamma"] = 0.0
        scheme = EDACScheme(**names, nu=nu, h=h, pb=rho * c * c if everywhere else 0.0, eps=0.0, clamp_p=not everywhere)
        step = smooth if everywhere else min(courant * 0.125 * h / c, smooth)
        scheme.configure_solver(kernel=QuinticSpline(dim=dim), dt=step)
    elif everywhere:
        facts["gamma"] = 1.0
        scheme = TVFScheme(**names, nu=nu, p0=rho * c * c, pb=rho * c * c, h0=h)
        scheme.configure_solver(kernel=QuinticSpline(dim=dim), dt=smooth)
    else:
        facts["gamma"] = 7.0
        scheme = WCSPHScheme(
            **names,
            h0=h,
            hdx=ratio,
            gamma=7.0,
            alpha=0.0 if nu else {"auto": 0.1, "thin": 0.01}[method],
            beta=0.0,
            nu=nu,
            hg_correction=bool(solids),
            update_h=bool(solids),
        )
        scheme.configure_solver(
            kernel=WendlandQuintic(dim=dim) if solids else Gaussian(dim=dim),
            integrator_cls=PECIntegrator if solids else EPECIntegrator,
            dt=courant * (0.125 * h / c if solids else 0.25 * h / (c + facts["reference_speed"])),
            adaptive_timestep=True,
            cfl=0.3 * courant,
            n_damp=50,
            fixed_h=False,
        )
    return scheme, ratio


def wall_particles(facts: dict[str, Any]) -> np.ndarray:
    """Places of the wall particles, (n, dim): the lattice of the box, carried on through its walls."""
    dim, dx = facts["dim"], facts["spacing"]
    layers = max(LAYERS, math.ceil(2.0 * (facts["ratio"] or 1.3)))
    lines, inside = [], []
    for axis in range(dim):
        low, high = facts["lower"][axis], facts["upper"][axis]
        count = round((high - low) / dx)
        before, after = (
            layers if kind == "wall" and not lid(facts, axis, side) else 0
            for side, kind in zip((-1.0, 1.0), facts["faces"][2 * axis : 2 * axis + 2], strict=True)
        )
        # Each wall stands where the box ends, be that a whole number of spacings away or not.
        inner = low + (np.arange(count) + 0.5) * (high - low) / count
        below = low - (np.arange(before, 0, -1) - 0.5) * dx
        above = high + (np.arange(after) + 0.5) * dx
        lines.append(np.concatenate([below, inner, above]))
        inside.append(np.concatenate([np.zeros(before, bool), np.ones(count, bool), np.zeros(after, bool)]))
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=1)
    within = np.logical_and.reduce([axis.ravel() for axis in np.meshgrid(*inside, indexing="ij")])
    return grid[~within]


def lid(facts: dict[str, Any], axis: int, side: float) -> bool:
    """Whether gravity pulls straight away from this wall."""
    pull = facts["gravity"]
    return pull[axis] * side < 0.0 and not any(pull[other] for other in range(len(pull)) if other != axis)


if __name__ == "__main__":
    sys.exit(main())
