"""Heat: how temperature spreads."""

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.terms import DensityRate


@wp.func
def conduction(r: float, xu: float, slope: float, T_i: float, T_j: float, c: Constants) -> float:
    """dT_i/dt = 2 kappa sum V (T_i - T_j) W'/r: the Laplacian of the temperature (Cleary & Monaghan 1999, eq. 22)."""
    return 2.0 * c.thermal_diffusivity * (T_i - T_j) * slope


CONDUCTION = DensityRate(conduction)  # a sum of the same kind, of another field
