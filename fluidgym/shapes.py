"""Shapes in space: where fluid or a solid is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real

import numpy as np

from fluidgym.checks import Point, check_type, set_point

PointFunction = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Box:
    """An axis-aligned box of fluid between two corners [m], each (dim,)."""

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        set_point(self, "lower", "m")
        set_point(self, "upper", "m")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, dim) [m] lie inside: bool (n,)."""
        return np.all((points >= self.lower) & (points < self.upper), axis=1)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (n, dim) from the surface [m], negative inside, (n,)."""
        low, high = self.bounds()
        beyond = np.abs(points - 0.5 * (low + high)) - 0.5 * (high - low)
        return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner [m], each (dim,)."""
        return np.asarray(self.lower, float), np.asarray(self.upper, float)


@dataclass(frozen=True)
class Ball:
    """A disc (two dimensions) or ball (three): center [m] (dim,) and radius [m]."""

    center: Point
    radius: float

    def __post_init__(self) -> None:
        set_point(self, "center", "m")
        check_type("Ball.radius", self.radius, Real, "a number", "a positive one [m]")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, dim) [m] lie inside: bool (n,)."""
        return self.distance(points) < 0.0

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance of points (n, dim) from the surface [m], negative inside, (n,)."""
        return np.linalg.norm(points - np.asarray(self.center), axis=1) - self.radius

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

    def __post_init__(self) -> None:
        check_type(
            "Region.predicate", self.predicate, Callable, "a function", "one of points (n, dim) [m] -> bool (n,)"
        )
        set_point(self, "lower", "m")
        set_point(self, "upper", "m")

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
