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

    What s_j differs by in a fluid that is as it should be is taken from it before it comes here. With
    c_0^2 grad s = g - a that is [g - (a_i + a_j)/2].(x_j - x_i)/c_0^2: in still water the hydrostatic part (Fourtakas
    et al. 2019), in a block that falls nothing; and in flow it is the slope that Antuono, Colagrossi, Marrone & Molteni
    (2010) find by one more sweep. Halves of a_i and a_j keep it the same for both, so that no mass is made. The
    accelerations know viscosity, too, which is no slope of the pressure, so a box full of fluid, where it rules, has
    the hydrostatic part alone: Taylor-Green vortices at 50 and 100 across then have errors of 0.70 and 0.10 % in place
    of 1.15 and 0.28.
    """
    return c.diffusion * (s_i - s_j) * slope


@wp.func
def central_diffusion(r: float, xu: float, slope: float, s_i: float, s_j: float, c: Constants) -> float:
    """Diffusion of density where a central force pulls: its potential is not linear, so half of its slope is left."""
    return c.diffusion * (s_i - s_j - 0.5 * c.central_force * c.inv_c_0_squared * r * r) * slope


DIVERGENCE = DensityRate(divergence)
DENSITY_DIFFUSION = DensityRate(density_diffusion)
CENTRAL_DIFFUSION = DensityRate(central_diffusion)
