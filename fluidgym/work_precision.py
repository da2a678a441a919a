"""Run time against error: how much a second of computing buys, for each scheme, resolution and step size.

A curve is a scheme of ours or a peer (`fluidgym.peers`); a point of it is a case of the validation suite at one
resolution and one step size. Its error is the case's headline error; its time is the median, over the repeats, of the
time that the steps take on the clock, up to the instant where the case ends.

What counts: time stepping alone, and all of it: neighbours, walls, the launches and the Python between them. What does
not: making the solver, compiling, loading, and looking at the flow at the instants of the case, neither for us nor for
a peer. The runs of a resolution are made in turn, all curves once, then all again, so that a machine that slows down
slows all of them. On a CPU our kernels run in one thread, and so do peers.

Curves are compared at equal error, on their fronts (the points that no other point of the curve beats in both), between
which time follows error as a power law. Where the errors of two curves do not overlap there is nothing to compare, and
that is said instead.
"""

from __future__ import annotations

import math
import statistics
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fluidgym import peers
from fluidgym.files import replacing
from fluidgym.peers import Peer
from fluidgym.scene import Scene
from fluidgym.scene_file import load_scheme
from fluidgym.scheme import DEFAULT_SCHEME, FIDELITIES, MUELLER, Scheme
from fluidgym.sph.state_equation import TAIT
from fluidgym.sph.viscosity import VISCOSITY_MONAGHAN
from fluidgym.sph.wall_models import FrozenWalls, MirrorWalls
from fluidgym.validation import Case, Result, run
from fluidgym.validation.report import finite

Progress = Callable[[float], object]

# -- schemes by name -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class NamedScheme:
    """A scheme as the command line knows it.

    Attributes:
        title: One line for people.
        scheme: In place of a case's own; None leaves each case its own.
        stickiness: Least viscosity that the fluid must have for the scheme to hold together, over c_0 and the reach of
            the kernel; a scene with less is given that much.
    """

    title: str
    scheme: Scheme | None = None
    stickiness: float = 0.0


_ANCESTOR = replace(MUELLER, state_equation=TAIT)  # with the settings at the head of examples/ancestors.py
SCHEMES: dict[str, NamedScheme] = {
    "default": NamedScheme("each case's own: delta-SPH between mirror-image walls, with constants for the case"),
    "delta": NamedScheme("delta-SPH with the constants of Scheme(), whatever the case has", DEFAULT_SCHEME),
    **{name: NamedScheme(f"the scheme of fidelity {name!r}", scheme) for name, scheme in FIDELITIES.items()},
    "plain": NamedScheme("delta-SPH without its density diffusion", Scheme(density_diffusion=0.0)),
    "frozen": NamedScheme("delta-SPH between walls of frozen particles", Scheme(walls=FrozenWalls())),
    "monaghan": NamedScheme("delta-SPH with the viscosity of Monaghan", Scheme(viscosity=VISCOSITY_MONAGHAN)),
    "mueller": NamedScheme("Mueller et al. (2003), walls of springs", _ANCESTOR, 1.0 / 160.0),
    "mueller-mirror": NamedScheme(
        "Mueller et al. (2003), mirror-image walls", replace(_ANCESTOR, walls=MirrorWalls()), 1.0 / 160.0
    ),
}
USUAL = ("default", "mueller")  # what is compared unless schemes are named


def find_scheme(name: str) -> NamedScheme:
    """A scheme by its name, or of the [scheme] of a TOML file.

    Raises:
        ValueError: There is no scheme of that name, or the file cannot be read.
    """
    if name in SCHEMES:
        return SCHEMES[name]
    if name.endswith(".toml") or Path(name).is_file():
        return NamedScheme(f"the [scheme] of {name}", load_scheme(name))
    raise ValueError(f"unknown scheme {name}; known are {', '.join(SCHEMES)}, or a file such as mine.toml")


def adapted(case: Case, named: NamedScheme, courant: float = 1.0) -> Case:
    """A case under another scheme, its steps that much longer: what the scheme needs of the fluid, the scene has."""
    scheme = named.scheme or case.scheme
    assert scheme.courant is not None
    scheme = replace(scheme, courant=courant * scheme.courant) if courant != 1.0 else scheme

    def scene(resolution: int, dim: int) -> Scene:
        return _stuck(case.scene(resolution, dim), scheme, named.stickiness)

    parts = {name: adapted(part, named, courant) for name, part in case.parts.items()}
    return replace(case, scheme=scheme, scene=scene if named.stickiness else case.scene, parts=parts)


def _stuck(scene: Scene, scheme: Scheme, stickiness: float) -> Scene:
    """A scene whose fluid has at least the viscosity that a scheme needs."""
    reach = scheme.support(scene.particle_spacing, scene.dim)
    least = stickiness * scene.sound_speed * reach
    return replace(scene, material=replace(scene.material, viscosity=max(least, scene.material.viscosity)))


# -- points ----------------------------------------------------------------------------------------------------------


class Curve(Protocol):
    """What makes the points of one curve."""

    @property
    def name(self) -> str:
        """As on the command line."""
        ...

    def run(self, case: Case, resolution: int, dim: int, courant: float, progress: Progress) -> Result:
        """Run a case, its steps so many times as long as usual."""
        ...


@dataclass(frozen=True)
class SchemeCurve:
    """A scheme of ours on a device."""

    name: str
    named: NamedScheme
    device: str

    def run(self, case: Case, resolution: int, dim: int, courant: float, progress: Progress) -> Result:
        """Run a case."""
        return run(adapted(case, self.named, courant), resolution, dim, self.device, progress=progress)


@dataclass(frozen=True)
class PeerCurve:
    """A peer, run by an interpreter."""

    name: str
    peer: Peer
    interpreter: str

    def run(self, case: Case, resolution: int, dim: int, courant: float, progress: Progress) -> Result:
        """Run a case."""
        return peers.run(
            self.peer, case, resolution, dim, courant=courant, interpreter=self.interpreter, progress=progress
        )


def headline(case: Case) -> str:
    """Name of the error that stands for a case; '' where nothing says which, and the first is taken."""
    return case.headline or next((name for limits in case.goal.values() for name in limits), "")


@dataclass
class Point:
    """A case run by a curve, at a resolution and a step size, as often as it was.

    Attributes:
        case: Name of the case.
        dim: Number of dimensions.
        resolution: As the case counts it.
        curve: Name of the scheme or peer.
        courant: Length of the steps over the usual ones of the scheme.
        particles: Number of particles at the start.
        steps: Number of time steps.
        seconds: That they took, for each repeat [s].
        setup_s: Time to make the solver and compile, the longest of all repeats [s].
        headline: Name of the error that counts.
        errors: By name.
        refused: Why the scheme cannot run the case; '' where it can.
    """

    case: str
    dim: int
    resolution: int
    curve: str
    courant: float
    particles: int = 0
    steps: int = 0
    seconds: list[float] = field(default_factory=list)
    setup_s: float = 0.0
    headline: str = ""
    errors: dict[str, float] = field(default_factory=dict)
    refused: str = ""

    @property
    def wall_s(self) -> float:
        """Median time of the steps [s]; nan before the first run."""
        return statistics.median(self.seconds) if self.seconds else math.nan

    @property
    def spread(self) -> float:
        """The slowest repeat over the fastest."""
        return max(self.seconds) / min(self.seconds) if self.seconds else math.nan

    @property
    def error(self) -> float:
        """Size of the headline error; nan is a run that broke down, or none."""
        return abs(self.errors.get(self.headline, math.nan))

    @property
    def broke_down(self) -> bool:
        """Whether it ran, and what came out is no number."""
        return bool(self.seconds) and not math.isfinite(self.error)

    @property
    def place(self) -> tuple[float, float]:
        """Time [s] and error."""
        return self.wall_s, self.error

    def add(self, result: Result) -> None:
        """Count another repeat."""
        self.particles, self.steps, self.errors = result.particles, result.steps, dict(result.errors)
        self.headline = self.headline or next(iter(result.errors), "")
        self.seconds.append(result.wall_s)
        self.setup_s = max(self.setup_s, result.setup_s)

    def as_json(self, on_front: bool) -> dict[str, Any]:
        """Plain values; a number that is not finite is None."""
        names = ("case", "dim", "resolution", "curve", "courant", "particles", "steps", "headline")
        found: dict[str, Any] = {name: getattr(self, name) for name in names}
        found |= {"seconds": self.seconds, "wall_s": self.wall_s, "setup_s": self.setup_s, "error": self.error}
        found |= {"errors": self.errors, "on_front": on_front, "broke_down": self.broke_down, "refused": self.refused}
        return finite(found)

    def line(self) -> str:
        """One row under TABLE_HEAD."""
        where = f"{self.case} {self.dim}D", f"1/{self.resolution}", self.curve, f"{self.courant:g}"
        if self.refused:
            return f"{_COLUMNS.format(*where, *('',) * 6).rstrip()}  cannot run: {self.refused}"
        told = "broke down" if self.broke_down else f"{self.error:.3g}"
        return _COLUMNS.format(
            *where,
            self.particles,
            self.steps or "",
            f"{self.wall_s:.2f} s",
            f"{self.spread:.2f}",
            f"{self.setup_s:.1f} s",
            f"{self.headline:<16}{told:>10}",
        ).rstrip()


_COLUMNS = "{:<25}{:>6}  {:<16}{:>7}{:>11}{:>8}{:>11}{:>8}{:>9}   {}"
TABLE_HEAD = _COLUMNS.format(
    "case", "dx", "scheme", "step", "particles", "steps", "time", "spread", "set-up", f"{'error':<16}{'value':>10}"
)


class Comparison:
    """Cases run by all curves, step sizes and repeats in turn, one resolution after another.

    Attributes:
        plan: Case, resolution and dimension of each; those of a case stand together.
        curves: What runs them; the others are compared with the first.
        courants: Lengths of the steps over the usual ones of each curve.
        repeats: How often each is run.
        points: All that was run so far, and what was refused.
    """

    def __init__(
        self,
        plan: Sequence[tuple[Case, int, int]],
        curves: Sequence[Curve],
        courants: Sequence[float] = (1.0,),
        repeats: int = 1,
    ):
        self.plan, self.curves, self.courants, self.repeats = plan, curves, courants, repeats
        self.points: list[Point] = []
        self._told = 0  # points that a row was given out for
        self._summed = 0  # points that were compared
        self._refused: set[tuple[str, int, str, str]] = set()

    def run(self, progress: Callable[[str, float], Progress]) -> Iterator[list[str]]:
        """Run all of it.

        Args:
            progress: (what is run, its duration [s]) -> what is called with every further piece of simulated time.

        Yields:
            What there is to tell after each run: rows under TABLE_HEAD for every resolution that is finished, and how
            the curves compare for every case; mostly nothing. A run that is cut short is told by `rest`.
        """
        for index, (case, resolution, dim) in enumerate(self.plan):
            yield from self._run_resolution(case, resolution, dim, progress)
            yield self._rows()
            following = self.plan[index + 1] if index + 1 < len(self.plan) else (None, 0, 0)
            if (following[0], following[2]) != (case, dim):
                yield self._sums()

    def rest(self) -> list[str]:
        """What is there and was not told yet."""
        return self._rows() + (self._sums() if self._summed < len(self.points) else [])

    def _run_resolution(
        self, case: Case, resolution: int, dim: int, progress: Callable[[str, float], Progress]
    ) -> Iterator[list[str]]:
        points: dict[tuple[str, float], Point] = {}
        for repeat, curve, courant in product(range(self.repeats), self.curves, self.courants):
            point = points.get((curve.name, courant)) or Point(
                case.name, dim, resolution, curve.name, courant, headline=headline(case)
            )
            if point.refused or point.broke_down:  # it would be again
                continue
            label = f"{point.case} {dim}D 1/{resolution} {point.curve}, {repeat + 1} of {self.repeats}"
            try:
                point.add(curve.run(case, resolution, dim, courant, progress(label, case.end)))
            except np.linalg.LinAlgError:  # a fit to what is no number
                point.seconds.append(math.nan)
            except ValueError as error:
                point.refused = str(error)
            if not repeat:
                points[curve.name, courant] = point
                self.points.append(point)
            yield []

    def _rows(self) -> list[str]:
        new, self._told = self.points[self._told :], len(self.points)
        lines = []
        for point in new:
            reason = (point.case, point.dim, point.curve, point.refused)
            if not point.refused or reason not in self._refused:  # once is enough
                lines.append(point.line())
            self._refused.add(reason)
        return lines

    def _sums(self) -> list[str]:
        new, self._summed = self.points[self._summed :], len(self.points)
        lines = [f"  {case} {dim}D: {front_line(there)}" for (case, dim), there in by_case(new).items()]
        lines += [f"  {row['case']} {row['dim']}D: {row['said']}" for row in summarise(new)]
        return [*dict.fromkeys(lines), ""]


# -- comparing -------------------------------------------------------------------------------------------------------


def pareto(places: Sequence[tuple[float, float]]) -> list[bool]:
    """Which of some times and errors no other beats in one of the two without being worse in the other.

    What is not finite beats nothing and is never on the front.
    """

    def beaten(place: tuple[float, float], other: tuple[float, float]) -> bool:
        return other[0] <= place[0] and other[1] <= place[1] and other != place

    sound = [all(map(math.isfinite, place)) for place in places]
    return [
        good and not any(fine and beaten(place, other) for other, fine in zip(places, sound, strict=True))
        for place, good in zip(places, sound, strict=True)
    ]


def front(places: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points on the front that have a logarithm, the fastest first."""
    drawn = [place for place in places if min(place) > 0.0]
    return sorted({place for place, kept in zip(drawn, pareto(drawn), strict=True) if kept})


def time_at(curve: Sequence[tuple[float, float]], error: float) -> float:
    """Time at which a front has an error: a power law between its points; nan beyond its ends."""
    times, errors = np.log(np.array(curve, float).T)
    found = np.interp(math.log(error), errors[::-1], times[::-1], left=math.nan, right=math.nan)
    return float(np.exp(found))


def ratios(ours: Sequence[tuple[float, float]], theirs: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """How many times as long they take as we do, at equal error.

    Args:
        ours: Time and error of our points.
        theirs: Time and error of theirs.

    Returns:
        Error and ratio: at the errors of their front that ours has too or, where there is none, at the errors of our
        front that theirs has; empty where the two do not overlap.
    """
    one, other = front(ours), front(theirs)
    if not one or not other:
        return []
    found = []
    for points in (other, one):
        pairs = [(error, time_at(other, error) / time_at(one, error)) for _, error in points]
        found = [(error, ratio) for error, ratio in pairs if math.isfinite(ratio)]
        if found:
            break
    return found


def compare(name: str, ours: Sequence[Point], other: str, theirs: Sequence[Point]) -> dict[str, Any]:
    """One curve against another on a case: the ratios of `ratios`, and a line that says what they come to."""
    here, there = [point.place for point in ours], [point.place for point in theirs]
    found = ratios(here, there)
    one, another = front(here), front(there)
    if found:
        low, high = min(ratio for _, ratio in found), max(ratio for _, ratio in found)
        fast, slow = (name, other) if high >= 1.0 else (other, name)
        spans = (low, high) if high >= 1.0 else (1.0 / high, 1.0 / low)
        times = " to ".join(dict.fromkeys(map(_about, spans)))
        at = " to ".join(dict.fromkeys(f"{error:.2g}" for error, _ in (found[0], found[-1])))
        said = f"{fast} is {times} times as fast as {slow} at an equal error of {at}"
    elif not one or not another:
        lacking, mine = (other, theirs) if not another else (name, ours)
        said = f"{lacking} {'cannot run it' if all(point.refused for point in mine) else 'broke down'}"
    elif another[-1][1] > one[0][1]:
        said = _never(other, another, name, one)
    else:
        said = _never(name, one, other, another)
    return {"curve": name, "against": other, "ratios": [list(pair) for pair in found], "said": said}


def _about(value: float) -> str:
    """Two digits of a number, and no powers of ten."""
    return f"{float(f'{value:.2g}'):.15g}"


def _never(worse: str, their: Sequence[tuple[float, float]], better: str, front: Sequence[tuple[float, float]]) -> str:
    """What is to say where all of one front is worse than all of another: its best against the other's fastest."""
    (slow, large), (fast, small) = their[-1], front[0]
    told = f"its best is {large:.2g} in {slow:.2g} s, {better} has {small:.2g} in {fast:.2g} s"
    ahead = f", at least {_about(slow / fast)} times as fast" if slow > 1.05 * fast else ""
    return f"{worse} never reaches the errors of {better}: {told}{ahead}"


def summarise(points: Sequence[Point]) -> list[dict[str, Any]]:
    """The first curve against each other one, case by case."""
    found = []
    for (case, dim), there in by_case(points).items():
        curves = by_curve(there)
        first, *others = curves
        found += [{"case": case, "dim": dim} | compare(first, curves[first], other, curves[other]) for other in others]
    return found


def by_case(points: Sequence[Point]) -> dict[tuple[str, int], list[Point]]:
    """Points of each case and dimension."""
    found: dict[tuple[str, int], list[Point]] = {}
    for point in points:
        found.setdefault((point.case, point.dim), []).append(point)
    return found


def by_curve(points: Sequence[Point]) -> dict[str, list[Point]]:
    """Points of each curve."""
    found: dict[str, list[Point]] = {}
    for point in points:
        found.setdefault(point.curve, []).append(point)
    return found


def front_line(points: Sequence[Point]) -> str:
    """The points of one case that no other beats, the fastest first, in a line."""
    best = [point for point, kept in zip(points, pareto([p.place for p in points]), strict=True) if kept]
    told = [
        f"{point.curve} 1/{point.resolution}{f' step {point.courant:g}' if point.courant != 1.0 else ''}"
        f" ({point.error:.2g} in {point.wall_s:.2g} s)"
        for point in sorted(best, key=lambda point: point.wall_s)
    ]
    return "no other beats in both: " + (", ".join(told) or "nothing")


def objects(facts: Mapping[str, Any], points: Sequence[Point]) -> list[dict[str, Any]]:
    """What a JSON file of a comparison has: the machine, the points, and how the curves compare."""
    rows = []
    for there in by_case(points).values():
        fronts = pareto([point.place for point in there])
        rows += [point.as_json(kept) for point, kept in zip(there, fronts, strict=True)]
    return [dict(facts), *rows, {"summary": summarise(points)}]


# -- drawing ---------------------------------------------------------------------------------------------------------

PLOTS = (".png", ".pdf", ".svg")
COLOURS = ("#0b5394", "#d1495b", "#2e8b57", "#e08e0b", "#7b4fa3", "#3b9fb0", "#8c564b", "#6b7280")
_MARKERS = "os^Dv<>P"


def check_plot(path: Path) -> None:
    """Refuse a plot that could not be drawn, before anything is run.

    Raises:
        ValueError: The library is missing, or the file's name does not say what it is.
    """
    if find_spec("matplotlib") is None:
        raise ValueError("--plot needs matplotlib; pip install 'fluidgym-sph[plot]'")
    if path.suffix.lower() not in PLOTS:
        raise ValueError(f"--plot {path}: a plot is a {', '.join(PLOTS)} file; name one")


def draw(points: Sequence[Point], caption: str, path: Path) -> None:
    """Draw error against run time, a panel for each case, a line for each curve and step size; needs matplotlib.

    Args:
        points: The points.
        caption: What stands below.
        path: The file.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    cases = by_case(points)
    columns = math.ceil(math.sqrt(len(cases)))
    rows = math.ceil(len(cases) / columns)
    curves = list(by_curve(points))
    courants = sorted({point.courant for point in points}, reverse=True)
    figure = Figure(figsize=(max(6.4, 5.2 * columns), 4.2 * rows + 0.9), dpi=120, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(cases) :]:
        panel.set_visible(False)
    handles: dict[str, Any] = {}
    for panel, ((case, dim), there) in zip(panels, cases.items(), strict=False):
        broken = [name for name, mine in by_curve(there).items() if any(point.broke_down for point in mine)]
        for curve, courant in product(curves, courants):
            mine = [p for p in there if (p.curve, p.courant) == (curve, courant) and min(p.place) > 0.0]
            mine = sorted((p for p in mine if math.isfinite(p.error)), key=lambda p: p.resolution)
            if not mine:
                continue
            label = curve if len(courants) == 1 else f"{curve}, step {courant:g}"
            (handles[label],) = panel.plot(
                [p.wall_s for p in mine],
                [p.error for p in mine],
                color=COLOURS[curves.index(curve) % len(COLOURS)],
                marker=_MARKERS[courants.index(courant) % len(_MARKERS)],
                linestyle="-" if courant == courants[0] else "--",
                linewidth=2.2 if curve == curves[0] else 1.5,
                markersize=6.0,
                label=label,
                zorder=3.0 if curve == curves[0] else 2.0,
            )
            for p in mine if courant == courants[0] else ():
                panel.annotate(
                    f"1/{p.resolution}",
                    p.place,
                    textcoords="offset points",
                    xytext=(5, 4),
                    fontsize=7,
                    color=handles[label].get_color(),
                )
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.grid(True, which="major", color="#d5d9de", linewidth=0.8)
        panel.grid(True, which="minor", color="#eceff2", linewidth=0.5)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_locator(LogLocator(subs=range(2, 10)))
            axis.set_minor_formatter(NullFormatter())
        name = next((p.headline for p in there if p.headline), "")
        panel.set_title(f"{case}, {dim}D", fontsize=11)
        panel.set_xlabel("run time [s]")
        panel.set_ylabel(f"error: {name}")
        panel.margins(0.12)
        if broken:
            panel.text(0.02, 0.02, f"broke down: {', '.join(broken)}", transform=panel.transAxes, fontsize=8)
    if handles:
        figure.legend(
            handles.values(), handles.keys(), loc="outside upper center", ncols=min(4, len(handles)), frameon=False
        )
    width = round(14.0 * figure.get_figwidth())
    figure.supxlabel("\n".join(textwrap.wrap(caption, width)), fontsize=8, color="#4b5563")
    with replacing(path) as unfinished:
        figure.savefig(unfinished)
