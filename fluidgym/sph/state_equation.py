"""Pressure from density.

Each function gives p / (rho_0 c_0^2) from the relative density error s = rho/rho_0 - 1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from fluidgym.sph.constants import Constants


@dataclass(frozen=True)
class StateEquation:
    """A state equation.

    Attributes:
        name: As in reports.
        pressure: Warp function (s, Constants) -> p / (rho_0 c_0^2).
        pressure_of: The same in NumPy: (s, gamma) -> p / (rho_0 c_0^2).
        density_of: Its inverse in NumPy: (p / (rho_0 c_0^2), gamma) -> s.
    """

    name: str
    pressure: wp.Function
    pressure_of: Callable[[np.ndarray, Any], np.ndarray]
    density_of: Callable[[np.ndarray, Any], np.ndarray]


@wp.func
def linear_pressure(s: float, c: Constants) -> float:
    """p = c_0^2 (rho - rho_0)."""
    return s


@wp.func
def tait_pressure(s: float, c: Constants) -> float:
    """p = rho_0 c_0^2 / gamma ((rho/rho_0)^gamma - 1) (Cole 1948)."""
    return (wp.pow(1.0 + s, c.gamma) - 1.0) / c.gamma


@wp.func
def itself(s: float, c: Constants) -> float:
    """The relative density error, for forces that read it."""
    return s


LINEAR = StateEquation("linear", linear_pressure, lambda s, gamma: s, lambda p, gamma: p)
TAIT = StateEquation(
    "Tait",
    tait_pressure,
    lambda s, gamma: ((1.0 + s) ** gamma - 1.0) / gamma,
    lambda p, gamma: (1.0 + gamma * p) ** (1.0 / gamma) - 1.0,
)


@lru_cache
def torn_at(equation: StateEquation, tear: float) -> StateEquation:
    """The same state equation with its negative pressures cut off, so that fluid tears instead of clumping.

    s itself is not cut: where fluid has torn it tells how much is void, and until that closes there is no pressure.

    Args:
        equation: Any.
        tear: Largest tension, -p / (rho_0 c_0^2); 0 allows none.
    """
    pressure = equation.pressure

    @wp.func
    def pressure_or_torn(s: float, c: Constants) -> float:
        return wp.max(pressure(s, c), wp.static(-tear))

    return StateEquation(
        f"{equation.name} without tension" if tear == 0.0 else f"{equation.name}, torn at {tear:g}",
        pressure_or_torn,
        lambda s, gamma: np.maximum(equation.pressure_of(s, gamma), -tear),
        equation.density_of,
    )
