"""Viscous forces."""

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.terms import Drag, Force


@wp.func
def inverse_square(r2: float, c: Constants) -> float:
    """1 / (r^2 + eta^2)."""
    # The maximum, which changes nothing, keeps compilers from dividing last of all: the division is the slowest of a
    # pair's operations, and can be under way while the slope is found (8 % of the force sweep in 3D).
    return wp.max(1.0 / (r2 + c.eta_squared), 0.0)


@wp.func
def artificial_viscosity(r2: float, xu: float, slope: float, P_i: float, P_j: float, c: Constants) -> float:
    """alpha h c_0 sum V (x_ij.u_ij)/(r^2 + eta^2) grad W (Monaghan & Gingold 1983).

    It acts on pairs that part as on pairs that meet, and keeps angular momentum.
    """
    return c.artificial_viscosity * xu * slope * inverse_square(r2, c)


@wp.func
def viscosity_monaghan(r2: float, xu: float, slope: float, P_i: float, P_j: float, c: Constants) -> float:
    """2 (dim + 2) nu sum V (x_ij.u_ij)/(r^2 + eta^2) grad W (Monaghan 2005, eq. 8.8).

    It keeps angular momentum; on a lattice at the default smoothing length it acts 12 % (2D) to 14 % (3D) too weak.
    """
    return c.viscosity_monaghan * xu * slope * inverse_square(r2, c)


@wp.func
def viscosity_morris(r: float, xu: float, slope: float, P_i: float, P_j: float, c: Constants) -> float:
    """2 nu sum V u_ij W'/r (Morris, Fox & Zhu 1997, eq. 22): the Laplacian of the velocity."""
    return 2.0 * c.viscosity * slope


ARTIFICIAL_VISCOSITY = Force(artificial_viscosity, squared=True)
VISCOSITY_MONAGHAN = Force(viscosity_monaghan, squared=True)
VISCOSITY_MORRIS = Drag(viscosity_morris)
