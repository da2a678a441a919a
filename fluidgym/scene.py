"""What is simulated: the box and its faces, the fluid, gravity, the material.

Everything here is plain NumPy and frozen; a scene is checked when it is made. The last axis is up: y in two
dimensions, z in three.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

Point = tuple[float, ...]
PointFunction = Callable[[np.ndarray], np.ndarray]

AXES = "xyz"

# Sound speed over the largest expected speed: keeps density variations near 1 % (Monaghan 1994).
MACH_MARGIN = 10.0


def face_names(dim: int) -> tuple[str, ...]:
    """Names of the faces of a box in array order: x_min, x_max, y_min, ... (2 * dim,)."""
    return tuple(f"{AXES[axis]}_{side}" for axis in range(dim) for side in ("min", "max"))


@dataclass(frozen=True)
class Face:
    """One face of the box.

    Attributes:
        kind: "wall" keeps the fluid in; "open" has nothing there, and particles that leave are retired and counted;
            "periodic" joins the face to its opposite.
        slip: "free" lets the fluid slide along the wall; "no" makes viscosity stick to it.
        moving: Whether the wall moves along its normal. Only walls can.
        travel: Lowest and highest position of a moving wall [m]; None lets it go anywhere inside the box.
        sliding: Velocity of the wall within its own plane [m/s], (dim,); felt by viscosity where slip is "no".
    """

    kind: Literal["wall", "open", "periodic"] = "wall"
    slip: Literal["free", "no"] = "free"
    moving: bool = False
    travel: tuple[float, float] | None = None
    sliding: Point | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("wall", "open", "periodic"):
            raise ValueError(f"Face.kind = {self.kind!r} is unknown; use 'wall', 'open' or 'periodic'")
        if self.slip not in ("free", "no"):
            raise ValueError(f"Face.slip = {self.slip!r} is unknown; use 'free' or 'no'")
        if self.kind != "wall" and (self.moving or self.travel or self.sliding or self.slip == "no"):
            raise ValueError(
                f"Face.kind = {self.kind!r} takes no motion and no slip; only a 'wall' moves or holds the fluid"
            )
        if self.travel is not None and not self.travel[0] < self.travel[1]:
            raise ValueError(f"Face.travel = {self.travel} m must rise; give (lowest, highest)")


WALL = Face()
OPEN = Face("open")
PERIODIC = Face("periodic")
NO_SLIP_WALL = Face(slip="no")


@dataclass(frozen=True)
class Box:
    """An axis-aligned box of fluid between two corners [m], each (dim,)."""

    lower: Point
    upper: Point

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, dim) [m] lie inside: bool (n,)."""
        return np.all((points >= self.lower) & (points < self.upper), axis=1)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner [m], each (dim,)."""
        return np.asarray(self.lower, float), np.asarray(self.upper, float)


@dataclass(frozen=True)
class Ball:
    """A disc (two dimensions) or ball (three): center [m] (dim,) and radius [m]."""

    center: Point
    radius: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, dim) [m] lie inside: bool (n,)."""
        return np.sum((points - np.asarray(self.center)) ** 2, axis=1) < self.radius**2

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner of the enclosing box [m], each (dim,)."""
        center = np.asarray(self.center, float)
        return center - self.radius, center + self.radius


@dataclass(frozen=True)
class Region:
    """Any shape: a predicate on points (n, dim) [m] -> bool (n,), looked for between two corners [m]."""

    predicate: PointFunction
    lower: Point
    upper: Point

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, dim) [m] lie inside: bool (n,)."""
        inside = np.asarray(self.predicate(points), bool)
        if inside.shape != (len(points),):
            raise ValueError(
                f"Region.predicate returned shape {inside.shape}, limit ({len(points)},); return one bool a point"
            )
        return inside & Box(self.lower, self.upper).contains(points)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The two corners [m], each (dim,)."""
        return np.asarray(self.lower, float), np.asarray(self.upper, float)


Shape = Box | Ball | Region


@dataclass(frozen=True)
class Fluid:
    """A body of fluid at the start.

    Attributes:
        shape: Where it is: a Box, a Ball or a Region.
        velocity: One velocity [m/s] (dim,), or a function of points (n, dim) [m] -> (n, dim); None is at rest.
        pressure: "hydrostatic" balances gravity below the top of the shape; "released" is that of a dam just gone: a
            Box on the floor, held by a wall at its lower x and free at its upper x and on top; "none" starts at zero;
            a function gives it at points (n, dim) [m] -> (n,) [Pa].
    """

    shape: Shape
    velocity: Point | PointFunction | None = None
    pressure: Literal["hydrostatic", "released", "none"] | PointFunction = "none"

    def __post_init__(self) -> None:
        if not callable(self.pressure) and self.pressure not in ("hydrostatic", "released", "none"):
            raise ValueError(
                f"Fluid.pressure = {self.pressure!r} is unknown;"
                " use 'hydrostatic', 'released', 'none' or a function of points"
            )
        if self.velocity is not None and not callable(self.velocity):
            object.__setattr__(self, "velocity", _point("Fluid.velocity", self.velocity))
        if self.pressure == "released" and not isinstance(self.shape, Box):
            raise ValueError(
                f"Fluid.pressure = 'released' is for a Box, not a {type(self.shape).__name__}; use 'hydrostatic'"
            )


@dataclass(frozen=True)
class Material:
    """The fluid itself.

    Attributes:
        density: Rest density rho_0 [kg/m3].
        viscosity: Kinematic viscosity nu [m2/s]; 0 leaves the viscous term to the scheme's artificial one.
        sound_speed: Artificial speed of sound c_0 [m/s]; None takes ten times the scene's reference speed.
    """

    density: float = 1000.0
    viscosity: float = 0.0
    sound_speed: float | None = None

    def __post_init__(self) -> None:
        _check_number("Material.density", self.density, "kg/m3", above=0.0)
        _check_number("Material.viscosity", self.viscosity, "m2/s", least=0.0)
        if self.sound_speed is not None:
            _check_number("Material.sound_speed", self.sound_speed, "m/s", above=0.0)


@dataclass(frozen=True)
class Particles:
    """Particles of one world, in order of identity.

    Attributes:
        position: [m], (particle, dim).
        velocity: [m/s], (particle, dim).
        density: [kg/m3], (particle,).
        pressure: [Pa], (particle,).
        identity: Stable number of each particle within its world, (particle,).
    """

    position: np.ndarray
    velocity: np.ndarray
    density: np.ndarray
    pressure: np.ndarray
    identity: np.ndarray

    def __len__(self) -> int:
        return len(self.identity)


@dataclass(frozen=True)
class Scene:
    """A box of fluid, complete: what is simulated, and nothing of how.

    Attributes:
        lower: Lower corner of the box [m], (dim,).
        upper: Upper corner of the box [m], (dim,).
        particle_spacing: Distance dx of neighbouring particles at the start [m]; a particle carries rho_0 dx^dim.
        fluid: The bodies of fluid. Where shapes overlap the first one counts.
        faces: Face by name ("x_min", "x_max", "y_min", ...); a face not named is a free-slip wall.
        gravity: Acceleration [m/s2], (dim,); None is 9.81 downwards, a number is that magnitude downwards.
        material: Density, viscosity, sound speed.
        reference_speed: Largest speed expected [m/s]; None takes the larger of the initial speed and the wave speed
            sqrt(g * height of the fluid's top over the floor).
        jitter: Largest random shift of each start position as a share of the spacing.
        seed: Seed of the jitter.

    Raises:
        ValueError: A field is out of its limits; the message names the field, the value, the limit and the remedy.
    """

    lower: Point
    upper: Point
    particle_spacing: float
    fluid: Sequence[Fluid]
    faces: Mapping[str, Face] = field(default_factory=dict)
    gravity: Point | float | None = None
    material: Material = field(default_factory=Material)
    reference_speed: float | None = None
    jitter: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "lower", _point("Scene.lower", self.lower))
        set_(self, "upper", _point("Scene.upper", self.upper))
        if len(self.lower) not in (2, 3) or len(self.lower) != len(self.upper):
            raise ValueError(
                f"Scene.lower and Scene.upper have {len(self.lower)} and {len(self.upper)} components;"
                " give two each for a 2D scene, three for a 3D one"
            )
        for axis, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if not low < high:
                raise ValueError(
                    f"Scene.upper {AXES[axis]} = {high:g} m must exceed Scene.lower {AXES[axis]} = {low:g} m"
                )
        _check_number("Scene.particle_spacing", self.particle_spacing, "m", above=0.0)
        set_(self, "gravity", self._gravity_vector(self.gravity))
        set_(self, "faces", self._all_faces(self.faces))
        set_(self, "fluid", (self.fluid,) if isinstance(self.fluid, Fluid) else tuple(self.fluid))
        if not 0.0 <= self.jitter <= 0.5:
            raise ValueError(f"Scene.jitter = {self.jitter:g} is outside 0 to 0.5 spacings; use 0.25 or less")
        if self.reference_speed is not None:
            _check_number("Scene.reference_speed", self.reference_speed, "m/s", above=0.0)
        for body in self.fluid:
            self._check_fluid(body)

    @property
    def dim(self) -> int:
        """Number of dimensions, 2 or 3."""
        return len(self.lower)

    @property
    def gravity_vector(self) -> np.ndarray:
        """Acceleration of gravity [m/s2], (dim,)."""
        return np.asarray(self.gravity, float)

    @property
    def particle_mass(self) -> float:
        """Mass of one particle [kg] (per metre of depth in two dimensions)."""
        return self.material.density * self.particle_spacing**self.dim

    @property
    def sound_speed(self) -> float:
        """Artificial speed of sound c_0 [m/s]."""
        return self.material.sound_speed or MACH_MARGIN * self.speed_scale

    @cached_property
    def speed_scale(self) -> float:
        """Largest speed expected [m/s]: the reference speed, given or estimated."""
        if self.reference_speed is not None:
            return self.reference_speed
        position, velocity = self.sample_motion()
        speed = float(np.sqrt((velocity**2).sum(axis=1).max(initial=0.0)))
        gravity = self.gravity_vector
        g = float(np.linalg.norm(gravity))
        if g and len(position):
            depth = -(position @ gravity) / g
            floor = -gravity / g @ np.where(gravity > 0, self.upper, self.lower)
            speed = max(speed, math.sqrt(g * (depth.max() - floor + 0.5 * self.particle_spacing)))
        if not speed:
            raise ValueError(
                "Scene.reference_speed = None cannot be estimated without fluid that moves or weighs;"
                " give the largest speed expected [m/s]"
            )
        return speed

    def sample_motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Start positions [m] and velocities [m/s] on the lattice of the box, each (n, dim)."""
        positions, velocities, _ = self._sample_bodies()
        return positions, velocities

    def sample(self) -> Particles:
        """The particles at the start. Pressure is that asked for; density is left at rest (the solver sets it)."""
        positions, velocities, pressures = self._sample_bodies()
        n = len(positions)
        return Particles(positions, velocities, np.full(n, self.material.density), pressures, np.arange(n))

    def _sample_bodies(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        dx, dim = self.particle_spacing, self.dim
        positions, velocities, pressures = [np.empty((0, dim))], [np.empty((0, dim))], [np.empty(0)]
        for index, body in enumerate(self.fluid):
            points = self._lattice(*body.shape.bounds())
            inside = body.shape.contains(points)
            for earlier in self.fluid[:index]:
                inside &= ~earlier.shape.contains(points)
            points = points[inside]
            positions.append(points)
            velocities.append(_evaluate("Fluid.velocity", body.velocity, points, (len(points), dim)))
            pressures.append(self._start_pressure(body, points))
        position = np.concatenate(positions)
        if self.jitter:
            shift = np.random.default_rng(self.seed).uniform(-1.0, 1.0, position.shape)
            position = position + self.jitter * dx * shift
        return position, np.concatenate(velocities), np.concatenate(pressures)

    def _lattice(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Lattice points of the box between two corners, cell-centred so that walls stand half a spacing away."""
        dx = self.particle_spacing
        first = np.floor((low - self.lower) / dx - 0.5 - 1e-6).astype(int)
        last = np.ceil((high - self.lower) / dx - 0.5 + 1e-6).astype(int)
        lines = [self.lower[k] + (np.arange(first[k], last[k] + 1) + 0.5) * dx for k in range(self.dim)]
        grid = np.meshgrid(*reversed(lines), indexing="ij")
        return np.stack([axis.ravel() for axis in reversed(grid)], axis=1)

    def _start_pressure(self, body: Fluid, points: np.ndarray) -> np.ndarray:
        if callable(body.pressure):
            return _evaluate("Fluid.pressure", body.pressure, points, (len(points),))
        g = self.gravity_vector
        if body.pressure == "none" or not len(points) or not g.any():
            return np.zeros(len(points))
        if body.pressure == "released":
            low, high = body.shape.bounds()
            place = (points - low)[:, [0, -1]]
            pull = self.material.density * float(np.linalg.norm(g))
            return pull * released_head(place, high[0] - low[0], high[-1] - low[-1])
        # A plane of zero pressure half a spacing above the highest particle of the body.
        head = points @ g
        top = head.min() - 0.5 * self.particle_spacing * float(np.abs(g).max())
        return self.material.density * (head - top)

    def _gravity_vector(self, gravity: Point | float | None) -> Point:
        if gravity is None:
            gravity = 9.81
        if isinstance(gravity, (int, float, np.number)):
            gravity = (0.0,) * (self.dim - 1) + (-float(gravity),)
        gravity = _point("Scene.gravity", gravity)
        if len(gravity) != self.dim:
            raise ValueError(f"Scene.gravity = {gravity} m/s2 has {len(gravity)} components; give {self.dim}")
        return gravity

    def _all_faces(self, given: Mapping[str, Face]) -> dict[str, Face]:
        names = face_names(self.dim)
        for name in given:
            if name not in names:
                raise ValueError(f"Scene.faces has no face {name!r}; use {', '.join(names)}")
            if not isinstance(given[name], Face):
                raise ValueError(f"Scene.faces[{name!r}] = {given[name]!r} is not a Face; use Face('wall')")
        faces = {name: given.get(name, WALL) for name in names}
        for axis in range(self.dim):
            low, high = names[2 * axis], names[2 * axis + 1]
            if (faces[low].kind == "periodic") != (faces[high].kind == "periodic"):
                raise ValueError(f"Scene.faces {low!r} and {high!r} must both be periodic, or neither")
            for name in (low, high):
                self._check_face(name, faces[name], axis)
        return faces

    def _check_face(self, name: str, face: Face, axis: int) -> None:
        if face.travel is not None:
            low, high = face.travel
            if low < self.lower[axis] - 1e-9 or high > self.upper[axis] + 1e-9:
                raise ValueError(
                    f"Scene.faces[{name!r}].travel = ({low:g}, {high:g}) m leaves the box"
                    f" {self.lower[axis]:g} to {self.upper[axis]:g} m; enlarge the box or shorten the travel"
                )
        if face.sliding is not None:
            if len(face.sliding) != self.dim or face.sliding[axis]:
                raise ValueError(
                    f"Scene.faces[{name!r}].sliding = {face.sliding} m/s must have {self.dim} components"
                    f" and none along {AXES[axis]}; a wall moves along its normal by moving=True"
                )

    def _check_fluid(self, body: Fluid) -> None:
        low, high = body.shape.bounds()
        if isinstance(body.velocity, tuple) and len(body.velocity) != self.dim:
            raise ValueError(
                f"Fluid.velocity = {body.velocity} m/s has {len(body.velocity)} components; give {self.dim}"
            )
        if len(low) != self.dim or len(high) != self.dim:
            raise ValueError(
                f"Scene.fluid shape has {len(low)} and {len(high)} components, limit {self.dim}; match Scene.lower"
            )
        if not (np.isfinite([low, high]).all() and (low < high).all()):
            raise ValueError(
                f"Scene.fluid spans {tuple(map(float, low))} to {tuple(map(float, high))} m;"
                " give finite corners that rise, or a positive radius"
            )
        extent_names = {2: ("width", "height"), 3: ("width", "depth", "height")}[self.dim]
        for axis in range(self.dim):
            extent = high[axis] - low[axis]
            if self.particle_spacing > extent * (1 + 1e-6):
                raise ValueError(
                    f"Scene.particle_spacing = {self.particle_spacing:g} m exceeds the fluid {extent_names[axis]}"
                    f" {extent:g} m; use {extent / 4:.2g} m or less"
                )
            slack = 1e-6 * (self.upper[axis] - self.lower[axis])
            if low[axis] < self.lower[axis] - slack or high[axis] > self.upper[axis] + slack:
                raise ValueError(
                    f"Scene.fluid spans {AXES[axis]} = {low[axis]:g} to {high[axis]:g} m, outside the box"
                    f" {self.lower[axis]:g} to {self.upper[axis]:g} m; move the fluid or enlarge the box"
                )
        if not body.shape.contains(self._lattice(low, high)).any():
            raise ValueError(
                f"Scene.fluid has a body with no lattice point at Scene.particle_spacing ="
                f" {self.particle_spacing:g} m; use a smaller spacing or a larger body"
            )


def released_head(points: np.ndarray, width: float, height: float) -> np.ndarray:
    """Pressure over rho g [m] in a column of water at the instant after the dam is gone.

    The hydrostatic pressure of the instant before pushes on nothing where the dam was. What is left solves Laplace's
    equation with no pressure on top and at x = width, no slope at the wall x = 0, and dp/dy = -rho g at the floor;
    by separation of variables.

    Args:
        points: Places x, y from the column's corner at wall and floor [m], (n, 2).
        width: Of the column [m].
        height: Of the column [m].
    """
    order = np.arange(256)
    k = (order + 0.5) * math.pi / width
    amplitude = 2.0 * (-1.0) ** order / (width * k**2)
    x, y = points[:, :1], points[:, 1:]
    decay = (np.exp(-k * y) - np.exp(-k * (2.0 * height - y))) / (1.0 + np.exp(-2.0 * k * height))
    return (np.cos(k * x) * decay) @ amplitude


def _point(name: str, value: Sequence[float]) -> Point:
    point = tuple(float(component) for component in value)
    if not all(math.isfinite(component) for component in point):
        raise ValueError(f"{name} = {point} must be finite; give numbers")
    return point


def _check_number(name: str, value: float, unit: str, above: float | None = None, least: float | None = None) -> None:
    if not math.isfinite(value):
        raise ValueError(f"{name} = {value} {unit} must be finite; give a number")
    if above is not None and value <= above:
        raise ValueError(f"{name} = {value:g} {unit} must be greater than {above:g}; give a positive value")
    if least is not None and value < least:
        raise ValueError(f"{name} = {value:g} {unit} is below the limit {least:g}; use {least:g} or more")


def _evaluate(name: str, given: Any, points: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A constant or a function of points as an array of the shape asked for, checked."""
    value: Any = given(points) if callable(given) else (0.0 if given is None else given)
    try:
        array = np.array(np.broadcast_to(np.asarray(value, float), shape))
    except ValueError:
        raise ValueError(f"{name} has shape {np.shape(value)}, limit {shape}; return one row for each point") from None
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is not finite at {int((~np.isfinite(array)).sum())} places; return numbers")
    return array
