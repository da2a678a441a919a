"""The whole sum over what surrounds a particle: neighbours, images, shadows of bodies, frozen walls.

Three of them, one a sweep: density, force, and heat where there is any. What a structure lacks leaves no code.
"""

from functools import lru_cache, partial

import warp as wp

from fluidgym.sph.bodies import FOUR, FOUR_SHARES, NODE_SHARES, NODES, STEEPEST, make_bodies
from fluidgym.sph.constants import Constants
from fluidgym.sph.continuity import DENSITY_DIFFUSION
from fluidgym.sph.fans import make_density_fan, make_force_fan
from fluidgym.sph.heat import CONDUCTION
from fluidgym.sph.mueller import KERNEL_VISCOSITY
from fluidgym.sph.neighbors import Grid
from fluidgym.sph.pair_loop import make_pair_loop
from fluidgym.sph.structure import Structure
from fluidgym.sph.terms import Drag, Term, bound, no_term, total
from fluidgym.sph.viscosity import ARTIFICIAL_VISCOSITY, VISCOSITY_MONAGHAN, VISCOSITY_MORRIS
from fluidgym.sph.walls import make_images
from fluidgym.state import Bodies, Faces, Frozen


def _screen(s: Structure) -> tuple[bool, ...]:
    """Which rows of the screens are balls."""
    return s.balls * (2 if s.has_images else 1)


def _of_frozen(s: Structure, terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """The terms that frozen particles take part in.

    They would drain the pressure of the fluid by its diffusion, and hold the fluid back by its viscosity, which only a
    wall without slip does.
    """
    kept_out = [DENSITY_DIFFUSION, ARTIFICIAL_VISCOSITY]
    if not any(s.no_slip):
        kept_out += [VISCOSITY_MORRIS, VISCOSITY_MONAGHAN, KERNEL_VISCOSITY]
    return tuple(term for term in terms if term not in kept_out)


@wp.func
def point_volume(hit: float, end: float, m: int, share: float, dim: int, c: Constants) -> wp.vec2:
    """Distance [m] of the m-th dummy point of a ray that is filled from `hit` to `end`, and its share of a volume."""
    depth = end - hit
    r = hit + depth * NODES[m]
    area = r
    if dim == 3:
        area = r * r
    return wp.vec2(r, share * NODE_SHARES[m] * depth * area / c.volume)


@lru_cache
def make_density_sum(s: Structure) -> tuple[wp.Function, wp.Function]:
    """The first sweep's sum: (of the density terms, of -W'/r over particles, over what else is near), over V.

    And the function that emits the terms.
    """
    dim, leaning = s.dim, s.leaning
    tilted = s.gravity or s.has_walls or leaning
    vec = wp.types.vector(dim, wp.float32)
    flags = wp.types.vector(dim, wp.int32)
    images, solids, slope, weight = make_images(s), make_bodies(s), s.slope, s.weight
    near, count, query, near_bare = images.near, images.count, images.query, images.near_bare
    near_body, company, patch, ray, fan = solids.near, solids.company, solids.patch, solids.ray, solids.fan
    screens = solids.screens
    pair_loop = partial(make_pair_loop, dim, slope=slope, force=False, plain=s.plain, weight=weight)
    frozen_loop, emit_frozen = pair_loop(
        _of_frozen(s, s.density_terms), width=s.bare_width, tilted=False, of_images=True
    )
    of_fluid = partial(pair_loop, s.density_terms, width=s.middle_width, tilted=tilted, leaning=leaning)
    own, of_images = partial(of_fluid, half=s.half, central=s.central), partial(of_fluid, of_images=True)
    (loop, emit_fluid), (screened, _) = of_images(half=s.half_images), of_images(screen=_screen(s))
    (own_loop, _), (own_screened, _) = own(), own(screen=_screen(s))
    term = total(tuple(bound(term, dim) for term in s.density_terms))
    fan_sum = make_density_fan(dim, solids.Fan, term, slope, weight, FOUR, FOUR_SHARES)

    @wp.func
    def shadow_of_rays(
        x: vec, u: vec, a: float, found: flags, world: int, faces: Faces, bodies: Bodies, c: Constants
    ) -> wp.vec3:
        """The sum over the dummy points behind bodies."""
        sum = wp.vec3(0.0, 0.0, 0.0)
        around = company(x, found, world, bodies, faces, c.support)
        for n in range(bodies.patches):
            it = patch(n, around, x, found, world, bodies, faces, c.support)
            if it.seen:
                for k in range(bodies.rays):
                    hit = ray(k, it, x, found, world, bodies, faces, c.support)
                    if hit.distance < c.support:
                        closing = 2.0 * wp.dot(u - it.velocity, hit.direction)
                        for m in range(4):
                            point = point_volume(hit.distance, hit.end, m, hit.share, wp.static(dim), c)
                            r = point[0]
                            rate = term(r * r, -r * closing, slope(r, c), a, a, c)
                            sum += point[1] * wp.vec3(rate, 0.0, -weight(r, c))
        return sum

    @wp.func
    def shadow_of_fans(
        x: vec, u: vec, a: float, found: flags, world: int, faces: Faces, bodies: Bodies, c: Constants
    ) -> wp.vec3:
        """The same, all rays of a patch at once."""
        sum = wp.vec3(0.0, 0.0, 0.0)
        around = company(x, found, world, bodies, faces, c.support)
        for n in range(bodies.patches):
            it = patch(n, around, x, found, world, bodies, faces, c.support)
            if it.seen:
                sum += fan_sum(fan(it, x, found, world, bodies, faces, c.support), u - it.velocity, a, c)
        return sum

    shadow = shadow_of_fans if s.half else shadow_of_rays

    @wp.func
    def density_sum(
        i: int, free: bool, x: vec, u: vec, a: float, g: vec, lean: vec, world: int, reach: float, faces: Faces,
        bodies: Bodies, frozen: Frozen, frozen_grid: Grid, records: wp.array[float], bounds: wp.array[int], grid: Grid,
        c: Constants, sums: wp.array[float], spans: wp.array[int],
    ) -> wp.vec3:  # fmt: skip
        sum = wp.vec3(0.0, 0.0, 0.0)
        one = vec(1.0)
        tilt = c.inv_c_0_squared * (g - lean)
        shaded = bool(False)
        screening = bool(False)
        if wp.static(len(s.balls) > 0):
            shaded = near_body(x, world, bodies, c.support)
        if wp.static(s.hiding):
            screening = shaded
            if shaded:
                sum = own_screened(
                    i, x, u, a, 0.0, tilt, one, world, reach, records, bounds, grid, c, sums, spans,
                    screens(world, bodies, one, x, one, c.support),
                )  # fmt: skip
        if not screening:
            sum = own_loop(i, x, u, a, 0.0, tilt, one, world, reach, records, bounds, grid, c, sums, spans)
        if free:
            found = flags()
            if wp.static(s.has_images):
                found = near(x, world, faces, c.support)
                for n in range(1, count(found)):
                    q = query(n, found, x, u, g, lean, world, faces, c)
                    if wp.static(s.hiding):
                        if shaded:
                            sum += screened(
                                i, q.position, q.velocity, a, q.offset, q.density_tilt, one, world, reach, records,
                                bounds, grid, c, sums, spans,
                                screens(world, bodies, q.turn, q.plane, x - q.position, c.support),
                            )  # fmt: skip
                    if not screening:
                        sum += loop(
                            i, q.position, q.velocity, a, q.offset, q.density_tilt, one, world, reach, records, bounds,
                            grid, c, sums, spans,
                        )  # fmt: skip
            if wp.static(len(s.balls) > 0):
                if shaded:
                    sum += shadow(x, u, a, found, world, faces, bodies, c)
            if wp.static(s.frozen):
                if near_bare(x, world, faces, c.support):
                    sum += frozen_loop(
                        i,
                        x,
                        u,
                        a,
                        0.0,
                        vec(),
                        one,
                        0,
                        reach,
                        frozen.records,
                        frozen.bounds,
                        frozen_grid,
                        c,
                        sums,
                        spans,
                    )
        return sum

    @wp.func
    def emit_terms(c: Constants) -> float:
        value = emit_fluid(c)
        if wp.static(s.frozen):
            value += emit_frozen(c)
        return value

    return density_sum, emit_terms


@lru_cache
def make_force_sum(s: Structure) -> tuple[wp.Function, wp.Function]:
    """The second sweep's sum [m/s2], without gravity; and the function that emits the terms."""
    dim, tilted, signed, n_bodies = s.dim, s.has_walls, any(s.no_slip), len(s.balls)
    vec = wp.types.vector(dim, wp.float32)
    flags = wp.types.vector(dim, wp.int32)
    Forces = wp.types.matrix((max(n_bodies, 1), dim), wp.float32)
    sticky = wp.int32(sum(bool(stick) << body for body, stick in enumerate(s.no_slip_bodies)))
    images, solids, slope = make_images(s), make_bodies(s), s.slope
    near, count, query, near_bare = images.near, images.count, images.query, images.near_bare
    near_body, company, patch, ray, fan = solids.near, solids.company, solids.patch, solids.ray, solids.fan
    screens = solids.screens
    record_face, record_body = images.record, solids.record
    pair_loop = partial(make_pair_loop, dim, slope=slope, force=True, plain=s.plain)
    frozen_loop, emit_frozen = pair_loop(_of_frozen(s, s.force_terms), width=s.bare_width, tilted=False)
    of_fluid = partial(pair_loop, s.force_terms, width=s.end_width)
    own = partial(of_fluid, tilted=False, half=s.half)
    of_images = partial(of_fluid, tilted=tilted, signed=signed, of_images=True)
    (own_loop, emit_fluid), (own_screened, _) = own(), own(screen=_screen(s))
    (loop, _), (screened, _) = of_images(half=s.half_images), of_images(screen=_screen(s))
    drags = tuple(bound(term, dim) for term in s.force_terms if isinstance(term, Drag))
    force = total(tuple(bound(term, dim) for term in s.force_terms if not isinstance(term, Drag)))
    drag = total(drags) if drags else no_term
    fan_sum = make_force_fan(dim, solids.Fan, force, drag if drags else None, slope, STEEPEST, FOUR, FOUR_SHARES)

    @wp.func
    def record_bodies(of_body: Forces, world: int, forces: wp.array3d[wp.int64], c: Constants):
        """What the bodies do to a particle goes to the sums."""
        for b in range(wp.static(n_bodies)):
            value = vec()
            for k in range(wp.static(dim)):
                value[k] = c.volume * of_body[b, k]
            record_body(value, world, b, forces, c)

    @wp.func
    def shadow_of_rays(
        x: vec, u: vec, a: float, g: vec, found: flags, world: int, faces: Faces, bodies: Bodies,
        forces: wp.array3d[wp.int64], c: Constants,
    ) -> vec:  # fmt: skip
        """The sum over the dummy points behind bodies."""
        sum = vec()
        of_body = Forces()
        around = company(x, found, world, bodies, faces, c.support)
        for n in range(bodies.patches):
            it = patch(n, around, x, found, world, bodies, faces, c.support)
            if it.seen:
                part = vec()
                for k in range(bodies.rays):
                    hit = ray(k, it, x, found, world, bodies, faces, c.support)
                    if hit.distance < c.support:
                        e = hit.direction
                        # The fluid follows the body along its normal only, and so does the pressure.
                        pushed = wp.dot(it.acceleration, hit.normal) * wp.dot(hit.normal, e)
                        pull = (wp.dot(g, e) - pushed) * c.inv_c_0_squared
                        slip = u - it.velocity
                        if (sticky >> it.body) & 1 == 0:
                            slip = wp.dot(slip, hit.normal) * hit.normal
                        for m in range(4):
                            point = point_volume(hit.distance, hit.end, m, hit.share, wp.static(dim), c)
                            r = point[0]
                            v = slip * wp.min(r / wp.max(hit.distance, 1.0e-12), STEEPEST)
                            a_m = wp.max(a + pull * r, wp.min(a, 0.0))
                            w = slope(r, c)
                            xu = -r * wp.dot(e, v)
                            part -= (point[1] * r * force(r * r, xu, w, a, a_m, c)) * e
                            if wp.static(len(drags) > 0):
                                part += (point[1] * drag(r * r, xu, w, a, a_m, c)) * v
                sum += part
                if wp.static(s.forces):
                    for k in range(wp.static(dim)):
                        of_body[it.body, k] += part[k]
        if wp.static(s.forces):
            record_bodies(of_body, world, forces, c)
        return sum

    @wp.func
    def shadow_of_fans(
        x: vec, u: vec, a: float, g: vec, found: flags, world: int, faces: Faces, bodies: Bodies,
        forces: wp.array3d[wp.int64], c: Constants,
    ) -> vec:  # fmt: skip
        """The same, all rays of a patch at once."""
        sum = vec()
        of_body = Forces()
        around = company(x, found, world, bodies, faces, c.support)
        for n in range(bodies.patches):
            it = patch(n, around, x, found, world, bodies, faces, c.support)
            if it.seen:
                part = fan_sum(
                    fan(it, x, found, world, bodies, faces, c.support), u - it.velocity, it.acceleration, a, g,
                    (sticky >> it.body) & 1 != 0, c,
                )  # fmt: skip
                sum += part
                if wp.static(s.forces):
                    for k in range(wp.static(dim)):
                        of_body[it.body, k] += part[k]
        if wp.static(s.forces):
            record_bodies(of_body, world, forces, c)
        return sum

    shadow = shadow_of_fans if s.half else shadow_of_rays

    @wp.func
    def force_sum(
        i: int, free: bool, x: vec, u: vec, a: float, g: vec, world: int, reach: float, faces: Faces, bodies: Bodies,
        frozen: Frozen, frozen_grid: Grid, records: wp.array[float], bounds: wp.array[int], grid: Grid,
        forces: wp.array3d[wp.int64], c: Constants, sums: wp.array[float], spans: wp.array[int],
    ) -> vec:  # fmt: skip
        sum = vec()
        zero = vec()
        one = vec(1.0)
        shaded = bool(False)
        screening = bool(False)
        if wp.static(n_bodies > 0):
            shaded = near_body(x, world, bodies, c.support)
        if wp.static(s.hiding):
            screening = shaded
            if shaded:
                sum = own_screened(
                    i, x, u, a, 0.0, zero, one, world, reach, records, bounds, grid, c, sums, spans,
                    screens(world, bodies, one, x, one, c.support),
                )  # fmt: skip
        if not screening:
            sum = own_loop(i, x, u, a, 0.0, zero, one, world, reach, records, bounds, grid, c, sums, spans)
        if free:
            found = flags()
            if wp.static(s.has_images):
                found = near(x, world, faces, c.support)
                for n in range(1, count(found)):
                    q = query(n, found, x, u, g, zero, world, faces, c)
                    f = vec()
                    if wp.static(s.hiding):
                        if shaded:
                            f = screened(
                                i, q.position, q.viscous_velocity, a, q.offset, q.pressure_tilt, q.viscous_turn, world,
                                reach, records, bounds, grid, c, sums, spans,
                                screens(world, bodies, q.turn, q.plane, x - q.position, c.support),
                            )  # fmt: skip
                    if not screening:
                        f = loop(
                            i, q.position, q.viscous_velocity, a, q.offset, q.pressure_tilt, q.viscous_turn, world,
                            reach, records, bounds, grid, c, sums, spans,
                        )  # fmt: skip
                    sum += wp.cw_mul(q.turn, f)
                    if wp.static(s.forces and "mirror" in s.kinds):
                        record_face(c.volume * wp.cw_mul(q.turn, f), q.face, world, forces, c)
            if wp.static(n_bodies > 0):
                if shaded:
                    sum += shadow(x, u, a, g, found, world, faces, bodies, forces, c)
            if wp.static(s.frozen):
                if near_bare(x, world, faces, c.support):
                    sum += frozen_loop(
                        i, x, u, a, 0.0, zero, one, 0, reach, frozen.records, frozen.bounds, frozen_grid, c, sums, spans
                    )
        return c.volume * sum

    @wp.func
    def emit_terms(c: Constants) -> float:
        value = emit_fluid(c)
        if wp.static(s.frozen):
            value += emit_frozen(c)
        return value

    return force_sum, emit_terms


@lru_cache
def make_heat_sum(s: Structure) -> tuple[wp.Function, wp.Function]:
    """Rate of change of the temperature over V; and the function that emits the term.

    A wall of its own temperature T_w shows T_m = 2 T_w - T_j, an insulated one T_m = T_j. Seen from the particle,
    T_i - (flip T_j + shift) is flip ((T_i - shift) flip - T_j): the same sum from another temperature.
    """
    dim = s.dim
    vec = wp.types.vector(dim, wp.float32)
    flags = wp.types.vector(dim, wp.int32)
    warm = wp.int32(sum(bool(own) << body for body, own in enumerate(s.warm_bodies)))
    images, solids, slope = make_images(s), make_bodies(s), s.slope
    near, count, query = images.near, images.count, images.query
    near_body, company, patch, ray, screens = solids.near, solids.company, solids.patch, solids.ray, solids.screens
    of_fluid = partial(
        make_pair_loop, dim, (CONDUCTION,), slope, False, s.end_width, False, plain=s.plain, field_at=2 * dim + 1
    )
    own = partial(of_fluid, half=s.half)
    (own_loop, emit_terms), (own_screened, _) = own(), own(screen=_screen(s))
    (loop, _), (screened, _) = of_fluid(), of_fluid(screen=_screen(s))
    term = CONDUCTION.function

    @wp.func
    def shadow(x: vec, a: float, found: flags, world: int, faces: Faces, bodies: Bodies, c: Constants) -> float:
        """The sum over the dummy points behind bodies: linear from the particle through the surface."""
        sum = float(0.0)
        around = company(x, found, world, bodies, faces, c.support)
        for n in range(bodies.patches):
            it = patch(n, around, x, found, world, bodies, faces, c.support)
            if it.seen and (warm >> it.body) & 1 != 0:
                for k in range(bodies.rays):
                    hit = ray(k, it, x, found, world, bodies, faces, c.support)
                    if hit.distance < c.support:
                        for m in range(4):
                            point = point_volume(hit.distance, hit.end, m, hit.share, wp.static(dim), c)
                            r = point[0]
                            grown = wp.min(r / wp.max(hit.distance, 1.0e-12), STEEPEST)
                            a_m = a - grown * (a - bodies.temperature[it.body])
                            sum += point[1] * term(r, 0.0, slope(r, c), a, a_m, c)
        return sum

    @wp.func
    def heat_sum(
        i: int, free: bool, x: vec, a: float, world: int, reach: float, faces: Faces, bodies: Bodies,
        records: wp.array[float], bounds: wp.array[int], grid: Grid, c: Constants, sums: wp.array[float],
        spans: wp.array[int],
    ) -> float:  # fmt: skip
        part = wp.vec3(0.0, 0.0, 0.0)
        zero = vec()
        one = vec(1.0)
        shaded = bool(False)
        screening = bool(False)
        if wp.static(len(s.balls) > 0):
            shaded = near_body(x, world, bodies, c.support)
        if wp.static(s.hiding):
            screening = shaded
            if shaded:
                part = own_screened(
                    i, x, zero, a, 0.0, zero, one, world, reach, records, bounds, grid, c, sums, spans,
                    screens(world, bodies, one, x, one, c.support),
                )  # fmt: skip
        if not screening:
            part = own_loop(i, x, zero, a, 0.0, zero, one, world, reach, records, bounds, grid, c, sums, spans)
        sum = part[0]
        if free:
            found = flags()
            if wp.static(s.has_images):
                found = near(x, world, faces, c.support)
                for n in range(1, count(found)):
                    q = query(n, found, x, zero, zero, zero, world, faces, c)
                    if wp.static(s.hiding):
                        if shaded:
                            part = screened(
                                i, q.position, zero, q.flip * (a - q.shift), 0.0, zero, one, world, reach, records,
                                bounds, grid, c, sums, spans,
                                screens(world, bodies, q.turn, q.plane, x - q.position, c.support),
                            )  # fmt: skip
                    if not screening:
                        part = loop(
                            i, q.position, zero, q.flip * (a - q.shift), 0.0, zero, one, world, reach, records, bounds,
                            grid, c, sums, spans,
                        )  # fmt: skip
                    sum += q.flip * part[0]
            if wp.static(len(s.balls) > 0):
                if shaded:
                    sum += shadow(x, a, found, world, faces, bodies, c)
        return sum

    return heat_sum, emit_terms
