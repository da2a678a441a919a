"""How density changes: the continuity equation and its diffusion."""

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.terms import DensityRate


@wp.func
def divergence(r: float, xu: float, slope: float, s_i: float, s_j: float, c: Constants) -> float:
    """Compression, ds_i/dt = sum V u_ij . grad W (Monaghan 1992, eq. 2.18, over rho_0)."""
    return xu * slope


@wp.func
def density_diffusion(r: float, xu: float, slope: float, s_i: float, s_j: float, c: Constants) -> float:
    """Diffusion of density, 2 delta h c_0 sum V (s_j - s_i) (x_j - x_i).grad W / r^2 (Molteni & Colagrossi 2009).

    The hydrostatic part g.(x_j - x_i)/c_0^2 is taken from s_j before it comes here (Fourtakas et al. 2019).
    """
    return c.diffusion * (s_i - s_j) * slope


@wp.func
def central_diffusion(r: float, xu: float, slope: float, s_i: float, s_j: float, c: Constants) -> float:
    """Diffusion of density where a central force pulls: its potential is not linear, so half of its slope is left."""
    return c.diffusion * (s_i - s_j - 0.5 * c.central_force * c.inv_c_0_squared * r * r) * slope


DIVERGENCE = DensityRate(divergence)
DENSITY_DIFFUSION = DensityRate(density_diffusion)
CENTRAL_DIFFUSION = DensityRate(central_diffusion)
