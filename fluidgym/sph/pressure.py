"""The pressure force."""

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.terms import Force


@wp.func
def pressure_gradient(r: float, xu: float, slope: float, P_i: float, P_j: float, c: Constants) -> float:
    """-c_0^2 sum V (P_i + P_j) grad W, P = p rho_0 / (c_0^2 rho^2): conserves momentum (Monaghan 1992, eq. 3.3)."""
    return -c.c_0 * c.c_0 * (P_i + P_j) * slope


PRESSURE_GRADIENT = Force(pressure_gradient)
