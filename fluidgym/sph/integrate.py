"""One step in time.

By default kick, drift, density, drift, force, kick:

    u(n+1/2) = u(n) + dt/2 a(n)
    x(n+1/2) = x(n) + dt/2 u(n+1/2)             drift: and into the cells
    s(n+1)   = s(n) + dt D(x(n+1/2), u(n+1/2))  first sweep over pairs
    x(n+1)   = x(n+1/2) + dt/2 u(n+1/2)
    a(n+1)   = F(x(n+1), u(n+1/2), s(n+1))      second sweep over pairs
    u(n+1)   = u(n+1/2) + dt/2 a(n+1)

This is the velocity-Verlet form of leapfrog with the density advanced at its middle, where positions and velocities are
both known at the half step (second order; reversible but for the dissipative terms). Other integrators are other shares
of the same steps (integrators.py). Each kernel gathers in registers and writes its own particle once.
"""

from functools import lru_cache
from types import SimpleNamespace

import warp as wp

from fluidgym.compilation import OPTIONS, shared_module
from fluidgym.records import fetch, get, put, set_to
from fluidgym.sph.bodies import make_bodies
from fluidgym.sph.constants import Constants
from fluidgym.sph.inflow import FREE, GONE, IN_PIPE, WEIGHED, make_carriers, make_emit
from fluidgym.sph.neighbors import Grid, make_cell_of, make_gather
from fluidgym.sph.pair_loop import make_pair_loop
from fluidgym.sph.shifting import make_shift
from fluidgym.sph.structure import Structure
from fluidgym.sph.sums import make_density_sum, make_force_sum, make_heat_sum
from fluidgym.sph.surroundings import SPRAY_COMPANY, packing_pressure, spray_share
from fluidgym.sph.walls import make_images
from fluidgym.state import Bodies, Drains, Faces, Frozen, Nozzles


@wp.kernel(module=shared_module("integrate"), enable_backward=False)
def aim(duration: float, target: wp.array2d[float], velocity: wp.array2d[float], acceleration: wp.array2d[float]):
    """Set the accelerations that bring what is driven to its target velocities in a duration [s]; (world, item)."""
    world, item = wp.tid()
    acceleration[world, item] = (target[world, item] - velocity[world, item]) / duration


@wp.kernel(module=shared_module("integrate"), enable_backward=False)
def advance_driven(
    constants: wp.array[Constants],
    travel: wp.array2d[float],
    position_middle: wp.array2d[float],
    velocity_middle: wp.array2d[float],
    acceleration_middle: wp.array2d[float],
    position: wp.array2d[float],
    velocity: wp.array2d[float],
    acceleration: wp.array2d[float],
):
    """Move what is driven by one step: to its middle and to its end. At the end of its travel it stops."""
    world, item = wp.tid()
    dt = constants[world].dt
    u = velocity[world, item]
    a = acceleration[world, item]
    u_half = u + 0.5 * dt * a
    x = position[world, item]
    x_end = x + dt * u_half
    low = travel[item, 0]
    high = travel[item, 1]
    if x_end < low or x_end > high:
        x_end = wp.clamp(x_end, low, high)
        u_half = (x_end - x) / dt
        u = 0.0
        a = 0.0
        acceleration[world, item] = 0.0
    position_middle[world, item] = 0.5 * (x + x_end)
    velocity_middle[world, item] = u_half
    acceleration_middle[world, item] = a
    position[world, item] = x_end
    velocity[world, item] = u + dt * a


@wp.kernel(module=shared_module("integrate"), enable_backward=False)
def shift_acceleration(capacity: int, change: wp.array2d[float], acceleration: wp.array2d[float]):
    """Add what has changed of each world's gravity to the accelerations found before."""
    i = wp.tid()
    for k in range(change.shape[1]):
        acceleration[k, i] += change[i // capacity, k]


@lru_cache
def make_drift(s: Structure) -> wp.Kernel:
    """Kernel of the opening kick and drift, which also counts the particles of each cell."""
    dim, kinds, steps = s.dim, s.kinds, s.integrator
    vec = wp.types.vector(dim, wp.float32)
    images, solids, carriers = make_images(s), make_bodies(s), make_carriers(s)
    keep_inside, wrap, has_left = images.keep_inside, images.wrap, images.has_left
    keep_out, carried = solids.keep_out, carriers.carried
    cell_of = make_cell_of(dim)

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def drift(
        capacity: int,
        constants: wp.array[Constants],
        grid: Grid,
        faces: Faces,
        bodies_before: Bodies,
        bodies: Bodies,
        nozzles: Nozzles,
        drains: Drains,
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
        c = constants[world]
        cell = grid.stride - 1
        if identity[i] >= 0:
            x_0 = vec()
            u_0 = vec()
            u = vec()
            x = vec()
            for k in range(wp.static(dim)):
                x_0[k] = get(position, k, i)
                u_0[k] = get(velocity, k, i)
                u[k] = u_0[k] + wp.static(steps.opening_kick) * c.dt * get(acceleration, k, i)
            if wp.static(s.carried):
                at = carried(x_0, world, nozzles, drains, c)
                if at.how == IN_PIPE:
                    u_0 = at.velocity
                    u = at.velocity
            if wp.static(steps.drift_first):
                x = x_0 + (wp.static(steps.opening_drift) * c.dt) * u_0
            else:
                x = x_0 + (wp.static(steps.opening_drift) * c.dt) * u
            if wp.static(s.has_walls):
                kept = keep_inside(x, u, world, faces, c, clamped)
                x = kept.position
                u = kept.velocity
            if wp.static(len(s.balls) > 0):
                out = keep_out(x_0, x, u, world, bodies_before, bodies, c, clamped)
                x = out.position
                u = out.velocity
            if wp.static("periodic" in kinds):
                x = wrap(x, world, faces)
            for k in range(wp.static(dim)):
                set_to(position, k, i, x[k])
                set_to(velocity, k, i, u[k])
            cell = cell_of(x, grid)
            leaves = bool(False)
            if wp.static("open" in kinds):
                leaves = has_left(x, world, faces)
            if wp.static(s.drains > 0):
                end = carried(x, world, nozzles, drains, c)
                if end.how == GONE:
                    leaves = True
            if wp.static(s.drains > 0 or "open" in kinds):
                if leaves:
                    identity[i] = -1 - identity[i]
                    cell = grid.stride - 1
        key[i] = world * grid.stride + cell
        wp.atomic_add(bounds, key[i] + 2, 1)

    return drift


@lru_cache
def make_advance_density(s: Structure) -> wp.Kernel:
    """Kernel of the first sweep: density, the field of the force terms, and the closing drift."""
    dim, weight, steps, field_of = s.dim, s.weight, s.integrator, s.field
    vec = wp.types.vector(dim, wp.float32)
    images, solids, carriers = make_images(s), make_bodies(s), make_carriers(s)
    keep_inside, keep_out, carried = images.keep_inside, solids.keep_out, carriers.carried
    density_sum, emit_terms = make_density_sum(s)
    middle, end, heat_at = s.middle_width, s.end_width, s.bare_width
    mean_loop, emit_mean = make_pair_loop(dim, (WEIGHED,), weight, False, middle, False, plain=s.plain, weight=weight)

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def advance_density(
        capacity: int,
        constants: wp.array[Constants],
        gravity: wp.array2d[float],
        grid: Grid,
        bounds: wp.array[int],
        faces: Faces,
        faces_end: Faces,
        bodies: Bodies,
        bodies_end: Bodies,
        nozzles: Nozzles,
        drains: Drains,
        frozen: Frozen,
        frozen_grid: Grid,
        records: wp.array[float],
        identity: wp.array[int],
        temperature: wp.array[float],
        position: wp.array2d[float],
        density_error: wp.array[float],
        identity_out: wp.array[int],
        records_out: wp.array[float],
        clamped: wp.array[int],
        sums: wp.array[float],
        spans: wp.array[int],
    ):
        i = wp.tid()
        world = i // capacity
        c = constants[world]
        if capacity < 0:
            density_error[i] = emit_terms(c)
            if wp.static(s.carried):
                density_error[i] = emit_mean(c)
        identity_out[i] = identity[i]
        slot = i + world * grid.slack
        x = vec()
        u = vec()
        g = vec()
        lean = vec()
        for k in range(wp.static(dim)):
            x[k] = fetch(records, slot, k, wp.static(middle))
            u[k] = fetch(records, slot, wp.static(dim) + k, wp.static(middle))
            g[k] = get(gravity, world, k)
            if wp.static(s.leaning):
                lean[k] = 0.5 * fetch(records, slot, wp.static(s.bare_width) + k, wp.static(middle))
        if wp.static(s.central):
            g -= c.central_force * x
        error = fetch(records, slot, wp.static(2 * dim), wp.static(middle))
        extra = float(0.0)
        crowd = float(1.0)
        how = FREE
        if wp.static(s.carried):
            if identity[i] >= 0:
                at = carried(x, world, nozzles, drains, c)
                how = at.how
                if how != FREE:
                    error = at.held
                    if how == IN_PIPE:
                        mean = mean_loop(
                            i, at.mirror, u, 0.0, 0.0, vec(), vec(1.0), world, c.support, records, bounds, grid, c,
                            sums, spans,
                        )  # fmt: skip
                        error = mean[0] / wp.max(mean[1], wp.static(SPRAY_COMPANY) / (c.volume * c.h * c.h))
        if identity[i] >= 0:
            free = how == FREE
            if free or wp.static(s.half):
                sum = density_sum(
                    i, free, x, u, error, g, lean, world, c.support, faces, bodies, frozen, frozen_grid, records,
                    bounds, grid, c, sums, spans,
                )  # fmt: skip
            if free:
                if wp.static(s.summed):
                    error = c.density_unit * c.volume * sum[0] - 1.0
                else:
                    rate = c.volume * sum[0]
                    error += c.dt * rate
                    # The particle itself does not count. Where there is no other either, walls do not pull on it.
                    itself = weight(0.0, c)
                    company = c.volume * c.h * c.h * (wp.where(error < 0.0, sum[1], sum[1] + sum[2]) + itself)
                    felt = spray_share(company)
                    crowd = c.volume * c.h * c.h * (sum[1] + sum[2] + itself) / c.full_company
                    error *= felt
                    extra = packing_pressure(crowd)
                    if wp.static(s.damped):
                        # An explicit damper is the stiffer the closer the particles are.
                        extra += c.damping * felt * rate / wp.max(crowd * crowd, 1.0)
            if wp.static(steps.closing_drift > 0.0):
                x_0 = x
                x += (wp.static(steps.closing_drift) * c.dt) * u
                if wp.static(s.has_walls):
                    kept = keep_inside(x, u, world, faces_end, c, clamped)
                    x = kept.position
                if wp.static(len(s.balls) > 0):
                    out = keep_out(x_0, x, u, world, bodies, bodies_end, c, clamped)
                    x = out.position
        for k in range(wp.static(dim)):
            set_to(position, k, i, x[k])
            put(records_out, slot, k, wp.static(end), x[k])
            put(records_out, slot, wp.static(dim) + k, wp.static(end), u[k])
        density_error[i] = error
        if wp.static(s.leveled):
            error += c.level
        put(records_out, slot, wp.static(2 * dim), wp.static(end), field_of(error, c) + extra)
        if wp.static(s.heat):
            put(records_out, slot, wp.static(heat_at), wp.static(end), temperature[i])
        if wp.static(s.surface):
            put(records_out, slot, wp.static(end - 1), wp.static(end), crowd)

    return advance_density


@lru_cache
def make_kick(s: Structure) -> wp.Kernel:
    """Kernel of the second sweep: acceleration and the closing kick."""
    dim = s.dim
    vec = wp.types.vector(dim, wp.float32)
    images, solids, carriers = make_images(s), make_bodies(s), make_carriers(s)
    cushion, body_cushion, carried = images.cushion, solids.cushion, carriers.carried
    closing_kick = s.integrator.closing_kick
    has_cushion = "mirror" in s.kinds or s.wall == "penalty"
    force_sum, emit_terms = make_force_sum(s)
    end = s.end_width

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def kick(
        capacity: int,
        constants: wp.array[Constants],
        gravity: wp.array2d[float],
        grid: Grid,
        bounds: wp.array[int],
        faces: Faces,
        bodies: Bodies,
        nozzles: Nozzles,
        drains: Drains,
        frozen: Frozen,
        frozen_grid: Grid,
        records: wp.array[float],
        identity: wp.array[int],
        velocity: wp.array2d[float],
        acceleration: wp.array2d[float],
        forces: wp.array3d[wp.int64],
        sums: wp.array[float],
        spans: wp.array[int],
    ):
        i = wp.tid()
        world = i // capacity
        c = constants[world]
        if capacity < 0:
            acceleration[0, i] = emit_terms(c)
        slot = i + world * grid.slack
        x = vec()
        u = vec()
        g = vec()
        for k in range(wp.static(dim)):
            x[k] = fetch(records, slot, k, wp.static(end))
            u[k] = fetch(records, slot, wp.static(dim) + k, wp.static(end))
            g[k] = get(gravity, world, k)
        if wp.static(s.central):
            g -= c.central_force * x
        a = vec()
        live = identity[i] >= 0
        free = live
        if wp.static(s.carried):
            if live:
                at = carried(x, world, nozzles, drains, c)
                free = at.how == FREE
        if live and (free or wp.static(s.half)):
            field = fetch(records, slot, wp.static(2 * dim), wp.static(end))
            a = force_sum(
                i, free, x, u, field, g, world, c.support + c.skin, faces, bodies, frozen, frozen_grid, records, bounds,
                grid, forces, c, sums, spans,
            )  # fmt: skip
        if not free:  # what it met, it met for the sake of the others
            a = vec()
        else:
            a += g
            if wp.static(has_cushion):
                a += cushion(x, world, faces, forces, c)
            if wp.static(len(s.balls) > 0):
                a += body_cushion(x, world, bodies, forces, c)
        for k in range(wp.static(dim)):
            set_to(velocity, k, i, u[k] + wp.static(closing_kick) * c.dt * a[k])
            set_to(acceleration, k, i, a[k])

    return kick


@lru_cache
def make_conduct(s: Structure) -> wp.Kernel:
    """Kernel that advances the temperature, with the positions at the end of the step."""
    dim = s.dim
    vec = wp.types.vector(dim, wp.float32)
    heat_sum, emit_terms = make_heat_sum(s)
    carried = make_carriers(s).carried

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def conduct(
        capacity: int,
        constants: wp.array[Constants],
        grid: Grid,
        bounds: wp.array[int],
        faces: Faces,
        bodies: Bodies,
        nozzles: Nozzles,
        drains: Drains,
        records: wp.array[float],
        identity: wp.array[int],
        temperature: wp.array[float],
        sums: wp.array[float],
        spans: wp.array[int],
    ):
        i = wp.tid()
        world = i // capacity
        c = constants[world]
        if capacity < 0:
            temperature[i] = emit_terms(c)
        slot = i + world * grid.slack
        T = fetch(records, slot, wp.static(s.bare_width), wp.static(s.end_width))
        x = vec()
        for k in range(wp.static(dim)):
            x[k] = fetch(records, slot, k, wp.static(s.end_width))
        live = identity[i] >= 0
        free = live
        if wp.static(s.carried):
            if live:
                at = carried(x, world, nozzles, drains, c)
                free = at.how == FREE
        if live and (free or wp.static(s.half)):
            rate = heat_sum(
                i, free, x, T, world, c.support + c.skin, faces, bodies, records, bounds, grid, c, sums, spans,
            )  # fmt: skip
            if free:
                T += c.dt * c.volume * rate
        temperature[i] = T

    return conduct


def make_step(s: Structure) -> SimpleNamespace:
    """The kernels of one step of this structure; those that have nothing to do in it are None."""
    return SimpleNamespace(
        drift=make_drift(s),
        advance_density=make_advance_density(s),
        kick=make_kick(s),
        conduct=make_conduct(s) if s.heat else None,
        emit=make_emit(s) if s.round_pipes else None,
        shift=make_shift(s) if s.shift is not None else None,
        gather=make_gather(s),
    )
