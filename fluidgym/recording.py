"""Running an experiment and keeping what it shows: a table of measurements, pictures, a film, files for ParaView."""

from __future__ import annotations

import csv
import dataclasses
import math
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from fluidgym import paraview, usd
from fluidgym.diagnostics import Measurement, measure
from fluidgym.experiment import Experiment, drive
from fluidgym.picture import picture
from fluidgym.render import write_gif, write_mp4, write_png
from fluidgym.render.film import check_mp4
from fluidgym.scene import AXES
from fluidgym.scene_file import save
from fluidgym.solver import Solver

FILMS = ("gif", "mp4", "none")

# A film is kept in memory until it is written.
LARGEST_FILM = 1.5e9  # [bytes]
MOST_SAVES = 100_000

# Up to here a run is as weakly compressible as it should be; beyond the second its pressures are of little worth.
GOOD_DENSITY_ERROR, FAIR_DENSITY_ERROR = 0.01, 0.03


@dataclass(frozen=True)
class Output:
    """What is kept of a run.

    Attributes:
        folder: Where; it is there.
        film: "gif", "mp4" or "none".
        frames: Whether each frame is written as a picture too.
        vtk: Whether the particles are written for ParaView.
        usd: Whether they are, and in 3D their surface, to a file of USD.
        save_every: Simulated time between rows of the table, and between files or samples for other tools [s]; None is
            that between frames.
    """

    folder: Path
    film: str = "gif"
    frames: bool = False
    vtk: bool = False
    usd: bool = False
    save_every: float | None = None

    def check(self, experiment: Experiment) -> None:
        """Refuse what could not be written in the end.

        Raises:
            ValueError: A library is missing, or there is too much; one line with the remedy.
        """
        if self.film == "mp4":
            check_mp4()
        if self.vtk:
            paraview.check_library()
        if self.usd:
            usd.check_library()
        if self.save_every is not None and not (math.isfinite(self.save_every) and self.save_every > 0.0):
            raise ValueError(
                f"the time between saves, {self.save_every:g} s, must be above 0 and finite; use 0.1 or so"
            )
        saves = 0.0 if self.save_every is None else experiment.duration / self.save_every
        if saves > MOST_SAVES:
            raise ValueError(
                f"the time between saves, {self.save_every:g} s, asks for {saves:.3g} of them, limit {MOST_SAVES};"
                f" use {experiment.duration / MOST_SAVES:.2g} s or more"
            )
        view = experiment.view
        count = experiment.duration / view.frame_interval + 1.0
        size = 3.0 * view.size[0] * view.size[1] * count
        if self.film != "none" and size > LARGEST_FILM:
            raise ValueError(
                f"a film of {count:.0f} frames takes {1e-9 * size:.1f} GB, limit {1e-9 * LARGEST_FILM:.1f} GB;"
                " use fewer frames a second, a shorter duration or no film"
            )


@dataclass
class Record:
    """What came of a run.

    Attributes:
        solver: As it was left.
        measured: The rows of the table.
        steps: Number of time steps.
        setup_s: Time to make the solver, compiling included [s].
        solving_s: Time spent stepping [s].
        other_s: Time spent measuring, drawing and writing [s].
        files: What was written.
        failure: Why it ended early, None where it did not.
        broken_down: Whether that was because its numbers made no sense any more.
        interrupted: Whether the user ended it.
    """

    solver: Solver
    measured: list[Measurement] = field(default_factory=list)
    steps: int = 0
    setup_s: float = 0.0
    solving_s: float = 0.0
    other_s: float = 0.0
    files: list[Path] = field(default_factory=list)
    failure: str | None = None
    broken_down: bool = False
    interrupted: bool = False


def record(
    experiment: Experiment,
    output: Output,
    device: str | None = None,
    progress: Callable[[float], object] = lambda seconds: None,
) -> Record:
    """Run an experiment. An interrupt or a breakdown ends it early, and what there is by then is kept.

    Args:
        experiment: The experiment.
        output: What to keep.
        device: Name of the Warp device; None takes a GPU where there is one.
        progress: Called with simulated time as it passes [s].

    Raises:
        ValueError: The solver cannot be made for the scene, or a file could not be written; nothing has happened then.
        OSError: A file cannot be written.
    """
    output.check(experiment)
    begin = time.perf_counter()
    solver = Solver(experiment.scene, experiment.scheme, device=device)
    solver.step(1)  # compiles what is left to compile
    solver.reset()
    found = Record(solver, setup_s=time.perf_counter() - begin)
    save(experiment, output.folder / "as_run.toml")
    with ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.filterwarnings("ignore", "Scene.reserve")  # told at the end, in the summary
        keeper = _Keeper(experiment, output, found, stack)
        begin = time.perf_counter()
        try:
            _go(experiment, found, keeper, progress)
        except KeyboardInterrupt:
            found.interrupted = True
        keeper.finish()
        found.other_s = time.perf_counter() - begin - found.solving_s
    return found


def _go(experiment: Experiment, found: Record, keeper: _Keeper, progress: Callable[[float], object]) -> None:
    """Go from instant to instant until the end, or until the run breaks down."""
    solver, now = found.solver, 0.0
    for instant, frame_due, save_due in keeper.plan():
        if instant > 0.0:
            begin = time.perf_counter()
            try:
                found.steps += drive(experiment, solver, instant)
            except ValueError as error:  # a control that the solver cannot follow
                found.failure = f"at {now:.4g} s: {error}"
                return
            finally:
                wp.synchronize_device(solver.device)
                found.solving_s += time.perf_counter() - begin
            progress(instant - now)
            now = instant
        measured = measure(solver)
        found.measured.append(measured)
        keeper.keep(measured, frame_due, save_due)
        if not measured.credible:
            found.broken_down = True
            found.failure = (
                f"the run has broken down at {now:.4g} s, with a density error of {measured.largest_density_error:.2g};"
                " use a larger reference_speed, a smaller particle_spacing or a smaller courant"
            )
            return


class _Keeper:
    """Writes what a run shows, as it goes."""

    def __init__(self, experiment: Experiment, output: Output, found: Record, stack: ExitStack):
        self._experiment, self._output, self._found = experiment, output, found
        self._frames: list[np.ndarray] = []
        self._pictures = 0
        folder = output.folder
        found.files.append(folder / "as_run.toml")
        self._series = stack.enter_context((folder / "series.csv").open("w", newline="", encoding="utf-8"))
        found.files.append(folder / "series.csv")
        self._writer = csv.writer(self._series)
        self._particles = paraview.ParticleFiles(folder / "particles") if output.vtk else None
        self._stage = usd.UsdFile(folder / "fluid.usdc", found.solver) if output.usd else None
        if output.frames:
            (folder / "frames").mkdir(exist_ok=True)
            for old in (folder / "frames").glob("frame_*.png"):
                old.unlink()

    def plan(self) -> list[tuple[float, bool, bool]]:
        """Instants [s] with whether each is one of the film and one of the table, in order."""
        experiment, output = self._experiment, self._output
        wanted = output.film != "none" or output.frames
        frame = experiment.view.frame_interval
        save_interval = output.save_every or frame
        due: dict[int, list[Any]] = {}
        tick = 1e-6 * min(frame, save_interval, experiment.duration)  # instants closer than this are one

        def add(instant: float, which: int) -> None:
            due.setdefault(round(instant / tick), [instant, False, False])[which] = True

        for which, interval in ((1, frame), (2, save_interval)):
            for k in range(math.floor(experiment.duration / interval + 1e-6) + 1 if which == 2 or wanted else 0):
                add(min(k * interval, experiment.duration), which)
        add(experiment.duration, 2)
        return [(instant, frame_due, save_due) for _, (instant, frame_due, save_due) in sorted(due.items())]

    def keep(self, measured: Measurement, frame_due: bool, save_due: bool) -> None:
        """Keep what an instant shows."""
        solver, experiment = self._found.solver, self._experiment
        if save_due:
            account = solver.account()
            row = _row(measured) | {"emitted": account.emitted, "retired": account.retired}
            row |= _controlled(experiment, solver)
            if self._series.tell() == 0:
                self._writer.writerow(row)
            self._writer.writerow(row.values())
            self._series.flush()
            if self._particles:
                self._particles.write(solver.particles(), measured.time)
            if self._stage:
                self._stage.write()
        if frame_due:
            frame = self._look()
            if self._output.film != "none":
                self._frames.append(frame)
            if self._output.frames:
                write_png(self._output.folder / "frames" / f"frame_{self._pictures:04d}.png", frame)
            self._pictures += 1

    def finish(self) -> None:
        """Write the last picture and the film."""
        folder, files, film = self._output.folder, self._found.files, self._output.film
        files.append(folder / "last.png")
        write_png(files[-1], self._look())
        if self._frames:
            files.append(folder / f"film.{film}")
            write = write_gif if film == "gif" else write_mp4
            write(files[-1], self._frames, self._experiment.view.frames_per_second)
        if self._pictures and self._output.frames:
            files.append(folder / "frames")
        if self._particles:
            files.append(self._particles.collection)
        if self._stage:
            self._stage.close()
            files.append(self._stage.path)

    def _look(self) -> np.ndarray:
        view, solver = self._experiment.view, self._found.solver
        return picture(
            solver,
            colour=view.colour,
            value_range=view.value_range,
            title=self._experiment.title or None,
            time=float(solver.time[0]),
            size=view.size,
        )


def _row(measured: Measurement) -> dict[str, float]:
    """A measurement as one number a column."""
    row: dict[str, float] = {}
    for name, value in dataclasses.asdict(measured).items():
        if isinstance(value, np.ndarray):
            for index, component in np.ndenumerate(value):
                row[f"{name}_{''.join(AXES[axis] for axis in index)}"] = float(component)
        else:
            row[name] = value
    return row | {"energy": measured.energy}


def _controlled(experiment: Experiment, solver: Solver) -> dict[str, float]:
    """Where the moved parts are [m], and what gravity [m/s2] and the nozzles [m/s] are set to."""
    row: dict[str, float] = {}
    for target in dict.fromkeys(motion.target for motion in experiment.motions):
        kind, _, name = target.partition(".")
        if kind == "faces":
            row[target] = float(solver.face_position(name)[0])
        elif kind == "inflows":
            row[target] = float(solver.inflow_speed[0, solver.inflow_index(name)])
        else:
            vector = solver.gravity[0] if kind == "gravity" else solver.body_position(name)[0]
            row |= {f"{target}.{AXES[axis]}": float(value) for axis, value in enumerate(vector)}
    return row


def summary(found: Record) -> list[str]:
    """The table at the end of a run, a line each."""
    solver, measured = found.solver, found.measured
    if not measured:
        return ["  ended before the first measurement"]
    scene, start, end = solver.scene, measured[0], measured[-1]
    unit = "kg/m" if scene.dim == 2 else "kg"
    steps, solving = max(found.steps, 1), max(found.solving_s, 1e-9)
    work = found.steps * 0.5 * (start.particles + end.particles)
    account, m = solver.account(), scene.particle_mass
    worst = max(measured, key=lambda one: one.largest_density_error)
    rms = max(one.rms_density_error for one in measured)
    clamped = int(solver.state.clamped.numpy()[0])
    verdict = "good" if rms <= GOOD_DENSITY_ERROR else "fair" if rms <= FAIR_DENSITY_ERROR else "poor"
    advice = "" if verdict == "good" else "; a larger reference_speed makes the fluid stiffer"
    trust = f"{verdict}: weakly compressible flow keeps the rms density error below 1 %{advice}"
    rows = [
        ("simulated", f"{end.time:.4g} s in {found.steps} steps of up to {1e3 * solver.max_step:.3g} ms"),
        (
            "particles",
            f"{start.particles} at the start, {end.particles} at the end, {scene.particle_spacing:g} m apart",
        ),
        ("device", str(solver.device)),
        (
            "wall time",
            f"{found.solving_s:.1f} s stepping, {found.other_s:.1f} s measuring, drawing and writing,"
            f" {found.setup_s:.1f} s set-up",
        ),
        (
            "speed",
            f"{1e3 * solving / steps:.2f} ms a step, {1e-6 * work / solving:.2f} million particle-steps a second",
        ),
        (
            "mass",
            f"{m * account.started:.5g} {unit} at the start + {m * account.emitted:.5g} in"
            f" - {m * account.retired:.5g} out = {m * account.live:.5g} at the end",
        ),
        ("largest density error", f"{worst.largest_density_error:.2%} at {worst.time:.3g} s; rms at most {rms:.2%}"),
        ("stopped at a wall or body", f"{clamped} times by the safety net" if clamped else "never by the safety net"),
        ("trust", "none: it broke down" if found.broken_down else trust),
    ]
    if account.refused:
        rows.append(("nozzles waited", f"{account.refused} times, the reserve being used up; raise reserve"))
    width = max(len(name) for name, _ in rows)
    return [f"  {name:<{width}}  {value}" for name, value in rows]


def written(files: Sequence[Path]) -> list[str]:
    """What there is to look at, a line each."""
    return [f"  wrote {path}" for path in files]
