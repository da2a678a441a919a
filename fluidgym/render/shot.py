"""What a drawing shows, checked once, so that the painters can trust it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluidgym.render.checks import box, number, positive
from fluidgym.render.fittings import Nozzle, Solid, check_bodies, check_inflows, check_outflows

# How far to the right of the front the eye is, and how far above [degrees].
USUAL_CAMERA = (24.7, 25.3)

KINDS = ("wall", "open", "periodic")
_AXES = "xyz"
_FARTHEST = 100.0  # Particles farther from the middle of the box, in box diagonals, are left out.
_SMALLEST, _LARGEST = 64, 8192


@dataclass(frozen=True)
class Side:
    """One side of the box.

    Attributes:
        axis: 0, 1 or 2 for x, y or z.
        outward: -1 for the lower side of the axis, +1 for the upper.
        kind: "wall", "open" or "periodic".
        position: Where it lies on its axis [m].
        moving: Whether it is a driven wall.
    """

    axis: int
    outward: int
    kind: str
    position: float
    moving: bool


@dataclass(frozen=True)
class Shot:
    """Everything a drawing shows.

    Attributes:
        positions: Finite particle positions (n, dim) [m].
        values: Finite values to colour by (n,).
        lower: Lower box corner (dim,) [m].
        upper: Upper box corner (dim,) [m].
        spacing: Particle spacing [m].
        faces: The 2 dim sides of the box, by name.
        value_range: Values at the ends of the colour map.
        label: Name and unit of the value.
        time: Simulated time [s], or None.
        title: Heading, or None.
        text: Further lines under the heading.
        zone: Lower and upper corner of a target region (dim,) [m], or None.
        bodies: Solids in the box.
        inflows: Nozzles.
        outflows: Lower and upper corners of the regions that remove water (dim,) [m].
        grid: Shares in 0 to 1 of the cells of a grid over the box, from its lower corner (ny, nx), or None.
        size: Width and height of the picture [px].
        spheres: Whether each particle is drawn by itself, not the body of water that they make.
        camera: Around the box from the front to the right, and up from the floor, in three dimensions [degrees].
    """

    positions: np.ndarray
    values: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    spacing: float
    faces: dict[str, Side]
    value_range: tuple[float, float]
    label: str
    time: float | None
    title: str | None
    text: tuple[str, ...]
    zone: tuple[np.ndarray, np.ndarray] | None
    bodies: tuple[Solid, ...]
    inflows: tuple[Nozzle, ...]
    outflows: tuple[tuple[np.ndarray, np.ndarray], ...]
    grid: np.ndarray | None
    size: tuple[int, int]
    spheres: bool = False
    camera: tuple[float, float] = USUAL_CAMERA

    @property
    def dim(self) -> int:
        """Number of space dimensions, 2 or 3."""
        return len(self.lower)


def check_shot(
    positions: Any,
    values: Any,
    *,
    lower: Any,
    upper: Any,
    spacing: float,
    faces: Mapping[str, Mapping[str, Any]] | None,
    value_range: tuple[float, float] | None,
    label: str,
    time: float | None,
    title: str | None,
    text: str | Sequence[str],
    zone: tuple[Any, Any] | None,
    bodies: Sequence[Mapping[str, Any]],
    inflows: Sequence[Mapping[str, Any]],
    outflows: Sequence[Mapping[str, Any]],
    grid: Any = None,
    size: tuple[int, int],
    spheres: bool = False,
    camera: tuple[float, float] | None = None,
) -> Shot:
    """Check the arguments of ``draw_frame`` and gather them.

    Args:
        positions: As in ``draw_frame``.
        values: As in ``draw_frame``.
        lower: As in ``draw_frame``.
        upper: As in ``draw_frame``.
        spacing: As in ``draw_frame``.
        faces: As in ``draw_frame``.
        value_range: As in ``draw_frame``.
        label: As in ``draw_frame``.
        time: As in ``draw_frame``.
        title: As in ``draw_frame``.
        text: As in ``draw_frame``.
        zone: As in ``draw_frame``.
        bodies: As in ``draw_frame``.
        inflows: As in ``draw_frame``.
        outflows: As in ``draw_frame``.
        grid: As in ``draw_frame``.
        size: As in ``draw_frame``.
        spheres: As in ``draw_frame``.
        camera: As in ``draw_frame``.

    Returns:
        What is drawn, without particles that are far away or have a position or value that is not finite.

    Raises:
        ValueError: An argument is out of its limits.
    """
    corners = box("lower", lower, "upper", upper)
    points, numbers = _check_particles(positions, values, *corners)
    return Shot(
        positions=points,
        values=numbers,
        lower=corners[0],
        upper=corners[1],
        spacing=positive("spacing", spacing, "give the particle spacing"),
        faces=_check_faces(faces, *corners),
        value_range=_check_range(value_range, numbers),
        label=str(label),
        time=None if time is None else number("time", time, "[s]"),
        title=None if title is None else str(title),
        text=(text,) if isinstance(text, str) else tuple(str(line) for line in text),
        zone=None if zone is None else _check_zone(zone, len(corners[0])),
        bodies=check_bodies(bodies, *corners),
        inflows=check_inflows(inflows, *corners),
        outflows=check_outflows(outflows, *corners),
        grid=None if grid is None else _check_grid(grid, len(corners[0])),
        size=_check_size(size),
        spheres=bool(spheres),
        camera=USUAL_CAMERA if camera is None else _check_camera(camera),
    )


def _check_zone(zone: Any, dim: int) -> tuple[np.ndarray, np.ndarray]:
    if np.ndim(zone) != 2 or len(zone) != 2:
        raise ValueError(f"zone: {zone!r} must be two corners of one length; give (lower, upper) [m]")
    lower, upper = box("zone lower", zone[0], "zone upper", zone[1])
    if len(lower) != dim:
        raise ValueError(f"zone: {len(lower)} axes, but the box has {dim}; give corners of {dim} [m]")
    return lower, upper


def _check_camera(camera: Any) -> tuple[float, float]:
    if np.shape(camera) != (2,):
        raise ValueError(f"camera: {camera!r} must be two angles; give (around, up) [degrees]")
    around, up = (number("camera", angle, "[degrees]") for angle in camera)
    if not -89.0 <= up <= 89.0:
        raise ValueError(f"camera: {up:g} degrees up is outside -89 to 89; use 25 or so")
    return around, up


def _check_grid(grid: Any, dim: int) -> np.ndarray:
    shares = np.asarray(grid, dtype=np.float64)
    if dim != 2 or shares.ndim != 2 or not np.isfinite(shares).all():
        raise ValueError(f"grid: shape {shares.shape} in {dim}D must be finite (ny, nx) in 2D; leave it out in 3D")
    return shares.clip(0.0, 1.0)


def _check_particles(
    positions: Any, values: Any, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    dim = len(lower)
    points = np.asarray(positions, dtype=np.float64)
    numbers = np.asarray(values, dtype=np.float64)
    if points.size == 0:
        points = points.reshape(0, dim)
    if points.ndim != 2 or points.shape[1] != dim:
        raise ValueError(
            f"positions: shape {points.shape} must be (n, {dim}) as the box has {dim} axes; give one row per particle"
        )
    if numbers.shape != points.shape[:1]:
        raise ValueError(f"values: shape {numbers.shape} must be ({len(points)},); give one value per particle")
    near = np.abs(points - 0.5 * (lower + upper)) < _FARTHEST * np.linalg.norm(upper - lower)
    good = near.all(axis=1) & np.isfinite(numbers)
    return points[good], numbers[good]


def _check_range(value_range: Any, numbers: np.ndarray) -> tuple[float, float]:
    if value_range is None:
        low, high = (float(numbers.min()), float(numbers.max())) if len(numbers) else (0.0, 1.0)
        return (low, high) if high > low else (low, low + max(1.0, 1e-6 * abs(low)))
    if np.shape(value_range) != (2,):
        raise ValueError(f"value_range: {value_range!r} must be two numbers; give (low, high)")
    low, high = (number("value_range", end) for end in value_range)
    if not low < high:
        raise ValueError(f"value_range: ({low:g}, {high:g}) does not rise; give low below high")
    return low, high


def _check_size(size: Any) -> tuple[int, int]:
    sides = tuple(size) if isinstance(size, Sequence | np.ndarray) else (size,)
    whole = all(isinstance(side, int | np.integer) for side in sides)
    if len(sides) != 2 or not whole or not all(_SMALLEST <= side <= _LARGEST for side in sides):
        raise ValueError(
            f"size: {size!r} must be two whole numbers from {_SMALLEST} to {_LARGEST}; give (width, height) [px]"
        )
    return int(sides[0]), int(sides[1])


def _check_faces(
    faces: Mapping[str, Mapping[str, Any]] | None, lower: np.ndarray, upper: np.ndarray
) -> dict[str, Side]:
    given = dict(faces or {})
    checked = {}
    for axis in range(len(lower)):
        for outward, side, ends in ((-1, "min", lower), (1, "max", upper)):
            name = f"{_AXES[axis]}_{side}"
            entry = given.pop(name, {})
            kind = entry.get("kind", "wall")
            if kind not in KINDS:
                raise ValueError(f"faces[{name!r}]: kind {kind!r} must be one of {', '.join(KINDS)}")
            position = number(f"faces[{name!r}] position", entry.get("position", ends[axis]), "[m]")
            checked[name] = Side(axis, outward, kind, position, bool(entry.get("moving", False)))
    if given:
        raise ValueError(f"faces: {', '.join(map(repr, given))} unknown; use {', '.join(checked)}")
    return checked
