"""Viscous forces."""

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.terms import Force


@wp.func
def viscosity_monaghan(r: float, xu: float, slope: float, P_i: float, P_j: float, c: Constants) -> float:
    """K sum V (x_ij.u_ij)/(r^2 + eta^2) grad W, K = alpha h c_0 + 2 (dim + 2) nu (Monaghan & Gingold 1983).

    It acts on pairs that part as on pairs that meet, and keeps angular momentum.
    """
    return c.viscosity * xu * slope / (r * r + c.eta_squared)


VISCOSITY_MONAGHAN = Force(viscosity_monaghan)
