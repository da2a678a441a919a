"""Smoothing kernels W(r, h): what a particle's neighbours weigh.

A kernel is written in q = r/h and without its normalisation; value, slope and laplacian make Warp functions of (r, c)
from it for a number of dimensions.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import warp as wp

from fluidgym.precision import real
from fluidgym.sph.constants import Constants

Shape = wp.Function | tuple[wp.Function, wp.Function]


@dataclass(frozen=True)
class SmoothingKernel:
    """A smoothing kernel W = sigma / h^dim w(q), q = r/h.

    Attributes:
        name: As in reports.
        support: Radius beyond which it is zero, over the smoothing length h.
        sigma_2d: Normalisation in two dimensions.
        sigma_3d: Normalisation in three dimensions.
        w: Warp function q -> w(q); a pair is one for two dimensions and one for three.
        dw: Warp function q -> w'(q) / q, finite at q = 0; a function or a pair.
        ddw: Warp function q -> the Laplacian of w, for a kernel that is made for it; a function, a pair, or None.
        breadth: The usual smoothing length over that of Wendland C2: a kernel that falls off sooner wants more.
    """

    name: str
    support: float
    sigma_2d: float
    sigma_3d: float
    w: Shape
    dw: Shape
    ddw: Shape | None = None
    breadth: float = 1.0

    def sigma(self, dim: int) -> float:
        """Normalisation at h = 1."""
        return {2: self.sigma_2d, 3: self.sigma_3d}[dim]

    def slope_of(self, q: float) -> float:
        """w'(q)/q, in plain Python."""
        return float(_in(self.dw, 2)(real(q)))

    def value(self, dim: int) -> wp.Function:
        """Warp function (r, Constants) -> W [1/m^dim]."""
        return _scaled(_in(self.w, dim), self.sigma(dim), False)

    def slope(self, dim: int, cored: bool = False) -> wp.Function:
        """Warp function (r, Constants) -> W'(r)/r [1/m^(dim+2)], finite at r = 0; that with a core on request."""
        slope = _scaled(_in(self.dw, dim), self.sigma(dim), True)
        return with_core(slope) if cored else slope

    def laplacian(self, dim: int) -> wp.Function:
        """Warp function (r, Constants) -> the Laplacian of W [1/m^(dim+2)].

        Raises:
            ValueError: The kernel has none of its own.
        """
        if self.ddw is None:
            raise ValueError(f"{self.name} has no Laplacian of its own; use VISCOSITY_KERNEL")
        return _scaled(_in(self.ddw, dim), self.sigma(dim), True)


def _in(shape: Shape, dim: int) -> wp.Function:
    """The function for that many dimensions."""
    return shape[dim - 2] if isinstance(shape, tuple) else shape


@lru_cache
def _scaled(shape: wp.Function, sigma: float, second: bool) -> wp.Function:
    """A function of q with its units: those of W, or those of its second derivative."""

    @wp.func
    def weight(r: float, c: Constants) -> float:
        return sigma * c.inv_h_volume * shape(r * c.inv_h)

    @wp.func
    def second_derivative(r: float, c: Constants) -> float:
        return sigma * c.inv_h_slope * shape(r * c.inv_h)

    return second_derivative if second else weight


@lru_cache
def with_core(slope: wp.Function) -> wp.Function:
    """A slope W'(r)/r that is steeper where particles are closer than any lattice has them.

    The push of a pair is W', which for a smooth kernel has its peak at some half the smoothing length and falls to
    nothing at r = 0. Where the fluid is a particle or two thick, with few neighbours to hold a pair apart, two
    particles, or one and its image in a wall, then collapse onto each other, and the tip of a tongue of water stays
    behind by as much. The continuity equation and the pressure force share the slope, so energy is kept as with any
    kernel.
    """

    @wp.func
    def cored_slope(r: float, c: Constants) -> float:
        return slope(r, c) * (1.0 + c.core * wp.max(1.0 - r * c.inv_core_radius, 0.0))

    return cored_slope


@wp.func
def wendland_c2(q: float) -> float:
    """(1 - q/2)^4 (2 q + 1) (Wendland 1995)."""
    t = wp.max(1.0 - 0.5 * q, 0.0)
    return t * t * t * t * (5.0 - 4.0 * t)


@wp.func
def wendland_c2_slope(q: float) -> float:
    """-5 (1 - q/2)^3."""
    t = wp.max(1.0 - 0.5 * q, 0.0)
    return -5.0 * t * t * t


@wp.func
def wendland_c4(q: float) -> float:
    """(1 - q/2)^6 (35 q^2/12 + 3 q + 1) (Wendland 1995)."""
    t = wp.max(1.0 - 0.5 * q, 0.0)
    return t * t * t * t * t * t * ((35.0 / 12.0 * q + 3.0) * q + 1.0)


@wp.func
def wendland_c4_slope(q: float) -> float:
    """-(1 - q/2)^5 (14/3 + 35 q/3)."""
    t = wp.max(1.0 - 0.5 * q, 0.0)
    return -t * t * t * t * t * (14.0 / 3.0 + 35.0 / 3.0 * q)


@wp.func
def cubic_spline(q: float) -> float:
    """((2 - q)^3 - 4 (1 - q)^3) / 4, each part where it is positive (Monaghan & Lattanzio 1985)."""
    a = wp.max(2.0 - q, 0.0)
    b = wp.max(1.0 - q, 0.0)
    return 0.25 * a * a * a - b * b * b


@wp.func
def cubic_spline_slope(q: float) -> float:
    """(3 b^2 - 3 a^2/4) / q, with the 1/q taken out: for q < 1 it is 9 q/4 - 3."""
    p = wp.max(q, 1.0)
    a = wp.max(2.0 - p, 0.0)
    return 2.25 * wp.min(q, 1.0) - 2.25 - 0.75 * a * a / p


@wp.func
def poly6(q: float) -> float:
    """(1 - q^2)^3 (Mueller, Charypar & Gross 2003, eq. 20)."""
    t = wp.max(1.0 - q * q, 0.0)
    return t * t * t


@wp.func
def poly6_slope(q: float) -> float:
    """-6 (1 - q^2)^2."""
    t = wp.max(1.0 - q * q, 0.0)
    return -6.0 * t * t


@wp.func
def spiky(q: float) -> float:
    """(1 - q)^3 (Mueller et al. 2003, eq. 21)."""
    t = wp.max(1.0 - q, 0.0)
    return t * t * t


@wp.func
def spiky_slope(q: float) -> float:
    """-3 (1 - q)^2 / q; the kernel has a cusp, so that 1/q is held at a thousand."""
    t = wp.max(1.0 - q, 0.0)
    return -3.0 * t * t / wp.max(q, 1.0e-3)


@wp.func
def viscosity_2d(q: float) -> float:
    """q^2/4 - q^3/9 - ln(q)/6 - 5/36: what has the Laplacian 1 - q and ends smoothly at q = 1; cut at a thousandth."""
    p = wp.clamp(q, 1.0e-3, 1.0)
    t = 1.0 - p
    # The polynomial about q = 1, so that the end is exact: the constant is written out of it.
    return -wp.log(p) / 6.0 - t / 6.0 - t * t / 12.0 + t * t * t / 9.0


@wp.func
def viscosity_2d_slope(q: float) -> float:
    """1/2 - q/3 - 1/(6 q^2), factored."""
    p = wp.clamp(q, 1.0e-3, 1.0)
    return -(1.0 - p) * (1.0 - p) * (1.0 + 2.0 * p) / (6.0 * p * p)


@wp.func
def viscosity_2d_laplacian(q: float) -> float:
    """1 - q."""
    return wp.max(1.0 - q, 0.0)


@wp.func
def viscosity_3d(q: float) -> float:
    """-q^3/2 + q^2 + 1/(2 q) - 1 (Mueller et al. 2003, eq. 22); factored; cut at a thousandth."""
    p = wp.clamp(q, 1.0e-3, 1.0)
    t = 1.0 - p
    return t * t * t * (1.0 + p) / (2.0 * p)


@wp.func
def viscosity_3d_slope(q: float) -> float:
    """2 - 3 q/2 - 1/(2 q^3), factored."""
    p = wp.clamp(q, 1.0e-3, 1.0)
    return -(1.0 - p) * (1.0 - p) * ((3.0 * p + 2.0) * p + 1.0) / (2.0 * p * p * p)


@wp.func
def viscosity_3d_laplacian(q: float) -> float:
    """6 (1 - q)."""
    return 6.0 * wp.max(1.0 - q, 0.0)


WENDLAND_C2 = SmoothingKernel(
    "Wendland C2", 2.0, 7.0 / (4.0 * math.pi), 21.0 / (16.0 * math.pi), wendland_c2, wendland_c2_slope
)
WENDLAND_C4 = SmoothingKernel(
    "Wendland C4", 2.0, 9.0 / (4.0 * math.pi), 495.0 / (256.0 * math.pi), wendland_c4, wendland_c4_slope, breadth=1.1
)
CUBIC_SPLINE = SmoothingKernel(
    "cubic spline", 2.0, 10.0 / (7.0 * math.pi), 1.0 / math.pi, cubic_spline, cubic_spline_slope
)
POLY6 = SmoothingKernel("Poly6", 1.0, 4.0 / math.pi, 315.0 / (64.0 * math.pi), poly6, poly6_slope)
SPIKY = SmoothingKernel("Spiky", 1.0, 10.0 / math.pi, 15.0 / math.pi, spiky, spiky_slope)
VISCOSITY_KERNEL = SmoothingKernel(
    "viscosity",
    1.0,
    40.0 / math.pi,
    7.5 / math.pi,
    (viscosity_2d, viscosity_3d),
    (viscosity_2d_slope, viscosity_3d_slope),
    (viscosity_2d_laplacian, viscosity_3d_laplacian),
)
