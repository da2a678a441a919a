"""What stands in the box beside the water: solid bodies, nozzles and outflows, checked once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fluidgym.render.checks import box, number, positive

_FARTHEST = 1e5  # What reaches farther from the middle of the box, in box diagonals, is cut off there.
_MISSING = object()
_SHAPES = {"box": ("lower", "upper"), "ball": ("center", "radius")}
_NOZZLE = ("center", "direction", "width", "height", "length", "on", "name")


@dataclass(frozen=True)
class Solid:
    """A solid body.

    Attributes:
        lower: Lower corner of its bounds (dim,) [m].
        upper: Upper corner of its bounds (dim,) [m].
        round: Whether it is a ball, not a box.
        moving: Whether it is driven.
    """

    lower: np.ndarray
    upper: np.ndarray
    round: bool
    moving: bool


@dataclass(frozen=True)
class Nozzle:
    """A pipe from which fluid comes.

    Attributes:
        center: Middle of its closed back end (dim,) [m].
        axes: Unit vectors along the pipe and across it, one a row (dim, dim); in 3D the second is horizontal.
        length: Of the pipe [m].
        half: Half the sides of its opening (dim - 1,) [m].
        round: Whether the opening is round.
        on: Whether fluid comes now.
    """

    center: np.ndarray
    axes: np.ndarray
    length: float
    half: np.ndarray
    round: bool
    on: bool


def check_bodies(bodies: Any, lower: np.ndarray, upper: np.ndarray) -> tuple[Solid, ...]:
    """Check the bodies of ``draw_frame`` for a box between two corners (dim,) [m]."""
    solids = []
    for name, entry in _entries("bodies", bodies, '{"shape": "box", "lower": ..., "upper": ...}'):
        shape = entry.get("shape", _MISSING)
        if not isinstance(shape, str) or shape not in _SHAPES:
            given = "missing" if shape is _MISSING else f"{shape!r} unknown"
            raise ValueError(f"{name} shape: {given}; use {' or '.join(map(repr, _SHAPES))}")
        _check_keys(name, entry, ("shape", *_SHAPES[shape], "moving", "name"), _SHAPES[shape])
        if shape == "box":
            low, high = (_nearby(end, lower, upper) for end in _box(name, entry, len(lower)))
        else:
            center = _nearby(_point(f"{name} center", entry["center"], len(lower), "[m]"), lower, upper)
            radius = positive(f"{name} radius", entry["radius"], "give the radius of the ball")
            radius = min(radius, _reach(lower, upper))
            low, high = center - radius, center + radius
        solids.append(Solid(low, high, shape == "ball", bool(entry.get("moving", False))))
    return tuple(solids)


def check_inflows(inflows: Any, lower: np.ndarray, upper: np.ndarray) -> tuple[Nozzle, ...]:
    """Check the inflows of ``draw_frame`` for a box between two corners (dim,) [m]."""
    dim, reach = len(lower), _reach(lower, upper)
    nozzles = []
    for name, entry in _entries("inflows", inflows, '{"center": ..., "direction": ..., "width": ..., "length": ...}'):
        _check_keys(name, entry, _NOZZLE, ("center", "direction", "width", "length"))
        center = _nearby(_point(f"{name} center", entry["center"], dim, "[m]"), lower, upper)
        direction = _point(f"{name} direction", entry["direction"], dim)
        if not direction.any():
            raise ValueError(f"{name} direction: {direction.tolist()} has no length; give the way the fluid leaves")
        sides = [positive(f"{name} width", entry["width"], "give the width of the opening")]
        height = entry.get("height")
        if height is not None:
            if dim == 2:
                raise ValueError(f"{name} height: {height!r} is for three dimensions, not 2; leave it out")
            sides.append(positive(f"{name} height", height, "give the height of the opening, or None for a round one"))
        length = positive(f"{name} length", entry["length"], "give the length of the pipe")
        half = 0.5 * np.minimum((sides * 2)[: dim - 1], reach)
        round_ = dim == 3 and height is None
        nozzles.append(
            Nozzle(center, _pipe_axes(direction), min(length, reach), half, round_, bool(entry.get("on", True)))
        )
    return tuple(nozzles)


def check_outflows(outflows: Any, lower: np.ndarray, upper: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Check the outflows of ``draw_frame`` for a box between two corners (dim,) [m]."""
    regions = []
    for name, entry in _entries("outflows", outflows, '{"lower": ..., "upper": ...}'):
        _check_keys(name, entry, ("lower", "upper", "name"), ("lower", "upper"))
        low, high = _box(name, entry, len(lower))
        regions.append((_nearby(low, lower, upper), _nearby(high, lower, upper)))
    return tuple(regions)


def _entries(what: str, given: Any, example: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the name of each entry, as in messages, and the entry."""
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise ValueError(f"{what}: {_short(given)} must be a sequence of dicts; give [{example}]")
    for index, entry in enumerate(given):
        if not isinstance(entry, Mapping):
            raise ValueError(f"{what}[{index}]: {_short(entry)} must be a dict; give {example}")
        called = f" ({entry['name']!r})" if "name" in entry else ""
        yield f"{what}[{index}]{called}", entry


def _check_keys(name: str, entry: Mapping[str, Any], known: Sequence[str], needed: Sequence[str]) -> None:
    unknown = [key for key in entry if key not in known]
    if unknown:
        raise ValueError(f"{name}: {', '.join(map(repr, unknown))} unknown; use {', '.join(known)}")
    for key in needed:
        if key not in entry:
            raise ValueError(f"{name} {key}: missing; give {', '.join(needed)}")


def _short(value: Any) -> str:
    return " ".join(repr(value).split())


def _box(name: str, entry: Mapping[str, Any], dim: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = (_point(f"{name} {end}", entry[end], dim, "[m]") for end in ("lower", "upper"))
    return box(f"{name} lower", low, f"{name} upper", high)


def _point(name: str, value: Any, dim: int, unit: str = "") -> np.ndarray:
    parts = list(value) if np.iterable(value) else []
    if len(parts) != dim:
        raise ValueError(
            f"{name}: {_short(value)} must be {dim} numbers as the box has {dim} axes; give one an axis {unit}".rstrip()
        )
    return np.array([number(name, part, unit) for part in parts])


def _reach(lower: np.ndarray, upper: np.ndarray) -> float:
    return _FARTHEST * float(np.linalg.norm(upper - lower))


def _nearby(point: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return a point, moved to where numbers are still safe if it is beyond."""
    middle, reach = 0.5 * (lower + upper), _reach(lower, upper)
    return np.clip(point, middle - reach, middle + reach)


def _pipe_axes(direction: np.ndarray) -> np.ndarray:
    """Return unit vectors along a pipe and across it (dim, dim); in 3D the second is horizontal."""
    along = direction / np.abs(direction).max()
    along = along / np.linalg.norm(along)
    if len(along) == 2:
        return np.array([along, [-along[1], along[0]]])
    level = np.array([-along[1], along[0], 0.0])
    size = float(np.linalg.norm(level))
    level = level / size if size > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.stack([along, level, np.cross(along, level)])
