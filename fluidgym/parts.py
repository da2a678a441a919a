"""The parts of a scene: faces, bodies, fluid, material, nozzles and drains; frozen, and checked when they are made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fluidgym.checks import Point, check_choice, check_number, check_type, point, set_point
from fluidgym.shapes import Ball, Box, PointFunction, Shape


@dataclass(frozen=True)
class Face:
    """One face of the box.

    Attributes:
        kind: "wall" keeps the fluid in; "open" has nothing there, and particles that leave are retired and counted;
            "periodic" joins the face to its opposite.
        slip: "free" lets the fluid slide along the wall; "no" makes viscosity stick to it.
        moving: Whether the wall moves along its normal. Only walls can.
        travel: Lowest and highest position of a moving wall [m], (2,); None lets it go anywhere inside the box.
        start: Position of a moving wall at the start [m], inside its travel; None is the end of its travel on its own
            side of the box: the lowest for a "min" face, the highest for a "max" face.
        sliding: Velocity of the wall within its own plane [m/s], (dim,); only viscosity feels it, where slip is "no".
        temperature: Of the wall; None insulates. It counts where the material conducts heat.

    Raises:
        ValueError: A field is of a wrong type, out of its limits, or of no effect beside the others.
    """

    kind: Literal["wall", "open", "periodic"] = "wall"
    slip: Literal["free", "no"] = "free"
    moving: bool = False
    travel: tuple[float, float] | None = None
    start: float | None = None
    sliding: Point | None = None
    temperature: float | None = None

    def __post_init__(self) -> None:
        check_choice("Face.kind", self.kind, ("wall", "open", "periodic"), "'wall', 'open' or 'periodic'")
        check_choice("Face.slip", self.slip, ("free", "no"), "'free' or 'no'")
        check_type("Face.moving", self.moving, (bool, np.bool_), "a bool", "True or False")
        if self.travel is not None:
            set_point(self, "travel", "m", "give (lowest, highest)")
        if self.start is not None:
            check_number("Face.start", self.start, "m")
        if self.sliding is not None:
            set_point(self, "sliding", "m/s")
        if self.temperature is not None:
            check_number("Face.temperature", self.temperature, "degrees")
        given = (self.travel, self.start, self.sliding, self.temperature)
        if self.kind != "wall" and (self.moving or given != (None,) * 4 or self.slip == "no"):
            raise ValueError(
                f"Face.kind = {self.kind!r} takes no motion, no slip and no temperature; only a 'wall' moves, holds or"
                " heats the fluid"
            )
        if self.travel is not None and not (len(self.travel) == 2 and self.travel[0] < self.travel[1]):
            raise ValueError(f"Face.travel = {self.travel} m must rise; give (lowest, highest)")
        for name in ("travel", "start"):
            if getattr(self, name) is not None and not self.moving:
                raise ValueError(
                    f"Face.{name} = {getattr(self, name)} m is of no effect on a wall at rest; set moving=True"
                )
        if self.sliding is not None and self.slip != "no":
            raise ValueError(f"Face.sliding = {self.sliding} m/s is of no effect on a wall of free slip; set slip='no'")


WALL = Face()
OPEN = Face("open")
PERIODIC = Face("periodic")
NO_SLIP_WALL = Face(slip="no")


@dataclass(frozen=True)
class Fluid:
    """A body of fluid at the start.

    Attributes:
        shape: Where it is: a Box, a Ball or a Region.
        velocity: One velocity [m/s] (dim,), or a function of points (n, dim) [m] -> (n, dim); None is at rest.
        pressure: "hydrostatic" balances gravity below the top of the shape, and rows lie closer at the bottom, by what
            that pressure compresses the fluid (`Scene.sample`); "released" is that of a dam just gone: a
            Box on the floor, held by the wall x_min and free at its upper x and on top; "none" starts at zero; a
            function gives it at points (n, dim) [m] -> (n,) [Pa].
        temperature: One, or a function of points (n, dim) [m] -> (n,). It counts where the material conducts heat.

    Raises:
        ValueError: A field is of a wrong type or unknown.
    """

    shape: Shape
    velocity: Point | PointFunction | None = None
    pressure: Literal["hydrostatic", "released", "none"] | PointFunction = "none"
    temperature: float | PointFunction = 0.0

    def __post_init__(self) -> None:
        check_type("Fluid.shape", self.shape, Shape, "a shape", "a Box, a Ball or a Region")
        if not callable(self.pressure):
            known = "'hydrostatic', 'released', 'none' or a function of points"
            check_choice("Fluid.pressure", self.pressure, ("hydrostatic", "released", "none"), known)
        if self.velocity is not None and not callable(self.velocity):
            set_point(self, "velocity", "m/s", "give one for each axis, or a function of points")
        if not callable(self.temperature):
            check_number("Fluid.temperature", self.temperature, "degrees")
        if self.pressure == "released" and not isinstance(self.shape, Box):
            raise ValueError(
                f"Fluid.pressure = 'released' is for a Box, not a {type(self.shape).__name__}; use 'hydrostatic'"
            )


@dataclass(frozen=True)
class Material:
    """The fluid itself.

    Attributes:
        density: Rest density rho_0 [kg/m3].
        viscosity: Kinematic viscosity nu [m2/s]; it counts towards the scheme's artificial one, which adds only what
            is missing.
        sound_speed: Artificial speed of sound c_0 [m/s], at least five times the largest speed expected in the scene;
            None takes ten times that speed.
        thermal_diffusivity: Of heat [m2/s]; 0 leaves heat out.

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    density: float = 1000.0
    viscosity: float = 0.0
    sound_speed: float | None = None
    thermal_diffusivity: float = 0.0

    def __post_init__(self) -> None:
        check_number("Material.density", self.density, "kg/m3", above=0.0)
        check_number("Material.viscosity", self.viscosity, "m2/s", least=0.0)
        check_number("Material.thermal_diffusivity", self.thermal_diffusivity, "m2/s", least=0.0)
        if self.sound_speed is not None:
            check_number("Material.sound_speed", self.sound_speed, "m/s", above=0.0)


@dataclass(frozen=True)
class Body:
    """A solid inside the box: a gate, a lid, a paddle, an obstacle. It moves as it is told, without turning.

    It may be thinner than a particle, stand on a face or leave the box. Fluid on its two sides does not meet through
    it.

    Attributes:
        shape: Where it is at the start: a Box or a Ball.
        slip: "free" lets the fluid slide along it; "no" makes viscosity stick to it.
        moving: Whether it moves.
        travel: Lowest and highest displacement from its place at the start [m], each (dim,); None is without end.
        temperature: Of its surface; None insulates. It counts where the material conducts heat.

    Raises:
        ValueError: A field is of a wrong type, out of its limits, or of no effect beside the others.
    """

    shape: Box | Ball
    slip: Literal["free", "no"] = "free"
    moving: bool = False
    travel: tuple[Point, Point] | None = None
    temperature: float | None = None

    def __post_init__(self) -> None:
        check_type("Body.shape", self.shape, (Box, Ball), "a solid shape", "a Box or a Ball")
        check_choice("Body.slip", self.slip, ("free", "no"), "'free' or 'no'")
        check_type("Body.moving", self.moving, (bool, np.bool_), "a bool", "True or False")
        if self.temperature is not None:
            check_number("Body.temperature", self.temperature, "degrees")
        low, high = self.shape.bounds()
        if len(low) != len(high) or not (np.isfinite([low, high]).all() and (low < high).all()):
            raise ValueError(
                f"Body.shape spans {tuple(map(float, low))} to {tuple(map(float, high))} m; give finite corners that"
                " rise, or a positive radius"
            )
        if self.travel is None:
            return
        check_type("Body.travel", self.travel, Sequence, "a pair of points", "(lowest, highest)")
        if len(self.travel) != 2:
            raise ValueError(f"Body.travel has {len(self.travel)} entries, limit 2; give (lowest, highest)")
        ends = tuple(point("Body.travel", end, "m", "give one for each axis") for end in self.travel)
        object.__setattr__(self, "travel", ends)
        if not self.moving:
            raise ValueError(f"Body.travel = {ends} m is of no effect on a body at rest; set moving=True")
        for end in ends:
            if len(end) != len(low):
                raise ValueError(f"Body.travel = {end} m has {len(end)} components; give {len(low)}")
        if not all(lowest <= 0.0 <= highest for lowest, highest in zip(*ends, strict=True)):
            raise ValueError(
                f"Body.travel = {ends} m must have its start, 0, between the two; it counts from the body's place"
            )


@dataclass(frozen=True)
class Inflow:
    """A nozzle: a short pipe in which fluid is made and carried at a given speed to its end, where it comes free.

    Attributes:
        center: Middle of the back of the pipe [m], (dim,); the pipe lies inside the box.
        direction: Along which the fluid leaves, of any length above 0, (dim,).
        width: Of the opening [m]. In three dimensions its diameter, or with a height the horizontal side. The rows of
            particles that fill it are a whole number of spacings wide, so choose a multiple of the spacing.
        speed: Mean over the opening, at the start [m/s]; a control of the solver from then on.
        height: Other side of a rectangular opening in three dimensions [m]; None makes it round.
        max_speed: Largest that the control may ask for [m/s]; None is the speed at the start.
        profile: "uniform", or "parabolic" as of laminar flow: in two dimensions, between the sides of the height, or of
            a round pipe.
        length: Of the pipe [m]; None is five particle spacings. At least the radius of the smoothing kernel.
        temperature: Of what leaves it. It counts where the material conducts heat.

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    center: Point
    direction: Point
    width: float
    speed: float = 0.0
    height: float | None = None
    max_speed: float | None = None
    profile: Literal["uniform", "parabolic"] = "uniform"
    length: float | None = None
    temperature: float = 0.0

    def __post_init__(self) -> None:
        set_point(self, "center", "m")
        set_point(self, "direction", "1")
        dim = len(self.center)
        if dim not in (2, 3) or len(self.direction) != dim:
            raise ValueError(
                f"Inflow.center and Inflow.direction have {dim} and {len(self.direction)} components; give two each in"
                " 2D, three in 3D"
            )
        if not any(self.direction):
            raise ValueError(f"Inflow.direction = {self.direction} has no length; give the way the fluid leaves")
        check_number("Inflow.width", self.width, "m", above=0.0)
        check_number("Inflow.speed", self.speed, "m/s", least=0.0)
        check_number("Inflow.temperature", self.temperature, "degrees")
        check_choice("Inflow.profile", self.profile, ("uniform", "parabolic"), "'uniform' or 'parabolic'")
        for name in ("height", "length"):
            if getattr(self, name) is not None:
                check_number(f"Inflow.{name}", getattr(self, name), "m", above=0.0)
        if self.height is not None and dim == 2:
            raise ValueError(f"Inflow.height = {self.height:g} m is for three dimensions; leave it out")
        if self.max_speed is not None:
            check_number("Inflow.max_speed", self.max_speed, "m/s", above=0.0)
            if self.max_speed < self.speed:
                raise ValueError(
                    f"Inflow.speed = {self.speed:g} m/s exceeds Inflow.max_speed = {self.max_speed:g} m/s; raise that"
                )

        if not self.top_speed:
            raise ValueError(
                "Inflow.max_speed = None with Inflow.speed = 0 m/s lets nothing out, ever; give the largest speed that"
                " the control may ask for"
            )

    @property
    def top_speed(self) -> float:
        """Largest mean speed that the control may ask for [m/s]."""
        return self.speed if self.max_speed is None else self.max_speed

    def pipe_length(self, spacing: float) -> float:
        """Length of the pipe [m], whole particle spacings [m]."""
        return spacing * max(1, math.ceil((self.length or 5.0 * spacing) / spacing - 1e-6))

    def rows(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows of particles that fill the pipe, for a particle spacing [m].

        Returns:
            Place of each row across the pipe, in units of half its sides (row, dim - 1), in -1 to 1; and its speed over
            the mean of all rows (row,).
        """
        sides = [self.width] if len(self.center) == 2 else [self.width, self.height or self.width]
        lines = []
        for side in sides:
            n = max(1, round(side / spacing))
            lines.append(((np.arange(n) + 0.5) * spacing - 0.5 * n * spacing) / (0.5 * side))
        across = np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=1)
        round_pipe = len(sides) == 2 and self.height is None
        if round_pipe:
            across = across[(across**2).sum(axis=1) < 1.0]
        speed = np.ones(len(across))
        if self.profile == "parabolic":
            speed -= (across**2).sum(axis=1) if round_pipe else across[:, -1] ** 2
            speed /= speed.mean()
        return across, speed


def pipe_frame(direction: Sequence[float] | np.ndarray) -> np.ndarray:
    """The axes of a pipe as rows (dim, dim): along it, then across it; in 3D the second is horizontal."""
    along = np.asarray(direction, float) / np.linalg.norm(direction)
    if len(along) == 2:
        return np.array([along, [-along[1], along[0]]])
    across = np.array([-along[1], along[0], 0.0])
    size = np.linalg.norm(across)
    across = across / size if size > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.array([along, across, np.cross(along, across)])


@dataclass(frozen=True)
class Outflow:
    """A region where fluid leaves the world.

    Attributes:
        region: Where.
        direction: None retires a particle as it enters, as a drain does. An axis with its sign, "+x" or "-z", makes it
            the end of a channel that goes on: a particle is carried through at the velocity with which it entered and
            retired at the far side.
        pressure: Held in a region with a direction [Pa].

    Raises:
        ValueError: A field is of a wrong type or out of its limits.
    """

    region: Box
    direction: str | None = None
    pressure: float = 0.0

    def __post_init__(self) -> None:
        check_type("Outflow.region", self.region, Box, "a Box", "Box(lower, upper)")
        low, high = self.region.bounds()
        if len(low) != len(high) or not (low < high).all():
            raise ValueError(f"Outflow.region spans {low.tolist()} to {high.tolist()} m; give corners that rise")
        known = tuple(f"{sign}{axis}" for axis in "xyz"[: len(low)] for sign in "+-")
        if self.direction is not None:
            check_choice("Outflow.direction", self.direction, known, f"{', '.join(known)} or None")
        check_number("Outflow.pressure", self.pressure, "Pa")
        if self.pressure and self.direction is None:
            raise ValueError(f"Outflow.pressure = {self.pressure:g} Pa is of no effect in a drain; give a direction")


@dataclass(frozen=True)
class Particles:
    """Particles of one world, in order of identity.

    Attributes:
        position: [m], (particle, dim).
        velocity: [m/s], (particle, dim).
        density: [kg/m3], (particle,).
        pressure: [Pa], (particle,).
        identity: Stable number of each particle within its world, (particle,).
        temperature: (particle,); None where no heat is conducted.
    """

    position: np.ndarray
    velocity: np.ndarray
    density: np.ndarray
    pressure: np.ndarray
    identity: np.ndarray
    temperature: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.identity)

    def chosen(self, which: np.ndarray | slice) -> Particles:
        """Some of the particles: by slice, number or bool (particle,)."""
        kept: dict[str, Any] = {name: None if all_ is None else all_[which] for name, all_ in vars(self).items()}
        return Particles(**kept)
