"""One step in time: kick, drift, density, drift, force, kick.

The velocity-Verlet form of leapfrog with the density advanced at its middle, where positions and velocities are both
known at the half step (second order; reversible but for the dissipative terms):

    u(n+1/2) = u(n) + dt/2 a(n)
    x(n+1/2) = x(n) + dt/2 u(n+1/2)             drift: and into the cells
    s(n+1)   = s(n) + dt D(x(n+1/2), u(n+1/2))  first sweep over pairs
    x(n+1)   = x(n+1/2) + dt/2 u(n+1/2)
    a(n+1)   = F(x(n+1), u(n+1/2), s(n+1))      second sweep over pairs
    u(n+1)   = u(n+1/2) + dt/2 a(n+1)

Each kernel gathers in registers and writes its own particle once.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

from fluidgym.sph.constants import Constants
from fluidgym.sph.neighbors import Grid, make_cell_of
from fluidgym.sph.pair_loop import make_pair_loop
from fluidgym.sph.terms import DensityRate, DensitySum, Drag, Force
from fluidgym.sph.walls import make_images
from fluidgym.state import Faces

# A particle whose neighbours weigh less than this, as sum V |W'/r| h^2, is spray and carries no pressure of its own.
# One neighbour, or its own mirror image, weighs about 0.4 at dx and 0.05 at 2 dx; a full neighbourhood weighs 3.5.
SPRAY_COMPANY = 0.05


@wp.kernel(module="fluidgym.integrate", enable_backward=False)
def aim_faces(duration: float, target: wp.array2d[float], faces: Faces):
    """Set the accelerations that bring the faces to their target velocities in a duration [s]."""
    world, face = wp.tid()
    faces.acceleration[world, face] = (target[world, face] - faces.velocity[world, face]) / duration


@wp.kernel(module="fluidgym.integrate", enable_backward=False)
def advance_faces(
    constants: wp.array[Constants],
    travel: wp.array2d[float],
    middle: Faces,
    end: Faces,
):
    """Move the faces by one step: to its middle and to its end. A face at the end of its travel stops."""
    world, face = wp.tid()
    dt = constants[world].dt
    u = end.velocity[world, face]
    a = end.acceleration[world, face]
    u_half = u + 0.5 * dt * a
    x = end.position[world, face]
    x_end = x + dt * u_half
    low = travel[face, 0]
    high = travel[face, 1]
    if x_end < low or x_end > high:
        x_end = wp.clamp(x_end, low, high)
        u_half = (x_end - x) / dt
        u = 0.0
        a = 0.0
        end.acceleration[world, face] = 0.0
    middle.position[world, face] = 0.5 * (x + x_end)
    middle.velocity[world, face] = u_half
    middle.acceleration[world, face] = a
    end.position[world, face] = x_end
    end.velocity[world, face] = u + dt * a


@wp.kernel(module="fluidgym.integrate", enable_backward=False)
def shift_acceleration(capacity: int, change: wp.array2d[float], acceleration: wp.array2d[float]):
    """Add what has changed of each world's gravity to the accelerations found before."""
    i = wp.tid()
    for k in range(change.shape[1]):
        acceleration[k, i] += change[i // capacity, k]


@lru_cache
def make_drift(dim: int, kinds: tuple[str, ...], no_slip: tuple[bool, ...]) -> wp.Kernel:
    """Kernel of the first half kick and drift, which also counts the particles of each cell."""
    vec = wp.types.vector(dim, wp.float32)
    images = make_images(dim, kinds, no_slip)
    keep_inside, wrap, has_left = images.keep_inside, images.wrap, images.has_left
    cell_of = make_cell_of(dim)

    @wp.kernel(module="unique", enable_backward=False)
    def drift(
        capacity: int,
        constants: wp.array[Constants],
        grid: Grid,
        faces: Faces,
        acceleration: wp.array2d[float],
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        identity: wp.array[int],
        key: wp.array[int],
        bounds: wp.array[int],
        clamped: wp.array[int],
    ):
        i = wp.tid()
        world = i // capacity
        dt = constants[world].dt
        cell = grid.stride - 1
        if identity[i] >= 0:
            x = vec()
            u = vec()
            for k in range(wp.static(dim)):
                u[k] = velocity[k, i] + 0.5 * dt * acceleration[k, i]
                x[k] = position[k, i] + 0.5 * dt * u[k]
            if wp.static("wall" in kinds):
                kept = keep_inside(x, u, world, faces, clamped)
                x = kept.position
                u = kept.velocity
            if wp.static("periodic" in kinds):
                x = wrap(x, world, faces)
            for k in range(wp.static(dim)):
                position[k, i] = x[k]
                velocity[k, i] = u[k]
            cell = cell_of(x, grid)
            if wp.static("open" in kinds):
                if has_left(x, world, faces):
                    identity[i] = -1 - identity[i]
                    cell = grid.stride - 1
        key[i] = world * grid.stride + cell
        wp.atomic_add(bounds, key[i] + 2, 1)

    return drift


@lru_cache
def make_advance_density(
    dim: int,
    kinds: tuple[str, ...],
    no_slip: tuple[bool, ...],
    terms: tuple[DensityRate, ...],
    slope: wp.Function,
    pressure: wp.Function,
    tilted: bool,
    plain: bool = False,
) -> wp.Kernel:
    """Kernel of the first sweep: density, pressure, and the second half drift."""
    vec = wp.types.vector(dim, wp.float32)
    images = make_images(dim, kinds, no_slip)
    near, count, query, keep_inside = images.near, images.count, images.query, images.keep_inside
    pair_loop, emit_terms = make_pair_loop(dim, terms, slope, force=False, tilted=tilted, plain=plain)
    has_images = any(kind != "open" for kind in kinds)

    @wp.kernel(module="unique", enable_backward=False)
    def advance_density(
        capacity: int,
        constants: wp.array[Constants],
        gravity: wp.array2d[float],
        grid: Grid,
        bounds: wp.array[int],
        faces: Faces,
        faces_end: Faces,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        density_error: wp.array[float],
        identity: wp.array[int],
        position_out: wp.array2d[float],
        density_error_out: wp.array[float],
        identity_out: wp.array[int],
        reduced_pressure: wp.array[float],
        clamped: wp.array[int],
    ):
        i = wp.tid()
        world = i // capacity
        c = constants[world]
        if capacity < 0:
            reduced_pressure[i] = emit_terms(c)
        identity_out[i] = identity[i]
        x = vec()
        u = vec()
        g = vec()
        for k in range(wp.static(dim)):
            x[k] = position[k, i]
            u[k] = velocity[k, i]
            g[k] = gravity[world, k]
        s = density_error[i]
        if identity[i] >= 0:
            sum = wp.vec2(0.0, 0.0)
            first_cell = world * grid.stride
            one = vec(1.0)
            if wp.static(has_images):
                found = near(x, world, faces, c.support)
                for n in range(count(found)):
                    q = query(n, found, x, u, g, world, faces, c)
                    sum += pair_loop(
                        q.position, q.velocity, s, q.offset, q.density_tilt, one,
                        first_cell, c.support, position, velocity, density_error, bounds, grid, c,
                    )  # fmt: skip
            else:
                tilt = c.inv_c_0_squared * g
                sum += pair_loop(
                    x, u, s, 0.0, tilt, one,
                    first_cell, c.support, position, velocity, density_error, bounds, grid, c,
                )  # fmt: skip
            s += c.dt * c.volume * sum[0]
            company = c.volume * c.h * c.h * (sum[1] + slope(0.0, c))  # the particle itself does not count
            s *= wp.clamp(company / SPRAY_COMPANY, 0.0, 1.0)
            x += 0.5 * c.dt * u
            if wp.static("wall" in kinds):
                kept = keep_inside(x, u, world, faces_end, clamped)
                x = kept.position
        for k in range(wp.static(dim)):
            position_out[k, i] = x[k]
        density_error_out[i] = s
        reduced_pressure[i] = pressure(s, c)

    return advance_density


@lru_cache
def make_kick(
    dim: int,
    kinds: tuple[str, ...],
    no_slip: tuple[bool, ...],
    terms: tuple[Force | Drag, ...],
    slope: wp.Function,
    tilted: bool,
    plain: bool = False,
) -> wp.Kernel:
    """Kernel of the second sweep: acceleration and the second half kick."""
    vec = wp.types.vector(dim, wp.float32)
    images = make_images(dim, kinds, no_slip)
    near, count, query, cushion = images.near, images.count, images.query, images.cushion
    pair_loop, emit_terms = make_pair_loop(
        dim, terms, slope, force=True, tilted=tilted, signed=any(no_slip), plain=plain
    )
    has_images = any(kind != "open" for kind in kinds)

    @wp.kernel(module="unique", enable_backward=False)
    def kick(
        capacity: int,
        constants: wp.array[Constants],
        gravity: wp.array2d[float],
        grid: Grid,
        bounds: wp.array[int],
        faces: Faces,
        position: wp.array2d[float],
        velocity: wp.array2d[float],
        reduced_pressure: wp.array[float],
        identity: wp.array[int],
        velocity_out: wp.array2d[float],
        acceleration: wp.array2d[float],
    ):
        i = wp.tid()
        world = i // capacity
        c = constants[world]
        if capacity < 0:
            acceleration[0, i] = emit_terms(c)
        x = vec()
        u = vec()
        g = vec()
        for k in range(wp.static(dim)):
            x[k] = position[k, i]
            u[k] = velocity[k, i]
            g[k] = gravity[world, k]
        a = vec()
        if identity[i] >= 0:
            P = reduced_pressure[i]
            first_cell = world * grid.stride
            reach = c.support + c.skin
            a = g
            if wp.static(has_images):
                found = near(x, world, faces, c.support)
                for n in range(count(found)):
                    q = query(n, found, x, u, g, world, faces, c)
                    f = pair_loop(
                        q.position, q.viscous_velocity, P, q.offset, q.pressure_tilt, q.viscous_turn,
                        first_cell, reach, position, velocity, reduced_pressure, bounds, grid, c,
                    )  # fmt: skip
                    a += c.volume * wp.cw_mul(q.turn, f)
                if wp.static("wall" in kinds):
                    a += cushion(x, world, faces, c)
            else:
                a += c.volume * pair_loop(
                    x, u, P, 0.0, vec(), vec(1.0),
                    first_cell, reach, position, velocity, reduced_pressure, bounds, grid, c,
                )  # fmt: skip
        for k in range(wp.static(dim)):
            velocity_out[k, i] = u[k] + 0.5 * c.dt * a[k]
            acceleration[k, i] = a[k]

    return kick


def make_step(
    dim: int,
    kinds: tuple[str, ...],
    no_slip: tuple[bool, ...],
    density_terms: tuple[DensityRate | DensitySum, ...],
    force_terms: tuple[Force | Drag, ...],
    slope: wp.Function,
    pressure: wp.Function,
    gravity: bool,
    plain: bool = False,
) -> SimpleNamespace:
    """The kernels of one step of this structure: drift, advance_density, kick."""
    has_walls = "wall" in kinds
    return SimpleNamespace(
        drift=make_drift(dim, kinds, no_slip),
        advance_density=make_advance_density(
            dim, kinds, no_slip, density_terms, slope, pressure, gravity or has_walls, plain
        ),
        kick=make_kick(dim, kinds, no_slip, force_terms, slope, has_walls, plain),
    )
