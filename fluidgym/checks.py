"""What bad input is told: one line that names the field, the value, the limit and the remedy."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import numpy as np

Point = tuple[float, ...]


def check_type(name: str, value: Any, kinds: Any, what: str, remedy: str) -> None:
    """Refuse a value of a wrong type.

    Args:
        name: Of the field, as in the message.
        value: The value.
        kinds: Type or types that it may have.
        what: Those types in words.
        remedy: What to use.

    Raises:
        ValueError: It has none of the types.
    """
    if not isinstance(value, kinds):
        raise ValueError(f"{name} = {shown(value)} is not {what}; use {remedy}")


def shown(value: Any) -> str:
    """A value as in a message: in one line."""
    return " ".join(repr(value).split())


def check_choice(name: str, value: Any, choices: tuple[str, ...], remedy: str) -> None:
    """Refuse a word that is not one of the choices."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} = {shown(value)} is unknown; use {remedy}")


def point(name: str, value: Any, unit: str, remedy: str) -> Point:
    """A sequence of finite numbers as a tuple of floats; anything else is refused."""
    if not (np.iterable(value) and all(isinstance(component, Real) for component in value)):
        raise ValueError(f"{name} = {shown(value)} is not a sequence of numbers [{unit}]; {remedy}")
    point = tuple(float(component) for component in value)
    if not all(math.isfinite(component) for component in point):
        raise ValueError(f"{name} = {point} must be finite; give numbers")
    return point


def set_point(owner: Any, name: str, unit: str, remedy: str = "give one for each axis") -> None:
    """Check a field of a frozen object and make it a tuple of floats."""
    checked = point(f"{type(owner).__name__}.{name}", getattr(owner, name), unit, remedy)
    object.__setattr__(owner, name, checked)


def check_number(name: str, value: float, unit: str, above: float | None = None, least: float | None = None) -> None:
    """Refuse what is not a finite number above or at least a limit."""
    check_type(name, value, Real, "a number", f"one in {unit}")
    if not math.isfinite(value):
        raise ValueError(f"{name} = {value} {unit} must be finite; give a number")
    if above is not None and value <= above:
        raise ValueError(f"{name} = {value:g} {unit} must be greater than {above:g}; give a positive value")
    if least is not None and value < least:
        raise ValueError(f"{name} = {value:g} {unit} is below the limit {least:g}; use {least:g} or more")


def check_range(name: str, value: float, low: float, high: float, advice: str) -> None:
    """Refuse what is not a number within limits."""
    check_type(name, value, Real, "a number", advice)
    if not low <= value <= high:
        raise ValueError(f"{name} = {value:g} is outside {low:g} to {high:g}; use {advice}")
