"""Particle shifting: particles in disorder are moved a little, to where the sums over them are even.

    dr_i = -A U h dt sum_j V (1 + 0.2 (W(r)/W(dx))^4) grad W(x_ij)

(after Lind et al. 2012, eq. 26, with U h in place of a diffusivity as Sun et al. 2017 have it; the second part keeps
pairs from clumping, Monaghan 2000). Velocity and density stay with the particle. In this form it is for boxes full of
fluid: at a free surface it would push particles out and inflate the fluid.

Where there is a surface (Scheme.surface_shifting) a particle that is less crowded than inside is only pushed by those
that are closer than dx: of the bracket it has 0.5 max((W(r)/W(dx))^4 - 1, 0), and the others 1 + 0.5 (W(r)/W(dx))^4.
Nothing is known of normals: how crowded it is the first sweep has found. Fluid under tension, which else clumps and
tears, keeps its order: in a rotating square patch of 32 spacings the nearest two are 0.87 spacings apart after a third
of a turn, and 0.03 without. It is not for fluid that lies under gravity: U is then much more than how fast most of it
moves, and the second row below a surface pushes outward; still water rises by 3.5 % of its depth, and the front of a
dam break is off by 5 %.

Shifting moves density from place to place without the continuity equation, so that the mean density error of a box
whose volume and mass never change drifts; negative pressure opens voids. The step therefore takes from every density
error what their mean has gained in it, which leaves the mean at that of the start without anything to remember. And the
force sweep reads the pressure of s + level (layout.py): a uniform pressure changes nothing in a full box but that
particles under it lie more evenly. The density error that is kept, and all that is read from it, knows no level; the
forces on walls do, and are read without it. Terms of one's own see the level in P, not in s.

Where sums are uneven the level pushes, which viscosity turns into lost energy: too much of it, and the error no longer
falls with the spacing. Taylor-Green vortices at h = 2 dx, 50 and 100 across, error of the speed in percent:

    A   level 0      0.05 U^2/c_0^2   0.1          0.2          1
    1   0.93  0.26   0.72  0.21       0.55  0.21   0.40  0.39   3.10
    2   0.94  0.27   0.80  0.15       0.65  0.10   0.42  0.26
    4   0.90  0.26   0.77  0.16       0.66  0.09   0.47  0.19

and 3.4 at 50 without shifting. From 0.02 to 0.2 the longest shift changes nothing.
"""

from functools import lru_cache, partial

import warp as wp

from fluidgym.compilation import OPTIONS, shared_module
from fluidgym.records import fetch
from fluidgym.sph.bodies import make_bodies
from fluidgym.sph.constants import Constants
from fluidgym.sph.inflow import FREE, make_carriers
from fluidgym.sph.neighbors import Grid
from fluidgym.sph.pair_loop import make_pair_loop
from fluidgym.sph.smoothing import SmoothingKernel
from fluidgym.sph.structure import Structure
from fluidgym.sph.terms import Force
from fluidgym.sph.walls import make_images
from fluidgym.state import Bodies, Drains, Faces, Nozzles

# Longest shift of a step, over the spacing.
LONGEST = 0.05

# Crowd below which a particle is near a surface, and that below which it is spray and left alone.
INSIDE = 0.97
SPRAY = 0.2

# How much more than evenness a pair that is too close counts: in a full box, and where there is a surface.
CLUMPING = 0.2
SURFACE_CLUMPING = 0.5

CHUNK = 32  # slots that one thread adds up, so that few threads wait for each other
ONE = wp.constant(float(1 << 40))  # a density error of 1 in the fixed point of their sum


@lru_cache
def shift_term(kernel: SmoothingKernel, dim: int, surface: bool) -> Force:
    """What a neighbour adds to a shift, over -A U h dt: V (1 + C (W(r)/W(dx))^4) grad W.

    With a surface it reads how crowded i is, and near the surface is V C max((W(r)/W(dx))^4 - 1, 0) grad W.
    """
    value, slope = kernel.value(dim), kernel.slope(dim)

    @wp.func
    def closeness(r: float, c: Constants) -> float:
        share = value(r, c) * (1.0 / value(c.spacing, c))
        square = share * share
        return square * square

    @wp.func
    def evening(r: float, xu: float, w: float, a_i: float, a_j: float, c: Constants) -> float:
        return (1.0 + wp.static(CLUMPING) * closeness(r, c)) * slope(r, c)

    @wp.func
    def evening_inside(r: float, xu: float, w: float, a_i: float, a_j: float, c: Constants) -> float:
        close = closeness(r, c)
        apart = wp.static(SURFACE_CLUMPING) * wp.max(close - 1.0, 0.0)
        return wp.where(a_i < wp.static(INSIDE), apart, 1.0 + wp.static(SURFACE_CLUMPING) * close) * slope(r, c)

    return Force(evening_inside if surface else evening)


@lru_cache
def make_shift_sum(s: Structure) -> tuple[wp.Function, wp.Function]:
    """The sum of the shift over neighbours and images [1/m], over V; and the function that emits the term."""
    dim = s.dim
    vec = wp.types.vector(dim, wp.float32)
    flags = wp.types.vector(dim, wp.int32)
    images = make_images(s)
    near, count, query = images.near, images.count, images.query
    field_at = s.end_width - 1 if s.surface else None
    of_fluid = partial(
        make_pair_loop, dim, (s.shift,), s.slope, True, s.end_width, False, plain=s.plain, field_at=field_at
    )
    (own_loop, emit_terms), (loop, _) = of_fluid(half=s.half), of_fluid()

    @wp.func
    def shift_sum(
        i: int, x: vec, crowd: float, world: int, reach: float, faces: Faces, records: wp.array[float],
        bounds: wp.array[int], grid: Grid, c: Constants, sums: wp.array[float], spans: wp.array[int],
    ) -> vec:  # fmt: skip
        zero = vec()
        sum = own_loop(i, x, zero, crowd, 0.0, zero, zero, world, reach, records, bounds, grid, c, sums, spans)
        found = near(x, world, faces, c.support)
        for n in range(1, count(found)):
            q = query(n, found, x, zero, zero, zero, world, faces, c)
            part = loop(
                i, q.position, zero, crowd, 0.0, zero, zero, world, reach, records, bounds, grid, c, sums, spans
            )  # fmt: skip
            sum += wp.cw_mul(q.turn, part)
        return sum

    return shift_sum, emit_terms


@wp.kernel(module=shared_module("shifting"), enable_backward=False)
def add_up_gain(
    capacity: int, before: wp.array[float], now: wp.array[float], identity: wp.array[int], gain: wp.array[wp.int64]
):
    """Add up what the density errors of each world gain in a step, in fixed point, so that the order does not count."""
    world, chunk = wp.tid()
    sum = float(0.0)
    for slot in range(chunk * CHUNK, wp.min((chunk + 1) * CHUNK, capacity)):
        i = world * capacity + slot
        if identity[i] >= 0:
            sum += now[i] - before[i]
    wp.atomic_add(gain, world, wp.int64(wp.round(sum * ONE)))


@lru_cache
def make_shift(s: Structure) -> wp.Kernel:
    """Kernel that shifts the particles at the end of a step, and takes the mean's gain from their density errors."""
    dim, kinds = s.dim, s.kinds
    vec = wp.types.vector(dim, wp.float32)
    shift_sum, emit_terms = make_shift_sum(s)
    near_body, carried = make_bodies(s).near, make_carriers(s).carried
    walls = wp.int32(sum((kind == "mirror") << face for face, kind in enumerate(kinds)))

    @wp.kernel(module="unique", module_options=OPTIONS, enable_backward=False)
    def shift(
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
        gain: wp.array[wp.int64],
        density_error: wp.array[float],
        position: wp.array2d[float],
        sums: wp.array[float],
        spans: wp.array[int],
    ):
        i = wp.tid()
        world = i // capacity
        c = constants[world]
        if capacity < 0:
            density_error[i] = emit_terms(c)
        x = vec()
        for k in range(wp.static(dim)):
            x[k] = position[k, i]
        if identity[i] >= 0:
            reach = c.support + c.skin
            crowd = float(1.0)
            if wp.static(s.surface):
                crowd = fetch(records, i + world * grid.slack, wp.static(s.end_width - 1), wp.static(s.end_width))
            sum = shift_sum(i, x, crowd, world, reach, faces, records, bounds, grid, c, sums, spans)
            if wp.static(s.surface):
                if crowd < wp.static(SPRAY):
                    sum = vec()
            if wp.static(len(s.balls) > 0):
                if near_body(x, world, bodies, c.support):
                    sum = vec()
            if wp.static(s.carried):
                at = carried(x, world, nozzles, drains, c)
                if at.how != FREE:
                    sum = vec()
            d = (-c.shifting * c.dt * c.volume) * sum
            length = wp.length(d)
            longest = wp.static(LONGEST) * c.spacing
            if length > longest:
                d *= longest / length
            x += d
            # Beyond a periodic face the next drift brings a particle back in; a wall has to be kept here.
            for k in range(wp.static(dim)):
                if (walls >> (2 * k)) & 1 != 0:
                    x[k] = wp.max(x[k], faces.position[world, 2 * k])
                if (walls >> (2 * k + 1)) & 1 != 0:
                    x[k] = wp.min(x[k], faces.position[world, 2 * k + 1])
            if wp.static(s.leveled):
                # Beyond the cells of a world's box there is one more, of its retired particles.
                first = world * grid.stride
                live = bounds[first + grid.stride - 1] - bounds[first]
                density_error[i] -= float(gain[world]) / (ONE * float(live))
        for k in range(wp.static(dim)):
            position[k, i] = x[k]

    return shift
