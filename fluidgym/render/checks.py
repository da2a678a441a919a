"""Checks that the arguments of a drawing share: numbers, points and boxes."""

from __future__ import annotations

from typing import Any

import numpy as np


def number(name: str, value: Any, unit: str = "") -> float:
    """Return a finite number; anything else is refused in one line."""
    try:
        finite = float(value)
    except (TypeError, ValueError):
        finite = np.nan
    if not np.isfinite(finite):
        raise ValueError(f"{name}: {value!r} is not a finite number; give one number {unit}".rstrip())
    return finite


def positive(name: str, value: Any, remedy: str) -> float:
    """Return a length above 0 [m]; anything else is refused in one line."""
    length = number(name, value, "[m]")
    if length <= 0.0:
        raise ValueError(f"{name}: {length:g} m is not above 0; {remedy}")
    return length


def corner(name: str, value: Any) -> np.ndarray:
    """Return 2 or 3 finite numbers; anything else is refused in one line."""
    try:
        point = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        point = np.empty(0)
    if point.shape not in ((2,), (3,)) or not np.isfinite(point).all():
        raise ValueError(f"{name}: {value!r} is not 2 or 3 finite numbers; give a corner [m]")
    return point


def box(low_name: str, low: Any, high_name: str, high: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return two opposite corners, the lower one first; anything else is refused in one line."""
    lower, upper = corner(low_name, low), corner(high_name, high)
    if lower.shape != upper.shape or not (lower < upper).all():
        raise ValueError(
            f"{high_name}: {upper.tolist()} is not above {low_name} {lower.tolist()} on every axis; "
            "give two opposite corners [m]"
        )
    return lower, upper
