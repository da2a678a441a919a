"""Smoothing kernels W(r, h): what a particle's neighbours weigh.

A kernel is two plain Warp functions of the distance, and its normalisation for each dimension.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from fluidgym.sph.constants import Constants


@dataclass(frozen=True)
class SmoothingKernel:
    """A smoothing kernel.

    Attributes:
        name: As in reports.
        support: Radius beyond which it is zero, over the smoothing length h.
        sigma: Normalisation at h = 1 as a function of the dimension.
        value: Warp function (r, Constants) -> W [1/m^dim].
        slope: Warp function (r, Constants) -> W'(r) / r [1/m^(dim+2)], finite at r = 0.
    """

    name: str
    support: float
    sigma: Callable[[int], float]
    value: wp.Function
    slope: wp.Function


@wp.func
def wendland_c2_value(r: float, c: Constants) -> float:
    """W = sigma (1 - q/2)^4 (2 q + 1), q = r/h (Wendland 1995)."""
    t = wp.max(1.0 - r * c.inv_support, 0.0)
    return c.kernel_value * t * t * t * t * (5.0 - 4.0 * t)


@wp.func
def wendland_c2_slope(r: float, c: Constants) -> float:
    """W'/r = -5 sigma/h^2 (1 - q/2)^3: the same polynomial, differentiated."""
    t = wp.max(1.0 - r * c.inv_support, 0.0)
    return -5.0 * c.kernel_slope * t * t * t


WENDLAND_C2 = SmoothingKernel(
    name="Wendland C2",
    support=2.0,
    sigma={2: 7.0 / (4.0 * math.pi), 3: 21.0 / (16.0 * math.pi)}.__getitem__,
    value=wendland_c2_value,
    slope=wendland_c2_slope,
)
