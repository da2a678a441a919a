"""What is simulated: the box and its faces, the fluid, solid bodies, nozzles and drains, gravity, the material.

Everything here is plain NumPy and frozen; a scene is checked when it is made. The last axis is up: y in two
dimensions, z in three.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral, Real
from typing import Any

import numpy as np

from fluidgym.checks import Point, check_number, check_type, point, set_point
from fluidgym.parts import (
    NO_SLIP_WALL,
    OPEN,
    PERIODIC,
    WALL,
    Body,
    Face,
    Fluid,
    Inflow,
    Material,
    Outflow,
    Particles,
    pipe_frame,
)
from fluidgym.shapes import Ball, Box, Region

__all__ = [
    "AXES",
    "NO_SLIP_WALL",
    "OPEN",
    "PERIODIC",
    "WALL",
    "Ball",
    "Body",
    "Box",
    "Face",
    "Fluid",
    "Inflow",
    "Material",
    "Outflow",
    "Particles",
    "Region",
    "Scene",
    "check_type",
    "face_names",
    "pipe_frame",
    "released_head",
]

AXES = "xyz"

# More than a world may have: their numbers are 32-bit integers, and they would fill 25 GB.
MOST_PARTICLES = 1e8

# Fluid starts at least this far from a body, over the spacing; the wall of the box is half a spacing away.
BODY_CLEARANCE = 0.25

# Sound speed over the largest expected speed: keeps density variations near 1 % (Monaghan 1994).
MACH_MARGIN = 10.0

# Least sound speed over the largest expected speed: below it the density varies by more than about 4 %.
LEAST_MACH_MARGIN = 5.0


# How far the volume of the particles may be from that of a box that counts as full, as a share.
FULL = 0.005


def face_names(dim: int) -> tuple[str, ...]:
    """Names of the faces of a box in array order: x_min, x_max, y_min, ... (2 * dim,)."""
    return tuple(f"{AXES[axis]}_{side}" for axis in range(dim) for side in ("min", "max"))


@dataclass(frozen=True)
class Scene:
    """A box of fluid and what is in it, complete: what is simulated, and nothing of how.

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
        bodies: Solids by name. Fluid is left out where they are.
        inflows: Nozzles by name. Their pipes are full at the start; other fluid is left out where they are.
        outflows: Drains and channel ends by name. Fluid is left out of drains, and of a channel's end where it would
            not move on.
        reserve: Particles of each world set aside for the inflows; None is as many as would fill the box, and a
            tenth more. A nozzle that finds the reserve used up stops until particles have been retired.
        central_force: Pull towards the origin over the distance from it [1/s2], added to gravity.

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
    bodies: Mapping[str, Body] = field(default_factory=dict)
    inflows: Mapping[str, Inflow] = field(default_factory=dict)
    outflows: Mapping[str, Outflow] = field(default_factory=dict)
    reserve: int | None = None
    central_force: float = 0.0

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_point(self, "lower", "m")
        set_point(self, "upper", "m")
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
        check_number("Scene.particle_spacing", self.particle_spacing, "m", above=0.0)
        check_type("Scene.material", self.material, Material, "a Material", "Material(density=1000.0)")
        set_(self, "gravity", self._gravity_vector(self.gravity))
        set_(self, "faces", self._all_faces(self.faces))
        self._check_motion()
        set_(self, "fluid", self._all_fluid(self.fluid))
        for name, kind in (("bodies", Body), ("inflows", Inflow), ("outflows", Outflow)):
            set_(self, name, _named(name, getattr(self, name), kind))
        check_number("Scene.central_force", self.central_force, "1/s2")
        check_type("Scene.jitter", self.jitter, Real, "a number", "0 to 0.25")
        if not 0.0 <= self.jitter <= 0.5:
            raise ValueError(f"Scene.jitter = {self.jitter:g} is outside 0 to 0.5 spacings; use 0.25 or less")
        check_type("Scene.seed", self.seed, Integral, "a whole number", "0 or more")
        if self.seed < 0:
            raise ValueError(f"Scene.seed = {self.seed} is below the limit 0; use 0 or more")
        if self.reference_speed is not None:
            check_number("Scene.reference_speed", self.reference_speed, "m/s", above=0.0)
        self._check_size()
        for body in self.fluid:
            self._check_fluid(body)
        for name, solid in self.bodies.items():
            self._check_body(name, solid)
        for name, inflow in self.inflows.items():
            self._check_inflow(name, inflow)
        for name, outflow in self.outflows.items():
            self._check_inside(f"Scene.outflows[{name!r}].region", *outflow.region.bounds())
        self._check_reserve()
        self._check_temperatures()
        self._check_sound_speed()

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

    @property
    def speed_scale(self) -> float:
        """Largest speed expected [m/s]: the reference speed, given or estimated.

        Raises:
            ValueError: It is not given, and nothing moves or weighs from which to estimate it.
        """
        if not self._speed_estimate:
            raise ValueError(
                "Scene.reference_speed = None cannot be estimated without fluid that moves or weighs;"
                " give the largest speed expected [m/s]"
            )
        return self._speed_estimate

    @cached_property
    def is_full(self) -> bool:
        """Whether fluid fills the box at the start and nothing can change that: no openings, no bodies, no motion."""
        openings = self.bodies or self.inflows or self.outflows
        if openings or any(face.kind == "open" or face.moving for face in self.faces.values()):
            return False
        room = float(np.prod(np.subtract(self.upper, self.lower))) / self.particle_spacing**self.dim
        return abs(self._start_count / room - 1.0) < FULL

    @cached_property
    def _speed_estimate(self) -> float:
        """Largest speed expected [m/s]; 0 where nothing moves or weighs."""
        if self.reference_speed is not None:
            return self.reference_speed
        position, velocity = self.sample_motion()
        speed = float(np.sqrt((velocity**2).sum(axis=1).max(initial=0.0)))
        gravity = self.gravity_vector
        g = float(np.linalg.norm(gravity))
        speed = max([speed, *(inflow.top_speed for inflow in self.inflows.values())])
        if self.central_force and len(position):
            reach = float(np.sqrt((position**2).sum(axis=1).max()))
            speed = max(speed, reach * math.sqrt(abs(self.central_force)))
        if g and len(position):
            depth = -(position @ gravity) / g
            floor = -gravity / g @ np.where(gravity > 0, self.upper, self.lower)
            speed = max(speed, math.sqrt(g * (depth.max() - floor + 0.5 * self.particle_spacing)))
        return speed

    def face_travel(self) -> np.ndarray:
        """Lowest and highest position of each face along its normal [m], (face, 2); the same twice where it rests."""
        corners = np.stack([self.lower, self.upper], axis=1)
        travel = np.repeat(corners.reshape(-1, 1), 2, axis=1)
        for index, face in enumerate(self.faces.values()):
            if face.moving:
                travel[index] = face.travel or corners[index // 2]
        return travel

    def face_start_positions(self) -> np.ndarray:
        """Position of each face along its normal at the start [m], (face,)."""
        low, high = self.face_travel().T
        corners = np.stack([self.lower, self.upper], axis=1).ravel()
        given = [face.start for face in self.faces.values()]
        return np.where([start is None for start in given], np.clip(corners, low, high), np.array(given, float))

    def sample_motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Start positions [m] and velocities [m/s] on the lattice of the box and in pipes, each (n, dim)."""
        return self._sample_motion(self._sample_places())

    def sample(self) -> Particles:
        """The particles at the start. Pressure is that asked for; density is left at rest (the solver sets it).

        Places are those of the lattice, off it by the jitter, and closer at the bottom of hydrostatic fluid.
        """
        places = self._sample_places()
        positions, velocities = self._sample_motion(places)
        n = len(positions)
        pressure, temperature = np.zeros(n), None
        pressures = [self._start_pressure(body, points) for body, points in places]
        lattice = sum(map(len, pressures))
        pressure[:lattice] = np.concatenate([np.empty(0), *pressures])
        if places:
            positions[:lattice] += np.concatenate([self._settling(body, points) for body, points in places])
        if self.material.thermal_diffusivity:
            warmth = [
                _evaluate("Fluid.temperature", body.temperature, points, (len(points),)) for body, points in places
            ]
            pipes = [np.full(len(self._pipe(inflow)[0]), inflow.temperature) for inflow in self.inflows.values()]
            temperature = np.concatenate([np.empty(0), *warmth, *pipes])
        density = np.full(n, self.material.density)
        return Particles(positions, velocities, density, pressure, np.arange(n), temperature)

    def _sample_places(self) -> list[tuple[Fluid, np.ndarray]]:
        """Each body and its lattice points [m], (n, dim)."""
        places = []
        for index, body in enumerate(self.fluid):
            points = self._lattice(*body.shape.bounds())
            inside = body.shape.contains(points)
            for solid in self.bodies.values():
                inside &= solid.shape.distance(points) > BODY_CLEARANCE * self.particle_spacing
            for inflow in self.inflows.values():
                inside &= ~self._in_pipe(inflow, points)
            for outflow in self.outflows.values():
                inside &= ~(outflow.region.contains(points) & ~self._carried_out(outflow, body, points))
            for earlier in self.fluid[:index]:
                inside &= ~earlier.shape.contains(points)
            places.append((body, points[inside]))
        return places

    def _carried_out(self, outflow: Outflow, fluid: Fluid, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, dim) [m] an outflow would carry on: bool (n,). At rest they would stay for good."""
        if outflow.direction is None:
            return np.zeros(len(points), bool)
        velocity = _evaluate("Fluid.velocity", fluid.velocity, points, points.shape)
        return velocity[:, AXES.index(outflow.direction[1])] * float(f"{outflow.direction[0]}1") > 0.0

    def _sample_motion(self, places: list[tuple[Fluid, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """Start positions [m], jittered, and velocities [m/s], those in pipes last, each (n, dim)."""
        velocities = [
            _evaluate("Fluid.velocity", body.velocity, points, (len(points), self.dim)) for body, points in places
        ]
        nothing = np.empty((0, self.dim))
        position = np.concatenate([nothing, *(points for _, points in places)])
        if self.jitter:
            shift = np.random.default_rng(self.seed).uniform(-1.0, 1.0, position.shape)
            position = position + self.jitter * self.particle_spacing * shift
        pipes = [self._pipe(inflow) for inflow in self.inflows.values()]
        position = np.concatenate([position, *(points for points, _ in pipes)])
        return position, np.concatenate([nothing, *velocities, *(motion for _, motion in pipes)])

    def _pipe(self, inflow: Inflow) -> tuple[np.ndarray, np.ndarray]:
        """Start positions [m] and velocities [m/s] of the particles in a pipe, each (n, dim)."""
        dx, frame = self.particle_spacing, pipe_frame(inflow.direction)
        across, share = inflow.rows(dx)
        half = 0.5 * np.array([inflow.width, inflow.height or inflow.width])[: self.dim - 1]
        rows = np.asarray(inflow.center) + (across * half) @ frame[1:]
        along = (np.arange(round(inflow.pipe_length(dx) / dx)) + 0.5) * dx
        position = (along[:, None, None] * frame[0] + rows).reshape(-1, self.dim)
        return position, np.tile(share[:, None] * inflow.speed * frame[0], (len(along), 1))

    def _in_pipe(self, inflow: Inflow, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, dim) [m] are in a pipe or within half a spacing of it: bool (n,)."""
        margin = 0.5 * self.particle_spacing * (1.0 - 1e-6)
        place = (points - np.asarray(inflow.center)) @ pipe_frame(inflow.direction).T
        half = 0.5 * np.array([inflow.width, inflow.height or inflow.width])[: self.dim - 1]
        if self.dim == 3 and inflow.height is None:
            inside = (place[:, 1:] ** 2).sum(axis=1) < (half[0] + margin) ** 2
        else:
            inside = (np.abs(place[:, 1:]) < half + margin).all(axis=1)
        length = inflow.pipe_length(self.particle_spacing)
        return inside & (place[:, 0] > -margin) & (place[:, 0] < length + margin)

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

    def _settling(self, body: Fluid, points: np.ndarray) -> np.ndarray:
        """From the lattice points of a body (n, dim) [m] to where the fluid would lie still, (n, dim) [m].

        The fluid is compressible: under the pressure rho g z at a depth z, its density is 1 + g z/c_0^2 times that on
        top. A lattice with the same spacing all the way down is not at rest. What comes up from below spreads as the
        pressure on it falls, is then lighter than what it meets and goes on up, as air does that is warm below: at 40
        particles to the depth and c_0 = 8 sqrt(gH), a tank turned over at a rate of 0.07 sqrt(g/H), up to 2 % of
        sqrt(gH). So the rows lie closer at the bottom, in proportion to the density, between the same ends.
        """
        g = self.gravity_vector
        axes = np.flatnonzero(g)
        shift = np.zeros(points.shape)
        if body.pressure != "hydrostatic" or len(axes) != 1 or not len(points):
            return shift
        axis = axes[0]
        place = points[:, axis]
        low, high = place.min() - 0.5 * self.particle_spacing, place.max() + 0.5 * self.particle_spacing
        shift[:, axis] = 0.5 * g[axis] / self.sound_speed**2 * (place - low) * (high - place)
        return shift

    def _gravity_vector(self, gravity: Point | float | None) -> Point:
        if gravity is None:
            gravity = 9.81
        if isinstance(gravity, Real):
            gravity = (0.0,) * (self.dim - 1) + (-float(gravity),)
        gravity = point("Scene.gravity", gravity, "m/s2", "give one for each axis, or one number for downwards")
        if len(gravity) != self.dim:
            raise ValueError(f"Scene.gravity = {gravity} m/s2 has {len(gravity)} components; give {self.dim}")
        return gravity

    def _all_faces(self, given: Mapping[str, Face]) -> dict[str, Face]:
        check_type("Scene.faces", given, Mapping, "a mapping", "{'x_min': Face('wall')}")
        names = face_names(self.dim)
        for name in given:
            if name not in names:
                raise ValueError(f"Scene.faces has no face {name!r}; use {', '.join(names)}")
            check_type(f"Scene.faces[{name!r}]", given[name], Face, "a Face", "Face('wall')")
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

    def _check_motion(self) -> None:
        """Refuse a wall that starts outside its travel, and two that could meet."""
        travel, names = self.face_travel(), face_names(self.dim)
        for name, (low, high), start in zip(names, travel, self.face_start_positions(), strict=True):
            if not low <= start <= high:
                raise ValueError(
                    f"Scene.faces[{name!r}].start = {start:g} m is outside its travel {low:g} to {high:g} m;"
                    " start inside, or widen the travel"
                )
        for low, high in zip(names[::2], names[1::2], strict=True):
            highest, lowest = travel[names.index(low), 1], travel[names.index(high), 0]
            if self.faces[low].moving and self.faces[high].moving and highest >= lowest:
                raise ValueError(
                    f"Scene.faces {low!r} travels up to {highest:g} m and {high!r} down to {lowest:g} m, so they can"
                    " meet; give both a Face.travel that keeps them apart"
                )

    def _all_fluid(self, given: Fluid | Sequence[Fluid]) -> tuple[Fluid, ...]:
        if isinstance(given, Fluid):
            return (given,)
        check_type("Scene.fluid", given, Iterable, "a Fluid or a list of them", "[Fluid(shape)], or [] for none")
        bodies = tuple(given)
        for index, body in enumerate(bodies):
            check_type(f"Scene.fluid[{index}]", body, Fluid, "a Fluid", "Fluid(shape)")
        return bodies

    def lattice_count(self, fluid: Fluid) -> float:
        """How many particles would fill the box about a body of fluid; there are no more of it at the start."""
        low, high = fluid.shape.bounds()
        return float(np.prod(np.maximum(high - low, 0.0) / self.particle_spacing))

    def _check_size(self) -> None:
        """Refuse a lattice that no memory would hold, before it is made."""
        for fluid in self.fluid:
            low, high = fluid.shape.bounds()
            if len(low) == len(high) == self.dim and np.isfinite([low, high]).all():
                count = self.lattice_count(fluid)
                if count > MOST_PARTICLES:
                    coarse = self.particle_spacing * (count / MOST_PARTICLES) ** (1 / self.dim)
                    raise ValueError(
                        f"Scene.particle_spacing = {self.particle_spacing:g} m makes {count:.2g} particles, limit"
                        f" {MOST_PARTICLES:.0e}; use {coarse:.2g} m or more"
                    )

    def _check_inside(self, name: str, low: np.ndarray, high: np.ndarray) -> None:
        """Refuse what reaches out of the box."""
        if len(low) != self.dim:
            raise ValueError(f"{name} has {len(low)} components, limit {self.dim}; match Scene.lower")
        for axis in range(self.dim):
            slack = 1e-6 * (self.upper[axis] - self.lower[axis])
            if low[axis] < self.lower[axis] - slack or high[axis] > self.upper[axis] + slack:
                raise ValueError(
                    f"{name} spans {AXES[axis]} = {low[axis]:g} to {high[axis]:g} m, outside the box"
                    f" {self.lower[axis]:g} to {self.upper[axis]:g} m; move it or enlarge the box"
                )

    def _check_body(self, name: str, body: Body) -> None:
        low, _ = body.shape.bounds()
        if len(low) != self.dim:
            raise ValueError(
                f"Scene.bodies[{name!r}].shape has {len(low)} components, limit {self.dim}; match Scene.lower"
            )

    def _check_inflow(self, name: str, inflow: Inflow) -> None:
        label = f"Scene.inflows[{name!r}]"
        if len(inflow.center) != self.dim:
            raise ValueError(f"{label}.center has {len(inflow.center)} components, limit {self.dim}; match Scene.lower")
        if inflow.width < self.particle_spacing * (1.0 - 1e-6):
            raise ValueError(
                f"{label}.width = {inflow.width:g} m is below Scene.particle_spacing = {self.particle_spacing:g} m;"
                " use a wider opening or a smaller spacing"
            )
        position, _ = self._pipe(inflow)
        self._check_inside(f"{label} pipe", position.min(axis=0), position.max(axis=0))
        for other, body in self.bodies.items():
            if (body.shape.distance(position) < 0.0).any():
                raise ValueError(f"{label} pipe is inside Scene.bodies[{other!r}]; move one of them")
        for other, neighbour in self.inflows.items():
            if other != name and self._in_pipe(neighbour, position).any():
                raise ValueError(f"{label} pipe is less than half a spacing from that of {other!r}; move one of them")

    def _check_reserve(self) -> None:
        if self.reserve is not None:
            check_type("Scene.reserve", self.reserve, Integral, "a whole number", "0 or more, or None")
            if self.reserve < 0:
                raise ValueError(f"Scene.reserve = {self.reserve} is below the limit 0; use 0 or more")
            if self.reserve and not self.inflows:
                raise ValueError(f"Scene.reserve = {self.reserve} is of no effect without inflows; leave it out")
        elif self.inflows:
            extent = np.asarray(self.upper) - np.asarray(self.lower)
            room = float(np.prod(extent)) / self.particle_spacing**self.dim
            object.__setattr__(self, "reserve", math.ceil(max(0.0, room - self._start_count) + 0.1 * room) + 16)

    def _check_temperatures(self) -> None:
        """Refuse temperatures where no heat is conducted."""
        if self.material.thermal_diffusivity:
            return
        given = {f"faces[{name!r}]": face.temperature for name, face in self.faces.items()}
        given |= {f"bodies[{name!r}]": body.temperature for name, body in self.bodies.items()}
        given |= {f"fluid[{index}]": fluid.temperature or None for index, fluid in enumerate(self.fluid)}
        given |= {f"inflows[{name!r}]": inflow.temperature or None for name, inflow in self.inflows.items()}
        for name, temperature in given.items():
            if temperature is not None:
                raise ValueError(
                    f"Scene.{name}.temperature = {temperature} is of no effect where nothing conducts heat;"
                    " set Material.thermal_diffusivity"
                )

    @cached_property
    def _start_count(self) -> int:
        """Number of particles at the start."""
        return len(self.sample_motion()[0])

    def _check_sound_speed(self) -> None:
        given = self.material.sound_speed
        if given is None:
            return
        speed = self._speed_estimate
        if given < LEAST_MACH_MARGIN * speed:
            raise ValueError(
                f"Material.sound_speed = {given:g} m/s is below the limit {LEAST_MACH_MARGIN * speed:.3g} m/s,"
                f" {LEAST_MACH_MARGIN:g} times the largest speed expected; use {MACH_MARGIN * speed:.3g} m/s"
                f" ({MACH_MARGIN:g} times), or None for that"
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
            first, last = self.face_start_positions()[2 * axis : 2 * axis + 2]
            if low[axis] < first - slack or high[axis] > last + slack:
                raise ValueError(
                    f"Scene.fluid spans {AXES[axis]} = {low[axis]:g} to {high[axis]:g} m, beyond the walls, which start"
                    f" at {first:g} and {last:g} m; move the fluid, or a wall by Face.start"
                )
        if not body.shape.contains(self._lattice(low, high)).any():
            raise ValueError(
                f"Scene.fluid has a body with no lattice point at Scene.particle_spacing ="
                f" {self.particle_spacing:g} m; use a smaller spacing or a larger body"
            )
        if body.pressure == "released":
            self._check_released(low)

    def _check_released(self, low: np.ndarray) -> None:
        """Refuse a dam, by its lower corner, that its pressure is not the solution for."""
        gravity = self.gravity_vector
        if gravity[:-1].any() or gravity[-1] > 0.0:
            raise ValueError(
                f"Fluid.pressure = 'released' needs gravity straight down, not Scene.gravity = {self.gravity} m/s2;"
                " use 'hydrostatic'"
            )
        for axis in (0, self.dim - 1):
            name, start = face_names(self.dim)[2 * axis], self.face_start_positions()[2 * axis]
            if self.faces[name].kind != "wall" or abs(low[axis] - start) > 1e-6 * (self.upper[axis] - self.lower[axis]):
                raise ValueError(
                    f"Fluid.pressure = 'released' needs a Box held by a wall {name!r}: its {AXES[axis]} starts at"
                    f" {low[axis]:g} m, the face is {self.faces[name].kind!r} at {start:g} m; move the Box or use"
                    " 'hydrostatic'"
                )


def _named(field_name: str, given: Any, kind: type) -> dict[str, Any]:
    """The parts of one kind by name, checked."""
    check_type(f"Scene.{field_name}", given, Mapping, "a mapping", f"{{'name': {kind.__name__}(...)}}")
    for name, part in given.items():
        check_type(f"Scene.{field_name} name", name, str, "a string", "a name such as 'gate'")
        check_type(f"Scene.{field_name}[{name!r}]", part, kind, f"a {kind.__name__}", f"{kind.__name__}(...)")
    return dict(given)


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
