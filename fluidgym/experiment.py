"""What is done with a scene: for how long, what moves meanwhile, and what is drawn of it. Frozen, checked, NumPy only.

A motion says how one control changes with time: gravity, a moving face of the box, a moving body, a nozzle. `drive`
takes a solver through them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from numbers import Real
from typing import Literal

import numpy as np

from fluidgym.checks import Point, check_choice, check_number, check_range, check_type, point, shown
from fluidgym.scene import AXES, LEAST_MACH_MARGIN, Scene, face_names
from fluidgym.scheme import DEFAULT_SCHEME, Scheme
from fluidgym.solver import Solver

COLOURS = ("speed", "pressure", "density", "temperature")

# Pieces of constant acceleration in a period: the sum of trapezoids is then 0.03 % off a sine's integral.
PIECES_PER_PERIOD = 100

# Pieces in which a control that the solver holds meanwhile goes from one value to the next.
HELD_PIECES = 20

# A control is not changed more often than this in one experiment.
MOST_PIECES = 1_000_000


@dataclass(frozen=True)
class View:
    """What is drawn of an experiment.

    Attributes:
        colour: By what: "speed", "pressure", "density" or "temperature".
        value_range: Values at the two ends of the colour bar, in SI units; None takes one that suits the scene.
        frames_per_second: Of the film [1/s], 1 to 50.
        slow_motion: How many times slower than nature the film plays.
        size: Width and height of a picture [px].

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    colour: Literal["speed", "pressure", "density", "temperature"] = "speed"
    value_range: tuple[float, float] | None = None
    frames_per_second: float = 25.0
    slow_motion: float = 1.0
    size: tuple[int, int] = (640, 400)

    def __post_init__(self) -> None:
        check_choice("View.colour", self.colour, COLOURS, " or ".join(map(repr, COLOURS)))
        if self.value_range is not None:
            ends = point("View.value_range", self.value_range, "SI unit", "give (lowest, highest)")
            object.__setattr__(self, "value_range", ends)
            if len(ends) != 2 or not ends[0] < ends[1]:
                raise ValueError(f"View.value_range = {ends} must rise; give (lowest, highest)")
        check_range("View.frames_per_second", self.frames_per_second, 1.0, 50.0, "25")
        check_number("View.slow_motion", self.slow_motion, "times", above=0.0)
        check_type("View.size", self.size, Sequence, "a pair of numbers", "(640, 400)")
        size = tuple(self.size)
        object.__setattr__(self, "size", size)
        if len(size) != 2 or not all(isinstance(side, int) and 64 <= side <= 4096 for side in size):
            raise ValueError(f"View.size = {size} px is not a width and a height of 64 to 4096; use (640, 400)")

    @property
    def frame_interval(self) -> float:
        """Simulated time from frame to frame [s]."""
        return 1.0 / (self.frames_per_second * self.slow_motion)


@dataclass(frozen=True)
class Sine:
    """A control swings about its value in the scene, which is 0 for faces and bodies.

    It is that value + amplitude sin(2 pi t / period + phase). Several sines on one control add up.

    Attributes:
        target: "gravity", "faces.x_min", "bodies.NAME" or "inflows.NAME".
        amplitude: In the unit of the control: [m/s2] for gravity, [m/s] for the others; [m] of a displacement.
        period: [s].
        phase: At the start [rad].
        ramp: Time over which the amplitude grows from 0 to its full size [s].
        axis: "x", "y" or "z": along which gravity or a body swings.
        displacement: Whether it is the place of a face or body that swings, and not its velocity.

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    target: str
    amplitude: float
    period: float
    phase: float = 0.0
    ramp: float = 0.0
    axis: str | None = None
    displacement: bool = False

    def __post_init__(self) -> None:
        _check_common(self)
        check_number("Sine.amplitude", self.amplitude, "SI unit")
        check_number("Sine.period", self.period, "s", above=0.0)
        check_number("Sine.phase", self.phase, "rad")
        check_number("Sine.ramp", self.ramp, "s", least=0.0)

    @property
    def longest_piece(self) -> float:
        """Longest time of constant acceleration that still follows it [s]."""
        return self.period / PIECES_PER_PERIOD

    def knots(self) -> np.ndarray:
        """Instants at which it bends [s], (n,)."""
        return np.empty(0)

    def control(self, t: np.ndarray, base: np.ndarray) -> np.ndarray:
        """The control at times [s] (n,), given what it is without this motion (n,)."""
        angular = 2.0 * math.pi / self.period
        sine, cosine = np.sin(angular * t + self.phase), np.cos(angular * t + self.phase)
        # The amplitude grows as a squared sine, so that a displacement has no jump of velocity.
        quarter = np.clip(t / self.ramp, 0.0, 1.0) * (0.5 * math.pi) if self.ramp else np.full_like(t, 0.5 * math.pi)
        grown = np.sin(quarter) ** 2
        if not self.displacement:
            return base + self.amplitude * grown * sine
        growing = 0.5 * math.pi / self.ramp * np.sin(2.0 * quarter) if self.ramp else 0.0
        return base + self.amplitude * (angular * grown * cosine + growing * sine)


@dataclass(frozen=True)
class Keyframes:
    """A control goes through given values at given times: along a straight line in between, constant before and after.

    Attributes:
        target: "gravity", "faces.x_min", "bodies.NAME" or "inflows.NAME".
        times: When [s], rising, (n,).
        values: In the unit of the control: [m/s2] for gravity, [m/s] for the others; [m] of a displacement. Numbers
            (n,), or for gravity and bodies vectors (n, dim).
        axis: "x", "y" or "z": the component of gravity or of a body's velocity that numbers give.
        displacement: Whether the values are how far a face or body is from its start, not its velocity. It moves at a
            constant velocity in between.

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    target: str
    times: tuple[float, ...]
    values: tuple[float, ...] | tuple[Point, ...]
    axis: str | None = None
    displacement: bool = False

    def __post_init__(self) -> None:
        _check_common(self)
        _check_table(self, least=2)
        if self.displacement and np.any(self.values[0]):
            raise ValueError(
                f"Keyframes.values[0] = {self.values[0]} m: a displacement counts from the start; begin with 0"
            )

    @property
    def longest_piece(self) -> float:
        """Longest time of constant acceleration that still follows it [s]."""
        return math.inf

    def knots(self) -> np.ndarray:
        """Instants at which it bends [s], (n,)."""
        times = np.asarray(self.times)
        if not self.displacement:
            return _knots(self.target, times)
        # At each it takes on the next velocity, within a hundredth of the shortest stretch.
        return np.sort(np.concatenate([times, times + 0.01 * np.diff(times).min()]))

    def control(self, t: np.ndarray, base: np.ndarray) -> np.ndarray:
        """The control at times [s] (n,) or, for vectors, (n, dim), given what it is without this motion."""
        times, values = np.asarray(self.times), np.asarray(self.values, float)
        if not self.displacement:
            return _interpolate(t, times, values)
        slopes = np.diff(values, axis=0) / np.diff(times).reshape((-1,) + (1,) * (values.ndim - 1))
        slopes = np.concatenate([0.0 * slopes[:1], slopes, 0.0 * slopes[:1]])
        return slopes[np.searchsorted(times, t - 1e-9)]  # at a knot it is the slope before it


@dataclass(frozen=True)
class Steps:
    """A control is set to given values at given times; before the first it has its value in the scene.

    Attributes:
        target: "gravity", "faces.x_min", "bodies.NAME" or "inflows.NAME".
        times: When [s], rising, (n,).
        values: In the unit of the control: [m/s2] for gravity, [m/s] for the others. Numbers (n,), or for gravity and
            bodies vectors (n, dim).
        rise: Time that it takes to a new value [s], shorter than the time between two.
        axis: "x", "y" or "z": the component of gravity or of a body's velocity that numbers give.

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    target: str
    times: tuple[float, ...]
    values: tuple[float, ...] | tuple[Point, ...]
    rise: float = 0.01
    axis: str | None = None

    def __post_init__(self) -> None:
        _check_common(self)
        _check_table(self, least=1)
        check_number("Steps.rise", self.rise, "s", above=0.0)
        shortest = min(np.diff(self.times), default=math.inf)
        if self.rise > shortest * (1.0 + 1e-9):
            raise ValueError(
                f"Steps.rise = {self.rise:g} s exceeds the time between two steps, {shortest:g} s; use a shorter one"
            )

    @property
    def displacement(self) -> bool:
        """Whether the values are displacements: never."""
        return False

    @property
    def longest_piece(self) -> float:
        """Longest time of constant acceleration that still follows it [s]."""
        return math.inf

    def knots(self) -> np.ndarray:
        """Instants at which it bends [s], (n,)."""
        times = np.asarray(self.times)
        return _knots(self.target, np.stack([times, times + self.rise], axis=1).ravel())

    def control(self, t: np.ndarray, base: np.ndarray) -> np.ndarray:
        """The control at times [s] (n,) or, for vectors, (n, dim), given what it is without this motion."""
        times, values = np.asarray(self.times), np.asarray(self.values, float)
        before = np.concatenate([base[:1], values[:-1]])
        corners = np.stack([before, values], axis=1).reshape((-1, *values.shape[1:]))
        return _interpolate(t, np.stack([times, times + self.rise], axis=1).ravel(), corners)


Motion = Sine | Keyframes | Steps


def _check_common(motion: Motion) -> None:
    """Refuse a target or an axis that no scene has, and a displacement of what has no place."""
    kind = type(motion).__name__
    check_type(f"{kind}.target", motion.target, str, "a string", "'gravity', 'faces.x_max', 'bodies.NAME' or the like")
    if motion.axis is not None:
        check_choice(f"{kind}.axis", motion.axis, tuple(AXES), "'x', 'y' or 'z'")
    check_type(f"{kind}.displacement", motion.displacement, bool, "a bool", "True or False")
    if motion.displacement and not motion.target.startswith(("faces.", "bodies.")):
        raise ValueError(
            f"{kind}.displacement is of no effect on {motion.target!r}, which has no place; leave it out, or move a"
            " face or a body"
        )


def _check_table(motion: Keyframes | Steps, least: int) -> None:
    """Check times and values, and make them tuples."""
    kind, set_ = type(motion).__name__, object.__setattr__
    times = point(f"{kind}.times", motion.times, "s", "give one for each value")
    set_(motion, "times", times)
    check_type(f"{kind}.values", motion.values, Sequence, "a list", "one value for each time")
    if len(times) < least or len(times) != len(motion.values):
        raise ValueError(
            f"{kind} has {len(times)} times and {len(motion.values)} values; give as many of both, {least} or more"
        )
    falls = np.flatnonzero(np.diff(times) <= 0.0)
    if times[0] < 0.0 or len(falls):
        wrong = times[falls[0] + 1] if len(falls) else times[0]
        raise ValueError(f"{kind}.times = {wrong:g} s comes after a later time or before 0; give times that rise")
    if all(isinstance(value, Real) for value in motion.values):
        values = point(f"{kind}.values", motion.values, "SI unit", "give numbers")
    else:
        values = tuple(
            point(f"{kind}.values[{index}]", value, "SI unit", "give only numbers or only vectors")
            for index, value in enumerate(motion.values)
        )
        if len(set(map(len, values))) != 1:
            raise ValueError(f"{kind}.values has vectors of different lengths; give one component for each axis")
        if motion.axis is not None:
            raise ValueError(f"{kind}.axis = {motion.axis!r} is of no effect on vectors; leave it out, or give numbers")
    set_(motion, "values", values)


def _vector_size(motion: Motion) -> int:
    """Number of components of the vectors that a motion has as its values; 0 for numbers."""
    return 0 if isinstance(motion, Sine) or np.ndim(motion.values) == 1 else np.shape(motion.values)[1]


def _is_held(target: str) -> bool:
    """Whether the solver keeps a control constant through a call; others change evenly."""
    return not target.startswith(("faces.", "bodies."))


def _knots(target: str, times: np.ndarray) -> np.ndarray:
    """Where a control is to be set anew: where it bends, and between for one that is held."""
    if not _is_held(target):
        return times
    lines = [np.linspace(a, b, HELD_PIECES, endpoint=False) for a, b in pairwise(times)]
    return np.concatenate([*lines, times[-1:]])


def _interpolate(t: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Straight lines through values (n,) or (n, dim) at times (n,), constant beyond."""
    if values.ndim == 1:
        return np.interp(t, times, values)
    return np.stack([np.interp(t, times, component) for component in values.T], axis=1)


@dataclass(frozen=True)
class Experiment:
    """A scene, and what is done with it.

    Attributes:
        scene: What is simulated.
        duration: Simulated time [s].
        scheme: How it is simulated.
        motions: What changes meanwhile.
        title: Over its pictures.
        view: What is drawn.

    Raises:
        ValueError: A field is of a wrong type, out of its limits, or a motion does not fit the scene.
    """

    scene: Scene
    duration: float
    scheme: Scheme = DEFAULT_SCHEME
    motions: Sequence[Motion] = ()
    title: str = ""
    view: View = field(default_factory=View)

    def __post_init__(self) -> None:
        check_type("Experiment.scene", self.scene, Scene, "a Scene", "Scene(...)")
        check_number("Experiment.duration", self.duration, "s", above=0.0)
        check_type("Experiment.scheme", self.scheme, Scheme, "a Scheme", "Scheme(...)")
        check_type("Experiment.motions", self.motions, Sequence, "a list", "[Sine(...)]")
        object.__setattr__(self, "motions", tuple(self.motions))
        check_type("Experiment.title", self.title, str, "a string", "a few words")
        if len(self.title.splitlines()) > 1:
            raise ValueError("Experiment.title has several lines; use one")
        check_type("Experiment.view", self.view, View, "a View", "View(...)")
        if self.view.colour == "temperature" and not self.scene.material.thermal_diffusivity:
            raise ValueError(
                "View.colour = 'temperature' is the same everywhere where nothing conducts heat; set"
                " Material.thermal_diffusivity, or use 'speed'"
            )
        for index, motion in enumerate(self.motions):
            check_type(f"Experiment.motions[{index}]", motion, Motion, "a motion", "Sine, Keyframes or Steps")
            self._check_motion(f"Experiment.motions[{index}]", motion)
        self._check_together()
        self._check_controls()

    # -- what the motions amount to --------------------------------------------------------------------------------

    def instants(self, begin: float, end: float) -> np.ndarray:
        """Times [s] from begin to end, both included, at which controls are set anew (n,)."""
        slack = 1e-9 * max(1.0, abs(end))
        inner = np.concatenate([np.empty(0), *(motion.knots() for motion in self.motions)])
        inner = inner[(inner > begin + slack) & (inner < end - slack)]
        corners = np.concatenate([[begin], np.unique(inner), [end]])
        corners = corners[np.append(True, np.diff(corners) > slack)]
        longest = min((motion.longest_piece for motion in self.motions), default=math.inf)
        gaps = np.diff(corners)
        counts = np.maximum(1, np.ceil(gaps / longest - 1e-9)) if math.isfinite(longest) else np.ones(len(gaps))
        if counts.sum() > MOST_PIECES:
            raise ValueError(
                f"Experiment.motions have a period of {PIECES_PER_PERIOD * longest:g} s, which asks for"
                f" {counts.sum():.2g} changes of a control, limit {MOST_PIECES}; use a longer period"
            )
        parts = [
            np.linspace(a, b, int(n), endpoint=False) for a, b, n in zip(corners, corners[1:], counts, strict=False)
        ]
        return np.concatenate([*parts, [end]])

    def controls(self, instants: np.ndarray) -> dict[str, np.ndarray]:
        """What each target is set to between instants [s] (n + 1,): (n,), or (n, dim) for gravity and bodies.

        Gravity and nozzles are held meanwhile: theirs is that of the middle. Faces and bodies get there at the end.
        """
        found = {}
        for target in dict.fromkeys(motion.target for motion in self.motions):
            t = 0.5 * (instants[:-1] + instants[1:]) if _is_held(target) else instants[1:]
            value = np.tile(self._base(target), (len(t), 1))
            # Sines are added to what the others set.
            for motion in sorted(self._motions_of(target), key=lambda motion: isinstance(motion, Sine)):
                columns = self._components(motion)
                if _vector_size(motion):
                    value = motion.control(t, value)
                else:
                    value[:, columns[0]] = motion.control(t, value[:, columns[0]])
            found[target] = value if self._is_vector(target) else value[:, 0]
        return found

    def _motions_of(self, target: str) -> list[Motion]:
        return [motion for motion in self.motions if motion.target == target]

    def _is_vector(self, target: str) -> bool:
        return target == "gravity" or target.startswith("bodies.")

    def _base(self, target: str) -> np.ndarray:
        """What a target is without any motion, (component,)."""
        kind, _, name = target.partition(".")
        if kind == "inflows":
            return np.array([self.scene.inflows[name].speed])
        return {"gravity": self.scene.gravity_vector, "bodies": np.zeros(self.scene.dim)}.get(kind, np.zeros(1))

    def _components(self, motion: Motion) -> list[int]:
        """Numbers of the components that a motion sets."""
        if motion.axis is not None:
            return [AXES.index(motion.axis)]
        return list(range(self.scene.dim)) if self._is_vector(motion.target) else [0]

    # -- checks ------------------------------------------------------------------------------------------------------

    def targets(self) -> tuple[str, ...]:
        """What motions of this scene can have as their target."""
        scene = self.scene
        faces = [f"faces.{name}" for name, face in scene.faces.items() if face.moving]
        bodies = [f"bodies.{name}" for name, body in scene.bodies.items() if body.moving]
        return ("gravity", *faces, *bodies, *(f"inflows.{name}" for name in scene.inflows))

    def _check_motion(self, label: str, motion: Motion) -> None:
        """Refuse a motion that the scene has nothing for."""
        scene, target = self.scene, motion.target
        if target not in self.targets():
            kind, _, name = target.partition(".")
            known = {"faces": face_names(scene.dim), "bodies": scene.bodies}.get(kind, ())
            if name in known:
                raise ValueError(f"{label}.target = {target!r} does not move; set moving=True on it in the scene")
            raise ValueError(f"{label}.target = {target!r} is unknown; use {', '.join(self.targets())}")
        components = _vector_size(motion)
        if self._is_vector(target):
            if motion.axis is None and not components:
                vector = ", or vectors as values" if isinstance(motion, Keyframes | Steps) else ""
                raise ValueError(f"{label}.axis is missing for {target!r}; give 'x' or the like{vector}")
            if motion.axis is not None and motion.axis not in AXES[: scene.dim]:
                raise ValueError(f"{label}.axis = {motion.axis!r} is none of a 2D scene's; use 'x' or 'y'")
            if components not in (0, scene.dim):
                raise ValueError(f"{label}.values have {components} components; give {scene.dim}")
        elif components or motion.axis is not None:
            raise ValueError(
                f"{label} has an axis or vectors, but {target!r} is one number; leave it out, give numbers"
            )

    def _check_together(self) -> None:
        """Refuse two motions that would set the same component."""
        taken: dict[tuple[str, int], int] = {}
        for index, motion in enumerate(self.motions):
            for component in () if isinstance(motion, Sine) else self._components(motion):
                other = taken.setdefault((motion.target, component), index)
                if other != index:
                    raise ValueError(
                        f"Experiment.motions[{index}] sets {motion.target!r} as Experiment.motions[{other}] does;"
                        " put them into one"
                    )

    def _check_controls(self) -> None:
        """Refuse motions that the solver could not follow, or not to where they should go."""
        if not self.motions:
            return
        instants = self.instants(0.0, self.duration)
        for target, values in self.controls(instants).items():
            kind, _, name = target.partition(".")
            if not np.isfinite(values).all():
                raise ValueError(f"Experiment.motions of {target!r} are not finite; use smaller numbers")
            if kind == "inflows":
                most = self.scene.inflows[name].top_speed
                worst = min(float(values.min()), 0.0) or max(float(values.max()), most)
                if not 0.0 <= worst <= most * (1.0 + 1e-9):
                    raise ValueError(
                        f"Experiment.motions set {target!r} to {worst:g} m/s, outside 0 to its largest speed {most:g}"
                        " m/s; set Inflow.max_speed, or a smaller motion"
                    )
            elif kind in ("faces", "bodies"):
                self._check_speed(target, float(np.abs(values).max()))
                self._check_travel(target, instants, values)

    def _check_speed(self, target: str, fastest: float) -> None:
        limit = self.scene.sound_speed / LEAST_MACH_MARGIN
        if fastest > limit * (1.0 + 1e-9):
            raise ValueError(
                f"Experiment.motions move {target!r} at up to {fastest:.3g} m/s, limit {limit:.3g} m/s (the scene's"
                f" speed of sound over {LEAST_MACH_MARGIN:g}); use a slower motion or a larger Scene.reference_speed"
            )

    def _check_travel(self, target: str, instants: np.ndarray, velocity: np.ndarray) -> None:
        """Refuse a displacement that runs into the end of a travel; a velocity may, and is stopped there."""
        if not all(motion.displacement for motion in self._motions_of(target)):
            return
        kind, _, name = target.partition(".")
        if kind == "faces":
            index = face_names(self.scene.dim).index(name)
            start = self.scene.face_start_positions()[index]
            low, high = (self.scene.face_travel()[index] - start)[:, None]
        else:
            travel = self.scene.bodies[name].travel
            if travel is None:
                return
            low, high = np.asarray(travel)
        gaps = np.diff(instants)
        before = np.concatenate([np.zeros_like(velocity[:1]), velocity[:-1]])
        steps = 0.5 * (before + velocity) * (gaps if kind == "faces" else gaps[:, None])
        place = np.cumsum(steps, axis=0).reshape(len(gaps), -1)
        slack = 0.05 * float(np.ptp(place)) + 1e-9  # a start with a jump of velocity is off by some percent
        for lowest, highest, column in zip(low, high, place.T, strict=True):
            if column.min() < lowest - slack or column.max() > highest + slack:
                raise ValueError(
                    f"Experiment.motions take {target!r} {column.min():.3g} to {column.max():.3g} m from its start, but"
                    f" its travel is {lowest:.3g} to {highest:.3g} m; widen the travel, start inside it, or shorten the"
                    " motion"
                )


def drive(experiment: Experiment, solver: Solver, until: float) -> int:
    """Go on to a time, with all motions of an experiment.

    Args:
        experiment: The experiment.
        solver: A solver of its scene; all its worlds do the same.
        until: Simulated time at the end [s].

    Returns:
        The number of steps that it took.

    Raises:
        ValueError: A control is out of the solver's limits.
    """
    begin = float(solver.time[0])
    if not until > begin:
        raise ValueError(f"drive until = {shown(until)} s is not after the present time {begin:g} s; give a later one")
    instants = experiment.instants(begin, until)
    controls = experiment.controls(instants)
    setters = {target: _setter(solver, target) for target in controls}
    steps = 0
    for index, interval in enumerate(np.diff(instants)):
        for target, values in controls.items():
            setters[target](values[index])
        solver.advance(float(interval))
        steps += solver.steps_for(float(interval))
    return steps


def _setter(solver: Solver, target: str) -> Callable[[np.ndarray], None]:
    """What writes a control of all worlds."""
    kind, _, name = target.partition(".")
    if kind == "gravity":
        return lambda value: solver.gravity.__setitem__(slice(None), value)
    array, index = {
        "faces": lambda: (solver.face_velocity, solver.face_index(name)),
        "bodies": lambda: (solver.body_velocity, solver.body_index(name)),
        "inflows": lambda: (solver.inflow_speed, solver.inflow_index(name)),
    }[kind]()
    return lambda value: array.__setitem__((slice(None), index), value)
