"""The numbers a step needs, one record for each world, so that values change without compiling anew."""

import warp as wp


@wp.struct
class Constants:
    """Numbers of one world, as the device reads them."""

    dt: float  # time step [s]
    spacing: float  # particle spacing dx [m]
    h: float  # smoothing length [m]
    support: float  # radius beyond which the smoothing kernel is zero [m]
    skin: float  # how far two particles may approach between the sort and the second sweep [m]
    inv_h: float  # [1/m]
    inv_h_volume: float  # 1 / h^dim [1/m^dim]
    inv_h_slope: float  # 1 / h^(dim+2) [1/m^(dim+2)]
    core: float  # how much steeper W' is at r = 0 than the kernel's, over that
    inv_core_radius: float  # 1 over the distance below which it is steeper [1/m]
    volume: float  # rest volume of a particle, dx^dim [m^dim]
    c_0: float  # speed of sound [m/s]
    inv_c_0_squared: float  # [s2/m2]
    gamma: float  # exponent of Tait's equation
    diffusion: float  # 2 delta h c_0 [m2/s]
    damping: float  # of sound, b h / c_0; 0 where no time passes [s]
    full_company: float  # sum of V |W'/r| h^2 over a full neighbourhood
    artificial_viscosity: float  # alpha h c_0, less viscosity_monaghan [m2/s]
    viscosity: float  # nu [m2/s]
    viscosity_monaghan: float  # 2 (dim + 2) nu [m2/s]
    density_unit: float  # 1 over the sum of V W on a lattice at rest, where density is a sum
    thermal_diffusivity: float  # [m2/s]
    central_force: float  # pull to the origin over the distance [1/s2]
    shifting: float  # A U h of the particle shifting [m2/s]
    level: float  # density error whose pressure is added throughout a shifted box
    wall_stiffness: float  # of a penalty wall [1/s2]
    wall_margin: float  # reach of a penalty wall [m]
    wall_damping: float  # share of its normal speed that a particle keeps when a clamping wall throws it back
    force_unit: float  # what an acceleration of 1 m/s2 is in the fixed point of the sums of forces [s2/m]
    eta_squared: float  # keeps x.u / r^2 finite as r -> 0 [m2]
