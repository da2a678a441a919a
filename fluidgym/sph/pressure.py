"""The pressure force."""

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.terms import Force


@wp.func
def pressure_gradient(r: float, xu: float, slope: float, P_i: float, P_j: float, c: Constants) -> float:
    """-c_0^2 sum V (P_i + P_j) grad W, P = p / (rho_0 c_0^2) (after Bonet & Lok 1999, with rest volumes).

    It conserves momentum, and takes from the motion just the energy that the continuity equation of this package,
    ds/dt = sum V u_ij . grad W, puts into compression. Division by rho^2 (Monaghan 1992) would do neither better and
    bias the pressure of still water by twice its density error.
    """
    return -c.c_0 * c.c_0 * (P_i + P_j) * slope


PRESSURE_GRADIENT = Force(pressure_gradient)
