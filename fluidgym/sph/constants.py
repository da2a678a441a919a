"""The numbers a step needs, one record for each world, so that values change without compiling anew."""

import warp as wp


@wp.struct
class Constants:
    """Numbers of one world, as the device reads them."""

    dt: float  # time step [s]
    spacing: float  # particle spacing dx [m]
    h: float  # smoothing length [m]
    support: float  # radius beyond which the smoothing kernel is zero [m]
    inv_support: float  # [1/m]
    skin: float  # how far two particles may approach between the sort and the second sweep [m]
    kernel_value: float  # normalisation sigma of the smoothing kernel [1/m^dim]
    kernel_slope: float  # sigma / h^2 [1/m^(dim+2)]
    volume: float  # rest volume of a particle, dx^dim [m^dim]
    c_0: float  # speed of sound [m/s]
    inv_c_0_squared: float  # [s2/m2]
    gamma: float  # exponent of Tait's equation
    diffusion: float  # 2 delta h c_0 [m2/s]
    artificial_viscosity: float  # alpha h c_0, less viscosity_monaghan [m2/s]
    viscosity: float  # nu [m2/s]
    viscosity_monaghan: float  # 2 (dim + 2) nu [m2/s]
    eta_squared: float  # keeps x.u / r^2 finite as r -> 0 [m2]
