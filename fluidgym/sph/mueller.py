"""The terms of Mueller, Charypar & Gross (2003): density by summation, and forces with a kernel for each.

With m = rho_0 V, p = rho_0 c_0^2 P and rho_i = rho_0 (1 + s_i) their equations 3, 10 and 14 divided by rho_i read

    1 + s_i = sum V W_poly6
    a_i     = -c_0^2 sum V (P_i + P_j) / (2 (1 + s_i) (1 + s_j)) grad W_spiky
              + nu sum V (u_j - u_i) / ((1 + s_i) (1 + s_j)) Laplacian W_viscosity

rho_i is that of the sum, so that the forces of a pair are equal and opposite. The forces read s, not P: a state
equation without tension forgets s where it cuts P.

Momentum is kept, energy is not: the pressure works along the Spiky kernel and is stored by the Poly6 one, so the force
is the gradient of nothing, and a fluid stirred without friction gains energy at a rate of up to a third of c_0/h. A
viscosity nu of about c_0 h / 160 takes out what that puts in; twice that where walls clamp.
"""

from functools import lru_cache

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.smoothing import POLY6, SPIKY, VISCOSITY_KERNEL
from fluidgym.sph.state_equation import StateEquation
from fluidgym.sph.terms import DensitySum, Drag, Force

POLY6_SUMMATION = DensitySum(weight=POLY6.value)


@lru_cache
def spiky_pressure(state_equation: StateEquation) -> Force:
    """The pressure force for a state equation (Mueller et al. 2003, eq. 10)."""
    of = state_equation.pressure

    @wp.func
    def pressure(r: float, xu: float, slope: float, s_i: float, s_j: float, c: Constants) -> float:
        return -0.5 * c.c_0 * c.c_0 * (of(s_i, c) + of(s_j, c)) / ((1.0 + s_i) * (1.0 + s_j)) * slope

    return Force(pressure, SPIKY.slope, reads_density=True)


@wp.func
def kernel_viscosity(r: float, xu: float, laplacian: float, s_i: float, s_j: float, c: Constants) -> float:
    """-nu sum V u_ij / ((1 + s_i) (1 + s_j)) Laplacian W (Mueller et al. 2003, eq. 14)."""
    return -c.viscosity * laplacian / ((1.0 + s_i) * (1.0 + s_j))


KERNEL_VISCOSITY = Drag(kernel_viscosity, VISCOSITY_KERNEL.laplacian, reads_density=True)
